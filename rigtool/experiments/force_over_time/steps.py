"""From recorded samples to the samples and steps of the filter.

The filter advances by `SAMPLE_TIME` or less, and takes the angle in once in each `STEP_TIME`.
Finer recordings are averaged; in coarser ones, whose samples are means themselves, the current
holds for the sample, and the angle between them comes from the encoder's edges (`encoder_angle`):

    count = floor(angle / width of a count)
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from rigtool.experiments.force_over_time.drive import Drive
from rigtool.experiments.force_over_time.encoder_angle import interpolated
from rigtool.experiments.force_over_time.estimate import Signals

Array = NDArray[np.float64]

SAMPLE_TIME = 0.25e-3
"""Longest sample of the filter, s: bristles and tendon swing within milliseconds."""

STEP_TIME = 1e-3
"""From one angle that the filter takes in to the next, s."""


@dataclass(frozen=True)
class Grid:
    """Samples of the filter in recorded ones: means of `averaged`, or `divided` into parts.

    `sample_time` s is the filter's; `step_samples` of its samples are a step.
    """

    averaged: int
    divided: int
    sample_time: float
    step_samples: int

    @classmethod
    def of(cls, interval: float) -> Grid:
        """Return the grid for samples that were recorded every `interval` s."""
        averaged = max(1, int(SAMPLE_TIME / interval * (1 + 1e-6)))
        divided = max(1, int(np.ceil(interval / SAMPLE_TIME * (1 - 1e-6))))
        sample_time = interval * averaged / divided
        return cls(averaged, divided, sample_time, max(1, round(STEP_TIME / sample_time)))

    def means(self, signal: Array) -> Array:
        """Return a recorded signal (n,) at the samples of the filter (k,)."""
        size = len(signal) // self.averaged
        means: Array = signal[: size * self.averaged].reshape(size, self.averaged).mean(axis=1)
        return np.repeat(means, self.divided)

    def counts(self, encoder: Array) -> Array:
        """Return the count that the angle is in at the begin of each sample of the filter (k,)."""
        size = len(encoder) // self.averaged * self.averaged
        whole = encoder == np.floor(encoder)
        if self.divided == 1 and whole.all():
            return encoder[: size : self.averaged].copy()
        place = np.arange(0.0, size * self.divided // self.averaged)
        place *= self.averaged / self.divided
        sample = place.astype(np.intp)
        counts: Array = np.floor(interpolated(encoder, place))
        step = np.abs(np.diff(encoder, prepend=encoder[0], append=encoder[-1]))
        slow = whole & (np.maximum(step[:-1], step[1:]) <= 1)  # not a mean of several counts
        counts[slow[sample]] = encoder[sample][slow[sample]]
        return counts

    def signals(
        self, encoder: Array, current: Array, count: float, drive: Drive, torque_constant: float
    ) -> Signals:
        """Return what the filter takes of samples (n,) in counts and A.

        `count` rad is that of the encoder, `torque_constant` in N m/A.
        """
        low = self.counts(encoder) * count
        torque, viscous = drive.torque(
            low + count / 2, self.means(current), torque_constant, self.sample_time
        )
        return Signals(torque, viscous, low, count)

    def at_steps(self, signal: Array) -> Array:
        """Return a recorded signal (n,) at the end of each step (m,): the mean of both sides."""
        means = self.means(signal)
        ends = np.arange(self.step_samples, len(means), self.step_samples)
        found: Array = (means[ends - 1] + means[ends]) / 2
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
