"""An encoder's count as an interval: the angle lies between two edges.

    x ~ N(m, s^2) restricted to low <= x < high:  with alpha, beta the edges in s from m,
    Z = Phi(beta) - Phi(alpha),  d = (phi(alpha) - phi(beta)) / Z
    mean = m + s d,  variance = s^2 (1 + (alpha phi(alpha) - beta phi(beta)) / Z - d^2)

Inside a count the mean hardly moves and little is learned; at an edge much is. Rounding noise of
count^2/12 would claim the same information everywhere. (N. L. Johnson, S. Kotz, N. Balakrishnan,
Continuous Univariate Distributions 1, 2nd ed. 1994, section 13.10.1.)

Far out, 1 and d^2 cancel: of the variance, about alpha^-2, rounding is alpha^4 as large. There both
moments are counted from the edge, with Mills' ratio R = (1 - Phi) / phi = 1 / (x + D):

    q = phi(beta) / phi(alpha),  T = R(alpha) - q R(beta),  w = beta - alpha
    d - alpha = (R(alpha) D(alpha) - q R(beta) (D(beta) + w)) / T
    variance = s^2 (1 - alpha (d - alpha) - w q / T - (d - alpha)^2)
    D(x) = 1/(x + 2/(x + 3/(x + ...)))              P. S. Laplace, Traite de mecanique celeste 10
"""

from __future__ import annotations

import math

from rigtool.numerics.compiled import compiled

FAR_EDGE, TERMS = 6.0, 20
"""Nearer edge, in standard deviations, from which on moments are counted from it, and terms of the
fraction D: what it then lacks is below a double's rounding."""

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
def _beyond(x: float) -> float:
    """Return D(x) of Mills' ratio."""
    found = 0.0
    for n in range(TERMS, 0, -1):
        found = n / (x + found)
    return found


@compiled
def _far_out(alpha: float, beta: float) -> tuple[float, float]:
    """Return mean, from alpha on, and variance of a standard normal between edges in its tail."""
    width = beta - alpha
    beyond, next_beyond = _beyond(alpha), _beyond(beta)
    ratio = 1.0 / (alpha + beyond)
    next_part = math.exp(-0.5 * width * (alpha + beta))
    next_ratio = next_part / (beta + next_beyond)
    tail = ratio - next_ratio
    mean = (ratio * beyond - next_ratio * (next_beyond + width)) / tail
    return mean, 1.0 - alpha * mean - width * next_part / tail - mean * mean


@compiled
def truncated(alpha: float, beta: float) -> tuple[float, float]:
    """Return mean and variance of a standard normal between alpha < beta."""
    side = 1.0
    if alpha + beta < 0.0:  # by symmetry: above zero the tails are those that erfc resolves
        side, alpha, beta = -1.0, -beta, -alpha
    width = beta - alpha
    if width < NARROWEST_INTERVAL:
        mean, variance = _exponential(alpha + width / 2.0, width)
        return side * (alpha + mean), variance
    if alpha > FAR_EDGE:
        mean, variance = _far_out(alpha, beta)
        return side * (alpha + mean), variance
    tail = 0.5 * (math.erfc(alpha / math.sqrt(2.0)) - math.erfc(beta / math.sqrt(2.0)))
    low, high = _density(alpha) / tail, _density(beta) / tail
    mean = low - high
    return side * mean, 1.0 + alpha * low - (beta * high if high > 0.0 else 0.0) - mean * mean
