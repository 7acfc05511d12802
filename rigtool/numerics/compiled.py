"""Functions that numba compiles (Lam, Pitrou and Seibert, LLVM-HPC 2015); machine code is kept.

numba is imported with the first call of such a function: that takes a third of a second, and most
commands call none.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import update_wrapper
from threading import Lock
from typing import Any

from rigtool.errors import UsageError

_LOCK = Lock()


def compiled(function: Callable[..., Any]) -> Any:
    """Return a function that numba compiles at its first call; threads may run it side by side.

    It must not allocate: numba does not count references to its arrays. Counts are atomic, and took
    a sixth of a filter's time. What allocates is `compiled_allocating`.

    A division by zero gives infinity or NaN, as in numpy: a check would keep loops from several
    numbers at a time.

    The machine code is kept beside the module, or in the user's cache; where neither can be
    written, in a read-only installation without a home, each program compiles anew. The first
    call raises `UsageError` where variables of the environment keep numba from compiling.
    """
    return _Compiled(function, counted=False)


def compiled_allocating(function: Callable[..., Any]) -> Any:
    """Return a function as `compiled` does that makes arrays or lists, or assigns slices."""
    return _Compiled(function, counted=True)


class _Compiled:
    """A function that becomes numba's own when it is called, from Python or from another one."""

    def __init__(self, function: Callable[..., Any], *, counted: bool) -> None:
        update_wrapper(self, function)
        self._function, self._counted = function, counted
        self._dispatcher: Any = None

    def __call__(self, *arguments: Any) -> Any:
        return (self._dispatcher or self._compile())(*arguments)

    @property
    def _numba_type_(self) -> Any:
        """The type that numba sees where another compiled function calls this one."""
        return (self._dispatcher or self._compile())._numba_type_

    def _compile(self) -> Any:
        try:
            from numba import config, njit
        except ValueError as error:
            raise UsageError(f"numba: {error}: correct the variables NUMBA_*") from None
        if config.DISABLE_JIT:
            raise UsageError("NUMBA_DISABLE_JIT is set, without numba nothing is fast: unset it")
        options: dict[str, Any] = {"error_model": "numpy", "nogil": True, "_nrt": self._counted}
        with _LOCK:
            if self._dispatcher is None:
                try:
                    self._dispatcher = njit(cache=True, **options)(self._function)
                except RuntimeError:  # numba: cannot cache function, no locator for its file
                    self._dispatcher = njit(**options)(self._function)
        return self._dispatcher
