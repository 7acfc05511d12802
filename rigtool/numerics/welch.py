"""Power spectral density by Welch's method, block by block [P. D. Welch, IEEE Trans. 15, 1967].

scipy's welch needs the whole signal in memory, where a recording of hours does not fit.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from rigtool.errors import InsufficientDataError
from rigtool.numerics.arrays import Array

BATCH_SEGMENTS = 16
"""Number of segments that are transformed together."""


@dataclass(frozen=True, eq=False)
class PowerSpectrum:
    """One-sided power spectral density (m,), unit^2/Hz, over frequency (m,), Hz."""

    frequency: Array
    psd: Array


class Welch:
    """Mean periodogram of segments of `segment` samples, half overlapping, each without its mean.

    psd = 2 T / sum(w^2) * mean over segments of |DFT(w (x - mean x))|^2, w a Hann window and T the
    sample time; frequency zero, and half the sampling frequency, count once.
    """

    def __init__(self, segment: int) -> None:
        self._segment = segment
        # Periodic: only the first value is zero.
        self._window = 0.5 - 0.5 * np.cos(2 * np.pi * np.arange(float(segment)) / segment)
        self._waiting = np.zeros(0)
        self._power = np.zeros(segment // 2 + 1)
        self._count = 0
        # Reused: allocating memory for each batch would take longer than the transform.
        self._centred = np.empty((BATCH_SEGMENTS, segment))
        self._spectra = np.empty((BATCH_SEGMENTS, segment // 2 + 1), dtype=np.complex128)

    def add(self, signal: Array) -> None:
        """Take the next samples (n,)."""
        signal = np.concatenate([self._waiting, signal])
        step = self._segment - self._segment // 2
        count = 0
        if signal.size >= self._segment:
            windows = np.lib.stride_tricks.sliding_window_view(signal, self._segment)[::step]
            count = len(windows)
            for first in range(0, count, BATCH_SEGMENTS):
                self._add_segments(windows[first : first + BATCH_SEGMENTS])
        self._waiting = signal[count * step :].copy()

    def _add_segments(self, segments: Array) -> None:
        count = len(segments)
        centred, spectra = self._centred[:count], self._spectra[:count]
        np.subtract(segments, segments.mean(axis=1, keepdims=True), out=centred)
        centred *= self._window
        np.fft.rfft(centred, axis=1, out=spectra)
        parts = spectra.view(np.float64)  # real, imaginary, real..
        squares = np.einsum("ij,ij->j", parts, parts)
        self._power += squares[::2] + squares[1::2]
        self._count += count

    def spectrum(self, sample_time: float) -> PowerSpectrum:
        """Return the PSD; `sample_time` in s. Raises `InsufficientDataError` without a segment."""
        if not self._count:
            raise InsufficientDataError(
                f"{self._waiting.size} samples are too few, {self._segment} are needed: record "
                "for longer"
            )
        psd: Array = self._power * (2 * sample_time / self._count / float(np.sum(self._window**2)))
        psd[0] /= 2
        if self._segment % 2 == 0:
            psd[-1] /= 2
        frequency = np.arange(len(psd)) / (self._segment * sample_time)
        return PowerSpectrum(frequency, psd)
