"""An encoder's count as an interval: the angle lies between two edges.

    x ~ N(m, s^2) restricted to low <= x < high:  with alpha, beta the edges in s from m,
    Z = Phi(beta) - Phi(alpha),  d = (phi(alpha) - phi(beta)) / Z
    mean = m + s d,  variance = s^2 (1 + (alpha phi(alpha) - beta phi(beta)) / Z - d^2)

Inside a count the mean hardly moves and little is learned; at an edge much is. Rounding noise of
count^2/12 would claim the same information everywhere. (N. L. Johnson, S. Kotz, N. Balakrishnan,
Continuous Univariate Distributions 1, 2nd ed. 1994, section 13.10.1.)
"""

from __future__ import annotations

import math

from rigtool.numerics.compiled import compiled

FARTHEST_EDGE = 35.0
"""Edge, in standard deviations, from which on the normal's tail is below what a double holds."""

NARROWEST_INTERVAL = 1e-2
"""Width in standard deviations below which the density's logarithm is a straight line."""


@compiled
def _density(u: float) -> float:
    return math.exp(-0.5 * u * u) / math.sqrt(2.0 * math.pi)


@compiled
def _exponential(slope: float, width: float) -> tuple[float, float]:
    """Return mean and variance of a density exp(-slope x) between 0 and width."""
    if slope * width < 1e-2:
        return width * (0.5 - slope * width / 12.0), width * width / 12.0
    end = math.exp(-slope * width)
    mean = 1.0 / slope - width * end / (1.0 - end)
    return mean, 1.0 / slope**2 - width**2 * end / (1.0 - end) ** 2


@compiled
def truncated(alpha: float, beta: float) -> tuple[float, float]:
    """Return mean and variance of a standard normal between alpha < beta."""
    side = 1.0
    if alpha + beta < 0.0:  # by symmetry: above zero the tails are those that erfc resolves
        side, alpha, beta = -1.0, -beta, -alpha
    if beta - alpha < NARROWEST_INTERVAL or alpha > FARTHEST_EDGE:
        width = min(beta - alpha, 1.0)  # beyond 1 nothing is left of a tail that far out
        mean, variance = _exponential(alpha + min(width, NARROWEST_INTERVAL) / 2.0, width)
        return side * (alpha + mean), variance
    tail = 0.5 * (math.erfc(alpha / math.sqrt(2.0)) - math.erfc(beta / math.sqrt(2.0)))
    low, high = _density(alpha) / tail, _density(beta) / tail
    mean = low - high
    return side * mean, 1.0 + alpha * low - (beta * high if high > 0.0 else 0.0) - mean * mean
