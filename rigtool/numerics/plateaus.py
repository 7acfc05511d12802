"""Plateaus of a signal x: |x_(i+1) - x_i| <= step, and max x - min x <= largest; alike values."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from rigtool.numerics.arrays import Array

MIN_PLATEAU_VALUES = 3
"""Smallest number of values on a plateau."""


def find_plateaus(level: Array, step: float, largest: float) -> list[tuple[int, int]]:
    """Return first and last + 1 value of each plateau of a signal (n,).

    On a plateau |x_(i+1) - x_i| <= `step` and max x - min x <= `largest`: a slow ramp is not a
    plateau.
    """
    flat = np.abs(np.diff(level)) <= step
    ends = np.flatnonzero(np.diff(np.concatenate([[False], flat, [False]]).astype(np.int8)))
    stretches = ((int(a), int(b) + 1) for a, b in ends.reshape(-1, 2))
    return [
        (a, b)
        for a, b in stretches
        if b - a >= MIN_PLATEAU_VALUES and np.ptp(level[a:b]) <= largest
    ]


def group_numbers(values: Array, apart: float) -> NDArray[np.int64]:
    """Return the number of each value's group (n,), that of the lowest values first.

    In a group, no value is further than `apart` from the next one.
    """
    order = np.argsort(values, kind="stable")
    number = np.empty(len(order), dtype=np.int64)
    number[order] = np.cumsum(np.diff(values[order], prepend=-np.inf) > apart) - 1
    return number
