"""Smoothed signals and their derivatives, all through one kernel without delay.

A signal x and its derivatives are convolved with a Gaussian k of standard deviation s:

    smooth(x) = k * x,  smooth(x') = k' * x,  smooth(x'') = k'' * x

so that a linear equation between x, its derivatives and other signals holds between the smoothed
ones, and no measured signal is differenced: the kernel is differentiated in closed form (modulating
functions: Shinbrot, Trans. ASME 79, 547-552, 1957; the same filter on both sides of the equation of
motion: Gautier, Proc. IEEE ICRA 1997, 3284-3289). Of all kernels a Gaussian is the narrowest in
time for its band, which confines the effects of a reversal to its neighbourhood. Its response is
exp(-(2 pi f s)^2 / 2), 3 dB at f = 0.1325 / s.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rigtool.errors import InsufficientDataError
from rigtool.numerics.arrays import Array, Mask
from rigtool.numerics.checks import require_rising

KERNEL_REACH = 6.0
"""The kernel ends at this many standard deviations, where it is 1.5e-8 of its peak."""

CUTOFF = math.sqrt(math.log(2)) / (2 * math.pi)
"""Frequency of 3 dB times the standard deviation."""

IRREGULAR_INTERVAL = 0.01
"""A time axis is irregular if an interval differs from the median by more than this fraction."""

GAP_INTERVALS = 5.0
"""Intervals longer than this many medians are gaps without information."""

MAX_STRETCH = 10.0
"""Largest ratio of the samples of an even time axis to those of the irregular one."""

COUNT_TOLERANCE = 0.01
"""Steps of an encoder are whole multiples of a count within this fraction of a count."""


@dataclass(frozen=True)
class KernelSmoother:
    """A Gaussian kernel for signals that are sampled each `step` s.

    `width` is its standard deviation in s. A smoothed signal keeps one of `every` samples, and none
    where the kernel would extend past an end.
    """

    step: float
    width: float

    @property
    def cutoff(self) -> float:
        """Frequency of 3 dB, Hz."""
        return CUTOFF / self.width

    @property
    def every(self) -> int:
        """Samples from one smoothed sample to the next: half a standard deviation."""
        return max(1, int(self.width / self.step / 2))

    @property
    def reach(self) -> int:
        """Half the length of the kernel in samples, a multiple of `every`."""
        return self.every * math.ceil(KERNEL_REACH * self.width / self.step / self.every)

    def places(self, count: int) -> NDArray[np.intp]:
        """Return the indices, in a signal of `count` samples, of the smoothed samples."""
        return np.arange(self.reach, count - self.reach, self.every)

    def __call__(self, values: Array, derivative: int = 0) -> Array:
        """Return the smoothed signal, or its first or second derivative, at `places`."""
        from scipy.signal import upfirdn

        x = np.arange(-self.reach, self.reach + 1) * (self.step / self.width)
        smooth = np.exp(-(x**2) / 2)
        smooth /= smooth.sum()
        kernel = smooth * (np.ones_like(x), -x / self.width, (x**2 - 1) / self.width**2)[derivative]
        origin = 0.0
        if derivative:
            # The derivative of a constant is exactly zero, despite rounding and truncation.
            kernel -= kernel.sum() * smooth
            origin = values[0]
        passed: Array = upfirdn(kernel, values - origin, down=self.every)
        first = 2 * self.reach // self.every
        return passed[first : first + len(self.places(len(values)))]


def noise_of_derivatives(density: float, width: float) -> tuple[float, float]:
    """Return the standard deviations of white noise in the smoothed x' and x''.

    `density` is the noise's variance times its correlation time (two-sided power spectral density,
    unit^2 s): integrals of k'^2 and k''^2.
    """
    first = density / (4 * math.sqrt(math.pi) * width**3)
    second = density * 3 / (8 * math.sqrt(math.pi) * width**5)
    return math.sqrt(first), math.sqrt(second)


def position_noise(position: Array, step: float) -> float:
    """Return the noise density of an evenly sampled position (n,), unit^2 s.

    It is the larger of two estimates: that of fourth differences, whose variance is 70 w for white
    noise of variance w and nearly zero for a motion; and q^2/12 for rounding to counts q, times the
    duration of a count where that is longer than a sample.
    """
    white = float(np.mean(np.diff(position, 4) ** 2)) / 70 * step
    steps = np.abs(np.diff(position))
    moving = steps[steps > 1e-9 * np.max(steps, initial=0.0)]
    if not len(moving):
        return white
    count = float(moving.min())
    multiple = moving / count
    if np.mean(np.abs(multiple - np.round(multiple)) < COUNT_TOLERANCE) < 0.99:
        return white
    speed = float(steps.mean()) / step
    return max(white, count**2 / 12 * max(step, count / speed))


def resample(
    time: Array, *signals: Array, gap: float | None = None
) -> tuple[float, Mask, tuple[Array, ...]]:
    """Resample signals (n,) at the median interval: the interval, known samples, the signals.

    Signals on an even time axis are returned unchanged. Linear interpolation between samples
    smooths all signals alike. Samples in a gap are not known: an interval longer than `gap`, s, or
    than `GAP_INTERVALS` medians. Raises `InsufficientDataError` where
    time does not rise, or consists mostly of gaps.
    """
    step = require_rising(time)
    intervals = np.diff(time)
    if np.max(np.abs(intervals - step)) <= IRREGULAR_INTERVAL * step:
        return float(np.mean(intervals)), np.ones(len(time), dtype=bool), signals
    if time[-1] - time[0] > MAX_STRETCH * step * len(time):
        raise InsufficientDataError(
            f"the time axis has gaps up to {intervals.max():.3g} s, usual is {step:.3g} s: less "
            f"than one part in {MAX_STRETCH:g} of the time is recorded; import the parts one by one"
        )
    even = np.arange(time[0], time[-1], step)
    place = np.clip(np.searchsorted(time, even, side="right") - 1, 0, len(intervals) - 1)
    known = intervals[place] <= (GAP_INTERVALS * step if gap is None else gap)
    return step, known, tuple(np.interp(even, time, signal) for signal in signals)
