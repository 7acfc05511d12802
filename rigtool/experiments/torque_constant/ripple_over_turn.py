"""The amplifier's ripple over a turn, from the torque constants of all staircases [7.1.1]."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rigtool.experiments.torque_constant.clampings import HIGHEST_APART
from rigtool.experiments.torque_constant.staircases.fit import SAME_TEMPERATURE, Slopes
from rigtool.numerics.angle_effects import AngleEffects, fit_angle_effects
from rigtool.numerics.arrays import TINY, Array
from rigtool.numerics.turn_mean import group_angles
from rigtool.quantity import Quantity, combined, error_line

RIPPLE_PATH_U = 0.15
"""Standard uncertainty of what friction takes of the ripple, and of the torque with which
staircases begin in phase with it, relative to the part p that friction takes of a slope. Its path
follows each staircase, and of its law only the mean of all is known. Beyond what the other lines of
the budget explain, errors on 109 drawn rigs scatter by 0.15 p (0.12 to 0.19), maximum likelihood;
slopes themselves have 0.16(1) p of the torque with which they begin."""

SMEARED = 0.05
"""Change of the slope of u exp(i a u) over a staircase of u from 0 to 1, in a2: its line of least
squares has 1 + i a - 0.45 a2, and that from end to end exp(i a)."""

SMALLEST_PART = 100.0
"""Range of the torques without current, over the errors of it that are considered at least."""

DEFLECTION = "deflection of the arm"
"""Name of the line of a budget that has what it does to the ripple."""

EQUAL_PARTS = 0.9
"""Mean of exp(i m angle) from which the angles divide the turn into m equal parts: they are so to
1/40 of a part, and orders of a turn that are m apart are alike to them."""

FITS_BETTER = 0.25
"""Part of the square of an order of the ripple that is left where the cogging is of an alike order,
below which that is taken to be possible. Cogging of orders 1 to 6 does so by chance, by its phase:
on 2 of 12 drawn rigs with random phases that costs the ripple its u, with 0.5 on 5 of them."""

RIPPLE_ANGLES = 13
"""Rotor angles from which the ripple has an uncertainty: with fewer, orders of a turn up to the
sixth may show nothing, or a part that their phase decides (two angles an order, and one)."""


def ripple_over_turn(
    found: AngleEffects, value: float, slopes: Slopes, carried: Carried | None
) -> Quantity:
    """Return the relative standard deviation of r over a turn; without known angles `carried` is
    None.

    The arm's deflection d acts in two ways, since the angle changes with the torque within a
    staircase: order k of the ripple is turned by k d, its size changes by up to `SMEARED` (k d)2;
    and order k of the torque without current adds k d of that over the largest current, which is
    taken off. The gauge rounds each staircase by its own zero: `Slopes.rounding`
    is what that adds to the slopes.
    """
    order = np.repeat(np.arange(1, len(found.amplitudes) // 2 + 1), 2)
    carried = carried or _nothing(len(order))
    square, own = found.amplitudes**2, found.amplitudes - carried.amplitudes
    whole = found.deviation**2 + float(np.sum(own**2 - square)) / 2
    deviation = math.sqrt(max(whole - float(np.sum(carried.hidden)), 0.0))
    angle = math.hypot(slopes.deflection, slopes.deflection_u)
    turned = float(np.sum(square * (order * angle) ** 2) / max(np.sum(square), TINY))
    begin = _in_phase(own, carried.begin)
    path = math.hypot(deviation, begin) * RIPPLE_PATH_U * slopes.friction_share
    path = math.hypot(path, deviation * slopes.ripple_u)
    smear = deviation * SMEARED * turned
    left = float(np.sum(carried.unknown) + carried.error @ carried.error / 2)
    more = math.hypot(deviation, math.sqrt(left)) - deviation  # of what has no phase in common
    rounding = np.std(found.effect + slopes.rounding, axis=1) - np.std(found.effect)
    lines = [
        error_line("scatter", found.deviation_u / value, "1", found.deviation_dof),
        error_line("path of friction", path / value, "1"),
        error_line(DEFLECTION, math.hypot(smear, more, _alike(own, carried)) / value, "1"),
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


@dataclass(frozen=True)
class Alias:
    """Cogging of `order` that passes for the order `shown` at `parts` equal angles, by the slopes.

    The ripple would be smaller by `less`; `constant` is the relative standard uncertainty of the
    torque constant by cogging of the order `parts`, which no zero shows.
    """

    order: int
    shown: int
    parts: int
    less: float
    constant: float


def alias_of(
    ripple: Quantity, found: AngleEffects, value: float, slopes: Slopes, carried: Carried | None
) -> Alias | None:
    """Return the alike order whose cogging would lower the ripple most, None where none does.

    At m equal angles, orders k and k + n m are one to the zeros, w exp(i k a) N m. An arm that
    gives way by d carries them into the slopes by w (exp(i k d) - 1) and w (exp(i (k + n m) d) - 1)
    over the largest current, where a negative order is that of the conjugate. An order of the
    ripple (of any size, all orders of magnitude alike) of which an alike order leaves less than
    `FITS_BETTER`, was rather made by the cogging.
    """
    parts = _equal_parts(slopes.rotor_angle)
    if parts is None or carried is None:
        return None
    wave, own = _wave(carried.begin), _wave(found.amplitudes - carried.amplitudes)
    shown = np.arange(1, len(wave) + 1)
    most = 1 + HIGHEST_APART // parts
    apart = parts * np.arange(-most, most + 1)[:, None]
    order = np.abs(shown + apart)
    other = (order != shown) & (order <= HIGHEST_APART)
    turned = np.expm1(1j * apart * slopes.deflection)
    path_u = RIPPLE_PATH_U * slopes.friction_share * np.abs(own)
    noise = found.variance + carried.variance * np.abs(turned) ** 2 + path_u**2 + TINY
    square = np.abs(own - wave * np.exp(1j * shown * slopes.deflection) * turned) ** 2
    left = np.where(other, (square + noise) / (np.abs(own) ** 2 + noise), np.inf)
    best = np.argmin(left, axis=0), shown - 1
    those = left[best] < FITS_BETTER
    if not np.any(those):
        return None
    fall = np.where(those, np.abs(own) ** 2 - square[best], 0.0) / 2 / value**2
    worst = int(np.argmax(fall))
    hidden = float(np.linalg.norm(wave[those])) / math.sqrt(2)
    return Alias(
        order=int(order[best][worst]),
        shown=worst + 1,
        parts=parts,
        less=ripple.value - math.sqrt(max(ripple.value**2 - float(np.sum(fall)), 0.0)),
        constant=hidden * abs(np.expm1(1j * parts * slopes.deflection)) / abs(value),
    )


def _equal_parts(angle: Array) -> int | None:
    """Return into how many equal parts angles (n,), rad, divide the turn, None where they do not,
    or where there are fewer than `RIPPLE_ANGLES`."""
    angles, _ = group_angles(angle)
    parts = np.arange(RIPPLE_ANGLES, HIGHEST_APART + 1)
    equal = np.abs(np.mean(np.exp(1j * np.outer(parts, angles)), axis=1)) > EQUAL_PARTS
    return int(parts[equal][0]) if len(angles) >= RIPPLE_ANGLES and np.any(equal) else None


@dataclass(frozen=True)
class Carried:
    """What torque without current that changes with the angle does to slopes, N m/A, as the arm's
    deflection changes that torque.

    `amplitudes` (2 K,), and `error` (2 K,) by the deflection's standard uncertainty; by order up to
    `HIGHEST_APART`, the mean squares over a turn that the angles hide, `hidden`, and `unknown` with
    the deflection's own; `angles` counts those; `begin` (2 K,) is the torque itself, over the
    largest current, `variance` (K,) the sum of both variances of an order of it.
    """

    amplitudes: Array
    error: Array
    hidden: Array
    unknown: Array
    angles: int
    begin: Array
    variance: Array


def _nothing(count: int) -> Carried:
    none, no_order = np.zeros(count), np.zeros(HIGHEST_APART)
    return Carried(none, none, no_order, no_order, 1, none, none[::2])


def carried_by_arm(slopes: Slopes) -> Carried:
    """Return what the zeros of the staircases show of torque that an arm carries into slopes.

    What no order up to K explains may be of any up to `HIGHEST_APART`.
    """
    top = float(np.ptp(slopes.level))
    least = max(float(np.ptp(slopes.zero)), 1e-12) / SMALLEST_PART
    noise = np.maximum(slopes.zero_u, least)
    zero = fit_angle_effects(np.ones((len(noise), 1)), slopes.zero, noise, slopes.rotor_angle)
    order = np.arange(1.0, HIGHEST_APART + 1)
    turned = np.expm1(1j * order * slopes.deflection)
    count = len(zero.variance)
    wave = _wave(zero.amplitudes) / top
    moved = wave * turned[:count]
    error = wave * (1j * order * (1 + turned))[:count] * slopes.deflection_u
    square = np.full(len(order), zero.beyond / (len(order) - count))
    square[:count] = zero.variance / 2
    square /= top**2
    return Carried(
        np.stack([moved.real, -moved.imag], axis=1).ravel(),
        np.stack([error.real, -error.imag], axis=1).ravel(),
        square * np.abs(turned) ** 2,
        square * (np.abs(turned) ** 2 + (order * slopes.deflection_u) ** 2),
        len(group_angles(slopes.rotor_angle)[0]),
        zero.amplitudes / top,
        zero.variance / top**2,
    )


def _wave(amplitudes: Array) -> NDArray[np.complex128]:
    """Return w (K,) of Re(w exp(i k angle)) from cosines and sines (2 K,)."""
    cosine, sine = amplitudes.reshape(-1, 2).T
    return np.asarray(cosine - 1j * sine, dtype=np.complex128)


def _alike(ripple: Array, carried: Carried) -> float:
    """Return the standard deviation of what is unknown in phase with the ripple (2 K,), N m/A.

    An order of unknown phase has half of its mean square in phase with the same order of the
    ripple, by the part of the ripple's square that this order is. Orders above K are other than the
    ripple's; at m angles, two patterns have 1/m of their square in common.
    """
    part = ripple**2 / max(float(ripple @ ripple), TINY)
    count = len(ripple) // 2
    square = float(part.reshape(-1, 2).sum(axis=1) @ carried.unknown[:count]) / 2
    square += float(np.sum(carried.unknown[count:])) / carried.angles
    return math.hypot(math.sqrt(square), _in_phase(ripple, carried.error))


def _in_phase(ripple: Array, other: Array) -> float:
    """Return the standard deviation over a turn of what of another pattern (2 K,) is in proportion
    to the ripple (2 K,)."""
    return float(ripple @ other) / math.sqrt(max(2 * float(ripple @ ripple), TINY))


def stated_ripple(
    ripple: Quantity, angles: int, single: float, alias: Alias | None = None
) -> Quantity | None:
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
    if alias is not None and alias.less > (ripple.u or 0.0):
        reason = (
            f"cogging of order {alias.order} passes for order {alias.shown} at {alias.parts} equal "
            f"angles, and would explain the slopes with a ripple smaller by {100 * alias.less:.2g} "
            f"%, more than its uncertainty of {100 * (ripple.u or 0.0):.2g} %; take a stiffer arm, "
            "or clamp it at angles each its own, as of 6 positions at 4 temperatures"
        )
        return Quantity(ripple.value, "1", reason=reason)
    return ripple
