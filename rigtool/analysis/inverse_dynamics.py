"""Inertia and friction from any motion, by least squares on the equation of motion.

    torque = J a + fv v + fc sign(v) + offset

Torque and all regressors pass the same smoothing kernel, so that the equation still holds between
them and the band limit biases nothing (Gautier, Proc. IEEE ICRA 1997, 3284-3289; Swevers, Verdonck
& De Schutter, IEEE Control Systems 27(5) 58-71, 2007); speed and acceleration are the position
convolved with the kernel's derivatives (`smoothing`). Near standstill friction is not that of
sliding: samples of which the kernel sees too much of it are left out. The covariance allows for
residuals that are correlated in time (`correlated`), and for what the residuals show beside the
model (`model_doubt`): a function of speed (Stribeck), or of position (spring, ripple, load).

A linear axis is the same with position in m and force in N: J in kg, fv in N s/m.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from rigtool.analysis.correlated import independent_samples, long_run_covariance
from rigtool.analysis.model_doubt import own_part, structure
from rigtool.analysis.signals import require_signals
from rigtool.analysis.smoothing import (
    CUTOFF,
    Smoother,
    noise_of_derivatives,
    position_noise,
    resample,
)
from rigtool.errors import InsufficientDataError

Array = NDArray[np.float64]

PARAMETERS = ("inertia", "viscous", "coulomb", "offset")

NARROWEST = 2.0
"""Standard deviation of the kernel in samples, at least."""

WIDEST = 1 / 40
"""Standard deviation of the kernel as part of the recording, at most."""

GROWTH = 1.15
"""Kernels are tried that widen by this factor."""

NOISE_SHARE = 1e-3
"""Part of the acceleration's power that may be noise of the position: it biases inertia so much."""

NO_ACCELERATION = 0.1
"""From this part of noise on, there is no acceleration to tell inertia by."""

MOTION = 0.99
"""Part of the speed's power that is below the frequency of the motion."""

HARMONICS = 10
"""The kernel passes this many times the frequency of the motion: sign(v) has harmonics."""

STANDSTILL = 0.05
"""Speeds below this part of the highest are near standstill, as are those within their noise."""

SURE = 5.0
"""A speed beyond this many standard deviations of its noise has a known sign."""

SLIDING = 0.98
"""Part of the kernel's weight that must be on samples that slide."""

ONE_WAY = 0.01
"""With less than this part of the samples in one direction, the motion is in the other only."""

TOLD_APART = 0.01
"""Part of a regressor's power that the other regressors must leave unexplained."""

EXPLAINED = 0.5
"""Part of the torque's variance that the model must explain."""

SHORTEST = 50
"""Samples that a recording needs, and smoothed samples that a fit needs."""

ONE_FREQUENCY = 0.99
"""Correlation of position and acceleration from which on the motion has one frequency."""


@dataclass(frozen=True, eq=False)
class Motion:
    """One recording, smoothed: rows are equally far apart in time, `spacing` s.

    `design` (n, 4) for J, fv, fc, offset; `torque` (n,); `position` (n,); `used` (n,); `noise` are
    the standard deviations of speed and acceleration that the position's noise makes; `cutoff` in
    Hz; `samples` were recorded, `left_out` of them serve nothing; `resampled` says that the time
    axis was irregular.
    """

    design: Array
    torque: Array
    position: Array
    used: NDArray[np.bool_]
    spacing: float
    noise: tuple[float, float]
    cutoff: float
    samples: int
    left_out: int
    resampled: bool


@dataclass(frozen=True, eq=False)
class Dynamics:
    """Parameters J, fv, fc, offset (4,) with covariance (4, 4) and `dof` degrees of freedom.

    Inertia is NaN where the motion does not tell it; `without_inertia` then says why.
    `residual_rms` is that of the smoothed torque, `explained` the part of its variance that the
    model explains; `by_speed` and `by_position` are the parts of the residual's power that a
    function of speed, or of position, explains beyond chance. `single_frequency` says that position
    is proportional to acceleration: a spring then looks like (negative) inertia.
    """

    parameters: Array
    covariance: Array
    dof: int
    residual_rms: float
    explained: float
    by_speed: float
    by_position: float
    single_frequency: bool
    without_inertia: str | None = None

    def estimate(self, name: str) -> tuple[float, float]:
        """Return a parameter of `PARAMETERS` and its standard uncertainty."""
        index = PARAMETERS.index(name)
        return float(self.parameters[index]), math.sqrt(float(self.covariance[index, index]))

    def torque(self, motion: Motion) -> Array:
        """Return the model's torque for each row of a motion, (n,)."""
        # An inertia that is not told is no part of the model.
        torque: Array = motion.design @ np.nan_to_num(self.parameters)
        return torque


# -- regressors


def band_limit(*, time: ArrayLike, position: ArrayLike, torque: ArrayLike) -> Motion:
    """Return the regressors of a recording: signals (n,), time in s, position in rad or m.

    An irregular time axis is resampled first. Raises `InsufficientDataError` where nothing moves,
    or the recording is too short.
    """
    t, shaft, effort = require_signals(SHORTEST, time=time, position=position, torque=torque)
    step, known, (shaft, effort) = resample(t, shaft, effort)
    density = position_noise(shaft, step)
    smoother = _smoother(shaft, step, density)
    noise = noise_of_derivatives(density, smoother.width)
    speed = smoother(shaft, 1)
    highest = float(np.percentile(np.abs(speed), 99))
    if highest <= SURE * noise[0]:
        raise InsufficientDataError(
            f"nothing moves: the highest speed is {highest:.3g} (SI), {SURE:g} times its noise of "
            f"{noise[0]:.3g} is needed; move faster or further"
        )
    # The speed between its samples, for the place where it changes its sign.
    places = smoother.places(len(shaft))
    everywhere = np.interp(np.arange(len(shaft)), places, speed)
    sliding = known & (np.abs(everywhere) >= max(STANDSTILL * highest, SURE * noise[0]))
    used = smoother(sliding.astype(np.float64)) >= SLIDING
    design = np.column_stack(
        [smoother(shaft, 2), speed, smoother(np.sign(everywhere)), np.ones(len(speed))]
    )
    return Motion(
        design=design,
        torque=smoother(effort),
        position=shaft[places],
        used=used,
        spacing=smoother.every * step,
        noise=noise,
        cutoff=smoother.cutoff,
        samples=len(t),
        left_out=max(0, len(t) - int(used.sum()) * smoother.every),
        resampled=len(shaft) != len(t) or not known.all(),
    )


def _smoother(position: Array, step: float, density: float) -> Smoother:
    """Return the narrowest kernel that keeps noise out of the acceleration and passes the motion.

    Not narrower than the motion needs: the rest of the band is other dynamics. Where none keeps the
    noise out, the one with the least part of it is taken.
    """
    widest = max(len(position) * step * WIDEST, NARROWEST * step)
    best, least = Smoother(step, NARROWEST * step), math.inf
    width = best.width
    while width <= widest:
        smoother = Smoother(step, width)
        acceleration = smoother(position, 2)
        power = max(float(np.mean(acceleration**2)), 1e-300)
        share = noise_of_derivatives(density, width)[1] ** 2 / power
        if share < least:
            best, least = smoother, share
        if share <= NOISE_SHARE:
            break
        width *= GROWTH
    frequency = _highest_frequency(best(position, 1), best.every * step)
    return Smoother(step, max(best.width, min(CUTOFF / (HARMONICS * frequency), widest)))


def _highest_frequency(signal: Array, spacing: float) -> float:
    """Return the frequency below which `MOTION` of a signal's power is, Hz."""
    power = np.abs(np.fft.rfft((signal - signal.mean()) * np.hanning(len(signal)))) ** 2
    total = np.cumsum(power)
    first = int(np.searchsorted(total, MOTION * total[-1]))
    return max(first, 1) / (len(signal) * spacing)


# -- fit


def identify(motions: Sequence[Motion]) -> Dynamics:
    """Return the parameters that fit all recordings.

    Raises `InsufficientDataError` where the motion does not tell friction's parameters apart, or
    the model does not explain the torque.
    """
    used = np.concatenate([motion.used for motion in motions])
    if np.count_nonzero(used) < SHORTEST:
        raise InsufficientDataError(
            f"{np.count_nonzero(used)} smoothed samples are in motion, {SHORTEST} are needed: move "
            "for longer, faster, or with fewer reversals"
        )
    # Each second counts the same, whatever the spacing.
    weight = used * np.concatenate([np.full(len(m.torque), m.spacing**0.5) for m in motions])
    design = np.concatenate([motion.design for motion in motions]) * weight[:, None]
    torque = np.concatenate([motion.torque for motion in motions]) * weight
    _require_friction(design[used])
    noise, without = _inertia_told(motions, design)
    chosen = slice(1 if without else 0, 4)
    solution = np.linalg.lstsq(design[:, chosen], torque, rcond=None)[0]
    residual = torque - design[:, chosen] @ solution
    independent = _independent(motions, residual)
    within, dof = long_run_covariance(design[:, chosen], residual, independent)
    by = {}
    for name, over in (("speed", _speed(motions)), ("position", _centred(motions))):
        share, doubt = structure(over[used], residual[used], design[used, chosen], independent)
        by[name] = share
        within = within + np.diag(doubt**2)
    parameters, covariance = np.full(4, math.nan), np.full((4, 4), math.nan)
    parameters[chosen], covariance[chosen, chosen] = solution, within
    if not without:
        # Noise in a regressor draws its parameter towards zero: by how much is in doubt.
        covariance[0, 0] += (noise / own_part(design, 0) * parameters[0]) ** 2
    level = torque - weight * float(np.sum(torque * weight) / np.sum(weight**2))
    power = float(np.sum(residual**2))
    found = Dynamics(
        parameters=parameters,
        covariance=covariance,
        dof=dof,
        residual_rms=math.sqrt(power / float(np.sum(weight**2))),
        explained=1 - power / max(float(np.sum(level**2)), 1e-300),
        by_speed=by["speed"],
        by_position=by["position"],
        single_frequency=_single_frequency(motions),
        without_inertia=without,
    )
    _require_model(found)
    return found


def _require_friction(design: Array) -> None:
    """Raise where the motion does not tell viscous and Coulomb friction and offset apart."""
    forward = float(np.mean(design[:, 1] > 0))
    if not ONE_WAY <= forward <= 1 - ONE_WAY:
        way = "positive" if forward > 0.5 else "negative"
        raise InsufficientDataError(
            f"{max(forward, 1 - forward):.1%} of the motion is in the {way} direction: Coulomb "
            "friction and a constant torque cannot be told apart; move in both directions"
        )
    own = own_part(design, 1)
    if own < TOLD_APART:
        raise InsufficientDataError(
            f"the speed varies too little besides its direction ({own:.2g} of its power, limit "
            f"{TOLD_APART:g}): viscous and Coulomb friction cannot be told apart; move at "
            "different speeds"
        )


def _inertia_told(motions: Sequence[Motion], design: Array) -> tuple[float, str | None]:
    """Return the part of noise in the acceleration's power, and why inertia is not told, if so."""
    power = float(np.sum(design[:, 0] ** 2))
    noise = sum(np.sum(m.used) * m.spacing * m.noise[1] ** 2 for m in motions)
    share = float(noise / power) if power > 0 else math.inf
    if share > NO_ACCELERATION:
        return share, (
            "the acceleration does not stand out of the encoder's resolution "
            f"({min(share, 1.0):.0%} of its power is noise, limit {NO_ACCELERATION:.0%}): move "
            "with more acceleration"
        )
    if own_part(design, 0) < TOLD_APART:
        return share, (
            "the acceleration goes with the speed: inertia and friction are not told apart by this "
            "motion; vary the acceleration"
        )
    return share, None


def _require_model(found: Dynamics) -> None:
    """Raise where the model does not explain the torque, or friction drives the motion."""
    if found.explained < EXPLAINED:
        raise InsufficientDataError(
            f"inertia and friction explain {found.explained:.0%} of the torque's variance, limit "
            f"{EXPLAINED:.0%}: something else acts, such as a load or ripple, or torque and "
            "position are not of one clock"
        )
    coulomb, u = found.estimate("coulomb")
    if coulomb < -3 * u:
        raise InsufficientDataError(
            f"Coulomb friction comes out as {coulomb:.3g} (SI) with u = {u:.1g}: it cannot be "
            "below 0; check the signs of torque and position"
        )


# -- residuals


def _independent(motions: Sequence[Motion], residual: Array) -> float:
    """Return how many independent samples all residuals are worth."""
    total, start = 0.0, 0
    for motion in motions:
        part = residual[start : start + len(motion.torque)]
        start += len(motion.torque)
        # At two standard deviations of the kernel the smoothing itself hardly correlates any more.
        lag = max(1, round(2 * CUTOFF / motion.cutoff / motion.spacing))
        total += independent_samples(part, motion.used, lag)
    return total


def _speed(motions: Sequence[Motion]) -> Array:
    return np.concatenate([motion.design[:, 1] for motion in motions])


def _centred(motions: Sequence[Motion]) -> Array:
    """Return positions about their mean in each recording: encoders may start anywhere."""
    return np.concatenate([motion.position - motion.position.mean() for motion in motions])


def _single_frequency(motions: Sequence[Motion]) -> bool:
    """Say whether position is proportional to acceleration, throughout all recordings."""
    used = np.concatenate([motion.used for motion in motions])
    acceleration = np.concatenate([motion.design[:, 0] for motion in motions])[used]
    position = _centred(motions)[used]
    both = math.sqrt(float(np.sum(position**2) * np.sum(acceleration**2)))
    return float(np.sum(position * acceleration)) < -ONE_FREQUENCY * both
