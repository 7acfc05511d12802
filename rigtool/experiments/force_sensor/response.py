"""Up to which frequency the amplitude of a torque is right, from what acted and what was read.

With spectra R of the reference and Y of the torque, of n segments with a Hann window,

    H = sum conj(R) Y / sum |R|^2,   g^2 = |sum conj(R) Y|^2 / (sum |R|^2 sum |Y|^2)
    u(|H|) = |H| sqrt((1 - g^2) / (2 (n - 1) g^2))

(J. S. Bendat, A. G. Piersol, Random Data, 4th ed. 2010, sections 6.2 and 9.2.4). Segments overlap
by half; n counts those that do not, one of which H takes: g is 1 for a single one, whatever it is.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import reduce

import numpy as np
from numpy.typing import NDArray

from rigtool.numerics.arrays import Array, Mask

SEGMENT_TIME = 1.0
"""Of a segment, s: a Hann window resolves 2 Hz."""

RIGHT_AMPLITUDE = 0.95
"""Amplitude, relative to the true one, that is right."""

MAX_AMPLITUDE_U = 0.02
"""Standard uncertainty of an amplitude up to which it counts."""

HIGHEST_HZ = 100.0

TOGETHER = 32
"""Segments that are transformed at once."""

FEWEST_SEGMENTS = 6
"""Segments of which noise alone has `MAX_AMPLITUDE_U` at one of 100 frequencies in 0.03 % of cases:
each has it with a probability of (2 (n - 1) MAX_AMPLITUDE_U^2)^(n - 1)."""


@dataclass(frozen=True, eq=False)
class Spectra:
    """Sums over `count` segments, at `frequency` (f,) Hz."""

    frequency: Array
    of_reference: Array
    of_torque: Array
    cross: NDArray[np.complex128]
    count: int

    @classmethod
    def of(cls, torque: Array, reference: Array, valid: Mask, rate: float) -> Spectra:
        """Return the sums of signals (m,) of a rate, Hz; segments that are not all valid do not
        count."""
        size = round(SEGMENT_TIME * rate)
        frequency: Array = np.fft.rfftfreq(size, 1 / rate).astype(np.float64)
        kept = frequency <= HIGHEST_HZ
        window = np.hanning(size)
        zero = np.zeros(np.count_nonzero(kept))
        found = cls(frequency[kept], zero, zero, zero.astype(np.complex128), 0)
        firsts = range(0, len(torque) - size + 1, size // 2)
        whole = [first for first in firsts if valid[first : first + size].all()]
        for some in range(0, len(whole), TOGETHER):
            rows = np.array(whole[some : some + TOGETHER])[:, None] + np.arange(size)
            read, acted = (
                np.fft.rfft(window * (part - part.mean(axis=1, keepdims=True)))[:, kept]
                for part in (torque[rows], reference[rows])
            )
            sums = (np.abs(acted) ** 2).sum(axis=0), (np.abs(read) ** 2).sum(axis=0)
            cross = (np.conj(acted) * read).sum(axis=0)
            found = found.added(cls(found.frequency, *sums, cross, len(rows)))
        return found

    def added(self, other: Spectra) -> Spectra:
        """Return the sums over both."""
        return Spectra(
            self.frequency,
            self.of_reference + other.of_reference,
            self.of_torque + other.of_torque,
            self.cross + other.cross,
            self.count + other.count,
        )

    def amplitude(self) -> tuple[Array, Array]:
        """Return |H| and its standard uncertainty (f,); infinite where nothing acted, and of fewer
        than `FEWEST_SEGMENTS`."""
        left = self.count / 2 - 1 if self.count >= FEWEST_SEGMENTS else 0.0
        with np.errstate(divide="ignore", invalid="ignore"):
            ratio = np.abs(self.cross) / self.of_reference
            coherence = np.abs(self.cross) ** 2 / (self.of_reference * self.of_torque)
            u = ratio * np.sqrt((1 - coherence) / (2 * left * coherence))
        return ratio, np.where(np.isfinite(u), u, np.inf)


def amplitude_bandwidth(parts: Sequence[Spectra]) -> tuple[float, float]:
    """Return up to which frequency the amplitude is `RIGHT_AMPLITUDE`, Hz, and its standard
    uncertainty.

    That is the highest frequency at which the amplitude is known, or where it falls below. NaN
    where nothing is known, or already the lowest known amplitude is wrong.
    """
    whole = reduce(Spectra.added, parts)
    ratio, u = whole.amplitude()
    known = np.flatnonzero((u <= MAX_AMPLITUDE_U) & (whole.frequency > 0))
    frequency, ratio, u = whole.frequency[known], ratio[known], u[known]
    if not len(known) or ratio[0] < RIGHT_AMPLITUDE:
        return math.nan, math.nan
    spacing = 1 / SEGMENT_TIME
    wrong = np.flatnonzero(ratio < RIGHT_AMPLITUDE)
    if not len(wrong):
        return float(frequency[-1]), spacing / math.sqrt(12)
    after = wrong[0]
    before = after - 1
    slope = (ratio[before] - ratio[after]) / (frequency[after] - frequency[before])
    crossing = frequency[before] + (ratio[before] - RIGHT_AMPLITUDE) / slope
    return float(crossing), float(math.hypot(u[before] / slope, spacing / math.sqrt(12)))
