"""An inertia that the tables do not hold, by the accelerations that a set point asks for.

A force swings the rotor within its loop, and its torque then goes with the acceleration as that of
an inertia does. The acceleration a of the set point, which the output follows, knows nothing of
what touches. About each change k of the set point's speed, behind one low-pass, with what a line in
time and friction that changes with the direction hold taken off,

    J = median a_k' M_k / a_k' a_k

A pulse is in few of the changes, and a force that swings has another phase in each: both are in the
scatter of a_k' M_k, from which the median has its standard error. What repeats with the strokes and
is no inertia is not. It is left in r = M - J a, with M and a the medians of all changes, and by the
sums R and A over time of r and of a with themselves, shifted by each lag, it moves J by
sqrt(A' R / n) / a' a, n the points less what is fitted. A force that opposes the acceleration at
both ends of all strokes cannot be told from an inertia. Nor can friction that a reversal lacks: of
a slow turn it has the shape, and a line and friction leave little of its a, so that a small torque
makes a large J. So turns are compared where more than half of a is left, and J a_k, not J times the
whole acceleration, has to be beyond errors; in the mean of both ends, because a torque with one
sign adds to J at one end what it takes at the other.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from rigtool.experiments.force_sensor.unknown_inertia import (
    FEWEST_TURNS,
    LONGEST_STEP,
    SHOWN_HZ,
    TYPICAL_OVER_U,
    UnknownInertia,
    changes_of_speed,
)
from rigtool.numerics.arrays import Array, Mask, joined
from rigtool.numerics.lowpass import lowpass

REACH_TIME, POINTS = 0.15, 61
"""Time on both sides of a change that is compared, s, and points of it."""

MOVES = 1e-3
"""Part of the largest speed from which on a set point has a direction."""

TAKEN_OFF = 4
"""Parameters that are fitted: a line, friction and the inertia."""

LEAST_CERTAIN, CERTAIN = 1.0, 2.5
"""Standard errors by which the inertia of either side is above zero, and that of both together."""

LEFT = 0.5
"""Part of the acceleration that a line and friction leave at least: slow turns are as friction."""

ALIKE = 0.25
"""Part of the larger inertia that the other side shows at least: a spring is at one end."""


@dataclass(frozen=True, eq=False)
class CommandedTurns:
    """Changes of a set point's speed: its largest `acceleration` at the output, rad/s2, with its
    sign, and `u` of the torque, N m, (k,); `windows` (k, 2, POINTS): this acceleration and the
    torque, less what a line and friction hold of each."""

    acceleration: Array = field(default_factory=lambda: np.empty(0))
    u: Array = field(default_factory=lambda: np.empty(0))
    windows: Array = field(default_factory=lambda: np.empty((0, 2, POINTS)))

    @classmethod
    def of(
        cls, step_time: float, setpoint: Array, known: Mask, torque: Array, u: Array
    ) -> CommandedTurns:
        """Return those of rows (m,) every `step_time` s: set point of the output rad, torque and u
        N m; rows that are not `known` have no value."""
        reach = REACH_TIME / step_time
        if step_time > LONGEST_STEP or len(setpoint) < 4 * reach or not np.ptp(setpoint):
            return cls()
        given = np.where(known, torque, 0.0)
        wanted, shown = (lowpass(1 / step_time, one, SHOWN_HZ) for one in (setpoint, given))
        speed = np.gradient(wanted, step_time)
        asked = np.gradient(speed, step_time)
        moves = np.abs(speed) > MOVES * np.abs(speed).max()
        friction = lowpass(1 / step_time, np.where(moves, np.sign(speed), 0.0), SHOWN_HZ)
        rows, place = np.arange(len(known)), np.linspace(-1, 1, POINTS)
        largest, own_u, windows = [], [], []
        for change, sign in changes_of_speed(asked):
            at = (change.start + change.stop - 1) / 2 + reach * place
            about = slice(math.floor(at[0]), math.ceil(at[-1]) + 1)
            if about.start < 0 or about.stop > len(known) or not known[about].all():
                continue
            every = asked, shown, friction
            *own, turns = (np.interp(at, rows[about], one[about]) for one in every)
            held, window = np.stack([np.ones(POINTS), place, turns], axis=1), np.stack(own, axis=1)
            windows.append((window - held @ np.linalg.lstsq(held, window)[0]).T)
            largest.append(sign * np.abs(asked[change]).max())
            own_u.append(u[change].mean())
        return cls(np.array(largest), np.array(own_u), np.reshape(windows, (-1, 2, POINTS)))


def commanded_inertia(parts: Sequence[CommandedTurns]) -> UnknownInertia | None:
    """Return what the turns of stretches show, the larger of both signs; None where they are slow,
    may be chance or are not alike, or their torques are, in the mean, no more than errors."""
    acceleration, u, windows = joined(parts, "acceleration", "u", "windows")
    found, certain, over_u = [], 0.0, 0.0
    for side in (acceleration > 0, acceleration < 0):
        if side.sum() < FEWEST_TURNS:
            return None
        asked, left = np.abs(acceleration[side]), np.abs(windows[side, 0]).max(axis=1)
        inertia, error = _inertia(windows[side])
        if not inertia > LEAST_CERTAIN * error or np.median(left / asked) < LEFT:
            return None
        certain += inertia / error / math.sqrt(2)
        over_u += float(np.median(inertia * left / u[side])) / 2
        found.append(UnknownInertia(inertia, float(np.median(inertia * asked))))
    least, largest = sorted(found, key=lambda one: one.inertia)
    alike = least.inertia > ALIKE * largest.inertia
    return largest if alike and certain > CERTAIN and over_u > TYPICAL_OVER_U else None


def _inertia(windows: Array) -> tuple[float, float]:
    """Return the inertia that windows (k, 2, POINTS) show, kg m2, and its standard error."""
    asked, shown = windows.transpose(1, 0, 2)
    each = (asked * shown).sum(axis=1) / (asked**2).sum(axis=1)
    inertia = float(np.median(each))
    # of a median of normal errors, whose deviation is 1.4826 times their median
    scatter = 1.4826 * np.median(np.abs(each - inertia)) * math.sqrt(math.pi / 2 / len(each))
    motion = np.median(asked, axis=0)
    left = np.median(shown, axis=0) - inertia * motion
    lags = np.correlate(motion, motion, "full") @ np.correlate(left, left, "full")
    repeated = math.sqrt(lags / (POINTS - TAKEN_OFF)) / (motion @ motion)
    return inertia, math.hypot(scatter, repeated)
