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
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from rigtool.errors import InsufficientDataError
from rigtool.numerics.arrays import TINY, Array, Mask
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

SPEED = DYNAMICS_PARAMETERS.index("viscous")

DRIFT_REVERSALS, MOST_DRIFT, LEAST_DRIFT, DRIFT_RATIO = 4, 10, 2, 3.0
"""Reversals for each cosine of a drift, its most and fewest cosines, and the ratio of their power
to that of the next ones from which on there is a drift."""

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
    `samples` a row stands for `every`; `resampled` where the time axis was irregular. With `drift`,
    so many slow cosines of time are taken out of design and torque before a fit.
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
    drift: int = 0

    @property
    def left_out(self) -> int:
        """Number of samples that are not used."""
        return max(0, self.samples - int(self.used.sum()) * self.every)

    def slow(self, count: int) -> Array:
        """Return the `count` slowest cosines over the recording but the constant, (n, count)."""
        phase = np.pi * (np.arange(len(self.torque)) + 0.5) / len(self.torque)
        return np.cos(np.multiply.outer(phase, np.arange(1, count + 1)))

    def rows(self) -> tuple[Array, Array]:
        """Return design (n, 5 or 6) and torque (n,) without what the slow cosines explain.

        A fit to these is one that has the cosines among its regressors (Frisch & Waugh,
        Econometrica 1(4) 387-401, 1933).
        """
        if self.drift == 0:
            return self.design, self.torque
        slow, both = self.slow(self.drift), np.column_stack([self.design, self.torque])
        both -= slow @ np.linalg.lstsq(slow[self.used], both[self.used])[0]
        return both[:, :-1], both[:, -1]


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
        power = max(float(np.mean(acceleration**2)), TINY)
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
    rows = [motion.rows() for motion in motions]
    design = np.concatenate([design for design, _ in rows]) * weight[:, None]
    return design, np.concatenate([torque for _, torque in rows]) * weight, weight


def drift_terms(motions: Sequence[SmoothedMotion]) -> Array:
    """Return the cosines of all drifts (n, k), weighted as `weighted` does."""
    found = [np.zeros((len(motion.torque), sum(m.drift for m in motions))) for motion in motions]
    first = 0
    for motion, terms in zip(motions, found, strict=True):
        here = motion.slow(motion.drift) * motion.used[:, None] * motion.spacing**0.5
        terms[:, first : first + motion.drift] = here
        first += motion.drift
    return np.concatenate(found)


def with_drift(motions: Sequence[SmoothedMotion], chosen: Sequence[int]) -> list[SmoothedMotion]:
    """Return the motions, with a drift of the effort where the residuals of a fit show one.

    The slowest cosines of a recording, well below the frequency of its reversals, then have
    `DRIFT_RATIO` times the power of the next ones.
    """
    design, torque, _ = weighted(motions)
    solution = np.linalg.lstsq(design[:, chosen], torque)[0]
    found = []
    for motion in motions:
        turned = int(np.count_nonzero(np.diff(np.sign(motion.design[:, SPEED]))))
        count = min(turned // DRIFT_REVERSALS, MOST_DRIFT)
        if count >= LEAST_DRIFT:
            left = (motion.torque - motion.design[:, chosen] @ solution)[motion.used]
            slow = motion.slow(3 * count)[motion.used]
            power = np.linalg.lstsq(slow, left)[0] ** 2
            if power[:count].mean() > DRIFT_RATIO * power[count:].mean():
                motion = replace(motion, drift=count)
        found.append(motion)
    return found


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
