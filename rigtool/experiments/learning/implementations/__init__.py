"""The ways to learn: a module for each implementation of section 7.2.4, and their common parts."""
