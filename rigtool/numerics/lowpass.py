"""Low-pass without phase shift: a Butterworth filter, applied forward and backward [8.1].

The gain is that of the filter squared, 1 / (1 + (f / f_c)^4): one half at the cut-off f_c.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import accumulate

import numpy as np

from rigtool.errors import InsufficientDataError
from rigtool.numerics.arrays import Array, ComplexArray

BLOCK = 64
"""Samples that one product of matrices filters."""

KEPT_RATE = 125
"""Samples in each period of the cut-off that suffice: in signals decimated to it, the gain of
the low-pass is correct within 1e-4 below the cut-off and within 2e-4 above it."""


def lowpass(rate: float, values: Array, cutoff_hz: float) -> Array:
    """Filter signals (..., n) of a rate, Hz, without phase shift, as the thesis does at 5 Hz [8.1].

    Raises `InsufficientDataError` where the rate or the length does not allow that.
    """
    if not cutoff_hz < rate / 2:
        raise InsufficientDataError(
            f"a low-pass of {cutoff_hz} Hz needs signals above {2 * cutoff_hz} Hz, these have "
            f"{rate:.4g} Hz: record more often, or lower lowpass_hz"
        )
    length = round(rate / cutoff_hz)  # effects of the ends fade within this many samples
    size = values.shape[-1]
    if size < 4 * length:
        raise InsufficientDataError(
            f"{size} samples ({size / rate:.3g} s) are too few for a low-pass of "
            f"{cutoff_hz} Hz, {4 * length} are needed: record for longer, or raise lowpass_hz"
        )
    first, last = values[..., :1], values[..., -1:]
    before = 2 * first - values[..., length:0:-1]
    after = 2 * last - values[..., -2 : -length - 2 : -1]
    section = Section.of(rate, cutoff_hz)
    forward = section.filtered(np.concatenate([before, values, after], axis=-1), settled=True)
    backward = section.filtered(forward[..., ::-1], settled=True)
    return backward[..., ::-1][..., length:-length]


def delayed(rate: float, values: Array, cutoff_hz: float) -> Array:
    """Filter signals (..., n) of a rate, Hz, once, forward: by values up to its time alone."""
    return Section.of(rate, cutoff_hz).filtered(values, settled=False)


@dataclass(frozen=True)
class Section:
    """A Butterworth low-pass of second order as one complex pole p and its residue r.

        w[n+1] = p w[n] + x[n],  y[n] = d x[n] + 2 Re(r w[n])

    The parallel form of a section with real coefficients (Oppenheim & Schafer, Discrete-Time Signal
    Processing, 6.3.3). Unlike `scipy.signal`, whose import takes longer than most analyses, it
    needs numpy only.
    """

    pole: complex
    residue: complex
    direct: float

    @classmethod
    def of(cls, rate: float, cutoff_hz: float) -> Section:
        """Return the low-pass of signals of a rate, Hz, by the bilinear transform (7.1.2)."""
        k = math.tan(math.pi * cutoff_hz / rate)
        scale = 1 + math.sqrt(2) * k + k**2
        pole = complex(1 - k**2, math.sqrt(2) * k) / scale
        direct = k**2 / scale
        return cls(pole, direct * (pole + 1) ** 2 / complex(0, 2 * pole.imag), direct)

    def filtered(self, values: Array, *, settled: bool) -> Array:
        """Return the filtered signals (..., n).

        They begin from rest, or `settled`: as if the first value had been there for ever.
        """
        count = values.shape[-1]
        rows = values.reshape(-1, count)
        padded = np.zeros((len(rows), -(-count // BLOCK) * BLOCK))
        padded[:, :count] = rows
        blocks = padded.reshape(len(rows), -1, BLOCK)
        powers = np.array([self.pole**n for n in range(BLOCK + 1)])
        impulse = np.concatenate([[self.direct], 2 * (self.residue * powers[: BLOCK - 1]).real])
        since = np.subtract.outer(np.arange(BLOCK), np.arange(BLOCK))
        filtered: Array = blocks @ np.where(since >= 0, impulse[since], 0.0).T
        free = 2 * self.residue * powers[:BLOCK]
        begins = self._begins(blocks, powers, rows[:, 0] if settled else np.zeros(len(rows)))
        filtered += begins.view(np.float64).reshape(*begins.shape, 2) @ [free.real, -free.imag]
        return filtered.reshape(len(rows), -1)[:, :count].reshape(values.shape)

    def _begins(self, blocks: Array, powers: ComplexArray, settled_at: Array) -> ComplexArray:
        """Return w at the begin of each block (rows, blocks), after a value for ever (rows,)."""
        last = powers[BLOCK - 1 :: -1]
        gained = blocks @ last.real + 1j * (blocks @ last.imag)
        over = complex(powers[BLOCK])

        def advance(w: complex, gain: complex) -> complex:
            return over * w + gain

        return np.array(
            [
                list(accumulate(row[:-1], advance, initial=value / (1 - self.pole)))
                for row, value in zip(gained.tolist(), settled_at.tolist(), strict=True)
            ]
        )


def kept_factor(rate: float, cutoff_hz: float) -> int:
    """Return the factor by which signals may be decimated before the low-pass; see `KEPT_RATE`."""
    return max(1, math.floor(rate / (KEPT_RATE * cutoff_hz) * (1 + 1e-6)))
