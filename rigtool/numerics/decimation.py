"""Decimation without phase shift, block by block.

scipy's decimate needs the whole signal in memory, where a recording of hours does not fit.

A low-pass FIR filter (sinc, Kaiser window) is evaluated at every M-th sample only. With the new
sampling frequency f, components below 0.05 f keep their amplitude within 4e-5, and components above
0.95 f, which alias to frequencies below 0.05 f, are attenuated to 4e-5. Both ends of a signal are
extended by point reflection, as in `scipy.signal.filtfilt`.
Window and length: J. F. Kaiser, Proc. IEEE Symp. Circuits and Systems 1974, 20-23.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from rigtool.errors import InsufficientDataError
from rigtool.numerics.arrays import Array

HALF_LENGTH = 4
"""Half the length of the filter, in new samples."""

KAISER_BETA = 10.0
"""Stop-band attenuation of 100 dB."""


def block_means(values: Array, size: int) -> Array:
    """Return means of `size` values each of (n,): a first, coarse low-pass."""
    count = len(values) // size
    return values[: count * size].reshape(count, size).mean(axis=1)


class Decimator:
    """Decimates several signals of `samples` each by `factor`, block by block."""

    def __init__(self, factor: int, signals: int, samples: int) -> None:
        self._factor = factor
        self._taps = _taps(factor)
        self._samples = 0
        self._buffer = np.empty((signals, 0))
        self._waiting = self._buffer
        # As large as it will be: parts that are joined at the end would be in memory twice.
        self._found = np.empty((signals, -(-samples // factor)))
        self._count = 0

    def add(self, *signals: Array) -> None:
        """Take the next samples, (n,) of each signal."""
        reach = HALF_LENGTH * self._factor
        begun = self._samples > reach
        self._samples += signals[0].size
        self._append(signals)
        if self._factor > 1 and self._samples <= reach:
            return
        if self._factor > 1 and not begun:
            first = self._waiting[:, : reach + 1].copy()
            self._append(tuple(2 * first[:, :1] - first[:, :0:-1]), in_front=True)
        self._filter()

    def finish(self) -> Array:
        """Return samples 0, factor, 2*factor.. of the filtered signals, (signals, m).

        Raises `InsufficientDataError` where the signals are shorter than the filter.
        """
        if self._factor > 1:
            reach = HALF_LENGTH * self._factor
            if self._samples <= reach:
                raise InsufficientDataError(
                    f"{self._samples} samples are too few, {reach + 1} are needed: record for "
                    "longer"
                )
            last = self._waiting[:, -reach - 1 :].copy()
            self._append(tuple(2 * last[:, -1:] - last[:, -2::-1]))
            self._filter()
        return self._found[:, : -(-self._samples // self._factor)]

    def _append(self, signals: Sequence[Array], *, in_front: bool = False) -> None:
        """Append samples to the waiting ones, or prepend them, in a buffer that is reused."""
        waiting, size = self._waiting, self._waiting.shape[1]
        total = size + signals[0].size
        if total > self._buffer.shape[1] or in_front:
            self._buffer = np.empty((len(signals), 2 * total))
            begin = total - size if in_front else 0
            self._buffer[:, begin : begin + size] = waiting
        begin = 0 if in_front else size
        for row, signal in zip(self._buffer, signals, strict=True):
            row[begin : begin + signal.size] = signal
        self._waiting = self._buffer[:, :total]

    def _filter(self) -> None:
        """Filter as far as the waiting samples allow; keep those that are needed again."""
        signals, size = self._waiting.shape
        if self._factor == 1:
            count = size
            self._keep(self._waiting)
        else:
            rows = size // self._factor
            count = max(0, rows - 2 * HALF_LENGTH + 1)
            # Samples in rows of `factor`: a new sample is the sum over 2*REACH rows, each times its
            # part of the taps, and all rows times all parts is one product of matrices.
            table = self._waiting[:, : rows * self._factor].reshape(signals, rows, self._factor)
            parts = table @ self._taps
            found = parts[:, :count, 0].copy()
            for row in range(1, 2 * HALF_LENGTH):
                found += parts[:, row : row + count, row]
            self._keep(found)
        left = size - count * self._factor
        self._buffer[:, :left] = self._waiting[:, size - left :].copy()
        self._waiting = self._buffer[:, :left]

    def _keep(self, found: Array) -> None:
        """Keep new samples; behind the last one, the extension of the signal has some more."""
        kept = self._found[:, self._count :][:, : found.shape[1]]
        kept[:] = found[:, : kept.shape[1]]
        self._count += kept.shape[1]


def _taps(factor: int) -> Array:
    """Return the filter by (place in a row, row), (factor, 2*REACH); its sum is one."""
    half = HALF_LENGTH * factor - 1
    offset = np.arange(-half, half + 1)
    taps = np.sinc(offset / factor) * np.kaiser(offset.size, KAISER_BETA)
    taps = np.concatenate([[0.0], taps / taps.sum()])
    return taps.reshape(2 * HALF_LENGTH, factor).T.copy()
