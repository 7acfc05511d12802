"""Terms of the equation torque = J a + fv v + fc sign(v) + offset + fd |v|, band-limited alike.

Torque and all regressors pass the same smoothing kernel, so that the equation still holds between
them and the band limit biases nothing (Gautier, Proc. IEEE ICRA 1997, 3284-3289; Swevers, Verdonck
& De Schutter, IEEE Control Systems 27(5) 58-71, 2007); speed and acceleration are the position
convolved with the kernel's derivatives (`smoothing`). Near standstill the shaft does not slide:
smoothed samples with too much weight there are left out.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from rigtool.errors import InsufficientDataError
from rigtool.numerics.arrays import Array, Mask
from rigtool.numerics.checks import require_signals
from rigtool.numerics.residual_covariance import independent_samples
from rigtool.numerics.smoothing import (
    CUTOFF,
    KernelSmoother,
    noise_of_derivatives,
    position_noise,
    resample,
)

DYNAMICS_PARAMETERS = ("inertia", "viscous", "coulomb", "offset", "viscous_difference", "delay")

SPLIT, DELAY = DYNAMICS_PARAMETERS.index("viscous_difference"), DYNAMICS_PARAMETERS.index("delay")

NARROWEST_KERNEL = 2.0
"""Smallest standard deviation of the kernel, in samples."""

WIDEST_KERNEL = 1 / 40
"""Largest standard deviation of the kernel, relative to the recording."""

KERNEL_RATIO = 1.15
"""Ratio of the widths of successive kernels."""

NOISE_SHARE = 1e-3
"""Largest part of noise in the acceleration's power, which biases inertia by as much."""

MOTION_POWER = 0.99
"""Part of the speed's power below the frequency of the motion."""

KERNEL_HARMONICS = 10
"""Multiple of the motion's frequency that the kernel passes: sign(v) has harmonics."""

NEAR_STANDSTILL = (0.05, 0.02, 0.01, 0.0)
"""Speeds below one of these parts of the highest, or within their noise, are near standstill; at
the last one, all of the motion counts as sliding, and so does the noise."""

SURE_SIGN = 5.0
"""Standard deviations of its noise beyond which the sign of a speed is known."""

MIN_SLIDING_WEIGHT = 0.98
"""Smallest part of the kernel's weight on sliding samples."""

MIN_SAMPLES = 50
"""Smallest number of samples in a recording."""


@dataclass(frozen=True, eq=False)
class SmoothedMotion:
    """One recording, smoothed: rows are equally far apart in time, `spacing` s.

    `design` (n, 5) for J, fv, fc, offset, fd; `torque` (n,); `position` (n,); `used` (n,) is one of
    `sliding` (k, n), those for each of `NEAR_STANDSTILL`; `noise` are the standard deviations of
    speed and acceleration that the position's noise makes; `cutoff` in Hz; of the recorded
    `samples` a row stands for `every`; `resampled` where the time axis was irregular.
    """

    design: Array
    torque: Array
    position: Array
    used: Mask
    sliding: Mask
    spacing: float
    noise: tuple[float, float]
    cutoff: float
    samples: int
    every: int
    resampled: bool

    @property
    def left_out(self) -> int:
        """Number of samples that are not used."""
        return max(0, self.samples - int(self.used.sum()) * self.every)


def band_limit(
    *, time: ArrayLike, position: ArrayLike, torque: ArrayLike, cutoff: float | None = None
) -> SmoothedMotion:
    """Return the regressors of a recording: signals (n,), time in s, position in rad or m.

    The band is that of the motion, or up to `cutoff`, Hz. An irregular time axis is resampled
    first. Raises `InsufficientDataError` where nothing moves, or the recording is too short.
    """
    t, shaft, effort = require_signals(MIN_SAMPLES, time=time, position=position, torque=torque)
    step, known, (shaft, effort) = resample(t, shaft, effort)
    density = position_noise(shaft, step)
    smoother = _smoother(shaft, step, density)
    if cutoff is not None:
        smoother = KernelSmoother(step, CUTOFF / cutoff)
    noise = noise_of_derivatives(density, smoother.width)
    speed = smoother(shaft, 1)
    highest = float(np.percentile(np.abs(speed), 99))
    if highest <= SURE_SIGN * noise[0]:
        raise InsufficientDataError(
            f"nothing moves: the highest speed is {highest:.3g} (SI), {SURE_SIGN:g} times its "
            f"noise of {noise[0]:.3g} is needed; move faster or further"
        )
    # The speed between its samples, to place its change of sign.
    places = smoother.places(len(shaft))
    everywhere = np.interp(np.arange(len(shaft)), places, speed)
    limits = [
        max(part * highest, SURE_SIGN * noise[0]) if part else 0.0 for part in NEAR_STANDSTILL
    ]
    sliding = np.stack(
        [
            smoother((known & (np.abs(everywhere) >= limit)).astype(np.float64))
            >= MIN_SLIDING_WEIGHT
            for limit in limits
        ]
    )
    design = np.column_stack(
        [
            smoother(shaft, 2),
            speed,
            smoother(np.sign(everywhere)),
            np.ones(len(speed)),
            smoother(np.abs(everywhere)),
        ]
    )
    return SmoothedMotion(
        design=design,
        torque=smoother(effort),
        position=shaft[places],
        used=sliding[0],
        sliding=sliding,
        spacing=smoother.every * step,
        noise=noise,
        cutoff=smoother.cutoff,
        samples=len(t),
        every=smoother.every,
        resampled=len(shaft) != len(t) or not known.all(),
    )


def _smoother(position: Array, step: float, density: float) -> KernelSmoother:
    """Return the narrowest kernel that keeps noise out of the acceleration and passes the motion.

    Not narrower than the motion needs: the rest of the band is other dynamics. Where no
    kernel keeps the noise out, the kernel that passes the least of it.
    """
    widest = max(len(position) * step * WIDEST_KERNEL, NARROWEST_KERNEL * step)
    best, least = KernelSmoother(step, NARROWEST_KERNEL * step), math.inf
    width = best.width
    while width <= widest:
        smoother = KernelSmoother(step, width)
        acceleration = smoother(position, 2)
        power = max(float(np.mean(acceleration**2)), 1e-300)
        share = noise_of_derivatives(density, width)[1] ** 2 / power
        if share < least:
            best, least = smoother, share
        if share <= NOISE_SHARE:
            break
        width *= KERNEL_RATIO
    frequency = _highest_frequency(best(position, 1), best.every * step)
    return KernelSmoother(
        step, max(best.width, min(CUTOFF / (KERNEL_HARMONICS * frequency), widest))
    )


def _highest_frequency(signal: Array, spacing: float) -> float:
    """Return the frequency below which `MOTION_POWER` of a signal's power is, Hz."""
    power = np.abs(np.fft.rfft((signal - signal.mean()) * np.hanning(len(signal)))) ** 2
    total = np.cumsum(power)
    first = int(np.searchsorted(total, MOTION_POWER * total[-1]))
    return max(first, 1) / (len(signal) * spacing)


def weighted(motions: Sequence[SmoothedMotion]) -> tuple[Array, Array, Array]:
    """Return design (n, 5 or 6), torque (n,), weight (n,); each second has the same weight."""
    weight = np.concatenate([m.used * m.spacing**0.5 for m in motions])
    design = np.concatenate([motion.design for motion in motions]) * weight[:, None]
    return design, np.concatenate([motion.torque for motion in motions]) * weight, weight


def independent(motions: Sequence[SmoothedMotion], residual: Array) -> float:
    """Return the number of independent samples that all residuals (n,) amount to."""
    total, start = 0.0, 0
    for motion in motions:
        part = residual[start : start + len(motion.torque)]
        start += len(motion.torque)
        # At two standard deviations of the kernel the smoothing itself hardly correlates any more.
        lag = max(1, round(2 * CUTOFF / motion.cutoff / motion.spacing))
        total += independent_samples(part, motion.used, lag)
    return total
