"""Inertia and friction from any motion, by least squares on the equation of motion.

    torque = J a + fv v + fc sign(v) + offset

on the terms that `motion_terms` makes of recordings. The covariance allows for residuals that are
correlated in time (`residual_covariance`) and for structure in the residuals (`model_doubt`):
friction that is no straight line over speed (Stribeck), or a function of position (spring, ripple,
load). The offset is the mean torque over the positions that were visited: on less than a turn, it
includes a mean of the ripple.

A linear axis is the same with position in m and force in N: J in kg, fv in N s/m.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rigtool.errors import InsufficientDataError
from rigtool.experiments.friction.model_doubt import TIME_PARTS, curvature, own_part, structure
from rigtool.experiments.friction.motion_terms import SmoothedMotion
from rigtool.numerics.arrays import Array
from rigtool.numerics.residual_covariance import independent_samples, long_run_covariance
from rigtool.numerics.smoothing import CUTOFF

DYNAMICS_PARAMETERS = ("inertia", "viscous", "coulomb", "offset")

ACCELERATION_NOISE_LIMIT = 0.1
"""Largest part of noise in the acceleration's power for which inertia is stated."""

ONE_WAY = 0.01
"""Smallest part of the samples in a direction for which the motion counts as both ways."""

MIN_OWN_POWER = 0.01
"""Smallest part of a regressor's power that the other regressors may leave unexplained."""

MIN_EXPLAINED = 0.5
"""Smallest part of the torque's variance that the model may explain."""

ONE_FREQUENCY = 0.99
"""Correlation of position and acceleration above which the motion has one frequency."""

MIN_SAMPLES_IN_MOTION = 50
"""Smallest number of smoothed samples in motion for a fit."""


@dataclass(frozen=True, eq=False)
class Dynamics:
    """Parameters J, fv, fc, offset (4,) with covariance (4, 4) and `dof` degrees of freedom.

    Inertia is NaN where the motion does not resolve it; `without_inertia` then states why.
    `residual_rms` is that of the smoothed torque, `explained` the part of its variance that the
    model explains; `by_speed` and `by_position` are the parts of the residual's power that a
    function of speed, or of position, explains beyond chance. With `single_frequency`, position is
    proportional to acceleration: a spring then looks like (negative) inertia.
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
        """Return a parameter of `DYNAMICS_PARAMETERS` and its standard uncertainty."""
        index = DYNAMICS_PARAMETERS.index(name)
        return float(self.parameters[index]), math.sqrt(float(self.covariance[index, index]))

    def torque(self, motion: SmoothedMotion) -> Array:
        """Return the model's torque for each row of a motion, (n,)."""
        # An inertia that is not resolved is no part of the model.
        torque: Array = motion.design @ np.nan_to_num(self.parameters)
        return torque


# -- fit


def identify_dynamics(motions: Sequence[SmoothedMotion]) -> Dynamics:
    """Return the parameters that fit all recordings.

    Raises `InsufficientDataError` where the motion does not separate the parameters of friction, or
    the model does not explain the torque.
    """
    used = np.concatenate([motion.used for motion in motions])
    if np.count_nonzero(used) < MIN_SAMPLES_IN_MOTION:
        raise InsufficientDataError(
            f"{np.count_nonzero(used)} smoothed samples are in motion, {MIN_SAMPLES_IN_MOTION} are "
            "needed: move for longer, faster, or with fewer reversals"
        )
    # Each second has the same weight, for any spacing.
    weight = used * np.concatenate([np.full(len(m.torque), m.spacing**0.5) for m in motions])
    design = np.concatenate([motion.design for motion in motions]) * weight[:, None]
    torque = np.concatenate([motion.torque for motion in motions]) * weight
    _require_friction(design[used])
    noise, without = _resolves_inertia(motions, design)
    chosen = slice(1 if without else 0, 4)
    solution = np.linalg.lstsq(design[:, chosen], torque, rcond=None)[0]
    residual = torque - design[:, chosen] @ solution
    covariance, dof = long_run_covariance(
        design[:, chosen], residual, _independent(motions, residual)
    )
    doubt, by_speed, by_position = _doubt(motions, design[:, chosen], residual, weight)
    doubts = np.zeros(4)
    doubts[chosen] = doubt
    if not without:
        # Noise in a regressor draws its parameter towards zero: the bias counts as uncertainty.
        doubts[0] = math.hypot(doubts[0], noise / own_part(design, 0) * solution[0])
    parameters, total = np.full(4, math.nan), np.full((4, 4), math.nan)
    parameters[chosen] = solution
    total[chosen, chosen] = covariance + np.diag(doubts[chosen] ** 2)
    level = torque - weight * float(np.sum(torque * weight) / np.sum(weight**2))
    power = float(np.sum(residual**2))
    found = Dynamics(
        parameters=parameters,
        covariance=total,
        dof=dof,
        residual_rms=math.sqrt(power / float(np.sum(weight**2))),
        explained=1 - power / max(float(np.sum(level**2)), 1e-300),
        by_speed=by_speed,
        by_position=by_position,
        single_frequency=_single_frequency(motions),
        without_inertia=without,
    )
    _require_model(found)
    return found


def _doubt(
    motions: Sequence[SmoothedMotion], design: Array, residual: Array, weight: Array
) -> tuple[Array, float, float]:
    """Return the uncertainty of each parameter from structure in the residuals, (p,).

    And the parts of the residuals' power that are a function of speed, and of position.
    """
    used, times = weight > 0, _times(motions)
    speed, position = _speed(motions), _centred(motions)
    by_speed, _ = structure(speed[used], residual[used], design[used], times[used])
    by_position, doubt = structure(position[used], residual[used], design[used], times[used])
    bent = curvature(speed, weight, residual, design, _independent(motions, residual))
    return np.hypot(doubt, bent), by_speed, by_position


def _require_friction(design: Array) -> None:
    """Raise where the motion does not separate viscous friction, Coulomb friction and offset."""
    forward = float(np.mean(design[:, 1] > 0))
    if not ONE_WAY <= forward <= 1 - ONE_WAY:
        way = "positive" if forward > 0.5 else "negative"
        raise InsufficientDataError(
            f"{max(forward, 1 - forward):.1%} of the motion is in the {way} direction: Coulomb "
            "friction and a constant torque cannot be separated; move in both directions"
        )
    own = own_part(design, 1)
    if own < MIN_OWN_POWER:
        raise InsufficientDataError(
            f"the speed varies too little besides its direction ({own:.2g} of its power, limit "
            f"{MIN_OWN_POWER:g}): viscous and Coulomb friction cannot be separated; move at "
            "different speeds"
        )


def _resolves_inertia(motions: Sequence[SmoothedMotion], design: Array) -> tuple[float, str | None]:
    """Return the part of noise in the acceleration's power, and why inertia is not resolved."""
    power = float(np.sum(design[:, 0] ** 2))
    noise = sum(np.sum(m.used) * m.spacing * m.noise[1] ** 2 for m in motions)
    share = float(noise / power) if power > 0 else math.inf
    if share > ACCELERATION_NOISE_LIMIT:
        return share, (
            "the acceleration does not exceed the encoder's resolution "
            f"({min(share, 1.0):.0%} of its power is noise, limit "
            f"{ACCELERATION_NOISE_LIMIT:.0%}): move with more acceleration"
        )
    if own_part(design, 0) < MIN_OWN_POWER:
        return share, (
            "the acceleration goes with the speed: this motion does not separate inertia and "
            "friction; vary the acceleration"
        )
    return share, None


def _require_model(found: Dynamics) -> None:
    """Raise where the model does not explain the torque, or friction drives the motion."""
    if found.explained < MIN_EXPLAINED:
        raise InsufficientDataError(
            f"inertia and friction explain {found.explained:.0%} of the torque's variance, limit "
            f"{MIN_EXPLAINED:.0%}: something else acts, such as a load or ripple, or torque and "
            "position are not of one clock"
        )
    coulomb, u = found.estimate("coulomb")
    if coulomb < -3 * u:
        raise InsufficientDataError(
            f"Coulomb friction comes out as {coulomb:.3g} (SI) with u = {u:.1g}: it cannot be "
            "below 0; check the signs of torque and position"
        )


# -- residuals


def _independent(motions: Sequence[SmoothedMotion], residual: Array) -> float:
    """Return the number of independent samples that all residuals amount to."""
    total, start = 0.0, 0
    for motion in motions:
        part = residual[start : start + len(motion.torque)]
        start += len(motion.torque)
        # At two standard deviations of the kernel the smoothing itself hardly correlates any more.
        lag = max(1, round(2 * CUTOFF / motion.cutoff / motion.spacing))
        total += independent_samples(part, motion.used, lag)
    return total


def _times(motions: Sequence[SmoothedMotion]) -> NDArray[np.intp]:
    """Return the number of the part of the recordings to which each row belongs."""
    parts = [
        np.arange(len(m.torque)) * TIME_PARTS // len(m.torque) + TIME_PARTS * number
        for number, m in enumerate(motions)
    ]
    return np.concatenate(parts)


def _speed(motions: Sequence[SmoothedMotion]) -> Array:
    return np.concatenate([motion.design[:, 1] for motion in motions])


def _centred(motions: Sequence[SmoothedMotion]) -> Array:
    """Return positions minus their mean in each recording: encoders may start anywhere."""
    return np.concatenate([motion.position - motion.position.mean() for motion in motions])


def _single_frequency(motions: Sequence[SmoothedMotion]) -> bool:
    """Return whether position is proportional to acceleration throughout all recordings."""
    used = np.concatenate([motion.used for motion in motions])
    acceleration = np.concatenate([motion.design[:, 0] for motion in motions])[used]
    position = _centred(motions)[used]
    both = math.sqrt(float(np.sum(position**2) * np.sum(acceleration**2)))
    return float(np.sum(position * acceleration)) < -ONE_FREQUENCY * both
