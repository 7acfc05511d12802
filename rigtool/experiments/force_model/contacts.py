"""Contacts in a torque over time: found by tests whose thresholds follow from measured errors.

The torque M is that of a causal filter whose random walk is always that of no contact, since levels
that adapt widen the deviation just when something touches. Two tests are applied to it, after a
first-order low-pass of `JUMP_LAG`:

    jump    |M(t) - M(t - WINDOW)|       errors that last longer than the window cancel
    level   |M(t)| / u(t)                what comes slowly; u is the filter's deviation of M

Where a part of M is in doubt by d (ripple of another power-up), the level's u is sqrt(u^2 + d^2),
and a jump is multiplied by u over that: errors of a jump are in proportion to this sum.

Errors depend on the `MotionKind`: steady motion, within `REVERSAL_TIME` of a reversal or of a rotor
that creeps, which sticks and slips, and rest. In each, the highest values in blocks of WINDOW
(longer than the errors of a jump remember) where nothing touches give the threshold of a test at a
rate of false alarms: an exponential tail above the quantile t at `TAIL_QUANTILE` (J. Pickands, Ann.
Stat. 3(1) 119-131, 1975, shape 0), whose mean m is known from the n values that exceed it alone
(predictive distribution; prior 1 / m):

    P(x > t + y) = (1 - TAIL) (1 + y / (n m))^-n

A contact begins where M passed half of its highest value in the WINDOW after the contact was found,
and where it was found at the latest. It ends where M falls below half of its mean so far: such a
value is as near to no contact as to that mean. A force that swings through zero is found in each
half wave. A contact leaves the filter's friction wrong, and a level that seems to be another one
for `LEVEL_MEMORY`: `force_sensor.events` looks there at a torque from the whole recording.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from enum import IntEnum

import numpy as np
from numpy.typing import ArrayLike, NDArray

from rigtool.experiments.force_filter.highest import highest
from rigtool.experiments.force_filter.motion_states import CREEPING_KIND, State, States
from rigtool.numerics.arrays import Array
from rigtool.numerics.compiled import compiled_allocating
from rigtool.numerics.recursion import Biquad, filtered

Single = NDArray[np.float32]

JUMP_WINDOW = 0.06
"""Time of a jump, s: the touch of a hand or a tool rises within it."""

JUMP_LAG = 5e-3
"""Time constant of the low-pass, s."""

REVERSAL_TIME = 3 * JUMP_WINDOW
"""Time after a reversal in which its errors last, s: a jump looks back by one window."""

LEVEL_MEMORY = 1.0
"""Memory of the level's errors, and the longest time from the begin of a contact to its finding,
s."""

FALSE_ALARMS = ((1 / 72000, 1 / 7200), (1 / 7200, 1 / 7200), (1 / 7200, 1 / 7200))
"""Rates of false alarms by jump and by level, Hz, in motion of each `MotionKind`: one in two hours.
In steady motion jumps of errors are small, and a tenth of the rate costs no delay."""

TAIL_QUANTILE = 0.9

MIN_BLOCKS = 50
"""Blocks of a motion without which there is no threshold, and no contact is found in it."""

CONTACT_SETTLING_TIME = 2.0
"""Time without tests at the beginning of a stretch, s: the filter does not know the history."""


class MotionKind(IntEnum):
    """The kinds of motion on which the errors of a test depend."""

    STEADY = 0
    REVERSED = 1
    STILL = 2


@dataclass(frozen=True, eq=False)
class Trial:
    """Values of both tests at m steps, `jump` N m and `level`, both with their sign, and the
    `torque` N m; the motion, -1 where none is tested; (m,) each. `step_time` in s."""

    torque: Single
    jump: Single
    level: Single
    motion: NDArray[np.int8]
    step_time: float


@dataclass(frozen=True)
class Contact:
    """Steps at which a contact begins, is found, and ends."""

    begin: int
    found: int
    end: int

    def rows(self, every: int) -> slice:
        """Return the rows of a table, of `every` steps each, in which it lasts."""
        return slice(self.begin // every, self.end // every + 1)


def trial(
    torque: Array, deviation: Array, kinds: States, step_time: float, doubt: Array | float = 0.0
) -> Trial:
    """Return the tests of a stretch from torque and deviation of the filter without contacts, N m;
    (m,).

    `kinds` are `Judged.kinds`; `doubt` N m is the standard deviation of the ripple that was
    subtracted from the torque.
    """
    kept = math.exp(-step_time / JUMP_LAG)
    low_pass = Biquad(1 - kept, 0.0, 0.0, -kept, 0.0)
    smooth: Single = filtered(low_pass, torque).astype(np.float32)
    window = round(JUMP_WINDOW / step_time)
    jump: Single = np.zeros(len(smooth), dtype=np.float32)
    jump[window:] = smooth[window:] - smooth[: len(smooth) - window]
    whole = np.hypot(deviation, doubt)
    jump *= deviation
    jump /= whole
    motion = np.full(len(smooth), MotionKind.STEADY, dtype=np.int8)
    unsteady = (kinds == State.REVERSED) | (kinds == CREEPING_KIND)
    motion[highest(unsteady, round(REVERSAL_TIME / step_time), 0)] = MotionKind.REVERSED
    motion[kinds == State.STILL] = MotionKind.STILL
    motion[highest(kinds == State.OUTSIDE, window, 0)] = -1
    motion[: round(CONTACT_SETTLING_TIME / step_time)] = -1
    level: Single = np.divide(smooth, whole, dtype=np.float32)
    return Trial(smooth, jump, level, motion, step_time)


def thresholds(untouched: Sequence[Trial], rates: ArrayLike = FALSE_ALARMS) -> Array:
    """Return thresholds (3, 2) of jump N m and level by motion, infinite where too few are known.

    `rates` (3, 2) Hz are those of false alarms of each.
    """
    found = np.full((len(MotionKind), 2), np.inf)
    for motion, own in zip(MotionKind, np.asarray(rates), strict=True):
        for number, (name, memory) in enumerate((("jump", JUMP_WINDOW), ("level", LEVEL_MEMORY))):
            highest = [_highest(test, getattr(test, name), motion, memory) for test in untouched]
            values = np.concatenate([np.zeros(0), *highest])
            if len(values) >= MIN_BLOCKS:
                found[motion, number] = _exceeded(values, float(own[number]) * memory)
    return found


def _highest(test: Trial, values: Single, motion: MotionKind, memory: float) -> Array:
    """Return the highest absolute value in each block of `memory` s that has this motion."""
    size = round(memory / test.step_time)
    count = len(values) // size
    own = np.where(test.motion == motion, np.abs(values), -1.0)[: count * size]
    highest: Array = own.reshape(count, size).max(axis=1).astype(np.float64)
    return highest[highest >= 0]


def _exceeded(values: Array, probability: float) -> float:
    """Return the value that values like these (n,) exceed with a probability, by their tail."""
    start = float(np.quantile(values, TAIL_QUANTILE))
    beyond = values[values > start] - start
    if not len(beyond):
        return start
    count = len(beyond)
    return start + float(beyond.sum()) * (((1 - TAIL_QUANTILE) / probability) ** (1 / count) - 1)


def contacts(test: Trial, limits: Array) -> list[Contact]:
    """Return the contacts in a stretch, by thresholds (3, 2) as `thresholds` gives them."""
    longest = round(LEVEL_MEMORY / test.step_time)
    window = round(JUMP_WINDOW / test.step_time)
    levels = np.ascontiguousarray(limits)  # one kind of array: compiled once
    rows = _contacts(test.torque, test.jump, test.level, test.motion, levels, window, longest)
    return [Contact(*row) for row in rows]


@compiled_allocating
def _contacts(
    torque: Single,
    jump: Single,
    level: Single,
    motion: NDArray[np.int8],
    limits: Array,
    window: int,
    longest: int,
) -> list[tuple[int, int, int]]:
    rows = []
    begin, found, side, total = 0, -1, 0.0, 0.0
    ending = False  # a contact's level still falls: it is no other contact
    for k in range(len(torque)):
        if found >= 0:
            total += side * torque[k]
            if motion[k] < 0 or side * torque[k] < total / (k - found + 1) / 2.0:
                rows.append((begin, found, k))
                found, total, ending = -1, 0.0, True
            continue
        if motion[k] < 0:
            continue
        # a jump away from zero: what it ends at is nearer to itself than to nothing
        away = jump[k] * torque[k] > 0.0 and abs(torque[k]) > abs(jump[k]) / 2.0
        rises = away and abs(jump[k]) > limits[motion[k], 0]
        high = abs(level[k]) > limits[motion[k], 1]
        ending = ending and high
        if not rises and (ending or not high):
            continue
        found, side, begin = k, np.sign(torque[k]), k
        half = (side * torque[k : k + window + 1]).max() / 2.0
        earliest = max(rows[-1][2] if rows else 0, k - longest)
        while begin > earliest and side * torque[begin - 1] > half:
            begin -= 1
        total = abs(torque[k])
    if found >= 0:
        rows.append((begin, found, len(torque) - 1))
    return rows
