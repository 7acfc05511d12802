"""Checks that every analysis makes on its input arrays."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from rigtool.errors import InsufficientDataError
from rigtool.numerics.arrays import Array


def require_signals(minimum: int = 1, **signals: ArrayLike) -> tuple[Array, ...]:
    """Return signals as f8 arrays of one common length without NaN or infinity.

    Raises `InsufficientDataError` that names the signal, the sample and the remedy.
    """
    arrays = {name: np.asarray(values, dtype=np.float64) for name, values in signals.items()}
    first = next(iter(arrays))
    for name, values in arrays.items():
        if values.ndim != 1:
            raise InsufficientDataError(
                f"{name} has {values.ndim} dimensions, expected 1: give one value a sample"
            )
        if len(values) != len(arrays[first]):
            raise InsufficientDataError(
                f"{name} has {len(values)} samples but {first} has {len(arrays[first])}: "
                "record all signals together"
            )
        bad = np.flatnonzero(~np.isfinite(values))
        if len(bad):
            raise InsufficientDataError(
                f"{name} is {values[bad[0]]} at sample {bad[0]} ({len(bad)} of {len(values)} "
                "samples are not finite): repair the recording or measure again"
            )
    if len(arrays[first]) < minimum:
        raise InsufficientDataError(
            f"{len(arrays[first])} samples are too few, {minimum} are needed: record for longer"
        )
    return tuple(arrays.values())


def require_rising(time: Array) -> float:
    """Return the median sample time, s, of a time (n,); raise where time does not rise."""
    return float(np.median(rising_steps(time)))


def rising_steps(time: Array, first: int = 0) -> Array:
    """Return the steps of a rising time (n,), (n-1,) in s; raise where it does not rise.

    `first` is the number of the first sample, where a block of a longer signal is given. The
    error is an `InsufficientDataError`.
    """
    steps: Array = np.diff(time)
    if steps.size and steps.min() <= 0:
        bad = int(np.argmax(steps <= 0))
        raise InsufficientDataError(
            f"time does not rise at sample {first + bad + 1} ({time[bad + 1]:.10g} s after "
            f"{time[bad]:.10g} s): recordings must be in the order of the bench clock"
        )
    return steps
