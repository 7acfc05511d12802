"""Pure numerics: arrays in, frozen dataclasses out. Knows no file, no command line, no recipe."""
