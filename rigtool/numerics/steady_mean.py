"""Mean of consecutive readings and its standard uncertainty.

The deviation of one stroke of a tendon is partly compensated by the next: neighbouring readings
are negatively correlated, and their sum hardly grows. A mean with weights that fade towards both
ends, i (n + 1 - i), preserves this compensation; with equal weights the deviations of the first
and the last reading remain. It is the minimum-variance mean of a series whose neighbours
compensate fully; for independent readings its standard uncertainty is at most a tenth above the
lowest possible.

How much is paid back, p, and with it the variance of the mean, come from the readings themselves:
several series of the same motion are taken to have it in common,

    reading[i] = mean + s (e[i] - p e[i - 1])

whose covariance is tridiagonal, with the sine transform (DST-I) as its eigenvectors, so that its
likelihood is exact for any number of readings. Mean and s are each series' own (restricted
likelihood: H. D. Patterson and R. Thompson, Biometrika 58(3) 545-554, 1971). Where the slowest
waves of a series are larger than chance allows, drift counts as well.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from rigtool.errors import InsufficientDataError
from rigtool.numerics.arrays import Array

PAYBACK_VALUES = np.linspace(-0.95, 1.0, 79)
"""Values of p that are weighed by their likelihood; neighbours alike, p < 0, occur as well."""

SLOWEST_WAVES, BY_CHANCE = 6, 0.01
"""Number of the slowest waves that show drift, and how seldom chance makes them as large."""

LEAST_VARIANCE = 1e-200
"""Of readings that do not scatter at all."""

MIN_READINGS = 3
"""Fewest readings from which scatter is estimated."""


def weights(count: int) -> Array:
    """Return the weights of `count` readings; their sum is 1."""
    number = np.arange(1.0, count + 1)
    parabola = number * (count + 1 - number)
    return parabola / parabola.sum()


def steady_mean(values: Array) -> Array:
    """Return the mean of repeats along the first axis, values (m, n) or (m,) to (n,) or ()."""
    return np.tensordot(weights(len(values)), values, axes=1)


def steady_us(
    series: Sequence[Array], shares: Sequence[float] | None = None
) -> list[tuple[float, float]]:
    """Return standard uncertainty and degrees of freedom of each series' `steady_mean`.

    Each of the series (m,) has its own scatter, all have the payback in common. `shares` are the
    weights of the series in the likelihood of the payback: 1 by default, 1/k for readings that are
    given k times. Raises `InsufficientDataError` for fewer than three readings in one.
    """
    from scipy.special import chdtri

    likelihood = np.zeros(len(PAYBACK_VALUES))
    variances, drifts = [], []
    for values, part in zip(series, shares or [1.0] * len(series), strict=True):
        count = len(values)
        if count < MIN_READINGS:
            raise InsufficientDataError(
                f"{count} cycles show no scatter, {MIN_READINGS} are needed: measure more cycles"
            )
        waves, ones, weighted = (
            _sine_transform(each) for each in (values, np.ones(count), weights(count))
        )
        turn = np.pi * np.arange(1, count + 1) / (count + 1)
        p = PAYBACK_VALUES[:, None]
        power = 1 + p**2 - 2 * p * np.cos(turn)
        known = np.sum(ones**2 / power, axis=1)
        mean = np.sum(ones * waves / power, axis=1) / known
        left = (waves - mean[:, None] * ones) ** 2 / power
        scale = np.maximum(left.sum(axis=1) / (count - 1), LEAST_VARIANCE)
        misfit = (count - 1) * np.log(scale) + np.log(power).sum(axis=1) + np.log(known)
        likelihood -= part * misfit / 2
        variances.append(scale * np.sum(weighted**2 * power, axis=1))
        drifts.append(left[:, :SLOWEST_WAVES].mean(axis=1) / scale)
    share = np.exp(likelihood - likelihood.max())
    share /= share.sum()
    found = []
    for values, variance, drift in zip(series, variances, drifts, strict=True):
        slow, lowest = float(share @ drift), min(SLOWEST_WAVES, len(values))
        beyond = slow > chdtri(lowest, BY_CHANCE) / lowest
        square = float(share @ variance)
        relative = float(share @ (variance / square - 1) ** 2) + 2 / (len(values) - 1)
        found.append((math.sqrt(square * (slow if beyond else 1.0)), 2 / relative))
    return found


def _sine_transform(values: Array) -> Array:
    """Return the orthonormal DST-I of values (n,): the transform of their odd continuation."""
    odd = np.concatenate([[0.0], values, [0.0], -values[::-1]])
    return -np.fft.rfft(odd).imag[1:-1] / math.sqrt(len(odd))
