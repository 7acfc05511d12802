"""From recorded samples to the samples and steps of the filter.

The filter advances by `SAMPLE_TIME` or less, and takes the angle in once in each `STEP_TIME`.
Finer recordings are averaged; in coarser ones, whose samples are means themselves, the current
holds for the sample, and the angle between them comes from the encoder's edges (`encoder_angle`):

    count = floor(angle / width of a count)

The filter's equations are a leapfrog: speeds belong to the begin of a sample, angles to its middle.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from rigtool.experiments.force_filter.encoder_angle import interpolated
from rigtool.experiments.force_filter.estimate import Signals
from rigtool.experiments.force_model.drive import MotorMap
from rigtool.numerics.arrays import Array

SAMPLE_TIME = 0.5e-3
"""Longest sample of the filter, s: bristles and tendon swing within milliseconds. Half of it
changed errors by less than they scatter from rig to rig."""

STEP_TIME = 1e-3
"""Time from one angle that the filter takes in to the next, s."""

CONTEXT_SAMPLES = 4096
"""Recorded samples on either side from which angles between counts are interpolated."""


@dataclass(frozen=True)
class FilterSteps:
    """Samples of the filter in recorded ones: means of `averaged`, or `divided` into parts.

    `sample_time` s is the filter's; `step_samples` of its samples are a step. The encoder of a
    recorded sample is read `lead` recorded samples before the time that it stands for.
    """

    averaged: int
    divided: int
    sample_time: float
    step_samples: int
    lead: float

    @property
    def step_time(self) -> float:
        """Time of a step, s."""
        return self.step_samples * self.sample_time

    @classmethod
    def of(cls, interval: float, loop_time: float) -> FilterSteps:
        """Return the grid for samples that were recorded every `interval` s by a loop that reads
        the encoder at the begin of each sample of `loop_time` s."""
        averaged = max(1, int(SAMPLE_TIME / interval * (1 + 1e-6)))
        divided = max(1, int(np.ceil(interval / SAMPLE_TIME * (1 - 1e-6))))
        sample_time = interval * averaged / divided
        steps = max(1, round(STEP_TIME / sample_time))
        return cls(averaged, divided, sample_time, steps, loop_time / interval / 2)

    def means(self, signal: Array) -> Array:
        """Return a recorded signal (n,) at the samples of the filter (k,)."""
        size = len(signal) // self.averaged
        parts = signal[: size * self.averaged].reshape(size, self.averaged)
        means = parts[:, 0].copy()
        for part in range(1, self.averaged):  # a sum of columns: faster than one of each row
            means += parts[:, part]
        means /= self.averaged
        return means if self.divided == 1 else np.repeat(means, self.divided)

    def counts(self, encoder: Array) -> Array:
        """Return the count that the angle is in at the middle of each sample of the filter (k,)."""
        size = len(encoder) // self.averaged * self.averaged
        whole = encoder == np.floor(encoder)
        if self.divided == 1 and whole.all():
            return encoder[self.averaged // 2 : size : self.averaged].copy()
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
    """Recorded samples as those of the filter, block by block; what is left of a block waits.

    `count` rad is that of the encoder, `context` the recorded samples on either side that angles
    between counts may come from: 0 where each sample is a count of its own, and nothing waits.
    """

    def __init__(
        self, grid: FilterSteps, count: float, drive: MotorMap, context: int = CONTEXT_SAMPLES
    ) -> None:
        self._grid, self._count, self._drive = grid, count, drive
        self._context = context - context % grid.averaged
        self._lagging = np.zeros(2)
        self._held: Array | None = None
        self._before = 0  # of the held ones: context alone

    def add(self, samples: Array, *, last: bool = False) -> tuple[Signals, Array]:
        """Return the filter's input from samples (c, n), and the others at its samples (c - 3, k).

        The first three rows are the encoder in counts, the current in A, and the torque constant
        in N m/A. After the `last` ones nothing waits but less than an average.
        """
        grid, before = self._grid, self._before
        held = samples if self._held is None else np.hstack([self._held, samples])
        size = held.shape[1] - (0 if last else self._context) - before
        end = before + max(0, size // grid.averaged * grid.averaged)
        ends = [edge // grid.averaged * grid.divided for edge in (before, end)]
        low = grid.counts(held[0])[slice(*ends)] * self._count
        current, constant, *others = (grid.means(row[before:end]) for row in held[1:])
        torque, viscous = self._drive.torque(
            low + self._count / 2, current, constant, grid.sample_time, self._lagging
        )
        self._before = min(self._context, end)
        self._held = held[:, end - self._before :].copy()
        signals = Signals(torque, viscous, low, self._count)
        return signals, np.array(others).reshape(len(others), len(low))


class Stepper:
    """Samples of the filter at the ends of its steps: the mean of both sides."""

    def __init__(self, step_samples: int) -> None:
        self._size = step_samples
        self._held: Array | None = None

    def add(self, samples: Array) -> Array:
        """Return signals (c, k) at the end of every step that these samples complete, (c, m)."""
        held = samples if self._held is None else np.hstack([self._held, samples])
        count = max(0, (held.shape[1] - 1) // self._size)
        self._held = held[:, count * self._size :].copy()
        ends = np.arange(1, count + 1) * self._size
        found: Array = (held[:, ends - 1] + held[:, ends]) / 2
        return found


def unbroken(time: Array, good: NDArray[np.bool_], interval: float) -> list[slice]:
    """Return the stretches in which no sample is missing and all are good, (n,) each."""
    edges = np.diff(good.astype(np.int8), prepend=0, append=0)
    gap = np.flatnonzero(np.abs(np.diff(time) - interval) > interval / 2) + 1
    begins = np.flatnonzero(edges > 0)
    ends = np.flatnonzero(edges < 0)
    found = []
    for begin, end in zip(begins, ends, strict=True):
        cuts = [int(begin), *gap[(gap > begin) & (gap < end)].tolist(), int(end)]
        found += [slice(a, b) for a, b in pairwise(cuts)]
    return found
