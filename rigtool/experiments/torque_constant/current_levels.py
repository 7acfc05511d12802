"""Torque constant from any slow course of current against a torque sensor: plateaus, or ramps.

    torque = z + k i (1 + c (T - T0)) + q i (|i| - I/2) + h m + fv w + fc sign(w) + d sign(i)  (1)

i is the current, I its largest, z the zero of each recording, T the temperature. A shaft at rest
has friction h whose state m follows the way that the current goes (P. R. Dahl, AIAA J. 14(12)
1675-1682, 1976):

    dm = (sign(di) - m) |di| / s

A turning shaft has friction by its speed w instead; where the speed is not recorded and the current
has both signs, the shaft may turn with its torque, and friction d follows the current. (1) is
fitted to means: of each plateau, which counts as one observation, or of equal parts of a ramp,
whose residuals are correlated in time.

Friction, curvature q, c, and a drift of the sensor's zero over the recording have prior sizes,
typical of motors and sensors (`FRICTION` and so on). These sizes limit what the data do not
separate from k, and u of k includes it. The data weight the lengths s by their likelihood.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from rigtool.errors import InsufficientDataError
from rigtool.experiments.torque_constant.current_points import Points
from rigtool.experiments.torque_constant.staircases.model import SAME_TEMPERATURE
from rigtool.numerics.arrays import Array, joined
from rigtool.numerics.residual_covariance import independent_samples
from rigtool.quantity import REFERENCE_DEGC

MAGNET_COEFFICIENT = (-1.0e-3, 0.6e-3)
"""Temperature coefficient of magnets and its standard uncertainty, 1/K: from 0 for samarium cobalt
to -0.2 %/K for ferrite (J. R. Hendershot & T. J. E. Miller, Design of Brushless Permanent-Magnet
Machines, 2010, ch. 3), a rectangular distribution (GUM 4.3.7)."""

SHORTEST_TRANSITION, LONGEST_TRANSITION, TRANSITIONS = 0.005, 1.0, 24
"""Lengths s of the transition that are tried, relative to the span of the current."""

FINER_GRIDS, FINER_LENGTHS = 3, 9
"""Grids of lengths, each around the best of the one before: precise data need them."""

FRICTION, DRIFT, BENT, RIPPLE, CURVATURE = 0.05, 0.01, 0.004, 0.002, 0.015
"""Prior sizes: of h, of a straight and a bent drift, and of each wave of ripple, relative to the
span of the torque; of the change of torque per ampere from half the current to all of it, by
saturation of the iron."""

RIPPLE_WAVES = 4
"""Half waves of ripple over the span of the current of a ramp: its torque twists the shaft, which
turns through ripple. Shorter ones are scatter."""

NO_CURRENT = 0.02
"""Currents below this part of the largest turn no shaft."""

WEIGHTING_ROUNDS = 8
"""Of the fit: its weights follow its residuals."""

BOTH_WAYS = 0.1
"""Smallest part of the current's way in either direction for which friction at rest is known."""

TURNING_PART = 0.5
"""Part of the samples that move from which on the shaft turns."""

FEWEST_FREE = 3
"""Smallest number of independent plateaus beyond constant, zeros and drag."""

MAX_MISFIT = 0.1
"""Largest rms of the residuals, relative to the span of the torque."""


@dataclass(frozen=True, eq=False)
class CurrentFit:
    """k of (1) at `temperature` degC (NaN where unknown), with standard uncertainties.

    `curvature_u` is the relative standard uncertainty of one constant for all currents up to the
    largest. `reference` is k at 20 degC and `coefficient` c relative to it, None where the
    temperature does not change. `hysteresis` is 2 h, None for a shaft that turns or a current that
    goes one way. `measured` and `model` (n,) in N m, without zeros.
    """

    constant: float
    constant_u: float
    dof: float
    curvature_u: float
    temperature: float
    reference: tuple[float, float] | None
    coefficient: tuple[float, float] | None
    hysteresis: tuple[float, float] | None
    current: Array
    measured: Array
    model: Array
    plateaus: bool
    one_way: bool
    turning: bool


def fit_constant(runs: Sequence[Points]) -> CurrentFit:
    """Fit (1) to the means of all runs, each with a zero of its own.

    Raises `InsufficientDataError` where they do not carry a constant.
    """
    current, torque = joined(runs, "current", "torque")
    zeros = np.repeat(np.eye(len(runs)), [len(run.current) for run in runs], axis=0)
    temperature = _of_all(runs, "temperature")
    speed = _of_all(runs, "speed")
    turning = speed is not None and bool(
        np.mean(np.abs(speed) > 0.01 * np.abs(speed).max()) > TURNING_PART
    )
    up, down = (sum(run.ways[way] for run in runs) for way in (0, 1))
    one_way = min(up, down) < BOTH_WAYS * (up + down)
    columns = [_Column("constant", current), *(_Column("zero", zero) for zero in zeros.T)]

    def add(name: str, values: Array, size: float = math.inf, mean: float = 0.0) -> None:
        columns.append(_Column(name, values, mean, size))

    middle = math.nan
    if temperature is not None:
        middle = float((temperature.min() + temperature.max()) / 2)
        if np.ptp(temperature) > SAME_TEMPERATURE:
            rough = float(np.polyfit(current, torque, 1)[0])
            values = current * (temperature - middle)
            add("change", values, abs(MAGNET_COEFFICIENT[1] * rough), MAGNET_COEFFICIENT[0] * rough)
    if turning and speed is not None:
        for values in (speed, np.sign(speed)):
            if np.ptp(values) > 0.05 * np.abs(values).max():
                add("drag", values)
    free = len(torque) - sum(math.isinf(column.size) for column in columns)
    if free < FEWEST_FREE:
        raise InsufficientDataError(
            f"{len(torque)} plateaus do not carry a torque constant, {FEWEST_FREE - free} more are "
            "needed: hold more levels of current"
        )
    top = float(np.abs(current).max())
    torques = float(np.ptp(torque))
    add(
        "curvature",
        current * (np.abs(current) - top / 2),
        CURVATURE * torques / np.ptp(current) * 2 / top,
    )
    course = np.concatenate([np.linspace(-1, 1, len(run.current)) for run in runs])
    add("drift", course, DRIFT * torques)
    # A staircase up and down is alike in time to a drift that turns back.
    add("bend", 1.5 * course**2 - 0.5, BENT * torques)
    way = np.sign(np.where(np.abs(current) > NO_CURRENT * top, current, 0.0))
    if speed is None and np.ptp(way) > 1:
        add("driven", way, FRICTION * torques)  # a motor that drives a brake turns with its torque
    if not turning and not all(run.plateaus for run in runs):
        part = current / np.ptp(current)  # cosine and sine together have any phase
        for half_waves in range(1, RIPPLE_WAVES + 1):
            for wave in (np.cos, np.sin):
                add("ripple", wave(np.pi * half_waves * part), RIPPLE * torques)
    if turning:
        fits, volume = [_Fit(columns, torque)], np.ones(1)
    else:
        fits, volume = _fits_with_friction(columns, torque, runs)
    weight = _probability(fits, volume)
    return _result(fits, weight, runs, middle, one_way=one_way and not turning, turning=turning)


def _fits_with_friction(
    columns: Sequence[_Column], torque: Array, runs: Sequence[Points]
) -> tuple[list[_Fit], Array]:
    """Return a fit for each length of the transition, and the range of its logarithm."""
    size, span = FRICTION * float(np.ptp(torque)), float(np.ptp(columns[0].values))
    place = np.repeat(np.arange(len(runs)), [len(run.current) for run in runs])

    def fitted(lengths: Array) -> list[_Fit]:
        each = [run.states(lengths * span) for run in runs]
        first, kept = (np.concatenate(part, axis=1) for part in zip(*each, strict=True))
        return [
            _Fit(
                [
                    *columns,
                    _Column("friction", state, 0.0, size),
                    *(_Column("start", left * (place == k), 0.0, size) for k in range(len(runs))),
                ],
                torque,
            )
            for state, left in zip(first, kept, strict=True)
        ]

    lengths = np.geomspace(SHORTEST_TRANSITION, LONGEST_TRANSITION, TRANSITIONS)
    fits = fitted(lengths)
    for _ in range(FINER_GRIDS):
        best = int(np.argmin([fit.misfit for fit in fits]))
        ends = lengths[max(best - 1, 0)], lengths[min(best + 1, len(lengths) - 1)]
        new = np.setdiff1d(np.geomspace(*ends, FINER_LENGTHS), lengths)
        order = np.argsort(np.concatenate([lengths, new]))
        both = [*fits, *fitted(new)]
        fits, lengths = [both[k] for k in order], np.concatenate([lengths, new])[order]
    return fits, np.gradient(np.log(lengths))


def _probability(fits: Sequence[_Fit], volume: Array) -> Array:
    """Return the probability of each fit, p = Q^(-n/2) over n independent residuals."""
    misfit = np.array([fit.misfit for fit in fits])
    best = fits[int(np.argmin(misfit))]
    weight = volume * (misfit / misfit.min()) ** (-best.independent / 2)
    return weight / weight.sum()


@dataclass(frozen=True, eq=False)
class _Column:
    """A function of (1) at the points (n,), with the prior mean and size of its factor."""

    name: str
    values: Array
    mean: float = 0.0
    size: float = math.inf


class _Fit:
    """Least squares on columns of (1), with the prior sizes as further observations."""

    def __init__(self, columns: Sequence[_Column], torque: Array) -> None:
        self.names = [column.name for column in columns]
        self.design = np.column_stack([column.values for column in columns])
        self.torque = torque
        prior = np.array([column.size**-2 for column in columns])
        mean = np.array([column.mean for column in columns])
        normal = self.design.T @ self.design
        self.independent, variance = float(len(torque)), float(np.var(torque)) * 1e-4
        free = 0.0
        for _ in range(WEIGHTING_ROUNDS):
            share = self.independent / len(torque)
            self.inverse = np.linalg.pinv(
                share / variance * normal + np.diag(prior), hermitian=True
            )
            self.found = self.inverse @ (share / variance * self.design.T @ torque + prior * mean)
            self.residual = torque - self.design @ self.found
            everywhere = np.full(len(torque), True)
            known = np.count_nonzero(prior == 0)
            least = float(known + FEWEST_FREE)
            self.independent = max(independent_samples(self.residual, everywhere, 1), least)
            penalty = float(prior @ (self.found - mean) ** 2)
            free = self.independent - known
            power = float(np.mean(self.residual**2)) * self.independent
            variance = max((power + penalty * variance) / free, 1e-12 * float(np.var(torque)))
        self.free, self.variance = free, variance
        # A wrong model has fewer independent residuals, as they are correlated in time.
        self.misfit = (power + penalty * variance) / self.independent

    def estimate(self, parts: Mapping[str, float]) -> tuple[float, float]:
        """Return a sum of parameters with these factors, and its standard uncertainty."""
        factors = np.zeros(len(self.names))
        for name, factor in parts.items():
            factors[self.names.index(name)] = factor
        return float(factors @ self.found), math.sqrt(float(factors @ self.inverse @ factors))


def _result(
    fits: Sequence[_Fit],
    weight: Array,
    runs: Sequence[Points],
    middle: float,
    *,
    one_way: bool,
    turning: bool,
) -> CurrentFit:
    best = fits[int(np.argmin([fit.misfit for fit in fits]))]
    torque, current = best.torque, best.design[:, 0]
    rms, span = math.sqrt(float(np.mean(best.residual**2))), float(np.ptp(torque))
    if rms > MAX_MISFIT * span:
        raise InsufficientDataError(
            f"torque follows current with residuals of {rms:.3g} N m rms, {100 * MAX_MISFIT:.0f} % "
            "of its span "
            f"of {span:.3g} N m is the limit: see to the units and to what else loads the shaft"
        )

    def mean(**parts: float) -> tuple[float, float]:
        """Return a sum of parameters and its u over the lengths of the transition."""
        value, u = np.array([fit.estimate(parts) for fit in fits]).T
        middle = float(weight @ value)
        return middle, math.sqrt(float(weight @ (u**2 + (value - middle) ** 2)))

    constant, u = mean(constant=1.0)
    if constant <= 0:
        raise InsufficientDataError(
            f"torque falls with current, by {constant:.3g} N m/A: correct a sign in the mapping"
        )
    coefficient = reference = hysteresis = None
    if "change" in best.names:
        reference = mean(constant=1.0, change=REFERENCE_DEGC - middle)
        change, change_u = mean(change=1.0)
        coefficient = change / reference[0], change_u / reference[0]
    if "friction" in best.names and not one_way:
        friction, friction_u = mean(friction=1.0)
        hysteresis = 2 * abs(friction), 2 * friction_u
    curved = math.hypot(*mean(curvature=1.0)) * float(np.abs(current).max()) / 2
    rest = best.design[:, 1 : 1 + len(runs)] @ best.found[1 : 1 + len(runs)]
    return CurrentFit(
        constant=constant,
        constant_u=u,
        dof=best.free,
        curvature_u=curved / constant / math.sqrt(3),
        temperature=middle,
        reference=reference,
        coefficient=coefficient,
        hysteresis=hysteresis,
        current=current,
        measured=torque - rest,
        model=torque - rest - best.residual,
        plateaus=all(run.plateaus for run in runs),
        one_way=one_way,
        turning=turning,
    )


def _of_all(runs: Sequence[Points], name: str) -> Array | None:
    """Return a signal of all runs, None where one lacks it."""
    parts = [getattr(run, name) for run in runs]
    return None if any(part is None for part in parts) else np.concatenate(parts)
