"""Torque constant of each staircase, with friction and heat taken out of the slope [7.1.1].

The model is equation (1) of `rigtool.experiments.torque_constant.staircase_model`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from rigtool.errors import InsufficientDataError
from rigtool.experiments.torque_constant.staircase import LEVEL_TOLERANCE, Plateaus
from rigtool.experiments.torque_constant.staircase_model import (
    Common,
    Stairs,
    arrange,
    design_matrix,
    fit_common,
    mean_of,
    winding,
)
from rigtool.experiments.torque_constant.swings import swings_seen
from rigtool.numerics.arrays import Array
from rigtool.numerics.residual_covariance import independent_samples, long_run_covariance
from rigtool.numerics.turn_mean import mean_over_turn

MISFIT_LIMIT = 5e-3
"""Largest deviation of a level from the model, relative to the span of the torque."""

SLOPE_LIMIT = 0.25
"""Largest relative change of a straight line's slope by friction and heat."""

RATE_STEP = 1.03
"""Factor by which a parameter moves for the rate at which the model follows it."""

REJECTION_CHI2 = 10.8
"""Chi square with one degree of freedom that scatter alone exceeds with probability 0.001."""


@dataclass(frozen=True)
class Slopes:
    """Torque constants of m staircases, friction and heat taken out.

    `slope` (m,) in N m/A, `u` (m,) its standard uncertainty from scatter with `dof`; `temperature`
    (m,) in degC, weighted as the slope weights its plateaus; `rotor_angle` (m,) in rad.
    `heating` is the relative amount by which heat in the winding lowered the slopes on average,
    `heating_u` its standard uncertainty with `heating_dof`; `friction_u` the relative standard
    uncertainty from the model of friction with `friction_dof`, `friction_drift_u` in 1/K that of a
    relative change of the slopes with temperature. `transition` is s of (1) in N m (None where no
    friction shows), `time_constant` tau in s. `level` (l,) in A, `rising` and `falling` (l,) in
    N m: torque minus the straight line, mean over staircases; `hysteresis` in N m: falling minus
    rising in the middle of the span, `hysteresis_u` its standard uncertainty with `hysteresis_dof`.
    """

    slope: Array
    u: Array
    dof: int
    temperature: Array
    rotor_angle: Array
    heating: float
    heating_u: float
    heating_dof: float
    friction_u: float
    friction_dof: float
    friction_drift_u: float
    transition: float | None
    time_constant: float
    level: Array
    rising: Array
    falling: Array
    hysteresis: float
    hysteresis_u: float
    hysteresis_dof: int


def fit_staircases(plateaus: Plateaus, coefficient: float = 0.0) -> Slopes:
    """Fit (1) to all staircases together and return each one's slope.

    `coefficient` is c of (1) in 1/K, as far as it is known. Raises `InsufficientDataError` where a
    staircase does not rise and fall, or where torque does not follow current.
    """
    stairs = arrange(plateaus)
    # A gauge that shows no swings may be too slow for them: then straight steps are possible too.
    kinds = (True,) if swings_seen(stairs.courses) else (True, False)
    commons = [fit_common(stairs, coefficient, swings=swings) for swings in kinds]
    commons.sort(key=lambda common: common.square_misfit)
    common = commons[0]
    solution = _solve(stairs, common, coefficient)
    weight = np.full(len(solution.slope), 1 / len(solution.slope))
    friction_u, friction_dof = _lack_of_fit(stairs, solution, common, weight)
    rise = solution.temperature - solution.temperature.mean()
    spread = max(float(rise @ rise), 1e-300)
    drift_u = _lack_of_fit(stairs, solution, common, rise / spread)[0]
    for other in commons[1:]:
        worse = other.square_misfit / max(common.square_misfit, 1e-300) - 1
        if worse * common.dof < REJECTION_CHI2:
            change = float(np.mean(_solve(stairs, other, coefficient).slope / solution.slope - 1))
            friction_u = math.hypot(friction_u, change / math.sqrt(3))
    _require_straight(stairs, solution)
    level, rising, falling = _branches(stairs, solution.off_line)
    hysteresis, hysteresis_u, hysteresis_dof = _hysteresis(stairs, solution.off_line)
    return Slopes(
        slope=solution.slope,
        u=solution.u,
        dof=solution.dof,
        temperature=solution.temperature,
        rotor_angle=stairs.rotor_angle,
        heating=solution.heating,
        heating_u=solution.heating_u,
        heating_dof=solution.heating_dof,
        friction_u=friction_u,
        friction_dof=friction_dof,
        friction_drift_u=drift_u,
        transition=common.transition,
        time_constant=common.time_constant,
        level=level,
        rising=rising,
        falling=falling,
        hysteresis=hysteresis,
        hysteresis_u=hysteresis_u,
        hysteresis_dof=hysteresis_dof,
    )


@dataclass(frozen=True)
class _Solution:
    """Solution of (1) for given s and tau; names as in `Slopes`, by plateau (m, p) the rest."""

    slope: Array
    u: Array
    dof: int
    temperature: Array
    heating: float
    heating_u: float
    heating_dof: float
    design: Array
    parameters: Array
    residual: Array
    off_line: Array


def _solve(stairs: Stairs, common: Common, coefficient: float) -> _Solution:
    """Solve (1), linear in all that is left, for every staircase."""
    heat, warmth = winding(stairs, common.time_constant)
    temperature = mean_of(warmth, stairs.weight)
    current = stairs.current * (1 + coefficient * (warmth - temperature[:, None]))
    loss, loss_u, loss_dof = _heat_loss(stairs, common, current, heat)
    design = design_matrix(stairs, common, current * (1 - loss * heat))
    inverse = np.linalg.pinv(design)
    parameters = np.einsum("mcp,mp->mc", inverse, stairs.torque)
    residual = stairs.torque - np.einsum("mpc,mc->mp", design, parameters)
    dof = int(stairs.weight.sum()) - parameters.size
    sigma = math.sqrt(float(np.sum(residual**2)) / dof)
    share = float(np.mean(np.sum(inverse[:, 0] * current * heat, axis=1)))
    straight = np.einsum("mpc,mc->mp", design[:, :, :2], parameters[:, :2])
    return _Solution(
        slope=parameters[:, 0],
        u=sigma * np.sqrt(np.sum(inverse[:, 0] ** 2, axis=1)),
        dof=dof,
        temperature=temperature,
        heating=loss * share,
        heating_u=loss_u * share,
        heating_dof=loss_dof,
        design=design,
        parameters=parameters,
        residual=residual,
        off_line=stairs.torque - straight,
    )


def _heat_loss(
    stairs: Stairs, common: Common, current: Array, heat: Array
) -> tuple[float, float, float]:
    """Return g of (1), its standard uncertainty, 1/(A2 s), and degrees of freedom.

    At a single rotor angle its uncertainty is unknown, and taken as large as its value.
    """
    design = design_matrix(stairs, common, current)
    design = np.concatenate([design, (current * heat)[:, :, None]], axis=2)
    parameters = np.einsum("mcp,mp->mc", np.linalg.pinv(design), stairs.torque)
    mean = mean_over_turn(stairs.rotor_angle, -parameters[:, -1] / parameters[:, 0])
    if mean.dof == 0:
        return mean.value, abs(mean.value), math.inf
    return mean.value, mean.u, mean.dof


def _lack_of_fit(
    stairs: Stairs, solution: _Solution, common: Common, weight: Array
) -> tuple[float, float]:
    """Return the relative u that lack of fit gives a combination of slopes, and its dof.

    `weight` (m,) combines the staircases. What their residuals have in common from plateau to
    plateau is correlated along the staircase, as the covariance takes it; s and lag, found from the
    same plateaus, count among the parameters. Scatter that the slopes state already is taken off.
    """
    combined = weight @ solution.residual
    columns = np.mean(solution.design, axis=0).T
    fitted = np.einsum("mpc,mc->mp", solution.design, solution.parameters)
    rates = []
    for name in ("transition", "lag"):
        value = getattr(common, name)
        if value is not None:
            changed = replace(common, **{name: value * RATE_STEP})
            design = design_matrix(stairs, changed, solution.design[:, :, 0])
            moved = np.einsum("mpc,mc->mp", design, solution.parameters)
            rates.append(np.mean(moved - fitted, axis=0))
    design = np.stack([*columns, *rates], axis=1)
    used = np.ones(len(combined), dtype=np.bool_)
    covariance, dof = long_run_covariance(design, combined, independent_samples(combined, used, 1))
    own = float(np.sum((weight * solution.u) ** 2))
    u = math.sqrt(max(float(covariance[0, 0]) - own, 0.0)) / float(np.mean(solution.slope))
    return u, float(dof)


def _levels(stairs: Stairs) -> tuple[Array, NDArray[np.int_]]:
    """Return the levels of current (l,) in A and the level of each plateau (m, p)."""
    tolerance = 2 * LEVEL_TOLERANCE * float(np.ptp(stairs.setpoint))
    number = np.round(stairs.setpoint / tolerance).astype(np.int64)
    known, level = np.unique(number.ravel(), return_inverse=True)
    return np.asarray(known * tolerance), level.reshape(number.shape).astype(np.int_)


def _by_level(level: NDArray[np.int_], values: Array, weight: Array) -> tuple[Array, Array]:
    """Return the weighted mean of values at each level (NaN without any), and the weights' sum."""
    size = int(level.max()) + 1
    count = np.bincount(level.ravel(), weights=weight.ravel(), minlength=size)
    total = np.bincount(level.ravel(), weights=(values * weight).ravel(), minlength=size)
    mean = np.where(count > 0, total / np.maximum(count, 1), np.nan)
    return mean, np.asarray(count, dtype=np.float64)


def _require_straight(stairs: Stairs, solution: _Solution) -> None:
    """Raise where torque, without friction and heat, is no straight line of current."""
    straight = np.polyfit(stairs.current[stairs.weight > 0], stairs.torque[stairs.weight > 0], 1)
    if straight[0] < 0:
        raise InsufficientDataError(
            f"torque changes by {straight[0]:.3g} N m/A with current: reverse the sign of the "
            "gauge or of the current, so that positive current gives positive force"
        )
    change = abs(float(np.mean(solution.slope)) / straight[0] - 1)
    if change > SLOPE_LIMIT:
        raise InsufficientDataError(
            f"torque follows current by {straight[0]:.3g} N m/A on the whole, but by "
            f"{np.mean(solution.slope):.3g} N m/A once friction and heat are taken out; they may "
            f"change it by {SLOPE_LIMIT:.0%}: torque is not linear in current; look for an end "
            "stop or a saturated gauge, or raise current_max"
        )
    residual = solution.residual
    current, level = _levels(stairs)
    mean, count = _by_level(level, residual, stairs.weight)
    square, _ = _by_level(level, residual**2, stairs.weight)
    u = np.sqrt(np.maximum(square - mean**2, 0) / np.maximum(count - 1, 1))
    limit = MISFIT_LIMIT * float(np.ptp(stairs.torque))
    worst = int(np.argmax(np.abs(mean)))
    if abs(mean[worst]) > max(limit, 4 * u[worst]):
        raise InsufficientDataError(
            f"torque at {current[worst]:.3g} A is {mean[worst] * 1e3:.3g} mN m off the line "
            f"through all currents, limit {limit * 1e3:.3g} mN m: gauge, amplifier or motor is not "
            "linear there; lower current_max or look for an end stop"
        )


def _branches(stairs: Stairs, off_line: Array) -> tuple[Array, Array, Array]:
    """Return levels of current and the mean torque off the line on either branch, (l,)."""
    current, level = _levels(stairs)
    step = np.diff(stairs.setpoint, axis=1, prepend=np.nan)
    rising, _ = _by_level(level, off_line, stairs.weight * (step > 0))
    falling, _ = _by_level(level, off_line, stairs.weight * (step < 0))
    # Both branches meet where the current turns.
    rising = np.where(np.isnan(rising), falling, rising)
    return current, rising, np.where(np.isnan(falling), rising, falling)


def _hysteresis(stairs: Stairs, off_line: Array) -> tuple[float, float, int]:
    """Return falling minus rising in the middle third of the span, N m, and its uncertainty."""
    low, high = stairs.setpoint.min(), stairs.setpoint.max()
    middle = stairs.weight * (np.abs(stairs.setpoint - (low + high) / 2) <= (high - low) / 5.9)
    step = np.diff(stairs.setpoint, axis=1, prepend=np.nan)
    up, down = middle * (step > 0), middle * (step < 0)
    usable = (up.sum(axis=1) > 0) & (down.sum(axis=1) > 0)
    if not usable.any():
        raise InsufficientDataError(
            "no plateau lies in the middle third of the current's span: use more steps"
        )
    difference = (mean_of(off_line[usable], down[usable])) - mean_of(off_line[usable], up[usable])
    count = len(difference)
    u = float(np.std(difference, ddof=1)) / math.sqrt(count) if count > 1 else math.nan
    return float(np.mean(difference)), u, count - 1
