"""Test of Shapiro and Wilk, whether readings are drawn from a normal distribution.

    W = (sum a_i x_i)^2 / sum (x_i - mean)^2

over ordered readings, with weights a and a distribution of W as P. Royston approximates them: Stat.
Comput. 2(3) 117-119, 1992; Algorithm AS R94, Appl. Stat. 44(4) 547-551, 1995. The polynomials are
those of the algorithm. `scipy.stats` gives the same after an import of a third of a second.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.polynomial.polynomial import polyval

from rigtool.numerics.arrays import TINY, Array

LAST_COEFFICIENTS = (0.0, 0.221157, -0.147981, -2.07119, 4.434685, -2.706056)
NEXT_TO_LAST = (0.0, 0.042981, -0.293762, -1.752461, 5.682633, -3.582633)
"""Of 1 / sqrt(n): what the weights of the outer readings exceed those of the medians by."""

FEW_VALUES = ((0.544, -0.39978, 0.025054, -6.714e-4), (1.3822, -0.77857, 0.062767, -0.0020322))
MANY_VALUES = ((-1.5861, -0.31082, -0.083751, 0.0038915), (-0.4803, -0.082676, 0.0030302))
"""Mean, and logarithm of the deviation, of the transformed 1 - W: of n below 12, of log n above."""


def p_value(ordered: Array) -> float:
    """Return the probability of a smaller W for normal readings (n,), ordered and not all equal.

    Raises `ValueError` for fewer than 3 readings.
    """
    count = len(ordered)
    if count < 3:
        raise ValueError(f"{count} readings: the test needs 3")
    weight, deviation = _weights(count), ordered - ordered.mean()
    # 1 - W, without the loss of digits where W is near 1
    unit = deviation / np.linalg.norm(deviation)
    left = float((1 - weight @ unit) * (1 + weight @ unit))
    if count == 3:
        side = math.asin(math.sqrt(1 - left)) - math.asin(math.sqrt(0.75))
        return min(max(6 / math.pi * side, 0.0), 1.0)
    y = math.log(max(left, TINY))
    if count < 12:
        gamma = -2.273 + 0.459 * count  # above y: W is never below n a^2/(n - 1) of the largest a
        y, (mean, spread) = -math.log(gamma - y), (polyval(count, c) for c in FEW_VALUES)
    else:
        mean, spread = (polyval(math.log(count), c) for c in MANY_VALUES)
    return 0.5 * math.erfc((y - mean) / math.exp(spread) / math.sqrt(2))


def _weights(count: int) -> Array:
    """Return the weights of ordered readings (n,), of norm 1."""
    from statistics import NormalDist

    places = ((np.arange(1.0, count + 1) - 0.375) / (count + 0.25)).tolist()
    medians = np.array([NormalDist().inv_cdf(place) for place in places])
    if count == 3:
        return np.array([-math.sqrt(0.5), 0.0, math.sqrt(0.5)])
    square, u = float(medians @ medians), 1 / math.sqrt(count)
    outer = [polyval(u, LAST_COEFFICIENTS) + medians[-1] / math.sqrt(square)]
    if count > 5:
        outer.insert(0, polyval(u, NEXT_TO_LAST) + medians[-2] / math.sqrt(square))
    edge = len(outer)
    others, last = medians[edge:-edge], medians[-edge:]
    rest = (square - 2 * float(last @ last)) / (1 - 2 * float(np.sum(np.square(outer))))
    return np.concatenate([-np.array(outer[::-1]), others / math.sqrt(rest), outer])
