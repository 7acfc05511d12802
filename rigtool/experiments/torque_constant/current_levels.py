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
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from rigtool.errors import InsufficientDataError
from rigtool.experiments.torque_constant.staircase_fit import SAME_TEMPERATURE
from rigtool.numerics.arrays import Array
from rigtool.numerics.checks import require_rising, require_signals
from rigtool.numerics.plateaus import find_plateaus
from rigtool.numerics.residual_covariance import independent_samples
from rigtool.quantity import REFERENCE_DEGC

MAX_BLOCKS = 2000
"""Most parts of a recording in which plateaus are looked for."""

FLAT_RANGE = 5.0
"""Standard deviations of noise within which the current does not change."""

MAX_PLATEAU_CHANGE = 0.02
"""Largest change of current on a plateau, relative to the span."""

FEWEST_PLATEAUS = 5
"""Fewer plateaus are no staircase."""

ON_PLATEAUS = 0.3
"""Smallest part of the time on plateaus of a staircase."""

MAX_ALONG = 0.1
"""Largest change along a plateau, in terms of the step to the next one."""

SETTLING_PART = 0.25
"""Part of each plateau that is left out at its start."""

RAMP_PARTS = 120
"""Parts of a ramp."""

MAGNET_COEFFICIENT = (-1.0e-3, 0.6e-3)
"""Temperature coefficient of magnets and its standard uncertainty, 1/K: from 0 for samarium cobalt
to -0.2 %/K for ferrite (J. R. Hendershot & T. J. E. Miller, Design of Brushless Permanent-Magnet
Machines, 2010, ch. 3), a rectangular distribution (GUM 4.3.7)."""

TRANSITION_LENGTHS = (0.01, 0.03, 0.1, 0.3)
"""Lengths s of Dahl's transition that are tried, relative to the span of the current."""

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
class Course:
    """Signals (n,) of a recording: s, A, N m; degC and rad/s where they are known."""

    time: Array
    current: Array
    torque: Array
    temperature: Array | None = None
    speed: Array | None = None


@dataclass(frozen=True, eq=False)
class Points:
    """Means of (n,) plateaus or parts of a ramp; `path` (n, s) is m of (1) for each transition."""

    current: Array
    torque: Array
    temperature: Array | None
    speed: Array | None
    path: Array
    ways: tuple[float, float]
    plateaus: bool


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


def find_points(course: Course) -> Points:
    """Return the means of a recording; `InsufficientDataError` where its current is constant."""
    signals = {"time": course.time, "current": course.current, "torque": course.torque}
    signals |= {
        name: values
        for name, values in (("temperature", course.temperature), ("speed", course.speed))
        if values is not None
    }
    t, current, _, *_ = require_signals(50, **signals)
    require_rising(t)
    blocks = min(MAX_BLOCKS, len(t) // 4)
    edges = np.linspace(0, len(t), blocks + 1).round().astype(np.int64)
    level = _means(current, edges)
    noise = float(np.sqrt(np.mean(np.diff(current, 2) ** 2) / 6 / (len(t) / blocks)))
    span = float(np.ptp(level))
    if span <= 10 * noise:
        raise InsufficientDataError(
            f"the current changes by {span:.3g} A, its noise is {noise:.2g} A: step it, or ramp it"
        )
    band = max(FLAT_RANGE * math.sqrt(2) * noise, 1e-3 * span)
    followed = _one_way(level, band)
    path = np.stack([_dahl(followed, part * span) for part in TRANSITION_LENGTHS], axis=1)
    way = np.diff(followed)
    up, down = float(way[way > 0].sum()), float(-way[way < 0].sum())
    parts = find_plateaus(level, max(band, 1e-4 * span), max(MAX_PLATEAU_CHANGE * span, 2 * band))
    on_them = sum(b - a for a, b in parts)
    stairs = len(parts) >= FEWEST_PLATEAUS and on_them >= ON_PLATEAUS * blocks
    if not stairs or not _steps(level, parts):
        ends = np.linspace(0, blocks, min(RAMP_PARTS, blocks) + 1).round().astype(np.int64)
        parts = list(pairwise(ends.tolist()))
        settled = False
    else:
        settled = True
        parts = [(a + math.ceil(SETTLING_PART * (b - a)), b) for a, b in parts]

    def mean(values: Array) -> Array:
        return np.array([values[edges[a] : edges[b]].mean() for a, b in parts])

    return Points(
        mean(current),
        mean(course.torque),
        None if course.temperature is None else mean(course.temperature),
        None if course.speed is None else mean(course.speed),
        np.stack([path[a:b].mean(axis=0) for a, b in parts]),
        (up, down),
        settled,
    )


def _steps(level: Array, parts: Sequence[tuple[int, int]]) -> bool:
    """Return whether a level (n,) changes between its parts, and not along them as on a ramp."""
    along = np.median([abs(level[b - 1] - level[a]) for a, b in parts])
    between = np.median(np.abs(np.diff([level[a:b].mean() for a, b in parts])))
    return bool(along <= MAX_ALONG * between)


def _means(values: Array, edges: NDArray[np.int64]) -> Array:
    means: Array = np.add.reduceat(values, edges[:-1]) / np.diff(edges)
    return means


def _one_way(values: Array, band: float) -> Array:
    """Return values (n,) that go one way between turns by more than a band.

    A turn is at the extreme itself, which later values show.
    """
    turns, way, high, low = [0], 0, 0, 0
    for index, value in enumerate(values.tolist()):
        high, low = (
            (index if value > values[high] else high),
            (index if value < values[low] else low),
        )
        if way >= 0 and values[high] - value > band:
            turns.append(high)
            way, low = -1, index
        elif way <= 0 and value - values[low] > band:
            turns.append(low)
            way, high = 1, index
    followed = values.copy()
    for start, stop in pairwise([*turns, len(values) - 1]):
        rises = values[stop] >= values[start]
        along = np.maximum if rises else np.minimum
        followed[start : stop + 1] = along.accumulate(values[start : stop + 1])
    return followed


def _dahl(values: Array, length: float) -> Array:
    """Return m of (1) along values (n,), 0 at their start."""
    state = np.zeros(len(values))
    for index, step in enumerate(np.diff(values).tolist()):
        way = math.copysign(1.0, step)
        state[index + 1] = way + (state[index] - way) * math.exp(-abs(step) / length)
    return state


# -- fit


def fit_constant(runs: Sequence[Points]) -> CurrentFit:
    """Fit (1) to the means of all runs, each with a zero of its own.

    Raises `InsufficientDataError` where they do not carry a constant.
    """
    current, torque = (
        np.concatenate([getattr(run, n) for run in runs]) for n in ("current", "torque")
    )
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
        part = (current - current.min()) / np.ptp(current)
        for half_waves in range(1, RIPPLE_WAVES + 1):
            for wave in (np.cos, np.sin):
                add("ripple", wave(np.pi * half_waves * part), RIPPLE * torques)
    if turning:
        fits = [_Fit(columns, torque)]
    else:
        states = np.concatenate([run.path for run in runs]).T
        fits = [
            _Fit([*columns, _Column("friction", state, 0.0, FRICTION * torques)], torque)
            for state in states
        ]
    return _result(fits, runs, middle, one_way=one_way and not turning, turning=turning)


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
        self.power = power + penalty * variance

    def estimate(self, parts: Mapping[str, float]) -> tuple[float, float]:
        """Return a sum of parameters with these factors, and its standard uncertainty."""
        factors = np.zeros(len(self.names))
        for name, factor in parts.items():
            factors[self.names.index(name)] = factor
        return float(factors @ self.found), math.sqrt(float(factors @ self.inverse @ factors))


def _result(
    fits: Sequence[_Fit], runs: Sequence[Points], middle: float, *, one_way: bool, turning: bool
) -> CurrentFit:
    power = np.array([fit.power for fit in fits])
    if not all(run.plateaus for run in runs):
        # A wrong model has fewer independent samples, as its residuals are correlated in time.
        power /= [fit.independent for fit in fits]
    best = fits[int(np.argmin(power))]
    torque, current = best.torque, best.design[:, 0]
    rms, span = math.sqrt(float(np.mean(best.residual**2))), float(np.ptp(torque))
    if rms > MAX_MISFIT * span:
        raise InsufficientDataError(
            f"torque follows current with residuals of {rms:.3g} N m rms, {MAX_MISFIT:.0%} of its "
            "span "
            f"of {span:.3g} N m is the limit: see to the units and to what else loads the shaft"
        )
    weight = (power / power.min()) ** (-best.independent / 2)
    weight /= weight.sum()

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
