"""Plateaus of a signal x: |x_(i+1) - x_i| <= step, and max x - min x <= largest; alike values."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from rigtool.numerics.arrays import Array, Mask

MIN_PLATEAU_VALUES = 3
"""Smallest number of values on a plateau."""


def find_plateaus(level: Array, step: float, largest: float) -> list[tuple[int, int]]:
    """Return first and last + 1 value of each plateau of a signal (n,).

    On a plateau |x_(i+1) - x_i| <= `step` and max x - min x <= `largest`: a slow ramp is not a
    plateau.
    """
    return [
        (a, b + 1)
        for a, b in runs_of(np.abs(np.diff(level)) <= step)
        if b + 1 - a >= MIN_PLATEAU_VALUES and np.ptp(level[a : b + 1]) <= largest
    ]


def runs_of(mask: Mask) -> list[tuple[int, int]]:
    """Return where runs of a mask (n,) begin and end."""
    ends = np.flatnonzero(np.diff(mask, prepend=False, append=False)).tolist()
    return list(zip(ends[::2], ends[1::2], strict=True))


def group_numbers(values: Array, apart: float) -> NDArray[np.int64]:
    """Return the number of each value's group (n,), that of the lowest values first.

    In a group, no value is further than `apart` from the next one.
    """
    order = np.argsort(values, kind="stable")
    number = np.empty(len(order), dtype=np.int64)
    number[order] = np.cumsum(np.diff(values[order], prepend=-np.inf) > apart) - 1
    return number
