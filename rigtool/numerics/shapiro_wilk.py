"""Test of Shapiro and Wilk: whether readings are normally distributed.

S. S. Shapiro & M. B. Wilk, Biometrika 52 (1965) 591; its coefficients and the distribution of W
by P. Royston, "Algorithm AS R94", Applied Statistics 44 (1995) 547, for 3 to 5000 readings. The
same as `scipy.stats.shapiro`, without the import of all distributions.
"""

from __future__ import annotations

import math

import numpy as np

from rigtool.numerics.arrays import Array

LAST = (-2.706056, 4.434685, -2.07119, -0.147981, 0.221157, 0.0)
LAST_BUT_ONE = (-3.582633, 5.682633, -1.752461, -0.293762, 0.042981, 0.0)
"""Corrections of the two outermost coefficients, polynomials of 1/sqrt(n)."""

FEW = 11
"""Readings up to which -log(g - log(1 - W)) is normal; log(1 - W) for more."""
FEW_LIMIT = (0.459, -2.273)
FEW_MEAN = (-0.0006714, 0.025054, -0.39978, 0.544)
FEW_LOG_STD = (-0.0020322, 0.062767, -0.77857, 1.3822)
"""g, mean and logarithm of the standard deviation, polynomials of n."""
MANY_MEAN = (0.0038915, -0.083751, -0.31082, -1.5861)
MANY_LOG_STD = (0.0030302, -0.082676, -0.4803)
"""Mean and logarithm of the standard deviation, polynomials of log(n)."""


def shapiro_wilk(ordered: Array) -> tuple[float, float]:
    """Return W and the probability of a lower one, from normal readings (n,) in rising order.

    n is at least 3, and the readings are not all equal.
    """
    weights = _weights(len(ordered))
    apart = ordered - ordered.mean()
    w = min(float(weights @ apart) ** 2 / float(apart @ apart), 1.0)
    return w, _probability(w, len(ordered))


def _weights(count: int) -> Array:
    """Return the coefficients (n,) of the readings, antisymmetric and of norm one."""
    from scipy.special import ndtri

    if count == 3:
        return np.array([-math.sqrt(0.5), 0.0, math.sqrt(0.5)])
    scores: Array = ndtri((np.arange(1, count + 1) - 0.375) / (count + 0.25))
    size, root = float(scores @ scores), 1 / math.sqrt(count)
    outer = [np.polyval(LAST, root) + scores[-1] / math.sqrt(size)]
    if count > 5:
        outer.append(np.polyval(LAST_BUT_ONE, root) + scores[-2] / math.sqrt(size))
    edge = len(outer)
    left = size - 2 * sum(scores[-edge:] ** 2)
    weights = scores * math.sqrt((1 - 2 * sum(value**2 for value in outer)) / left)
    for number, value in enumerate(outer):
        weights[number], weights[-1 - number] = -value, value
    return weights


def _probability(w: float, count: int) -> float:
    """Return the probability of W or less."""
    from scipy.special import ndtr

    if count == 3:
        lowest = math.asin(math.sqrt(0.75))
        return max(6 / math.pi * (math.asin(math.sqrt(w)) - lowest), 0.0)
    if w == 1.0:
        return 1.0
    seen = math.log(1 - w)
    if count <= FEW:
        beyond = float(np.polyval(FEW_LIMIT, count)) - seen
        if beyond <= 0:
            return 0.0
        seen = -math.log(beyond)
        mean, log_std = np.polyval(FEW_MEAN, count), np.polyval(FEW_LOG_STD, count)
    else:
        logarithm = math.log(count)
        mean, log_std = np.polyval(MANY_MEAN, logarithm), np.polyval(MANY_LOG_STD, logarithm)
    return float(ndtr((mean - seen) / math.exp(log_std)))
