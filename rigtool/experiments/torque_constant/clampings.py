"""Rotor angles at which the arm is clamped, so that ripple passes for nothing else [7.1.1]."""

from __future__ import annotations

import numpy as np

from rigtool.numerics.angle_effects import HIGHEST_ORDER
from rigtool.numerics.arrays import Array

FEWEST_APART = 18
"""Clampings whose angles, all different, separate orders of a turn from a change with temperature;
with fewer they leave the temperature coefficient unknown where orders up to 12 occur."""

EVERY_ORDER = 2 * HIGHEST_ORDER + 3
"""Clampings that, at angles of their own, show sine and cosine of each order up to the highest,
beside the constant and its change with temperature."""

HIGHEST_APART = 48
"""Order up to which none may pass for the constant or its change: above that of the commutation of
seven pole pairs, 42."""

DRAWS = 1000
"""Ways to choose the angles that are compared; four times as many lower the largest part that any
order has in common with the constant or its change by 0 to 6 %."""


def clamping_angles(temperatures_degc: tuple[float, ...], positions: int) -> Array:
    """Return the rotor angles (temperatures, positions), rad.

    Each temperature has angles at equal distance. The lowest has those of the highest, the second
    that of the second highest and so on, so that no order of the amplifier's ripple can pass for a
    change with temperature; the others lie between them, to resolve more orders. Where these angles
    divide the turn into n parts, order n passes for the constant, and orders k and n - k for each
    other. If this concerns orders up to `HIGHEST_ORDER`, and there are `FEWEST_APART` clampings
    against the first or `EVERY_ORDER` against the second, each has an angle of its own instead, so
    that no order repeats (`_apart`).
    """
    temperatures = len(temperatures_degc)
    parts, count = positions * ((temperatures + 1) // 2), positions * temperatures
    passes, mixes = parts <= HIGHEST_ORDER, parts <= 2 * HIGHEST_ORDER
    if (passes and count >= FEWEST_APART) or (mixes and count >= EVERY_ORDER):
        return _apart(temperatures_degc, positions)
    place = np.argsort(np.argsort(temperatures_degc, kind="stable"))
    place = np.minimum(place, temperatures - 1 - place)
    shift = place[:, None] / ((temperatures + 1) // 2)
    return 2 * np.pi * (np.arange(positions) + shift) / positions


def _apart(temperatures_degc: tuple[float, ...], positions: int) -> Array:
    """Return angles (temperatures, positions), rad, that rise at each temperature, none alike.

    The turn has as many equal parts as there are clampings. An angle is drawn within each part, and
    the angles are dealt out to the temperatures. Of `DRAWS` such draws it is the one whose orders,
    as waves (cos, sin) over the clampings, have the least in common with the constant and its
    change with temperature: the largest projection onto these two. Those up to `HIGHEST_ORDER`,
    which are fitted and as a rule larger, weigh more, by the root of `HIGHEST_ORDER`/order. At
    angles by a constant step some order always follows the temperature: by the golden section,
    orders 13, 21 and 34 turn by so little from clamping to clamping that they pass for its change.
    """
    rng = np.random.default_rng(0)
    count = len(temperatures_degc) * positions
    rise = np.repeat(temperatures_degc, positions)
    own, _ = np.linalg.qr(np.column_stack([np.ones(count), rise - rise.mean()]))
    order = np.arange(1, HIGHEST_APART + 1)
    weight = np.sqrt(np.maximum(HIGHEST_ORDER / order, 1.0))
    best, least = np.zeros(count), np.inf
    for _ in range(DRAWS):
        angle = 2 * np.pi * rng.permutation((np.arange(count) + rng.random(count)) / count)
        common = np.linalg.norm(own.T @ np.exp(1j * np.outer(angle, order)), axis=0)
        if (largest := float(np.max(weight * common))) < least:
            best, least = angle, largest
    return np.sort(best.reshape(-1, positions), axis=1)
