"""Random-phase multisines: periodic excitation of chosen lines with a low crest factor.

    x(t) = sum over lines k of A_k cos(2 pi k t/T + phi_k),  phi_k uniform and independent

Pintelon & Schoukens, System Identification, 2nd edition, Wiley 2012, chapter 2. A period is excited
at its lines only, so that in steady state nothing leaks from one line into another.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from rigtool.numerics.arrays import Array, ComplexArray

LineNumbers = NDArray[np.intp]

PHASE_DRAWS = 200
"""Number of sets of phases to try; the one with the lowest peak is kept."""


def quasi_log_lines(low: int, high: int, count: int) -> LineNumbers:
    """Return up to `count` whole numbers from `low` to `high`, as evenly in logarithm as they go.

    Raises ValueError unless 1 <= low < high.
    """
    if not 1 <= low < high:
        raise ValueError(f"lines must rise from 1 or more, got {low} to {high}")
    return np.unique(np.geomspace(low, high, count).round().astype(np.intp))


def random_phases(lines: LineNumbers, samples: int, rng: np.random.Generator) -> ComplexArray:
    """Return unit amplitudes (k,) at these lines of a period of `samples`, with a low crest factor.

    Of `PHASE_DRAWS` random sets of phases the one whose sum has the lowest peak is taken.
    """
    phases = np.exp(2j * np.pi * rng.random((PHASE_DRAWS, len(lines))))
    peaks = [np.abs(periodic(lines, phase, samples)).max() for phase in phases]
    return phases[int(np.argmin(peaks))]


def periodic(lines: LineNumbers, amplitude: ComplexArray, samples: int) -> Array:
    """Return one period (..., samples) of the real part of sum A_k exp(2 pi i k n/samples).

    Amplitudes A are (..., k).

    Raises ValueError for lines at or above half of the sampling rate.
    """
    if lines.max() >= samples / 2:
        raise ValueError(f"line {lines.max()} of a period of {samples} samples lies above half")
    spectrum = np.zeros((*amplitude.shape[:-1], samples // 2 + 1), dtype=np.complex128)
    spectrum[..., lines] = amplitude * (samples / 2)
    return np.fft.irfft(spectrum, samples)
