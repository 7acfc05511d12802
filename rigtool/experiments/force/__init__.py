"""Force from current: cycles, correction, uncertainty."""
