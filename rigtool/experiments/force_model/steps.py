"""From recorded samples to the samples and steps of the filter.

The filter advances by `SAMPLE_TIME` or less, and uses the angle once in each `STEP_TIME`. Finer
recordings are averaged; in coarser ones the current holds for the sample. Where recorded samples
are means, or too far apart, the angle between them comes from the encoder's edges
(`encoder_angle`):

    count = floor(angle / width of a count)

The filter's equations are a leapfrog: speeds belong to the beginning of a sample, angles to its
middle. A loop reads the encoder at the beginning of its samples. Where that is not the middle of a
sample of the filter, these begin earlier, by half a sample of the loop, or of the filter if that is
shorter. The encoder reading is then in the middle, and nothing waits for the next sample; each
current acts in two samples of the filter.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from rigtool.experiments.force_filter.encoder_angle import interpolated
from rigtool.experiments.force_filter.estimate import Signals
from rigtool.experiments.force_model.drive import MotorMap
from rigtool.numerics.arrays import Array, Mask

SAMPLE_TIME = 0.5e-3
"""Longest sample of the filter, s: bristles and tendon swing within milliseconds. With half of it,
errors differ by less than they scatter from rig to rig."""

STEP_TIME = 1e-3
"""Time from one angle that the filter uses to the next, s."""

AT_EACH_SAMPLE = 0.49
"""Lead, in recorded samples, from which on a recording has each sample of the loop."""

LONGEST_EXACT = 1.5e-3
"""Longest sample of a loop, s, that is a step by itself: bristles change within longer ones."""

NO_CURRENT = 1e-3
"""Largest current of a motor that is not driven, A."""

HELD_TIME = 1e-3
"""Time for which a current that is missing is taken for that of the sample before it, s: a step, a
thirtieth of a period of the low-pass's corner. Without it the filter would begin anew."""

CONTEXT_SAMPLES = 4096
"""Recorded samples on either side from which angles between counts are interpolated."""


@dataclass(frozen=True)
class FilterSteps:
    """Samples of the filter: means of `averaged` recorded ones, or one `divided` into parts.

    `sample_time` s is the filter's; `step_samples` of its samples are a step. The encoder of a
    recorded sample is read `lead` recorded samples before the time that it stands for. `earlier`:
    samples of the filter begin earlier.
    """

    averaged: int
    divided: int
    sample_time: float
    step_samples: int
    lead: float
    earlier: bool

    @property
    def step_time(self) -> float:
        """Time of a step, s."""
        return self.step_samples * self.sample_time

    @property
    def immediate(self) -> bool:
        """Whether no angle comes from later samples."""
        return self.divided == 1 or self.earlier

    @classmethod
    def of(cls, interval: float, loop_time: float) -> FilterSteps:
        """Return the grid for samples that were recorded every `interval` s by a loop that reads
        the encoder at the beginning of each sample of `loop_time` s."""
        averaged = max(1, int(SAMPLE_TIME / interval * (1 + 1e-6)))
        divided = max(1, int(np.ceil(interval / SAMPLE_TIME * (1 - 1e-6))))
        sample_time = interval * averaged / divided
        steps = max(1, round(STEP_TIME / sample_time))
        lead = loop_time / interval / 2
        earlier = averaged % 2 == 1 and lead > AT_EACH_SAMPLE and interval < LONGEST_EXACT
        if earlier and divided > 1:  # angles between samples are not exact
            steps = divided * max(1, round(STEP_TIME / interval))
        return cls(averaged, divided, sample_time, steps, lead, earlier)

    def means(self, signal: Array) -> Array:
        """Return a recorded signal (n,) at the samples of the filter (k,), with one more in front
        where these begin earlier."""
        if self.earlier:
            between, signal = (signal[:-1] + signal[1:]) / 2, signal[1:]
            if self.divided > 1:
                held = np.repeat(signal, self.divided)
                held[:: self.divided] = between
                return held
            signal = between
        size = len(signal) // self.averaged
        parts = signal[: size * self.averaged].reshape(size, self.averaged)
        means = parts[:, 0].copy()
        for part in range(1, self.averaged):  # a sum of columns: faster than one of each row
            means += parts[:, part]
        means /= self.averaged
        return means if self.divided == 1 else np.repeat(means, self.divided)

    def counts(self, encoder: Array) -> Array:
        """Return the count that the angle is in at the middle of each sample of the filter (k,);
        where these begin earlier, at the first one of each that was recorded."""
        size = len(encoder) // self.averaged * self.averaged
        whole = encoder == np.floor(encoder)
        if self.divided == 1 and whole.all():
            return encoder[self.averaged // 2 : size : self.averaged].copy()
        if self.earlier and whole.all():
            return np.repeat(encoder, self.divided)
        place = np.arange(0.5, size * self.divided // self.averaged)
        place *= self.averaged / self.divided
        place = np.minimum(place + self.lead, len(encoder))
        sample = np.minimum(place.astype(np.intp), len(encoder) - 1)
        counts: Array = np.floor(interpolated(encoder, place))
        step = np.abs(np.diff(encoder, prepend=encoder[0], append=encoder[-1]))
        slow = whole & (np.maximum(step[:-1], step[1:]) <= 1)  # not a mean of several counts
        counts[slow[sample]] = encoder[sample][slow[sample]]
        return counts


class Sampler:
    """Converts recorded samples to those of the filter, block by block; the rest of a block waits.

    `count` rad is that of the encoder. `context` is the number of recorded samples on either side
    from which angles between counts may come: 0 where each sample is a count, and nothing waits.
    """

    def __init__(
        self, grid: FilterSteps, count: float, drive: MotorMap, context: int = CONTEXT_SAMPLES
    ) -> None:
        self._grid, self._count, self._drive = grid, count, drive
        self._context = context - context % grid.averaged
        self._lagging = np.zeros(2)
        self._held: list[Array] = []
        self._before = 0  # of the held ones: context alone

    def add(self, samples: Sequence[Array], *, last: bool = False) -> tuple[Signals, Array]:
        """Return the filter's input from c rows of samples (n,), and all but the first row at its
        samples (c - 1, k).

        The first three rows are the encoder in counts, the current in A, and the torque constant
        in N m/A. After the `last` ones only samples that do not fill an average are left.
        """
        grid, before, held = self._grid, self._before, samples
        if self._held:
            held = [np.concatenate(both) for both in zip(self._held, samples, strict=True)]
        size = len(held[0]) - (0 if last else self._context) - before
        end = before + max(0, size // grid.averaged * grid.averaged)
        ends = [edge // grid.averaged * grid.divided for edge in (before, end)]
        low = grid.counts(held[0])[slice(*ends)] * self._count
        known = [row[before - (grid.earlier and before > 0) : end] for row in held[1:]]
        if grid.earlier and not before:
            known = [np.concatenate([row[:1], row]) for row in known]
        found = np.array([grid.means(row) for row in known])
        current, constant = found[:2]
        torque, viscous = self._drive.torque(
            low + self._count / 2, current, constant, grid.sample_time, self._lagging
        )
        self._before = min(max(self._context, grid.averaged), end)
        self._held = [row[end - self._before :].copy() for row in held]
        return Signals(torque, viscous, low, self._count, np.abs(current) <= NO_CURRENT), found


class Stepper:
    """Signals at the ends of the filter's steps: the mean of the samples on both sides."""

    def __init__(self, step_samples: int) -> None:
        self._size = step_samples
        self._held: Array | None = None

    def add(self, samples: Array) -> Array:
        """Return signals (c, k) at the end of every step that these samples complete, (c, m)."""
        held = samples if self._held is None else np.hstack([self._held, samples])
        count = max(0, (held.shape[1] - 1) // self._size)
        self._held = held[:, count * self._size :].copy()
        end, size = count * self._size, self._size
        return (held[:, size - 1 : end : size] + held[:, size : end + 1 : size]) / 2


def held_samples(interval: float) -> int:
    """Return for how many samples of `interval` s a current holds that is not known."""
    return max(1, round(HELD_TIME / interval))


class Holder:
    """Holds current and temperature where one of both is no number, for `held_samples`; samples are
    added as they come. `count` is how many were held."""

    def __init__(self, interval: float) -> None:
        self._most = held_samples(interval)
        self._last, self._since = np.zeros((2, 1)), self._most
        self.count = 0

    def add(self, signals: Array) -> Array:
        """Return current and temperature (2, n)."""
        known: Mask = np.logical_and.reduce(np.isfinite(signals), axis=0)
        if known.all():
            self._last, self._since = signals[:, -1:].copy(), 0
            return signals
        place = np.arange(1, len(known) + 1)
        last = np.maximum.accumulate(np.where(known, place, 0))
        since = place - last + np.where(last == 0, self._since, 0)
        held = ~known & (since <= self._most)
        whole = np.hstack([self._last, signals])
        self._last, self._since = whole[:, last[-1] :][:, :1].copy(), int(since[-1])
        self.count += int(np.count_nonzero(held))
        return np.where(held, whole[:, last], signals)


def unbroken(steps: Array, good: Mask, interval: float) -> list[slice]:
    """Return the stretches in which no sample is missing and all are good, from the steps of time
    (n - 1,) s between samples, and which are good, (n,)."""
    follows = np.abs(steps - interval) <= interval / 2
    follows &= good[1:]
    follows &= good[:-1]
    begins = np.append(0, np.flatnonzero(~follows) + 1)[: len(good)]
    spans = np.column_stack([begins, np.append(begins, len(good))[1:]])[good[begins]]
    return [slice(begin, end) for begin, end in spans.tolist()]
