"""Functions that numba compiles (Lam, Pitrou and Seibert, LLVM-HPC 2015); machine code is kept.

numba is imported with the first call of such a function: that takes a third of a second, and most
commands call none.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import update_wrapper
from hashlib import sha256
from inspect import ismodule
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
    written, in a read-only installation without a home, each program compiles anew. Its name holds
    what it was made of, since numba itself looks at the function's own file only. The first call
    raises `UsageError` where variables of the environment keep numba from compiling.
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
                made_of = sha256("\n".join(_parts(self._function, set())).encode()).hexdigest()
                self._function.__qualname__ += f"-{made_of[:12]}"
                try:
                    self._dispatcher = njit(cache=True, **options)(self._function)
                except RuntimeError:  # numba: cannot cache function, no locator for its file
                    self._dispatcher = njit(**options)(self._function)
        return self._dispatcher


def _parts(function: Callable[..., Any], seen: set[Callable[..., Any]]) -> Iterator[str]:
    """Yield what numba compiles into a function: its code, and, of any module, the numbers and
    tuples that this names and the same of the functions that it calls, each of them once."""
    seen.add(function)
    code = function.__code__
    yield f"{code.co_code.hex()} {code.co_consts} {function.__defaults__}"
    named = [function.__globals__.get(name) for name in code.co_names]
    for scope in (function.__globals__, *(vars(one) for one in named if ismodule(one))):
        for name in code.co_names:
            value = scope.get(name)
            if isinstance(value, _Compiled) and value._function not in seen:
                yield from _parts(value._function, seen)
            elif isinstance(value, int | float | tuple):
                yield f"{name} = {value}"
