"""Correlation and shift of maps around a turn, one value for each angle.

map(angle) = mean + sum over orders k of amplitude_k cos(k angle + phase_k)
"""

from __future__ import annotations

import math

import numpy as np

from rigtool.errors import InsufficientDataError
from rigtool.experiments.ripple.orders import Match, match_orders
from rigtool.numerics.arrays import Array, ComplexArray
from rigtool.numerics.checks import require_rising, require_signals

MIN_ANGLES = 16
"""Smallest number of angles in a map."""


def highest_order(position: Array) -> int:
    """Return the highest order that angles (n,), rad, resolve: half a cycle in the widest gap."""
    gaps = np.diff(position, append=position[0] + 2 * np.pi)
    return int(math.pi / gaps.max() * (1 - 1e-9))


def map_orders(position: Array, values: Array, orders: int) -> ComplexArray:
    """Return amplitude*exp(i phase) of the orders 1..`orders` (orders,), by least squares.

    `position` (n,) rises within a turn, rad; `values` (n,) in any unit. Raises
    `InsufficientDataError` where the angles do not resolve that many orders.
    """
    angle, value = require_signals(MIN_ANGLES, position=position, values=values)
    require_rising(angle)
    if orders < 1 or orders > highest_order(angle):
        raise InsufficientDataError(
            f"{len(angle)} angles resolve orders up to {highest_order(angle)}, {orders} are "
            "needed: sample more of the turn"
        )
    order = np.arange(1, orders + 1)
    turning = np.exp(1j * np.outer(angle, order))
    design = np.column_stack([np.ones(len(angle)), turning.real, -turning.imag])
    found = np.linalg.lstsq(design, value)[0]
    return found[1 : orders + 1] + 1j * found[orders + 1 :]


def match_maps(reference: ComplexArray, other: ComplexArray) -> Match:
    """Compare two maps by their orders 1..m (m,); `InsufficientDataError` where one is constant.

    The uncertainty of the shift is from the differences between the two: of each order by itself,
    or of all alike, whichever is larger.
    """
    if not np.any(reference) or not np.any(other):
        raise InsufficientDataError("a map is constant: there is no ripple to compare")
    correlation, shift, best, scale = match_orders(reference, other)
    order = np.arange(1, len(reference) + 1)
    turned = scale * reference * np.exp(-1j * order * shift)
    # Linear in a small turn: other - turned = -i k turned d. Only the part along the slope moves
    # the shift; its square replaces a common variance, as orders differ in their noise.
    slope, apart = -1j * order * turned, other - turned
    along = np.real(np.conj(slope) * apart)
    weight = np.abs(slope) ** 2
    # The shift follows the orders with most weight: their differences are too small by as much
    # (HC2, MacKinnon & White, J. Econometrics 29(3) 305-325, 1985).
    kept = np.maximum(1 - weight / weight.sum(), 1e-6)
    own = float(np.sum(along**2 / kept)) / float(weight.sum()) ** 2
    # One or two orders may hold nearly all weight, which is too few to show their own noise.
    alike = float(np.mean(np.abs(apart) ** 2)) / 2 / float(weight.sum())
    return Match(correlation, shift, math.sqrt(max(own, alike)), best, scale)


def typical(maps: list[ComplexArray]) -> int:
    """Return the index of the map that correlates best with all others at equal angles."""
    norms = [orders / np.linalg.norm(orders) for orders in maps]
    alike = np.real(np.conj(np.array(norms)) @ np.array(norms).T)
    return int(np.argmax(alike.sum(axis=1)))
