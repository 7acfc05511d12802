"""Torque constant of each staircase, with friction and heat taken out of the slope [7.1.1].

The model is equation (1) of `rigtool.experiments.torque_constant.staircases.model`.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from rigtool.experiments.torque_constant.staircases.angle_losses import heat_loss, hidden_loss
from rigtool.experiments.torque_constant.staircases.friction_change import (
    between,
    either,
    friction_changes,
    of_trend,
)
from rigtool.experiments.torque_constant.staircases.friction_cone import begins_with
from rigtool.experiments.torque_constant.staircases.friction_of_each import friction_of_each
from rigtool.experiments.torque_constant.staircases.gauge_rounding import (
    rounding_errors,
    spread_over_zeros,
)
from rigtool.experiments.torque_constant.staircases.hypotheses import loss_by_heat, weigh_hypotheses
from rigtool.experiments.torque_constant.staircases.least_squares import LeastSquares
from rigtool.experiments.torque_constant.staircases.levels import (
    branches,
    deflection,
    hysteresis,
    lines_through,
    off_trend,
    straight_slope,
)
from rigtool.experiments.torque_constant.staircases.model import (
    SAME_TEMPERATURE,
    Stairs,
    arrange,
    columns_of,
    mean_of,
)
from rigtool.experiments.torque_constant.staircases.plateaus import Plateaus
from rigtool.experiments.torque_constant.staircases.refusals import (
    require_dithered,
    require_resolution,
    require_shown,
    require_straight,
)
from rigtool.experiments.torque_constant.staircases.winding_time import mean_winding
from rigtool.numerics.arrays import TINY, Array
from rigtool.numerics.residual_covariance import independent_samples, long_run_covariance
from rigtool.quantity import Quantity

COARSE = 1e-3
"""Relative uncertainty of a slope by the gauge's rounding from which hypotheses are tried on that
rounding, too; below, it is little beside friction's own."""

MOTIONS = 2
"""Times that the arm is moved with the friction with which each staircase begins and which it has
at its temperature, each with the solution so far."""


@dataclass(frozen=True)
class Slopes:
    """Torque constants of m staircases, friction and heat taken out.

    `slope` (m,) in N m/A, `u` (m,) its standard uncertainty from scatter with `dof`; `first` (m,)
    is the slope where the current is small, `first_u` (m,) its standard uncertainty; `zero` (m,) is
    the torque without current, N m, `zero_u` (m,) its standard uncertainty by scatter;
    `temperature` (m,) in degC, weighted as the slope weights its plateaus; `rotor_angle` (m,) in
    rad; `deflection` is the angle by which the arm gives way from zero to the largest current, rad,
    `deflection_u` its standard uncertainty.
    `heating` is the relative amount by which heat in the winding lowered the slopes on average,
    `heating_u` its standard uncertainty with `heating_dof`; `lasting_heating` 1/A2 is what a
    current lowers the constant by within `HEATING_TIME`, over its square; `friction_u` the relative
    standard uncertainty from the model of friction with `friction_dof`, `friction_share` the
    relative part by which friction changes a straight line's slope; `resolution_u` that from the
    resolution of the gauge,
    `rounding` (places, m) in N m/A what it adds to each slope with the gauge's zero at some places
    within its step; `trend_u` in N m/(A K) is what both give a change with temperature, `lag_u`
    what tau gives it, as the winding is warmer than a housing that cools; `ripple_u`
    what friction's scatter gives the size of the ripple, relative. `transition` is s of (1) in N m
    (None where no friction shows), `exponent` that of its law, `time_constant` the mean of tau in
    s, on a logarithmic scale. `level`
    (l,) in A, `rising` and `falling` (l,) in N m: torque minus the straight line, mean over
    staircases; `hysteresis` in N m: falling minus rising in the middle of the span, `hysteresis_u`
    its standard uncertainty with `hysteresis_dof`.
    """

    slope: Array
    first: Array
    first_u: Array
    zero: Array
    zero_u: Array
    deflection: float
    deflection_u: float
    u: Array
    dof: int
    temperature: Array
    rotor_angle: Array
    heating: float
    heating_u: float
    heating_dof: float
    lasting_heating: Quantity
    friction_u: float
    friction_dof: float
    friction_share: float
    resolution_u: float
    rounding: Array
    trend_u: float
    lag_u: float
    ripple_u: float
    transition: float | None
    exponent: float
    time_constant: float
    level: Array
    rising: Array
    falling: Array
    hysteresis: float
    hysteresis_u: float
    hysteresis_dof: int


def fit_staircases(plateaus: Plateaus) -> Slopes:
    """Fit (1) to all staircases together and return each one's slope.

    Raises `InsufficientDataError` where a staircase does not rise and fall, or where torque does
    not follow current.
    """
    require_resolution(plateaus)
    stairs = arrange(plateaus)
    require_shown(stairs)
    rise = mean_of(stairs.temperature, stairs.weight)
    rise = rise - rise.mean()
    trend = rise / max(float(rise @ rise), TINY)
    ripple = off_trend(stairs, rise)
    average = np.full(len(rise), 1 / len(rise))
    coefficient = _about(stairs)
    hypotheses = weigh_hypotheses(stairs, coefficient, trend)
    stairs, best = hypotheses.means.stairs, hypotheses.weighed.best
    coefficient = hypotheses.means.coefficient
    tau, probable = hypotheses.time_constants()
    warm, range_u = mean_winding(stairs, tau, probable, trend)
    given = stairs, warm, friction_of_each(hypotheses.means, best), coefficient, rise
    both = _solve(*given), _solve(*given, steady=True)
    for _ in range(MOTIONS if given[2] else 0):
        motion = _begins(stairs, both[0].fit), _sizes(stairs, both, trend, rise)
        friction = friction_of_each(hypotheses.means, best, *motion)
        given = *given[:2], friction, coefficient, rise
        both = _solve(*given), _solve(*given, steady=True)
    solution, steady = both
    hidden = hidden_loss(stairs, solution.warmed, _scatter(stairs, solution.warmed)[0])
    constant = hypotheses.constant
    share = abs(straight_slope(stairs) / constant - 1 + solution.heating)
    fitted = stairs.torque - solution.fit.residual
    errors = rounding_errors(stairs, fitted)
    changes, known = friction_changes(stairs.weight, solution.fit, steady.fit, trend)
    roundings = [np.stack([each.fit.solve(one)[0][:, 0] for one in errors]) for each in both]
    rounding = between(changes * known, *roundings)
    resolution_u, trend_resolution_u = (_rms(rounding @ each) for each in (average, trend))
    moved_u = 0.0
    if resolution_u > COARSE * abs(constant):
        moved_u = spread_over_zeros(plateaus, stairs, fitted + errors[::2], coefficient, trend)
    u, dof = _lack_of_fit(stairs, solution, average, resolution_u)
    trends = [trend @ each.slope for each in both]
    scatter = [
        _trend_scatter(stairs, each, trend, _rms(its @ trend)) ** 2
        for each, its in zip(both, roundings, strict=True)
    ]
    trend_us = [
        math.sqrt(between(part, *scatter) + drift**2)
        for part, drift in ((known, hypotheses.drift), (0.0, hypotheses.steady_drift))
    ]
    moved, trend_u = either(changes, [between(known, *trends), trends[1]], trend_us)
    in_ripple = ripple / max(float(ripple @ ripple), TINY)
    require_dithered(stairs, solution.fit.residual)
    require_straight(stairs, solution.slope, solution.u, solution.fit.residual, solution.off_line)
    level, rising, falling = branches(stairs, solution.off_line)
    bent, bent_u = deflection(stairs)
    difference, hysteresis_u, hysteresis_dof = hysteresis(stairs, solution.off_line)
    return Slopes(
        # Single staircases differ from their mean; what the mean is, all hypotheses say.
        slope=solution.slope
        + (constant - float(np.mean(solution.slope)))
        + rise * (moved - trends[0]),
        first=solution.first,
        first_u=solution.first_u,
        zero=solution.fit.own[:, 1],
        zero_u=_scatter(stairs, solution.fit)[0]
        * np.linalg.norm(solution.fit.inverse[:, 1], axis=1),
        deflection=bent,
        deflection_u=bent_u,
        u=solution.u,
        dof=solution.dof,
        temperature=solution.temperature,
        rotor_angle=stairs.rotor_angle,
        heating=solution.heating,
        heating_u=solution.heating_u,
        heating_dof=solution.heating_dof,
        lasting_heating=loss_by_heat(hypotheses, *hidden),
        friction_u=math.hypot(u, hypotheses.spread) / constant,
        friction_dof=dof,
        friction_share=share,
        resolution_u=max(resolution_u, moved_u) / constant,
        rounding=rounding,
        trend_u=math.hypot(trend_u, trend_resolution_u),
        lag_u=abs(moved) * range_u,
        ripple_u=_trend_scatter(stairs, solution, in_ripple, 0.0) / abs(constant),
        transition=best.transition,
        exponent=best.exponent,
        time_constant=math.exp(float(probable @ np.log(tau))),
        level=level,
        rising=rising,
        falling=falling,
        hysteresis=difference,
        hysteresis_u=hysteresis_u,
        hysteresis_dof=hysteresis_dof,
    )


def _about(stairs: Stairs) -> float:
    """Return c of (1), 1/K, by lines through staircases: the drift within one is small."""
    degc = mean_of(stairs.temperature, stairs.weight)
    if np.ptp(degc) <= SAME_TEMPERATURE:
        return 0.0
    slope, middle = np.polyfit(degc - degc.mean(), lines_through(stairs, stairs.torque), 1).tolist()
    return float(slope / middle)


@dataclass(frozen=True)
class _Solution:
    """Solution of (1) for given s and tau; names as in `Slopes`, by plateau (m, p) the rest."""

    slope: Array
    first: Array
    first_u: Array
    u: Array
    dof: int
    temperature: Array
    heating: float
    heating_u: float
    heating_dof: float
    warmed: LeastSquares
    fit: LeastSquares
    off_line: Array


def _solve(
    stairs: Stairs,
    warm: tuple[Array, Array],
    friction: tuple[Array, ...],
    coefficient: float,
    rise: Array,
    *,
    steady: bool = False,
) -> _Solution:
    """Solve (1), linear in all that is left, for all staircases; arguments as in `columns_of`."""
    current, lost, own, shared = columns_of(
        stairs, warm, friction, coefficient, rise, steady=steady
    )
    warmed = LeastSquares(stairs.torque, [current, current * lost, *own], shared)
    loss, loss_u, loss_dof = heat_loss(stairs, warmed)
    current = current * (1 - loss * lost)
    bend, first, first_u, u, dof = _bend(stairs, current, own, shared)
    top = float(np.max(np.abs(current)))
    level = stairs.torque - bend[:, None] * current * np.abs(current)
    fit = LeastSquares(level, [current, *own], shared)
    share = float(np.mean(np.sum(fit.inverse[:, 0] * current * lost, axis=1)))
    slope = fit.own[:, 0] + top * bend
    return _Solution(
        slope=slope,
        first=first,
        first_u=first_u,
        u=u,
        dof=dof,
        temperature=mean_of(warm[1], stairs.weight),
        heating=loss * share,
        heating_u=loss_u * share,
        heating_dof=loss_dof,
        warmed=warmed,
        fit=fit,
        off_line=stairs.torque - current * slope[:, None] - stairs.weight * fit.own[:, 1:2],
    )


def _bend(
    stairs: Stairs, current: Array, own: list[Array], shared: list[Array]
) -> tuple[Array, Array, Array, Array, int]:
    """Return by how much each staircase is bent more than the mean of all (m,), N m/A2, the slopes
    where the current is small, their standard uncertainty by scatter, that of the slopes from zero
    to the largest current, and its degrees of freedom.

    Ripple that grows with the current bends a staircase, as i |i|, by an amount of each angle: it
    is no scatter. Over all angles it is zero on average.
    """
    curved, top = current * np.abs(current), float(np.max(np.abs(current)))
    bent = LeastSquares(stairs.torque, [current, curved, *own], shared)
    sigma, dof = _scatter(stairs, bent)
    first = sigma * np.sqrt(np.sum(bent.inverse[:, 0] ** 2, axis=1))
    inverse = np.linalg.pinv(np.stack([current, *own], axis=2))[:, 0]
    taken = np.sum(inverse * curved, axis=1)
    to_top = inverse + (top - taken)[:, None] * bent.inverse[:, 1]
    u = sigma * np.sqrt(np.sum(to_top**2, axis=1))
    return bent.own[:, 1] - bent.own[:, 1].mean(), bent.own[:, 0], first, u, dof


def _scatter(stairs: Stairs, fit: LeastSquares) -> tuple[float, int]:
    """Return by how much torques differ beyond what all staircases of a kind have in common, N m,
    and the degrees of freedom. What they have in common is lack of fit, stated on its own."""
    square, free = 0.0, 0.0
    for number in range(int(stairs.courses.kind.max()) + 1):
        those = stairs.courses.kind == number
        own = fit.residual[those] - fit.residual[those].mean(axis=0)
        square += float(np.sum(own**2))
        each = stairs.weight[those][0].sum() - fit.own.shape[1]
        free += (np.count_nonzero(those) - 1) * float(each)
    if free < 1:
        square = float(np.sum(fit.residual**2))
        free = max(float(stairs.weight.sum()) - fit.parameters, 1.0)
    return math.sqrt(square / free), int(free)


def _begins(stairs: Stairs, fit: LeastSquares) -> Array:
    """Return the friction with which each staircase begins, over the largest (m,)."""
    u = _scatter(stairs, fit)[0] * np.linalg.norm(fit.inverse[:, 2], axis=1)
    return begins_with(fit.own[:, 2], u, float(fit.shared[1]))


def _sizes(stairs: Stairs, both: tuple[_Solution, _Solution], trend: Array, rise: Array) -> Array:
    """Return the friction that moves the arm in each staircase, over the mean (m,): with the change
    that is likely, as it changes the path, too."""
    changing, steady = (each.fit for each in both)
    changes, known = friction_changes(stairs.weight, changing, steady, trend)
    change = changes * known * float(changing.shared[-1])
    sizes: Array = np.maximum(1 + change / max(float(steady.shared[1]), TINY) * rise, 0.0)
    return sizes if steady.shared[1] > 0 else np.ones(len(rise))


def _rms(values: Array) -> float:
    return math.sqrt(float(np.mean(values**2)))


def _lack_of_fit(
    stairs: Stairs, solution: _Solution, weight: Array, rounding_u: float
) -> tuple[float, float]:
    """Return the u that lack of fit gives a combination of slopes, N m/A, and its dof.

    `weight` (m,) combines the staircases, `rounding_u` N m/A is what the gauge's resolution gives.
    The common part of their residuals is correlated from plateau to plateau along the staircase, as
    the covariance assumes. What scatter of each staircase and resolution of the gauge explain is
    taken off: it is stated on its own.
    """
    fit = solution.fit
    combined = weight @ fit.residual
    used = np.mean(stairs.weight, axis=0) > 0
    independent = independent_samples(combined, used, 1)
    covariance, dof = long_run_covariance(fit.design, combined, independent)
    own = float(np.sum((weight * solution.u) ** 2)) + rounding_u**2
    return math.sqrt(max(float(covariance[0, 0]) - own, 0.0)), float(dof)


def _trend_scatter(stairs: Stairs, solution: _Solution, trend: Array, rounding_u: float) -> float:
    """Return the u that scatter gives a change of slopes with temperature, N m/(A K), or with the
    ripple, N m/A, as friction may change, too: beyond that of single slopes and the gauge's
    resolution, stated on their own.

    `trend` (m,) combines the staircases.
    """
    left, free = of_trend(stairs.weight, solution.fit, trend)
    single = left / free / max(float(trend @ trend), TINY)
    square = single * float(np.sum(solution.fit.response(trend) ** 2))
    own = float(np.sum((trend * solution.u) ** 2)) + rounding_u**2
    return math.sqrt(max(square - own, 0.0))
