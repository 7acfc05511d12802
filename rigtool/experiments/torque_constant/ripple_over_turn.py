"""The amplifier's ripple over a turn, from the torque constants of all staircases [7.1.1]."""

from __future__ import annotations

import math

import numpy as np

from rigtool.experiments.torque_constant.clampings import HIGHEST_APART
from rigtool.experiments.torque_constant.staircases.fit import SAME_TEMPERATURE, Slopes
from rigtool.numerics.angle_effects import AngleEffects, fit_angle_effects
from rigtool.numerics.arrays import TINY, Array
from rigtool.quantity import Quantity, combined, error_line

RIPPLE_PATH_U = 0.25
"""Standard uncertainty of what friction takes of the ripple, relative: its path follows each
staircase, from the torque with which it begins, and of its law only the mean of all is known."""

SMEARED = 0.05
"""Change of the slope of u exp(i a u) over a staircase of u from 0 to 1, in a2: its line of least
squares has 1 + i a - 0.45 a2, and that from end to end exp(i a)."""

ALIKE = 6**-0.5
"""Root mean square of the part that two patterns of six orders have in common by chance."""

SMALLEST_PART = 100.0
"""Range of the torques without current, over the errors of it that are considered at least."""

DEFLECTION = "deflection of the arm"
"""Name of the line of a budget that has what it does to the ripple."""

RIPPLE_ANGLES = 13
"""Rotor angles from which the ripple has an uncertainty: with fewer, orders of a turn up to the
sixth may show nothing, or a part that their phase decides (two angles an order, and one)."""


def ripple_over_turn(found: AngleEffects, value: float, slopes: Slopes, *, known: bool) -> Quantity:
    """Return the relative standard deviation of r over a turn.

    The arm's deflection d acts in two ways, since the angle changes with the torque within a
    staircase: order k of the ripple is turned by k d, its size changes by up to `SMEARED` (k d)2;
    and order k of the torque without current adds k d of that over the largest current, which is
    taken off. The gauge rounds each staircase by its own zero: `Slopes.rounding`
    is what that adds to the slopes.
    """
    order = np.repeat(np.arange(1, len(found.amplitudes) // 2 + 1), 2)
    none = np.zeros(len(order)), 0.0, 0.0, 0.0
    carried, hidden, left, begin = _carried(slopes) if known else none
    square = found.amplitudes**2
    own = found.deviation**2 + float(np.sum((found.amplitudes - carried) ** 2 - square)) / 2
    deviation = math.sqrt(max(own - hidden**2, 0.0))
    angle = math.hypot(slopes.deflection, slopes.deflection_u)
    turned = float(np.sum(square * (order * angle) ** 2) / max(np.sum(square), TINY))
    path = math.hypot(deviation, begin) * RIPPLE_PATH_U * slopes.friction_share
    path = math.hypot(path, deviation * slopes.ripple_u)
    smear = deviation * SMEARED * turned
    more = math.hypot(deviation, left) - deviation  # of phases that have nothing in common
    rounding = np.std(found.effect + slopes.rounding, axis=1) - np.std(found.effect)
    lines = [
        error_line("scatter", found.deviation_u / value, "1", found.deviation_dof),
        error_line("path of friction", path / value, "1"),
        error_line(DEFLECTION, math.hypot(smear, more, ALIKE * left) / value, "1"),
        error_line("gauge resolution", math.sqrt(float(np.mean(rounding**2))) / value, "1"),
    ]
    return combined(deviation / value, "1", lines)


def first_ripple(slopes: Slopes) -> Quantity:
    """Return the relative standard deviation over a turn of the slopes where the current is small.

    Of the scatter about a line over temperature, what each slope scatters by itself is taken off,
    but for the standard deviation of that.
    """
    degree = int(np.ptp(slopes.temperature) > SAME_TEMPERATURE)
    line = np.polyfit(slopes.temperature, slopes.first, degree)
    rest = slopes.first - np.polyval(line, slopes.temperature)
    free = max(len(rest) - degree - 1, 1)
    own = float(np.mean(slopes.first_u**2))
    square = max(float(rest @ rest) / free - own, 0.0) + own * math.sqrt(2 / free)
    ripple = math.sqrt(square) / abs(float(np.mean(slopes.first)))
    return Quantity(ripple, "1", reason="a measure of scatter itself")


def _carried(slopes: Slopes) -> tuple[Array, float, float, float]:
    """Return what torque without current that changes with the angle does to slopes, N m/A, as the
    arm's deflection changes that torque.

    These are amplitudes (2 K,); standard deviations over a turn of what the angles hide of it, and
    of all that stays unknown, as the deflection does; and that of the torque itself, over the
    largest current. What no order up to K explains may be of any up to `HIGHEST_APART`.
    """
    top = float(np.ptp(slopes.level))
    least = max(float(np.ptp(slopes.zero)), 1e-12) / SMALLEST_PART
    noise = np.maximum(slopes.zero_u, least)
    zero = fit_angle_effects(np.ones((len(noise), 1)), slopes.zero, noise, slopes.rotor_angle)
    order = np.arange(1.0, HIGHEST_APART + 1)
    turned = np.expm1(1j * order * slopes.deflection)
    count = len(zero.variance)
    cosine, sine = zero.amplitudes.reshape(-1, 2).T
    moved = (cosine - 1j * sine) * turned[:count] / top
    # Mean squares over a turn of each order, and of the unknown part of it.
    square = np.full(len(order), zero.beyond / (len(order) - count))
    unknown = square.copy()
    square[:count], unknown[:count] = (cosine**2 + sine**2) / 2, zero.variance / 2
    hidden = math.sqrt(float(unknown @ np.abs(turned) ** 2)) / top
    left = math.hypot(hidden, math.sqrt(float(square @ order**2)) * slopes.deflection_u / top)
    carried = np.stack([moved.real, -moved.imag], axis=1).ravel()
    return carried, hidden, left, zero.deviation / top


def stated_ripple(ripple: Quantity, angles: int, single: float) -> Quantity | None:
    """Return the ripple: without uncertainty from few angles, None from less than three.

    Of n angles around a turn, the orders that are multiples of n show nothing, and those of n/2 as
    much as their phase allows.
    """
    if angles < 3:
        return None
    if angles < RIPPLE_ANGLES:
        reason = (
            f"{angles} rotor angles do not show all orders: their ripple may be larger; clamp "
            f"the arm at {RIPPLE_ANGLES} or more"
        )
        return Quantity(ripple.value, "1", reason=reason)
    if ripple.value < single:
        reason = (
            f"a single staircase scatters by {100 * single:.2g} %, more than the ripple that "
            "shows: it may hide there; take a finer or quieter gauge, or raise current_max"
        )
        return Quantity(ripple.value, "1", reason=reason)
    carried = max((one.u for one in ripple.budget if one.name == DEFLECTION), default=0.0)
    if ripple.value < carried:
        reason = (
            f"as the arm gives way, torque without current that differs around the turn changes "
            f"slopes by {100 * carried:.2g} %, more than the ripple that shows: it may hide there; "
            "take a stiffer arm, or clamp it at more angles"
        )
        return Quantity(ripple.value, "1", reason=reason)
    return ripple
