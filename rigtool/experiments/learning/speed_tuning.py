"""Amplitude and phase tables of a map that was learned at one speed [Fig. 42].

    torque(p, v) = a(v) map(p + s(v))

At each other speed, a and s are least-squares estimates from the repeatable part; the thesis tuned
them by hand. As the shift of a map is ambiguous where few orders dominate it, shifts are followed
from the learning speed outwards: the next one is searched within half a period of the order that
counts most.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from rigtool.control.lookup_table import LookupTable
from rigtool.experiments.learning.rows import Row
from rigtool.numerics.arrays import Array, ComplexArray
from rigtool.numerics.jackknife import jackknife

Orders = ComplexArray

SIGNIFICANT_RATIO = 3.0
"""Standard uncertainties that an amplitude needs: below, it is noise, and the table is zero."""

ROW_ANGLE = 0.3
"""Angle of the leading order by which neighbouring rows of the written-out table may differ, rad.

Half way between two rows, interpolation then loses 1 - cos(0.15) = 1 % of the amplitude.
"""


NEWTON_STEPS = 5
"""From within a sixteenth of the highest order's period of a summit, to rounding."""


@dataclass(frozen=True, eq=False)
class Tuning:
    """Amplitude and shift by speed, rad/s (k,), rising; `u` where they are estimated, else zero,
    with `dof`.

    `correlation` is that of the shifted map with the repeatable part at the speed; 1 where the map
    was learned.
    """

    speed: Array
    amplitude: Array
    amplitude_u: Array
    shift: Array
    shift_u: Array
    correlation: Array
    dof: Array

    def at(self, speed: Array) -> tuple[Array, Array]:
        """Return amplitude and shift at other speeds (n,), linear in between, constant beyond."""
        return (
            np.interp(speed, self.speed, self.amplitude),
            np.interp(speed, self.speed, self.shift),
        )


def tune(learned: Row, others: Sequence[Row]) -> Tuning:
    """Find amplitude and shift of the map at the speeds of the other rows.

    `learned.mean` is the map. Uncertainties by the jackknife over the turns of each other row. An
    amplitude that is not above its uncertainty, or negative, is zero, with the shift before it.
    """
    wave = _orders(learned.mean)
    found: dict[float, tuple[float, ...]] = {learned.speed: (1.0, 0.0, 0.0, 0.0, 1.0, math.inf)}
    near = {True: 0.0, False: 0.0}  # the shift before, at faster and at slower speeds
    apart = [row for row in others if row.speed != learned.speed]
    for row in sorted(apart, key=lambda row: abs(row.speed - learned.speed)):
        faster = row.speed > learned.speed
        found[row.speed] = _fit(wave, row, near[faster])
        near[faster] = found[row.speed][2]
    ordered = sorted(found.items())
    columns = np.array([values for _, values in ordered]).T
    return Tuning(np.array([speed for speed, _ in ordered]), *columns)


def _orders(values: Array) -> Orders:
    """Return the orders 1.. of values (..., n) by angle; the mean is friction, not ripple."""
    return np.fft.rfft(values)[..., 1:] / values.shape[-1]


def leading_order(wave: Orders) -> int:
    """Return the order that decides about a shift: the one of the steepest wave."""
    return int(np.argmax(np.abs(wave) * np.arange(1, wave.size + 1))) + 1


def _fit(wave: Orders, row: Row, near: float) -> tuple[float, ...]:
    """Return amplitude, its u, shift, its u, correlation and dof at the speed of a row."""
    power = float(np.sum(np.abs(wave) ** 2))
    if power == 0:
        return 0.0, 0.0, near, 0.0, 0.0, row.dof
    reach = math.pi / leading_order(wave)
    measured = _orders(row.moves)

    def best(keep: NDArray[np.intp]) -> float:
        return best_shift(wave, measured[keep].mean(axis=0), near, reach)

    count = len(measured)
    shift, shift_u = jackknife(count, best)
    turned = wave * np.exp(1j * np.arange(1, wave.size + 1) * shift)
    each = np.real(measured @ np.conj(turned)) / power
    amplitude = float(each.mean())
    amplitude_u = float(each.std(ddof=1)) / math.sqrt(count)
    mean = measured.mean(axis=0)
    norm = math.sqrt(power * float(np.sum(np.abs(mean) ** 2)))
    correlation = amplitude * power / norm if norm > 0 else 0.0
    if amplitude < SIGNIFICANT_RATIO * amplitude_u or amplitude <= 0:
        return 0.0, amplitude_u, near, shift_u, correlation, row.dof
    return amplitude, amplitude_u, shift, shift_u, correlation, row.dof


def best_shift(wave: Orders, other: Orders, near: float, reach: float) -> float:
    """Return the shift s within `near` +- `reach` at which wave(p + s) is most like the other."""
    order = np.arange(1, wave.size + 1)
    cross = np.conj(wave) * other
    counts = np.flatnonzero(np.abs(cross) > 1e-6 * np.abs(cross).max(initial=0.0))
    if not counts.size:
        return near
    cross, order = cross[counts], order[counts]
    # Sixteen points a period of the highest order; Newton's method from the best one on.
    points = max(33, math.ceil(16 * order[-1] * reach / math.pi) | 1)
    shifts = near + np.linspace(-reach, reach, points)
    turned = np.exp(-1j * np.outer(shifts, order))
    best = float(shifts[np.argmax(np.real(turned @ cross))])
    step = shifts[1] - shifts[0]
    low, high = max(best - step, shifts[0]), min(best + step, shifts[-1])
    for _ in range(NEWTON_STEPS):
        parts = cross * np.exp(-1j * best * order)
        slope, bend = float(np.imag(parts) @ order), -float(np.real(parts) @ order**2)
        if bend >= 0:
            break
        best = min(max(best - slope / bend, low), high)
    return best


def written_out(position: Array, learned: Row, tuning: Tuning) -> tuple[LookupTable, Array]:
    """Return the map as a table by position and speed, and its standard uncertainty, of that shape.

    The uncertainty has the map's, times the amplitude, and those of amplitude and shift.
    `position` (n,) rad is a whole turn.
    """
    wave = _orders(learned.mean)
    speeds = _fine_speeds(tuning, leading_order(wave) if wave.any() else 1)
    amplitude, shift = tuning.at(speeds)
    order = np.arange(1, wave.size + 1)
    phase = np.exp(1j * np.outer(shift, order))
    turned = amplitude[:, None] * wave * phase
    torque, per_amplitude, per_shift = (
        _by_angle(each, position.size) for each in (turned, wave * phase, 1j * order * turned)
    )
    amplitude_u, shift_u = (
        np.interp(speeds, tuning.speed, u)[:, None] for u in (tuning.amplitude_u, tuning.shift_u)
    )
    variance = (amplitude[:, None] * learned.u) ** 2
    variance += (per_amplitude * amplitude_u) ** 2 + (per_shift * shift_u) ** 2
    lowest = float(np.abs(speeds).min())
    table = LookupTable(
        position, speeds, torque, np.array([0.0, lowest]), np.array([0.0, 1.0]), period=2 * math.pi
    )
    return table, np.sqrt(variance)


def _by_angle(orders: Orders, size: int) -> Array:
    """Return the values (..., size) by angle of orders 1.. (..., m)."""
    whole = np.concatenate([np.zeros_like(orders[..., :1]), orders], axis=-1)
    return np.fft.irfft(whole * size, size)


def _fine_speeds(tuning: Tuning, order: int) -> Array:
    """Return the tuning's speeds and as many between as keep neighbours alike, but not zero."""
    speeds = [tuning.speed[:1]]
    turns = np.abs(np.diff(tuning.shift)) * order
    for (slow, fast), turn in zip(pairwise(tuning.speed), turns, strict=True):
        if slow < 0 < fast:
            speeds.append(np.array([fast]))  # through standstill the table goes through zero
            continue
        pieces = max(1, math.ceil(turn / ROW_ANGLE))
        speeds.append(slow + (fast - slow) * np.arange(1, pieces + 1) / pieces)
    return np.concatenate(speeds)
