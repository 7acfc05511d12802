"""Emulators of devices: they speak a protocol byte for byte on a pseudo-terminal or a socket."""
