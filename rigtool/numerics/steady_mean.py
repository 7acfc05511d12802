"""Mean of consecutive readings and its standard uncertainty.

The deviation of one stroke of a tendon is partly compensated by the next: neighbouring readings
are negatively correlated, and their sum hardly grows. A mean with weights that fade towards both
ends, i (n + 1 - i), preserves this compensation; with equal weights the deviations of the first
and the last reading remain. It is the minimum-variance mean of a series whose neighbours
compensate fully; for independent readings its standard uncertainty is at most a tenth above the
lowest possible.

The variance of a mean is the power of the readings at frequency zero. It is estimated by the power
at the lowest frequencies of their cosine transform: drift makes it larger than the scatter of the
readings, compensation smaller (P. Heidelberger and P. D. Welch, Comm. ACM 24(4) 233-245,
1981, who fit the same periodogram). Each frequency adds one degree of freedom.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from rigtool.errors import InsufficientDataError
from rigtool.numerics.arrays import Array

LOWEST_FREQUENCIES = 6
"""Number of the lowest frequencies, in half periods of the series, that estimate the power."""

MIN_READINGS = 3
"""Fewest readings from which scatter is estimated."""


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
    if count < MIN_READINGS:
        raise InsufficientDataError(
            f"{count} cycles show no scatter, {MIN_READINGS} are needed: measure more cycles"
        )
    lowest = min(LOWEST_FREQUENCIES, count - 1)
    waves = dct(values - values.mean(axis=0), norm="ortho", axis=0)[1 : lowest + 1]
    power = np.mean(waves**2, axis=0)
    return np.sqrt(power * np.sum(weights(count) ** 2)), float(lowest)
