"""Scatter of an order over few turns, with that of the orders around it.

The scatter s2 of one order over n turns has d = 2 (n - 1) degrees of freedom: with two turns it is
less than a twentieth of the true one in one order of 20. Scatter varies little from an order to
the next, so that the orders around show it as well. The variance sigma2 of an order k is taken as
drawn around a straight line in log k, as d0 degrees of freedom would show it about s0^2. Its
estimate is

    (d0 s0^2 + d s2) / (d0 + d),   with d0 + d degrees of freedom

(G. K. Smyth, Stat. Appl. Genet. Mol. Biol. 3(1), 3, 2004). s0 and d0 follow from mean and variance
of log s2 about lines through the orders around, each of which has, by its own scatter,

    E log s2 = log sigma2 + digamma(d/2) - log(d/2),   var log s2 = trigamma(d/2).
"""

from __future__ import annotations

import numpy as np
from scipy import special

from rigtool.experiments.ripple.orders import NEIGHBOURING_ORDERS
from rigtool.numerics.arrays import Array

ENOUGH = 20
"""Degrees of freedom from which an order's own scatter stands alone: an interval of 95 % is then
6 % wider than with many."""

FEWEST_AROUND = 5
"""Orders around that show scatter and slope."""

BY_CHANCE = 0.01
"""Probability of a scatter this much above that of the orders around, below which it is its own:
ripple that differs from turn to turn."""


def shared_floor(order: Array, floor: Array, dof: float) -> tuple[Array, Array]:
    """Return the noise floors of orders (m,), 1 or more, and the degrees of freedom of each (m,).

    `floor` (m,) has `dof` degrees of freedom at each order; NaN where an order is not resolved.
    """
    own = np.full(floor.shape, float(dof))
    known = np.flatnonzero(floor > 0)  # not NaN
    if dof >= ENOUGH or known.size <= FEWEST_AROUND:
        return floor, own
    power = floor[known] ** 2
    expected, leverage = _expected(
        np.log(order[known]), np.log(power) - special.digamma(dof / 2) + np.log(dof / 2)
    )
    by_scatter = float(special.polygamma(1, dof / 2))
    away = np.log(power) - special.digamma(dof / 2) + np.log(dof / 2) - expected
    total = float(np.mean(away**2 / (1 + leverage)))
    spread = max(0.0, total - by_scatter)
    half = _inverse_trigamma(spread + (spread + by_scatter) * leverage)
    around = np.exp(expected + special.digamma(half) - np.log(half))
    more = np.minimum(2 * half, ENOUGH - dof)
    shared = (more * around + dof * power) / (more + dof)
    alike = special.fdtrc(dof, 2 * half, power / around) > BY_CHANCE
    steadied, known_dof = floor.copy(), own
    steadied[known] = np.sqrt(np.where(alike, shared, power))
    known_dof[known] += np.where(alike, more, 0.0)
    return steadied, known_dof


def _expected(place: Array, value: Array) -> tuple[Array, Array]:
    """Return at each place (m,) the value of a straight line through the places around it, and
    its variance for values of variance one."""
    expected, leverage = np.empty_like(value), np.empty_like(value)
    for index in range(len(place)):
        low, high = max(0, index - NEIGHBOURING_ORDERS), index + 1 + NEIGHBOURING_ORDERS
        around = np.r_[low:index, index + 1 : min(high, len(place))]
        middle = place[around].mean()
        away, here = place[around] - middle, place[index] - middle
        slope = away @ value[around] / (away @ away)
        expected[index] = value[around].mean() + slope * here
        leverage[index] = 1 / around.size + here**2 / (away @ away)
    return expected, leverage


def _inverse_trigamma(value: Array) -> Array:
    """Return x > 0 with trigamma(x) = `value` (m,) > 0.

    Newton's method for 1/trigamma, convex and nearly linear, from below.
    """
    found: Array = 0.5 + 1 / value
    for _ in range(10):
        here = special.polygamma(1, found)
        found = found + here * (1 - here / value) / special.polygamma(2, found)
    return found
