"""Mean of readings that follow each other, and how uncertain it is.

What a stroke of a tendon deviates, the next one partly pays back: such readings oppose their
neighbours, and their sum hardly grows. A mean whose weights fade to both ends, i (n + 1 - i), keeps
that; equal weights leave the first and the last deviation unpaid. It is the minimum-variance mean
of a series whose neighbours pay back all, and for independent readings its standard uncertainty is
at most a tenth above the lowest possible.

The variance of a mean is the power of the readings at frequency zero. The power at the lowest
frequencies of the series, by its cosine transform, stands for that: drift makes it larger than the
scatter of the readings, payback smaller (P. Heidelberger and P. D. Welch, Comm. ACM 24(4) 233-245,
1981, who fit the same periodogram). Each frequency adds one degree of freedom.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from rigtool.errors import InsufficientDataError
from rigtool.numerics.arrays import Array

LOWEST = 6
"""Lowest frequencies, half periods of the series, whose power stands for that at zero."""

FEWEST = 3
"""Readings without which there is no scatter to judge."""


def weights(count: int) -> Array:
    """Return the weights of `count` readings; their sum is 1."""
    number = np.arange(1.0, count + 1)
    parabola = number * (count + 1 - number)
    weight: Array = parabola / parabola.sum()
    return weight


def steady_mean(values: Array) -> Array:
    """Return the mean of repeats along the first axis, values (m, n) or (m,) to (n,) or ()."""
    mean: Array = np.tensordot(weights(len(values)), values, axes=1)
    return mean


def steady_u(values: Array) -> tuple[Any, float]:
    """Return the standard uncertainty of `steady_mean` and its degrees of freedom.

    Repeats along the first axis, values (m, n) or (m,) to (n,) or (). Raises
    `InsufficientDataError` for fewer than three.
    """
    from scipy.fft import dct

    count = len(values)
    if count < FEWEST:
        raise InsufficientDataError(
            f"{count} cycles show no scatter, {FEWEST} are needed: measure more cycles"
        )
    lowest = min(LOWEST, count - 1)
    waves = dct(values - values.mean(axis=0), norm="ortho", axis=0)[1 : lowest + 1]
    power = np.mean(waves**2, axis=0)
    return np.sqrt(power * np.sum(weights(count) ** 2)), float(lowest)
