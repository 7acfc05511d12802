"""The estimate of a recording smoothed by what follows, block by block.

The equations are those of the causal form (`estimate`), run backwards (`smoother`, Bryson and
Frazier 1963), each time over `BLOCK` and the `AHEAD` that follows it.

A step of the torque shows some time after it began. The smoothed form therefore rests on a second
filter, which raises the noise of the torque `ONSET_TIME` before the step showed (`Again`): a random
walk without jumps would spread a load that comes at rest over the rest before it.
"""

from __future__ import annotations

import math
from collections import deque

import numpy as np

from rigtool.experiments.force_filter import passed, smoother
from rigtool.experiments.force_filter.estimate import PIECE_STEPS, Estimate, Filter, Signals
from rigtool.experiments.force_filter.highest import highest
from rigtool.experiments.force_filter.kalman import Uncertainty
from rigtool.experiments.force_filter.linear import ROW_LENGTH
from rigtool.experiments.force_filter.motion_states import UNSEEN_TIME
from rigtool.experiments.force_filter.plant import STATES, Plant
from rigtool.numerics.arrays import Array

ONSET_TIME = 30e-3
"""Time from a change of the torque until it shows, s."""

UNLIKE = 1.5
"""Standard deviations by which the torques before and after such a rest differ if it changed."""

BLOCK, AHEAD = 64.0, 20.0
"""Time that is smoothed at once, and the time that must follow it, s. With 20 s, later samples
change the torque by less than 1e-4 of its deviation; with 10 s, by up to 0.7 of it in long
rests."""


class Again:
    """The second filter, for the smoother; it runs behind the first one. Samples are added as they
    come.

    The noise of the torque is raised from `ONSET_TIME` before the first filter raised it. It is
    also raised about the end of a rest of `UNSEEN_TIME` within a count, if the first filter finds
    another torque afterwards: a changed load moved the rotor, and the low noise of the rest would
    spread the change over the rest.
    """

    def __init__(
        self, plant: Plant, uncertainty: Uncertainty, step_samples: int, corner_hz: float
    ) -> None:
        self._filter = Filter(plant, uncertainty, step_samples, corner_hz)
        self._size = step_samples
        steps = [
            max(1, round(time / (step_samples * plant.sample_time)))
            for time in (ONSET_TIME, uncertainty.busy_time, UNSEEN_TIME)
        ]
        self._onset, self._settled, self._rest = steps
        self._signals: Signals | None = None
        self._less = np.empty(0)
        self._seen = np.empty((0, 4))  # level, torque, deviation, steps at rest
        self._low = math.nan
        self._begun = False

    def add(
        self,
        signals: Signals,
        estimate: Estimate,
        *,
        less: Array | None = None,
        last: bool = False,
    ) -> Estimate:
        """Take samples and the steps that they complete in the first filter; return the steps that
        are far enough back, or all after the `last` ones, with what the smoother needs.

        `less` (m,) N m is subtracted from the drive torque in each step, if it is given."""
        if self._signals is not None:
            signals = self._signals.joined(signals)
        less = np.zeros(len(estimate.outputs)) if less is None else less
        less = np.concatenate([self._less, less])
        seen = np.column_stack([estimate.outputs[:, [2, 0, 1]], self._rested(estimate.low)])
        self._seen = np.concatenate([self._seen, seen])
        ahead = self._onset + self._settled
        before = len(self._seen) - len(less)  # steps already filtered, still needed for `_least`
        count = max(0, len(less) - (0 if last else ahead))
        end = count * self._size + (0 if self._begun or not count else 1)
        found = self._filter.add(
            signals.part(0, end),
            keep=True,
            less=less[:count],
            least=self._least()[before : before + count],
        )
        self._begun = self._begun or count > 0
        self._signals, self._less = signals.part(end, None), less[count:]
        self._seen = self._seen[max(0, before + count - self._onset - 1) :]
        return found

    def _rested(self, low: Array) -> Array:
        """Return the number of steps since the angle entered its present count, (m,)."""
        if not len(low):
            return np.empty(0)
        step, first = np.arange(float(len(low))), self._seen[-1, 3] if len(self._seen) else -1.0
        moved = low != np.concatenate([[self._low], low[:-1]])
        self._low = float(low[-1])
        return step - np.maximum.accumulate(np.where(moved, step, -1.0 - first))

    def _least(self) -> Array:
        """Return the lowest levels of the torque's noise at the steps in `_seen`, (m,)."""
        level, torque, deviation, rested = self._seen.T
        later = np.minimum(np.arange(len(level)) + self._settled, len(level) - 1)
        ended = np.zeros(len(level))
        changed = np.abs(torque[later][1:] - torque[:-1])
        unlike = changed > UNLIKE * np.hypot(deviation[later][1:], deviation[:-1])
        ended[1:][(rested[1:] == 0) & (rested[:-1] >= self._rest) & unlike] = 2.0
        return highest(np.maximum(level, highest(ended, self._onset, 0)), 0, self._onset)


class Smoother:
    """The smoothed estimate of the steps that the filter kept, as soon as enough steps follow.

    `step_time` s is that of the filter's steps.
    """

    def __init__(self, uncertainty: Uncertainty, step_time: float) -> None:
        self._kept = math.exp(-step_time / uncertainty.friction_noise_time)
        self._block, self._ahead = BLOCK / step_time, AHEAD / step_time
        self._waiting: deque[tuple[Array, Array, tuple[Array, ...]]] = deque()
        self._count = 0

    def add(self, estimate: Estimate) -> tuple[Array, Array]:
        """Take the kept data of steps; return torque and deviation of the next steps, (m,) N m.

        Only steps that enough others follow are returned; often there are none.
        """
        if len(estimate.deviation):
            assert estimate.kept is not None
            own = estimate.torque.copy(), estimate.deviation.copy(), estimate.kept
            self._waiting.append(own)
            self._count += len(estimate.deviation)
        if self._count < self._block + self._ahead:
            return np.empty(0), np.empty(0)
        return self._backwards(self._ahead)

    def finish(self) -> tuple[Array, Array]:
        """Return torque and deviation of all waiting steps, (m,) N m each."""
        return self._backwards(0)

    def _backwards(self, ahead: float) -> tuple[Array, Array]:
        """Smooth the waiting steps; return all of them except at least the last `ahead`."""
        rows = np.zeros(STATES * ROW_LENGTH)
        done: deque[tuple[Array, Array]] = deque()
        behind = 0
        for causal, spread, kept in reversed(self._waiting):
            torque, deviation = causal.copy(), spread.copy()
            smoother.smooth_steps(rows, self._kept, kept, torque, deviation)
            if behind >= ahead:
                done.appendleft((torque, deviation))
            behind += len(deviation)
        for torque, _ in done:
            self._waiting.popleft()
            self._count -= len(torque)
        if not done:
            return np.empty(0), np.empty(0)
        first, second = (np.concatenate(parts) for parts in zip(*done, strict=True))
        return first, second


def smoothed(
    plant: Plant,
    uncertainty: Uncertainty,
    step_samples: int,
    corner_hz: float,
    signals: Signals,
) -> tuple[Array, Array]:
    """Return the torque after each step, and its deviation behind a low-pass without phase shift,
    (m,) N m each, from the whole recording.

    Raises `ValueError` for less than a step of samples.
    """
    if signals.low.size <= step_samples:
        raise ValueError(f"{signals.low.size} samples are less than a step of {step_samples}")
    causal = Filter(plant, uncertainty, step_samples, corner_hz)
    again = Again(plant, uncertainty, step_samples, corner_hz)
    step_time = step_samples * plant.sample_time
    later = Smoother(uncertainty, step_time)
    found = []
    for first in range(0, signals.low.size, PIECE_STEPS * step_samples):
        piece = signals.part(first, first + PIECE_STEPS * step_samples)
        last = first + PIECE_STEPS * step_samples >= signals.low.size
        found.append(later.add(again.add(piece, causal.add(piece), last=last)))
    found.append(later.finish())
    torque, deviation = (np.concatenate(parts) for parts in zip(*found, strict=True))
    return torque, without_delay(deviation, corner_hz, step_time)


def without_delay(deviation: Array, corner_hz: float, step_time: float) -> Array:
    """Return the deviation behind a low-pass without phase shift, (m,) N m.

    It is the deviation behind the causal low-pass of the same corner, at a time later by its delay.
    """
    late = min(round(passed.delay(corner_hz) / step_time), len(deviation) - 1)
    return np.append(deviation[late:], np.full(late, deviation[-1]))
