"""Settling of a signal: low - margin <= signal <= high + margin, the range of its last part."""

from __future__ import annotations

import numpy as np

from rigtool.numerics.arrays import Array

BAND_WIDENING = 0.25
"""Part of the last part's range by which that range is widened on either side."""


def settled_from(signal: Array, last_part: int, resolution: float = 0.0) -> int:
    """Return the first sample from which on a signal (n,) stays as it is from `last_part` on.

    Deviations below `resolution`, in the unit of the signal, do not count.
    """
    low, high = np.min(signal[last_part:]), np.max(signal[last_part:])
    margin = max(BAND_WIDENING * (high - low), resolution)
    outside = (signal[:last_part] < low - margin) | (signal[:last_part] > high + margin)
    return int(np.flatnonzero(outside)[-1]) + 1 if outside.any() else 0
