"""The state of motion at each step; it decides whether there is a value, and how large its u is.

With rotor speed w, deflection h of the long bristle (`plant`) and torque M on the output,

    still        the encoder passes one edge at most within `STILL_TIME`
    reversed     h sign(w) < `SLIDING_DEFLECTION`: friction is not yet that of sliding
    against      M w >= 0,   with   M w < 0
    outside      angle, speed, torque or temperature beyond what was learned

The size of the error also depends on whether a sliding rotor creeps: with less than
`CREEP_SPEED_RATIO` of the slowest speed that was learned under load it sticks and slips.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from rigtool.experiments.force_filter.highest import highest
from rigtool.numerics.arrays import Array, Mask, joined

States = NDArray[np.int32]
Holding = NDArray[np.int8]

STILL_TIME = 0.1
"""Time, s, within which a rotor that stands still passes one edge of the encoder at most."""

UNSEEN_TIME = 0.25
"""Rest within a count, s, from which on a load may have changed unseen. Of contacts that begin each
5 s, as the ripple's rows expect, 5 % begin within it, which a 95 % interval leaves out."""

LIMIT_TIME = 0.1
"""Time about a current at its limit, and behind the begin of a filter, in which the torque has no
value, s. Errors of filters that begin in motion are as usual from then on."""

SPEED_TIME = 0.05
"""Time over which a speed is averaged before the comparison with learned speeds, s."""

SLIDING_DEFLECTION = 0.9
"""Part of its deflection at which friction is that of sliding."""

LARGEST_LEARNED_RATIO, FASTEST_LEARNED_RATIO = 1.1, 1.100017
"""Multiples of the learned torque and speed up to which values are given; that of speed is a little
more than 1.1, so that rounding does not decide where it is a whole number of counts."""

CREEP_SPEED_RATIO = 0.4999
"""Part of the slowest speed learned under load, below which a sliding rotor creeps. It is a little
less than half, so that rounding does not decide at half of a round speed."""

BEYOND_ANGLE = 0.010017
"""Part of the range of angles by which values are given beyond it, on both sides: a little more
than a hundredth, for the same reason."""


class State(IntEnum):
    """The numbers are those in run files."""

    OUTSIDE = 0
    AGAINST = 1
    WITH = 2
    REVERSED = 3
    STILL = 4


CREEPING_KIND = len(State)
"""Behind the states, the kind of a step at which the rotor slides and creeps."""

KIND_COUNT = CREEPING_KIND + 1

STATE_NAMES = {
    State.OUTSIDE: "outside what was learned: no value",
    State.AGAINST: "moving against the load",
    State.WITH: "moving with the load",
    State.REVERSED: "after a reversal",
    State.STILL: "standing still",
}


@dataclass(frozen=True)
class Reach:
    """The range in which a model was learned: angle of the rotor rad, its speed rad/s, torque on
    the output N m, and temperature of the motor degC; a sliding rotor creeps below `slow` rad/s."""

    angle: tuple[float, float]
    speed: float
    torque: float
    temperature_degc: tuple[float, float]
    slow: float = 0.0

    def left_by(self, angle: Array, speed: Array, torque: Array, temperature_degc: Array) -> Mask:
        """Return where these (m,) are beyond what was learned."""
        low, high = self.angle
        margin = BEYOND_ANGLE * (high - low)
        cold, warm = self.temperature_degc
        return (
            (angle < low - margin)
            | (angle > high + margin)
            | (np.abs(speed) > FASTEST_LEARNED_RATIO * self.speed)
            | (np.abs(torque) > LARGEST_LEARNED_RATIO * self.torque)
            | (temperature_degc < cold)
            | (temperature_degc > warm)
        )


@dataclass(frozen=True, eq=False)
class Moments:
    """Signals from which states follow, at each of m steps.

    `low` rad is the lower edge of the angle's count, `speed` rad/s and the deflection of the long
    bristle `housing` are the filter's, `torque` N m is that on the output, positive where it
    resists positive motion, `limited` where the current is at its limit, `idle` where the
    motor has had none. All (m,).
    """

    low: Array
    speed: Array
    housing: Array
    torque: Array
    temperature_degc: Array
    limited: Array
    idle: Mask

    def part(self, first: int, last: int | None = None) -> Moments:
        """Return these from step `first` up to `last`."""
        return Moments(*(getattr(self, name)[first:last] for name in self.__dataclass_fields__))

    @classmethod
    def joined(cls, *parts: Moments) -> Moments:
        """Return the parts one behind the other."""
        return cls(*joined(parts, *cls.__dataclass_fields__))


class Judged(NamedTuple):
    """The state at each step; the kind of error, which is the state or `CREEPING_KIND`; whether
    friction may hold what does not show, `holding`; and where it holds the rotor, which stands
    still or creeps after a reversal, `held`. All (m,).

    `holding` is 1 where the motor has had no current, 2 where the rotor crawls besides, one count
    at most within `SPEED_TIME`; 3 where the rotor of a driven motor has been in its count for
    `UNSEEN_TIME`; else 0.
    """

    states: States
    kinds: States
    holding: Holding
    held: Mask


@dataclass(frozen=True)
class Judge:
    """Assigns states; `count` rad is the encoder's, `step_time` s that of a step.

    Where a span of time is needed, it lies on both sides of a step; where `causal`, before it.
    """

    reach: Reach
    count: float
    step_time: float
    causal: bool = False

    @property
    def span(self) -> int:
        """Steps on either side that a state may depend on."""
        about = 2 * max(1, round(max(STILL_TIME, LIMIT_TIME) / self.step_time))
        return max(about, self.unseen)

    @property
    def unseen(self) -> int:
        """Steps in `UNSEEN_TIME`."""
        return max(1, round(UNSEEN_TIME / self.step_time))

    def judged(self, moments: Moments) -> Judged:
        """Return state, kind and what friction holds at each step."""
        low = moments.low
        mean_speed = self._mean_speed(low)
        slow = np.abs(mean_speed) < self.reach.slow
        way = self._highest(low, STILL_TIME) + self._highest(-low, STILL_TIME)
        direction = np.sign(moments.speed)
        found = np.where(moments.torque * direction >= 0, State.AGAINST, State.WITH)
        found[moments.housing * direction < SLIDING_DEFLECTION] = State.REVERSED
        found[way < 1.5 * self.count] = State.STILL
        outside = self.reach.left_by(low, mean_speed, moments.torque, moments.temperature_degc)
        near = self._highest(moments.limited, LIMIT_TIME * (1 if self.causal else 2)) > 0
        found[outside | near] = State.OUTSIDE
        states: States = found.astype(np.int32)
        sliding = (states == State.AGAINST) | (states == State.WITH)
        kinds: States = np.where(sliding & slow, CREEPING_KIND, states).astype(np.int32)
        holding = np.where(moments.idle, 1, np.where(self._rests(low), 3, 0)).astype(np.int8)
        holding[moments.idle & (np.abs(mean_speed) < self.crawling)] = 2
        held = (states == State.STILL) | ((states == State.REVERSED) & slow)
        return Judged(states, kinds, holding, held)

    def _rests(self, low: Array) -> Mask:
        """Return where the count has been the same for `UNSEEN_TIME`, and will be if it is not
        `causal`, (m,); before the first step, it has just come."""
        moved = np.diff(low, prepend=[np.nan, low[0]]) != 0
        steps = self.unseen - 1
        return ~highest(moved, steps, 0 if self.causal else steps)[1:]

    @property
    def crawling(self) -> float:
        """Mean speed below which a rotor crawls, rad/s: rounding does not choose the side."""
        return 1.5 * self.count / SPEED_TIME

    def _highest(self, values: Array, span: float) -> Array:
        """Return the highest value within a span of time, s, about each step or up to it."""
        half = max(1, round(span / self.step_time / 2))
        return highest(values, 2 * half if self.causal else half, 0 if self.causal else half)

    def _mean_speed(self, low: Array) -> Array:
        """Return the mean speed about each step, or up to it, (m,), rad/s."""
        half = max(1, round(SPEED_TIME / self.step_time / 2))
        size = len(low)
        after = np.minimum(np.arange(size) + (0 if self.causal else half), size - 1)
        before = np.maximum(np.arange(size) - half * (2 if self.causal else 1), 0)
        return (low[after] - low[before]) / (np.maximum(after - before, 1) * self.step_time)
