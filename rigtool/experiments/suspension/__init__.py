"""The springs that an instrument hangs in."""
