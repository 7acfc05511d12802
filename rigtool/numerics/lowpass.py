"""Low-pass without phase shift: a Butterworth filter of order 2, forward and backward [8.1].

The gain is that of the filter squared, 1 / (1 + (f / f_c)^4): one half at the cut-off f_c.
"""

from __future__ import annotations

import math

from rigtool.errors import InsufficientDataError
from rigtool.numerics.arrays import Array
from rigtool.numerics.recursion import butterworth, filtered, filtered_both_ways

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
    return filtered_both_ways(butterworth(rate, cutoff_hz), values, length)


def delayed(rate: float, values: Array, cutoff_hz: float) -> Array:
    """Filter signals (..., n) of a rate, Hz, once, forward: by values up to its time alone."""
    return filtered(butterworth(rate, cutoff_hz), values)


def kept_factor(rate: float, cutoff_hz: float) -> int:
    """Return the factor by which signals may be decimated before the low-pass; see `KEPT_RATE`."""
    return max(1, math.floor(rate / (KEPT_RATE * cutoff_hz) * (1 + 1e-6)))
