"""Known loads read from current: cycles, correction, uncertainty."""
