"""Memory that was freed, and that the C library keeps for what comes next: malloc_trim(3) of glibc
2.8 (2008) gives it back."""

from __future__ import annotations

import ctypes


def give_back() -> None:
    """Return freed memory to the kernel: before results that need as much as what was freed, but in
    pieces of another size. Other C libraries than glibc are left alone."""
    try:
        ctypes.CDLL(None).malloc_trim(0)
    except (AttributeError, OSError, TypeError):
        return
