"""Functions that numba compiles (Lam, Pitrou and Seibert, LLVM-HPC 2015); machine code is kept."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from numba import njit


def compiled(function: Callable[..., Any]) -> Any:
    """Return a function that numba compiles at its first call; threads may run it side by side.

    A division by zero gives infinity or NaN, as in numpy: a check would keep loops from several
    numbers at a time.

    The machine code is kept beside the module, or in the user's cache; where neither can be
    written, in a read-only installation without a home, each program compiles anew.
    """
    try:
        return njit(cache=True, error_model="numpy", nogil=True)(function)
    except RuntimeError:  # numba: cannot cache function, no locator available for its file
        return njit(error_model="numpy", nogil=True)(function)
