"""An inertia that the tables do not hold, found at the turns of the recording itself.

An inertia J at the output that was not learned reads as a torque in proportion to the output's
acceleration a, of one sign at both ends of a stroke, where a spring's has two and friction changes
with the direction. About each change of speed, with torque and acceleration behind one low-pass,

    M = c_0 + c_1 t + J a + e        by least squares

What touches may push the rotor: there, a speed comes back to what it was. A slow swing under a
force looks like a turn, but an inertia is there all the time: most changes of speed show it, also
those that come back. A force of some hertz swings the rotor in all of them, as an inertia would.
Behind a lower low-pass the turns of the motion are left, and an inertia shows there as well: the
median of J of all changes, by the squares of what no line in t holds of their a. A part of J a is
taken for friction of the strokes, so that the torque may be off for as much between the turns as
well.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field

import numpy as np

from rigtool.numerics.arrays import Array, Mask, joined
from rigtool.numerics.lowpass import lowpass

SHOWN_HZ, SLOW_HZ, LONGEST_STEP = 8.0, 2.5, 0.011
"""Corner of the low-pass, below which counts of the encoder show an acceleration, and of that which
leaves turns, whatever swings faster; and the longest step by which rows show a turn, s."""

LARGE_PART, LARGE_QUANTILE, NEXT_TIME, KEPT = 0.3, 0.99, 0.1, 0.7
"""Part of a quantile of accelerations from which on speed changes; time on both sides of a change
that is compared, s; and the part of the accelerations there that the speed keeps."""

SLOW_PART = 0.25
"""Part of the inertia that shows behind the lower low-pass at least: friction that a turn draws
anew is in it there, and a force of five hertz or more leaves less."""

FEWEST_TURNS = 4
"""Turns of each sign below which nothing is compared."""

TYPICAL_OVER_U, LEAST_OVER_U = 0.5, 0.2
"""J a over u that is beyond errors: median, and lower quartile, of the turns of both signs."""


@dataclass(frozen=True, eq=False)
class Turns:
    """Changes of speed: largest `acceleration` of the output, rad/s2, with its sign, `inertia` that
    the torque shows there, kg m2, and its `u`, N m; (k,) each. `passing` (m,) kg m2 is what those
    show that come back. `slow` (l, 2) are a'^2 and a' M' of all, the parts behind the lower
    low-pass that no line holds."""

    acceleration: Array = field(default_factory=lambda: np.empty(0))
    inertia: Array = field(default_factory=lambda: np.empty(0))
    u: Array = field(default_factory=lambda: np.empty(0))
    passing: Array = field(default_factory=lambda: np.empty(0))
    slow: Array = field(default_factory=lambda: np.empty((0, 2)))

    @classmethod
    def of(cls, step_time: float, output: Array, known: Mask, torque: Array, u: Array) -> Turns:
        """Return those of rows (m,) every `step_time` s: angle of the output rad, torque and u N m;
        rows that are not `known` have no value."""
        margin = round(NEXT_TIME / step_time)
        if step_time > LONGEST_STEP or len(output) < 4 * margin:
            return cls()
        given = np.where(known, torque, 0.0)
        acceleration, shown = _behind(SHOWN_HZ, step_time, output, given)
        turning = np.stack(_behind(SLOW_HZ, step_time, output, given), axis=1)
        found, passing, slow = [], [], []
        for change, sign in changes_of_speed(acceleration):
            about = slice(change.start - margin, change.stop + margin)
            if about.start < 0 or about.stop > len(known) or not known[about].all():
                continue
            own = acceleration[about]
            line = np.stack([np.ones(len(own)), np.linspace(-1, 1, len(own)), own], axis=1)
            inertia = np.linalg.lstsq(line, shown[about])[0][2]
            bent = turning[about] - line[:, :2] @ np.linalg.lstsq(line[:, :2], turning[about])[0]
            slow.append(bent[:, 0] @ bent)
            if abs(own.sum()) < KEPT * np.abs(own).sum():
                passing.append(inertia)
                continue
            largest = sign * np.abs(acceleration[change]).max()
            found.append((largest, inertia, u[change].mean()))
        every = *np.array(found).reshape(-1, 3).T, np.array(passing), np.array(slow).reshape(-1, 2)
        return cls(*every)


def changes_of_speed(acceleration: Array) -> Iterator[tuple[slice, float]]:
    """Yield the rows of each large acceleration of one sign, of all (m,), and this sign."""
    least = LARGE_PART * np.quantile(np.abs(acceleration), LARGE_QUANTILE)
    side = np.where(np.abs(acceleration) > least, np.sign(acceleration), 0.0)
    edges = np.flatnonzero(np.diff(side, prepend=0.0, append=0.0)).tolist()
    for first, last in itertools.pairwise(edges):
        if side[first]:
            yield slice(first, last), float(side[first])


def _behind(corner_hz: float, step_time: float, angle: Array, torque: Array) -> tuple[Array, Array]:
    """Return the acceleration at an angle, and the torque, behind a low-pass, (m,) each."""
    angle, shown = (lowpass(1 / step_time, one, corner_hz) for one in (angle, torque))
    return np.gradient(np.gradient(angle, step_time), step_time), shown


@dataclass(frozen=True)
class UnknownInertia:
    """An `inertia` at the output that was not learned, kg m2, and the `torque` that it takes at the
    turns, N m."""

    inertia: float
    torque: float


def unknown_inertia(parts: Sequence[Turns]) -> UnknownInertia | None:
    """Return what the turns of stretches show, the larger of both signs; None where their torques
    are no more than errors, not in proportion to the acceleration, or where half of all changes of
    speed show less than half of it, or less than `SLOW_PART` behind the lower low-pass."""
    names = "acceleration", "inertia", "u", "passing", "slow"
    acceleration, inertia, u, passing, slow = joined(parts, *names)
    found = []
    for side in (acceleration > 0, acceleration < 0):
        if side.sum() < FEWEST_TURNS:
            return None
        torque = inertia[side] * np.abs(acceleration[side])
        low, middle = np.quantile(torque / u[side], [0.25, 0.5])
        if low < LEAST_OVER_U or middle < TYPICAL_OVER_U:
            return None
        found.append(UnknownInertia(float(np.median(inertia[side])), float(np.median(torque))))
    largest = max(found, key=lambda one: one.torque)
    every = np.median(np.concatenate([inertia, passing]))
    squares, products = slow.T
    slowly = np.quantile(products / squares, 0.5, weights=squares, method="inverted_cdf")
    turns = slowly > SLOW_PART * largest.inertia
    return largest if turns and every > largest.inertia / 2 else None
