"""Inertia and friction from any motion, by least squares on the equation of motion.

    torque = J a + fv v + fc sign(v) + offset + fd |v|

on the terms that `motion_terms` makes of recordings. The covariance allows for residuals that are
correlated in time (`residual_covariance`) and for structure in the residuals (`model_doubt`):
friction that is not a straight line over speed (Stribeck), or that depends on position (spring,
ripple, load), and efforts that are coarsely resolved or not linear. The offset is the mean torque
over the positions that were visited: on less than a turn, it includes a mean of the ripple. Viscous
friction is fv + fd in the positive direction and fv - fd in the negative one; fd is part of the
model where it is significant.

A delay between effort and position is part of the model where the residuals ask for it, and of the
uncertainties where they do not (`effort_delay`).

How much is left out around standstill is chosen by the residuals: samples at lower speeds are used
as long as the model fits them as well as the others. What the choice changes is part of the
uncertainties.

A linear axis has the same equations with position in m and force in N: J in kg, fv in N s/m.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from rigtool.errors import InsufficientDataError
from rigtool.experiments.friction.effort_delay import SIGNIFICANT_RATIO, on_time
from rigtool.experiments.friction.model_doubt import (
    TIME_PARTS,
    curvature,
    long_ripple,
    own_part,
    structure,
)
from rigtool.experiments.friction.motion_terms import (
    DELAY,
    DYNAMICS_PARAMETERS,
    NEAR_STANDSTILL,
    SPLIT,
    SmoothedMotion,
    drift_terms,
    independent,
    weighted,
    with_drift,
)
from rigtool.numerics.arrays import TINY, Array
from rigtool.numerics.residual_covariance import kept_by_fit, long_run_covariance

AS_WELL, ON_ONE_SIDE = 3.0, 2.0
"""Standard deviations by which chance raises the power of residuals near standstill, and moves
their mean along the motion: with more, friction at low speed differs (Stribeck)."""

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
    """Parameters J, fv, fc, offset, fd, d (6,), covariance (6, 6), `dof` degrees of freedom.

    Inertia is NaN where the motion does not resolve it; `without_inertia` then states why. fd is
    NaN where viscous friction is the same in both directions, d where the effort is not late.
    `standstill` is the part of the highest speed below which samples were left out, `motions` those
    with the rest.
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
    standstill: float
    motions: Sequence[SmoothedMotion]
    without_inertia: str | None = None

    @property
    def by_direction(self) -> bool:
        """Whether viscous friction differs by direction."""
        return bool(np.isfinite(self.parameters[SPLIT]))

    @property
    def is_late(self) -> bool:
        """Whether the effort is recorded later, or earlier, than the position."""
        return bool(np.isfinite(self.parameters[DELAY]))

    def estimate(self, *names: str) -> tuple[float, float]:
        """Return a sum of parameters of `DYNAMICS_PARAMETERS` and its standard uncertainty.

        A minus sign before a name subtracts it.
        """
        factor = np.zeros(len(DYNAMICS_PARAMETERS))
        for name in names:
            factor[DYNAMICS_PARAMETERS.index(name.lstrip("-"))] = -1.0 if name[0] == "-" else 1.0
        there = factor != 0
        spread = factor[there] @ self.covariance[np.ix_(there, there)] @ factor[there]
        return float(factor[there] @ self.parameters[there]), math.sqrt(float(spread))

    def torque(self, motion: SmoothedMotion) -> Array:
        """Return the model's torque for each row of a motion, (n,)."""
        # An inertia that is not resolved is no part of the model, a delay is none of its rows.
        return motion.design[:, :DELAY] @ np.nan_to_num(self.parameters[:DELAY])


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
    _require_friction(np.concatenate([motion.design[motion.used] for motion in motions]))
    without = _resolves_inertia(motions)[1]
    plain = [1, 2, 3] if without else [0, 1, 2, 3]
    motions = with_drift(motions, [*plain, SPLIT])
    motions, delay, change = on_time(motions, [*plain, SPLIT])
    late = [DELAY] if delay else []
    split = [*plain, SPLIT, *late]
    motions, standstill = _with_all_that_fits(motions, split)
    found = _fit(motions, split, standstill, without)
    difference, u = found.estimate("viscous_difference")
    own = own_part(weighted(motions)[0][:, [*plain, SPLIT]], len(plain))
    if abs(difference) < SIGNIFICANT_RATIO * u or own < MIN_OWN_POWER:
        found = _fit(motions, [*plain, *late], standstill, without)
    found.parameters[DELAY] += delay
    found.covariance[range(DELAY), range(DELAY)] += change**2
    _require_model(found)
    return found


def _with_all_that_fits(
    motions: Sequence[SmoothedMotion], chosen: Sequence[int]
) -> tuple[list[SmoothedMotion], float]:
    """Return the motions with all samples near standstill that the model fits as well as the
    others.

    Also return the part of the highest speed below which samples are left out.
    """
    here = list(motions)
    standstill = NEAR_STANDSTILL[0]
    for number, part in enumerate(NEAR_STANDSTILL[1:], start=1):
        more = [replace(motion, used=motion.sliding[number]) for motion in motions]
        design, torque, weight = weighted(here)
        solution = np.linalg.lstsq(design[:, chosen], torque)[0]
        _, _, wider = weighted(more)
        left = np.concatenate(
            [torque - design[:, chosen] @ solution for design, torque in (m.rows() for m in here)]
        )
        new = (wider > 0) & (weight == 0)
        along = (left * np.sign(_speed(motions)))[new]
        others = float(np.mean(left[weight > 0] ** 2))
        alike = independent(here, torque - design[:, chosen] @ solution)
        count = max(alike * np.count_nonzero(new) / np.count_nonzero(weight), 1.0)
        if new.any() and (
            float(np.mean(along**2)) > others * (1 + AS_WELL * math.sqrt(2 / count))
            or abs(float(np.mean(along))) > ON_ONE_SIDE * math.sqrt(others / count)
        ):
            break
        here, standstill = more, part
    return here, standstill


def _fit(
    motions: Sequence[SmoothedMotion], chosen: list[int], standstill: float, without: str | None
) -> Dynamics:
    """Fit the chosen parameters to the samples in use."""
    design, torque, weight = weighted(motions)
    solution = np.asarray(np.linalg.lstsq(design[:, chosen], torque)[0], np.float64)
    residual = torque - design[:, chosen] @ solution
    covariance, dof = long_run_covariance(
        design[:, chosen], residual, independent(motions, residual)
    )
    loss = np.sqrt(kept_by_fit(design[:, chosen], dof, drift_terms(motions)))
    covariance = covariance / np.outer(loss, loss)
    doubt, by_speed, by_position = _doubt(motions, design[:, chosen], residual, weight)
    doubt = np.hypot(doubt, _choice(motions, chosen, solution))
    if 0 in chosen:
        # Noise in a regressor draws its parameter towards zero: the bias counts as uncertainty.
        noise = _resolves_inertia(motions)[0]
        doubt[0] = math.hypot(doubt[0], noise / own_part(design[:, chosen], 0) * solution[0])
    size = len(DYNAMICS_PARAMETERS)
    parameters, total = np.full(size, math.nan), np.full((size, size), math.nan)
    parameters[chosen] = solution
    total[np.ix_(chosen, chosen)] = covariance + np.diag(doubt**2)
    level = torque - weight * float(np.sum(torque * weight) / np.sum(weight**2))
    power = float(np.sum(residual**2))
    return Dynamics(
        parameters=parameters,
        covariance=total,
        dof=dof,
        residual_rms=math.sqrt(power / float(np.sum(weight**2))),
        explained=1 - power / max(float(np.sum(level**2)), TINY),
        by_speed=by_speed,
        by_position=by_position,
        single_frequency=_single_frequency(motions),
        standstill=standstill,
        motions=motions,
        without_inertia=without,
    )


def _choice(motions: Sequence[SmoothedMotion], chosen: list[int], solution: Array) -> Array:
    """Return the uncertainty (p,) from the choice of what is left out around standstill.

    The largest change by leaving out more, as half the width of a rectangular distribution
    (GUM 4.3.7).
    """
    change = np.zeros(len(chosen))
    for number in range(len(NEAR_STANDSTILL)):
        other = [replace(m, used=m.used & m.sliding[number]) for m in motions]
        design, torque, _ = weighted(other)
        found = np.linalg.lstsq(design[:, chosen], torque)[0]
        change = np.maximum(change, np.abs(found - solution))
    return change / math.sqrt(3)


def _doubt(
    motions: Sequence[SmoothedMotion], design: Array, residual: Array, weight: Array
) -> tuple[Array, float, float]:
    """Return the uncertainty of each parameter from structure in the residuals, (p,).

    Also return the parts of the residuals' power that are a function of speed, and of position.
    """
    used, times = weight > 0, _times(motions)
    speed, position = _speed(motions), _centred(motions)
    by_speed, _ = structure(speed[used], residual[used], design[used], times[used])
    by_position, doubt = structure(position[used], residual[used], design[used], times[used])
    # The effort of the model: of the measured one, residuals are a function themselves.
    effort = np.concatenate([motion.torque for motion in motions])[used]
    effort -= residual[used] / weight[used]
    _, by_effort = structure(effort, residual[used], design[used], times[used])
    coulomb = weighted(motions)[0][:, DYNAMICS_PARAMETERS.index("coulomb")]
    count = independent(motions, residual)
    bent = curvature(speed, coulomb, residual, design, count)
    long = long_ripple(position, weight, residual, design, count)
    return np.sqrt(doubt**2 + by_effort**2 + bent**2 + long**2), by_speed, by_position


def _require_friction(design: Array) -> None:
    """Raise where the motion does not separate viscous friction, Coulomb friction and offset."""
    forward = float(np.mean(design[:, 1] > 0))
    if not ONE_WAY <= forward <= 1 - ONE_WAY:
        way = "positive" if forward > 0.5 else "negative"
        raise InsufficientDataError(
            f"{100 * max(forward, 1 - forward):.1f} % of the motion is in the {way} direction: "
            "Coulomb friction and a constant torque cannot be separated; move in both directions"
        )
    own = own_part(design, 1)
    if own < MIN_OWN_POWER:
        raise InsufficientDataError(
            f"the speed varies too little besides its direction ({own:.2g} of its power, limit "
            f"{MIN_OWN_POWER:g}): viscous and Coulomb friction cannot be separated; move at "
            "different speeds"
        )


def _resolves_inertia(motions: Sequence[SmoothedMotion]) -> tuple[float, str | None]:
    """Return the part of noise in the acceleration's power, and why inertia is not resolved."""
    design = weighted(motions)[0][:, :4]
    power = float(np.sum(design[:, 0] ** 2))
    noise = sum(np.sum(m.used) * m.spacing * m.noise[1] ** 2 for m in motions)
    share = float(noise / power) if power > 0 else math.inf
    if share > ACCELERATION_NOISE_LIMIT:
        return share, (
            "the acceleration does not exceed the encoder's resolution "
            f"({100 * min(share, 1.0):.0f} % of its power is noise, limit "
            f"{100 * ACCELERATION_NOISE_LIMIT:.0f} %): move with more acceleration"
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
            f"inertia and friction explain {100 * found.explained:.0f} % of the torque's variance, "
            f"limit {100 * MIN_EXPLAINED:.0f} %: something else acts, such as a load or ripple, or "
            "torque and position are not of one clock"
        )
    coulomb, u = found.estimate("coulomb")
    if coulomb < -3 * u:
        raise InsufficientDataError(
            f"Coulomb friction comes out as {coulomb:.3g} (SI) with u = {u:.1g}: it cannot be "
            "below 0; check the signs of torque and position"
        )


# -- residuals


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
