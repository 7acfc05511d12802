"""How an effort was recorded: its noise above the bandwidth, its steps, and a low-pass before it.

What the recordings that were learned show there, others of the same rig show as well, at any load
and speed. With density S of the noise in octaves above the bandwidth B, and the densities of the
recordings that were learned, a recording has in the band, beside the scatter that was learned,

    more noise      variance max(S - S_highest) 3 pi B / (8 sqrt 2)   (of the low-pass squared)
    fewer samples   the same of S_highest above half the sampling frequency, which folding spreads
                    evenly below it, at most min(S - S_lowest) of what is seen there
    rounding        variance q^2/12 exp(-(2 pi s / q)^2)              (B. Widrow, I. Kollar, 2008)
    a low-pass      lag t = sqrt(r - 1) / (2 pi f), r = S_lowest / S at f: an error t de/dt

q is the step of the values and s the scatter from sample to sample, which spreads rounding over all
frequencies. A pole makes r grow as the frequency squared; less noise alone does not.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from rigtool.numerics.arrays import TINY, Array
from rigtool.numerics.welch import Welch

OCTAVES = 8
"""Octaves above twice the bandwidth in which noise is looked at."""

SEGMENT_PERIODS = 8
"""Length of the segments of a spectrum, in periods of the bandwidth."""

MOST_PARTS = 3
"""Parts of a recording whose noise is compared."""

PASSED = 3 * math.pi / (8 * math.sqrt(2))
"""Integral of 1 / (1 + x^4)^2: of the power that the low-pass lets through."""

LEAST_RATIO, LEAST_GROWTH = 2.0, 0.5
"""Ratio r from which on it counts, and its least growth, as a power of the frequency: a pole has 2,
less noise alone 0."""


@dataclass(frozen=True, eq=False)
class EffortNoise:
    """Of one recording at `rate` Hz: `density` (o,) of its noise in octaves above the bandwidth,
    unit^2/Hz, NaN beyond half the rate; variance of its `rounding`, unit^2."""

    density: Array
    rounding: float
    rate: float

    def by(self, unit: float) -> EffortNoise:
        """Return that of the effort by a unit."""
        return EffortNoise(self.density / unit**2, self.rounding / unit**2, self.rate)


@dataclass(frozen=True, eq=False)
class LearnedNoise:
    """Of the recordings that were learned: `lowest` and `highest` density (o,), 1/Hz, and variance
    of the rounding, 1, in units of effort."""

    lowest: Array
    highest: Array
    rounding: float

    def beyond(self, noise: EffortNoise, bandwidth_hz: float) -> tuple[float, float]:
        """Return the variance of noise and rounding beside those learned, and the lag, s."""
        more = noise.density - self.highest
        density = float(
            np.max(more, where=np.isfinite(more), initial=self._folded(noise, bandwidth_hz))
        )
        rounding = max(noise.rounding - self.rounding, 0.0)
        ratios = _ratio(self.lowest, noise.density), _ratio(noise.density, self.highest)
        lag = max(_lag(ratio, bandwidth_hz) for ratio in ratios)
        return PASSED * bandwidth_hz * density + rounding, lag

    def _folded(self, noise: EffortNoise, bandwidth_hz: float) -> float:
        """Return the density of noise from above half the rate of a recording, 1/Hz."""
        above = np.isnan(noise.density) & np.isfinite(self.highest)
        most = float(np.sum((self.highest * np.diff(_edges(bandwidth_hz)))[above])) / (
            noise.rate / 2
        )
        seen = noise.density - self.lowest
        return max(float(np.min(seen, where=np.isfinite(seen), initial=most)), 0.0)


def learned_noise(noises: Sequence[EffortNoise]) -> LearnedNoise:
    """Return the noise of recordings."""
    density = np.array([one.density for one in noises])
    rounding = max(one.rounding for one in noises)
    known = np.isfinite(density).all(axis=0)
    lowest: Array = np.where(known, density.min(axis=0), np.nan)
    highest: Array = np.where(known, density.max(axis=0), np.nan)
    return LearnedNoise(lowest, highest, rounding)


def _edges(bandwidth_hz: float) -> Array:
    return bandwidth_hz * np.exp2(np.arange(1.0, OCTAVES + 2))


def noise_of(effort: Array, rate: float, bandwidth_hz: float) -> EffortNoise:
    """Return the noise of an effort (n,), at `rate` Hz: the median of parts, of which a transient
    such as homing is one."""
    segment = max(16, round(SEGMENT_PERIODS * rate / bandwidth_hz))
    parts = np.array_split(effort, min(max(len(effort) // (2 * segment), 1), MOST_PARTS))
    density = np.median([_density(part, segment, rate, bandwidth_hz) for part in parts], axis=0)
    step = float(np.ptp(effort)) / max(len(np.unique(effort)) - 1, 1)
    scatter = max(float(np.var(np.diff(effort))) / 2 - step**2 / 12, 0.0)
    dither = math.exp(-min((2 * math.pi) ** 2 * scatter / max(step**2, TINY), 700.0))
    return EffortNoise(density, step**2 / 12 * dither, rate)


def _density(effort: Array, segment: int, rate: float, bandwidth_hz: float) -> Array:
    """Return the density (o,) in each octave, NaN beyond half the sampling frequency."""
    welch = Welch(segment)
    welch.add(effort)
    spectrum = welch.spectrum(1 / rate)
    density, edges = np.full(OCTAVES, np.nan), _edges(bandwidth_hz)
    for number, (low, high) in enumerate(itertools.pairwise(edges)):
        if high <= rate / 2:
            within = (spectrum.frequency >= low) & (spectrum.frequency < high)
            density[number] = spectrum.psd[within].mean()
    return density


def _ratio(density: Array, other: Array) -> Array:
    """Return the ratio of two densities (o,), NaN where the other one has no noise."""
    return np.divide(density, other, out=np.full(OCTAVES, np.nan), where=other > 0)


def _lag(ratio: Array, bandwidth_hz: float) -> float:
    """Return the lag, s, of a pole that makes noise differ by ratios (o,), 0 where none does."""
    known = np.flatnonzero(np.isfinite(ratio))
    if len(known) < 2:
        return 0.0
    first, last = known[[0, -1]]
    grown = ratio[last] / max(ratio[first], 1.0) > 2.0 ** (LEAST_GROWTH * (last - first))
    counted = known[ratio[known] > LEAST_RATIO]
    if not grown or not len(counted):
        return 0.0
    frequency = math.sqrt(2) * _edges(bandwidth_hz)[counted]
    return float(np.median(np.sqrt(ratio[counted] - 1) / frequency)) / (2 * math.pi)
