"""Friction against speed: Coulomb and viscous, and the Stribeck effect where data resolve it.

For one direction, with speed v > 0 and torque f against the motion [7.1.2, 7.2.1, 7.2.2]:

    linear:    f = fc + fv v
    Stribeck:  f = fc + (fs - fc) exp(-(v/vs)^d) + fv v

(Armstrong-Helouvry, Dupont, Canudas de Wit, Automatica 30(7) 1083-1138, 1994). A shaft whose speed
swings about v shows the mean of f over these speeds, which `_columns` take. What both directions
have in common: `offset`.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from rigtool.errors import InsufficientDataError
from rigtool.experiments.friction.direction_fit import (
    DIRECTION_NAMES,
    DirectionFit,
    curve,
    peak,
    require_explained,
    require_no_fall,
)
from rigtool.numerics.arrays import TINY, Array
from rigtool.numerics.checks import require_signals
from rigtool.numerics.minimum import minimum

HOLD_REPEAT_TOLERANCE = 5e-3
"""Holds whose speeds differ by less than this part repeat one speed."""

DETERMINED_RATIO = 3.0
"""Multiple of its uncertainty above which a Stribeck parameter is determined."""

BUMP_SIGNIFICANCE = 2.0
"""Multiple of their uncertainty by which three speeds must show the Stribeck effect."""

OFF_THE_LINE = 3.0
"""Multiple of its scatter by which the lowest speed must miss the line to be left out."""

OTHER_VELOCITIES = 25
"""Number of Stribeck velocities that represent all those that the data may not resolve."""

FAR_BEYOND = 3.0
"""Multiple of the scatter of points from which on residuals are structure: scatter that is itself
uncertain leaves less, which the uncertainty of the fit includes."""

EXPONENT_LEADS = {2.0: 0.0, 1.0: 6.0}
"""Exponents d to try, each with the lead in the Akaike criterion that it needs: the Gaussian, and
Tustin's, which extrapolates further towards standstill and so must be clearly better."""

FEW_SPEEDS = 8
"""Number of speeds below which residuals hardly show their variance: models are weighed by the
uncertainties of the points. A curve of four parameters leaves seven points three residuals, and
the correction of the criterion, 60, would reject one that fits to a fiftieth of the line's."""

SWING_U = 0.2
"""Relative standard uncertainty of the variance of the speed within holds: what an inertia known to
a tenth leaves of it."""


class _Points(NamedTuple):
    """Friction at speeds, rising, of one direction; each (n,).

    `v` > 0 in rad/s; `f` against the motion, N m; `weight`, 1 over its standard uncertainty;
    `swing`, the standard deviation of the speed about v, rad/s.
    """

    v: Array
    f: Array
    weight: Array
    swing: Array

    def weighted(self, modelled: Array) -> Array:
        """Return what a model leaves of the friction, over its uncertainty, (n,)."""
        return (self.f - modelled) * self.weight

    def inverse(self, design: Array) -> Array:
        """Return the weighted pseudo-inverse (p, n) of the columns of a model (n, p)."""
        return np.asarray(np.linalg.pinv(design * self.weight[:, None]), dtype=np.float64)

    def solve(self, design: Array) -> Array:
        """Return the parameters (p,) of columns (n, p) with the least weighted squares."""
        scaled = design * self.weight[:, None]
        return np.asarray(np.linalg.lstsq(scaled, self.f * self.weight)[0], dtype=np.float64)


def fit_directions(
    speed: Array, torque: Array, u: Array, swing: Array | None = None
) -> dict[int, DirectionFit]:
    """Return the fit of each direction (+1, -1) that was held, from the means of holds (n,).

    `swing` is the standard deviation of the speed within each hold, rad/s; without it, zero.

    One law holds in both directions: where they prefer different ones, the one with the lowest sum
    of criteria is taken of those that both show, since parameters of two models have no mean. A
    direction that shows a Stribeck effect alone does so by its noise, which makes the effect wider
    and lower: curves as narrow and high as they are seem less determined. Raises
    `InsufficientDataError` where a direction cannot be fitted.
    """
    swing = np.zeros_like(speed) if swing is None else swing
    holds = speed, torque, u, swing
    fits = _by_direction(*holds, EXPONENT_LEADS)
    if len(_laws(fits)) > 1:
        unchosen = dict.fromkeys(EXPONENT_LEADS, math.inf)
        shapes = [unchosen, *({exponent: lead} for exponent, lead in EXPONENT_LEADS.items())]
        common = [_by_direction(*holds, each) for each in shapes]
        fits = min(
            (found for found in common if len(_laws(found)) == 1),
            key=lambda found: sum(fit.criterion for fit in found.values()),
        )
    require_explained(list(fits.values()))
    return fits


def _laws(fits: Mapping[int, DirectionFit]) -> set[float | None]:
    return {fit.exponent for fit in fits.values()}


def _by_direction(
    speed: Array, torque: Array, u: Array, swing: Array, shapes: Mapping[float, float]
) -> dict[int, DirectionFit]:
    fits, reasons = {}, []
    for sign in DIRECTION_NAMES:
        chosen = speed * sign > 0
        if not chosen.any():
            continue
        signals = speed[chosen] * sign, torque[chosen] * sign, u[chosen]
        try:
            fits[sign] = fit_direction(*signals, shapes, swing[chosen])
        except InsufficientDataError as error:
            reasons.append(f"{DIRECTION_NAMES[sign]} direction: {error}")
    if reasons or not fits:
        raise InsufficientDataError("; ".join(reasons) or "no speed but zero was held")
    return fits


def fit_direction(
    speed: Array,
    torque: Array,
    u: Array,
    shapes: Mapping[float, float] = EXPONENT_LEADS,
    swing: Array | None = None,
) -> DirectionFit:
    """Fit friction in one direction by weighted least squares.

    `speed` (n,) > 0 in rad/s, `torque` (n,) against the motion with standard uncertainty `u`, N m;
    `shapes` are the exponents to try, with the lead that each needs; `swing` (n,) is the standard
    deviation of the speed in each point, rad/s, zero without it.
    The Stribeck model is chosen only where the Akaike criterion (corrected: Hurvich and Tsai 1989)
    prefers it and all its parameters are determined; else the line is fitted, without the lowest
    speeds where they lie off it. A curve that fits best without being determined rules out others
    that are: their parameters would be those of the wrong law. Raises `InsufficientDataError` where
    there are too few speeds.
    """
    speed, torque, u = require_signals(1, speed=speed, torque=torque, u=u)
    v, f, scatter = mean_by_speed(speed, torque, u)
    s = mean_by_speed(speed, np.zeros_like(speed) if swing is None else swing, u)[1]
    if len(v) < 3 or v.max() < 2 * v.min():
        held = (
            f"one speed, {v[0]:.3g} rad/s, does"
            if len(v) == 1
            else f"{len(v)} speeds from {v.min():.3g} to {v.max():.3g} rad/s do"
        )
        raise InsufficientDataError(
            f"{held} not separate Coulomb and viscous friction: measure 3 speeds or more over a "
            "factor of 2 or more"
        )
    # Uncertainties from few degrees of freedom are uncertain themselves: weigh in the median.
    points = _Points(v, f, 1 / np.sqrt((scatter**2 + np.median(scatter) ** 2) / 2 + 1e-30), s)
    best = line = _line(points)
    lowest, needed = _criterion(best, points), 0.0
    fitted = {exponent: _curve(points, exponent) for exponent in shapes}
    curves = {
        exponent: fit if fit is not None and _determined(fit, points) else None
        for exponent, fit in fitted.items()
    }
    for exponent, candidate in fitted.items():
        if candidate is not None:
            criterion = _criterion(candidate, points)
            if criterion + shapes[exponent] < lowest:
                best, lowest, needed = candidate, criterion, shapes[exponent]
    if best.exponent is None or curves[best.exponent] is None:
        lowest, needed = _criterion(line, points), 0.0
        best = _straight_part(points)
        require_no_fall(best)
    averaged, own = _averaged(best, curves, points)
    covariance = best.covariance.copy()
    covariance[:2, :2] = own
    return replace(best, averaged=averaged, covariance=covariance, criterion=lowest + needed)


def _averaged(
    chosen: DirectionFit, curves: Mapping[float, DirectionFit | None], points: _Points
) -> tuple[Array, Array]:
    """Return fc and fv (2,) and their covariance (2, 2), that of each model and between them.

    They are those of a chosen Stribeck curve; where the line is chosen, the mean over all models: a
    line through an unresolved Stribeck effect has less slope than the friction, never more.

    The line, and Stribeck curves by exponent: the determined one, or those of all velocities. Each
    has its Akaike weight, half of which is the line's before the data speak (Burnham and Anderson,
    Model Selection and Multimodel Inference, 2nd ed., 2002, sections 4.2 and 4.3): data that do not
    resolve a Stribeck effect do not show that there is none. Points that the line leaves out count
    as its parameters.
    """
    v = points.v
    line = _straight_part(points)
    left_out = v < line.lowest
    few = len(v) < FEW_SPEEDS
    of_line = points.weighted(line.evaluate(v)) * ~left_out
    criteria = [_akaike(of_line, 2 + int(left_out.sum()), known=few)]
    parameters, covariances, prior = [line.parameters[:2]], [line.covariance[:2, :2]], [0.5]

    def add(found: Array, covariance: Array, criterion: float, share: float) -> None:
        parameters.append(found[:2])
        covariances.append(covariance[:2, :2])
        criteria.append(criterion)
        prior.append(0.5 / len(curves) * share)

    velocities = np.geomspace(v.min() / 3, v.max() / 3, OTHER_VELOCITIES)
    for exponent, resolved in curves.items():
        if resolved is not None:
            rest = points.weighted(resolved.evaluate(v, points.swing))
            add(resolved.parameters, resolved.covariance, _akaike(rest, 4, known=few), 1.0)
            continue
        for vs in velocities:
            design = _columns(points, vs, exponent)
            found = points.solve(design)
            if found[2] >= found[0]:
                inverse, rest = points.inverse(design), points.weighted(design @ found)
                scale = max(1.0, float(rest @ rest) / max(len(v) - 3, 1))
                criterion = _akaike(rest, 3, known=few)
                add(found, inverse @ inverse.T * scale, criterion, 1 / len(velocities))
    probable = np.array(prior) * np.exp((min(criteria) - np.array(criteria)) / 2)
    probable /= probable.sum()
    line_chosen = chosen.exponent is None
    stated = probable @ np.array(parameters) if line_chosen else chosen.parameters[:2]
    apart = np.array(parameters) - stated
    between = np.einsum("k,ki,kj->ij", probable, apart, apart)
    return stated, np.einsum("k,kij->ij", probable, np.array(covariances)) + between


def mean_by_speed(v: Array, f: Array, u: Array) -> tuple[Array, Array, Array]:
    """Return speed, mean of f and its uncertainty for each distinct speed, rising, (k,)."""
    order = np.argsort(v, kind="stable")
    v, f, weight = v[order], f[order], 1 / np.maximum(u[order], 1e-15) ** 2
    group = np.concatenate([[0], np.cumsum(np.diff(v) > HOLD_REPEAT_TOLERANCE * v[1:])])
    count, total = np.bincount(group), np.bincount(group, weights=weight)
    mean = np.bincount(group, weights=weight * f) / total
    square = np.bincount(group, weights=weight * (f - mean[group]) ** 2)
    # Scatter of repeats counts where it exceeds their uncertainties (Birge ratio).
    scale = np.maximum(square / np.maximum(count - 1, 1), 1.0)
    return np.bincount(group, weights=weight * v) / total, mean, np.sqrt(scale / total)


def _finish(
    parameters: Array, design: Array, points: _Points, exponent: float | None
) -> DirectionFit:
    """Return a fit with covariance from its Jacobian `design` (n, p)."""
    v, f, weight, swing = points
    inverse = points.inverse(design)
    residual = f - curve(parameters, v, exponent, swing)
    dof = len(v) - len(parameters)
    square = float(np.sum((residual * weight) ** 2))
    # Scatter counts where it exceeds the uncertainties of the means (Birge ratio).
    scale = max(1.0, square / dof) if dof > 0 else 1.0
    excess = np.mean(residual**2) * len(v) / max(dof, 1) - np.mean((FAR_BEYOND / weight) ** 2)
    return DirectionFit(
        parameters=parameters,
        averaged=parameters[:2],
        covariance=inverse @ inverse.T * scale,
        exponent=exponent,
        dof=dof,
        lowest=float(v.min()),
        highest=float(v.max()),
        structure=math.sqrt(max(0.0, float(excess))),
        worst_speed=float(v[np.argmax(np.abs(residual))]),
        friction=float(np.mean(f)),
    )


def _line(points: _Points) -> DirectionFit:
    design = np.column_stack([np.ones(len(points.v)), points.v])
    return _finish(points.solve(design), design, points, None)


def _straight_part(points: _Points) -> DirectionFit:
    """Fit a line, leaving the lowest speeds out one by one while they lie off it."""
    while len(points.v) > 4 and points.v[-1] >= 2 * points.v[1]:
        faster = _Points(*(each[1:] for each in points))
        rest = _line(faster)
        design = np.array([1.0, points.v[0]])
        u = math.sqrt(1 / points.weight[0] ** 2 + float(design @ rest.covariance @ design))
        if abs(points.f[0] - rest.evaluate(points.v[:1])[0]) <= OFF_THE_LINE * u:
            break
        points = faster
    return _line(points)


def _curve(points: _Points, exponent: float) -> DirectionFit | None:
    """Fit the Stribeck model; None for fewer than six speeds."""
    v, _, weight, swing = points
    if len(v) < 6:
        return None

    def misfit(vs: float) -> float:
        design = _columns(points, vs, exponent)
        return float(np.sum(points.weighted(design @ points.solve(design)) ** 2))

    # The model is linear in all parameters but vs.
    vs = minimum(misfit, v.min() / 3, v.max() / 3)
    coulomb, viscous, static = points.solve(_columns(points, vs, exponent))
    slope = (static - coulomb) * peak(v, vs, exponent, swing)[1]
    design = np.column_stack([_columns(points, vs, exponent), slope])
    parameters = np.array([coulomb, viscous, static, vs])
    fit = _finish(parameters, design, points, exponent)
    # All holds swing in the same loop: an error of the variance is common to them.
    by_swing = fit.evaluate(v, swing) - fit.evaluate(v)
    shift = SWING_U * points.inverse(design) @ (by_swing * weight)
    covariance = fit.covariance + np.outer(shift, shift)
    return replace(fit, covariance=covariance)


def _determined(fit: DirectionFit, points: _Points) -> bool:
    """Return whether the data determine the parameters of a Stribeck curve."""
    v, _, weight, swing = points
    coulomb, _, static, vs = fit.parameters
    covariance = fit.covariance
    bump = (static - coulomb) * peak(v, vs, fit.exponent or 0.0, swing)[0]
    rise_u = math.sqrt(covariance[0, 0] + covariance[2, 2] - 2 * covariance[0, 2])
    return bool(
        static - coulomb > DETERMINED_RATIO * rise_u
        and vs > DETERMINED_RATIO * math.sqrt(covariance[3, 3])
        and 1.1 * v.min() / 3 < vs < v.max() / 3 / 1.1
        and np.count_nonzero(bump * weight > BUMP_SIGNIFICANCE) >= 3
    )


def _columns(points: _Points, vs: float, exponent: float) -> Array:
    """Return the columns (n, 3) of fc, fv and fs in a Stribeck curve of this velocity."""
    bump, _ = peak(points.v, vs, exponent, points.swing)
    return np.column_stack([1 - bump, points.v, bump])


def _akaike(residual: Array, parameters: int, *, known: bool) -> float:
    """Return the Akaike criterion for the variance that is stated, one, if it is `known`; else the
    corrected one for an unknown variance, which counts as a parameter."""
    n, k, square = len(residual), parameters + 1, float(residual @ residual)
    if known:
        return square + 2 * parameters
    return n * math.log(max(square / n, TINY)) + 2 * k + 2 * k * (k + 1) / max(n - k - 1, 1)


def _criterion(fit: DirectionFit, points: _Points) -> float:
    residual = points.weighted(fit.evaluate(points.v, points.swing))
    return _akaike(residual, len(fit.parameters), known=len(residual) < FEW_SPEEDS)
