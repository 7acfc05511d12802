"""Model of a staircase of current against a force gauge: friction, heat in the winding [7.1.1].

With the shaft clamped by an elastic arm, the gauge torque on plateau j is

    torque_j = k i_j (1 - g w_j) (1 + c (T_j - T)) + o - f z_j                         (1)

k is the torque constant at the staircase's mean temperature T, i the measured current, o a
constant. z in -1..1 is the state of the shaft's friction: the arm yields very little, in proportion
to the gauge's torque, so friction does not slide freely but changes over a transition of s N m,
along each swing of the arm (`rigtool.experiments.torque_constant.swings`). Without z the slope
would be too low by up to a part f/s.
w = integral of i2 R/R20 exp(-t/tau) dt is the heat in the winding (R/R20 for copper), which a
sensor on the housing does not show, and g the relative loss of torque constant by it; T_j is the
housing's temperature with the lag of the winding, tau, and c the relative coefficient of the torque
constant. s and tau are common to all staircases and come from the data; (1) is linear in all other
parameters.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np

from rigtool.errors import InsufficientDataError
from rigtool.experiments.torque_constant.staircase import Plateaus
from rigtool.experiments.torque_constant.swings import (
    Courses,
    friction_state,
    mean_courses,
    path,
    straight_path,
)
from rigtool.numerics.arrays import Array
from rigtool.numerics.minimum import minimum

SHORTEST_TIME_CONSTANT, LONGEST_TIME_CONSTANT = 2.0, 300.0
"""Range in which the winding's thermal time constant tau is searched, s."""

START_TIME_CONSTANT = 30.0
"""Where the search for tau begins, s."""

COPPER = 3.93e-3
"""Temperature coefficient of a copper winding's resistance at 20 degC, 1/K (IEC 60028)."""

FITTED_STAIRCASES = 96
"""Largest number of staircases, spread over all, from which s and tau are found."""

FRICTION_SIGNIFICANCE = 1e-3
"""Probability below which friction shows in the data."""


@dataclass(frozen=True)
class Stairs:
    """Plateaus by staircase, (m, p); shorter staircases end in plateaus without weight."""

    setpoint: Array
    current: Array
    torque: Array
    temperature: Array
    begin: Array
    end: Array
    weight: Array  # 1, or 0 where a staircase has ended
    rotor_angle: Array  # (m,)
    courses: Courses

    def taken(self, every: int) -> Stairs:
        """Return every so many of the staircases; the courses stay those of all."""
        values = {n: v[::every] for n, v in vars(self).items() if n != "courses"}
        kind, scale = self.courses.kind[::every], self.courses.scale[::every]
        courses = replace(self.courses, kind=kind, scale=scale)
        return Stairs(**values, courses=courses)


@dataclass(frozen=True)
class Common:
    """Parameters that all staircases share, and the misfit that they leave.

    `transition` is s in N m, None without friction; `lag` that of the arm's swings, s, None where
    friction follows straight steps; `time_constant` is tau, s.
    """

    transition: float | None
    lag: float | None
    time_constant: float
    square_misfit: float
    dof: int


def arrange(plateaus: Plateaus) -> Stairs:
    """Return the plateaus by staircase.

    Raises `InsufficientDataError` where one does not separate friction from slope.
    """
    length = np.bincount(plateaus.staircase)
    first = np.concatenate([[0], np.cumsum(length)[:-1]])
    place = np.minimum(np.arange(length.max())[None, :], length[:, None] - 1) + first[:, None]
    weight = np.where(np.arange(length.max())[None, :] < length[:, None], 1.0, 0.0)
    setpoint = plateaus.current_setpoint[place]
    steps = np.diff(setpoint, axis=1)
    fewest = np.minimum(np.sum(steps > 0, axis=1), np.sum(steps < 0, axis=1))
    if (worst := int(np.argmin(fewest))) >= 0 and fewest[worst] < 3:
        raise InsufficientDataError(
            f"staircase {worst} has {fewest[worst]} steps in one of its directions, 3 up and 3 "
            "down are needed to separate friction from the torque constant: run it up and down"
        )
    begin, end = plateaus.begin[place], plateaus.end[place]
    torque = plateaus.torque[place]
    return Stairs(
        setpoint=setpoint,
        current=plateaus.current[place] * weight,
        torque=torque * weight,
        temperature=plateaus.temperature[place],
        begin=np.where(weight > 0, begin, end),
        end=end,
        weight=weight,
        rotor_angle=plateaus.rotor_angle[first],
        courses=mean_courses(setpoint, torque, plateaus.course[place], end - begin),
    )


def mean_of(values: Array, weight: Array) -> Array:
    """Return the weighted mean of each staircase (m,) of values (m, p)."""
    mean: Array = np.sum(values * weight, axis=1) / np.sum(weight, axis=1)
    return mean


def winding(stairs: Stairs, time_constant: float) -> tuple[Array, Array]:
    """Return w of (1), A2 s, and the housing's temperature with the winding's lag, degC, (m, p).

    Both hold for the middle of each plateau. Between staircases no current flows, and the winding
    approaches the housing.
    """
    decay = np.exp(-(stairs.end - stairs.begin) / time_constant)
    idle = np.ones(decay.shape)
    idle[:, 1:] = np.exp(-(stairs.begin[:, 1:] - stairs.end[:, :-1]) / time_constant)
    change = np.diff(stairs.temperature, axis=1, prepend=stairs.temperature[:, :1])
    power = stairs.current**2 * (1 + COPPER * (stairs.temperature - 20))
    before, after = np.empty(decay.shape), np.empty(decay.shape)
    lag = np.empty(decay.shape)
    stored, behind = np.zeros(len(decay)), np.zeros(len(decay))
    for j in range(decay.shape[1]):
        before[:, j] = stored * idle[:, j]
        gained = power[:, j] * time_constant * (1 - decay[:, j])
        stored = before[:, j] * decay[:, j] + gained
        after[:, j] = stored
        behind = behind * idle[:, j] * decay[:, j] - change[:, j] * np.sqrt(decay[:, j])
        lag[:, j] = behind
    # Heat left over from the staircase before
    ended = stairs.end[:-1, -1]
    fades = np.exp(-(ended - stairs.begin[:-1, 0]) / time_constant)
    pauses = np.exp(-(stairs.begin[1:, 0] - ended) / time_constant)
    left = [0.0]
    for held, fade, pause in zip(after[:-1, -1], fades, pauses, strict=True):
        left.append(float((held + left[-1] * fade) * pause))
    middle = (stairs.begin + stairs.end) / 2 - stairs.begin[:, :1]
    heat = (before + after) / 2 + np.array(left)[:, None] * np.exp(-middle / time_constant)
    return heat, stairs.temperature + lag


def design_matrix(stairs: Stairs, common: Common, current: Array) -> Array:
    """Return the columns of (1) for staircases (m, p): (m, p, 2) without friction, or (m, p, 4)."""
    return np.stack([current, stairs.weight, *friction_columns(stairs, common)], axis=2)


def friction_columns(stairs: Stairs, common: Common) -> tuple[Array, ...]:
    """Return the columns of (1) for friction, two of (m, p), or none."""
    if common.transition is None:
        return ()
    courses = stairs.courses
    swings = straight_path(courses) if common.lag is None else path(courses, common.lag)
    a, b = friction_state(courses.of_each(swings), common.transition)
    return -a * stairs.weight, -b * stairs.weight


def fit_common(stairs: Stairs, coefficient: float, *, swings: bool) -> Common:
    """Return what all staircases share, by variable projection; `coefficient` is c of (1), 1/K.

    With `swings` friction follows the arm along its swings, else along straight steps. Of more than
    `FITTED_STAIRCASES` staircases, that many are used, spread evenly over all. An additional column
    i |i| absorbs the amplifier's ripple at one rotor angle, which would otherwise look like heat.
    Raises `InsufficientDataError` where the plateaus leave no degrees of freedom.
    """
    from scipy.optimize import Bounds, minimize
    from scipy.special import fdtrc

    taken = _Taken(stairs, coefficient)
    dof = int(taken.stairs.weight.sum()) - 6 * len(taken.stairs.setpoint)
    if dof < 1:
        raise InsufficientDataError(
            f"{int(taken.stairs.weight.sum())} plateaus in {len(taken.stairs.setpoint)} staircases "
            "leave no degree of freedom to the fit: use more steps"
        )
    low, high = _ranges(stairs, swings)
    begin = _start(taken, low, high)

    # The path has turns that appear and vanish with the lag: a search without derivatives.
    def square(logarithms: Array) -> float:
        return float(np.sum(taken.residual(_common(logarithms)) ** 2))

    found = minimize(
        square,
        begin,
        method="Nelder-Mead",
        bounds=Bounds(low, high),
        options={"xatol": 2e-3, "fatol": math.inf, "maxfev": 200},
    )
    common = replace(_common(found.x), square_misfit=float(found.fun), dof=dof)
    none = replace(common, transition=None, lag=None)
    without = float(np.sum(taken.residual(none) ** 2))
    # F test of the friction columns, two a staircase
    extra = 2 * len(taken.stairs.setpoint)
    ratio = (without - common.square_misfit) / extra / max(common.square_misfit / dof, 1e-300)
    shows = fdtrc(extra, dof, max(ratio, 0.0)) < FRICTION_SIGNIFICANCE
    return common if shows else replace(none, square_misfit=common.square_misfit)


def _ranges(stairs: Stairs, swings: bool) -> tuple[Array, Array]:
    """Return bounds of the logarithms of tau, s and, with swings, lag."""
    courses = stairs.courses
    span = float(np.ptp(courses.torque[0]))
    step = span * float(np.median(np.abs(np.diff(courses.setpoint[0]))))
    step /= float(np.ptp(courses.setpoint[0]))
    low, high = [SHORTEST_TIME_CONSTANT, step / 4], [LONGEST_TIME_CONSTANT, 10 * span]
    if swings:
        part = float(np.median(courses.part))
        low.append(part / 4)
        high.append(part * courses.course.shape[2] / 4)
    return np.log(low), np.log(high)


def _start(taken: _Taken, low: Array, high: Array) -> Array:
    """Return where to begin a search: the best s for each of some lags, which go together."""
    best, begin = math.inf, low
    for lag in np.linspace(low[2:], high[2:], 7 if len(low) > 2 else 1):

        def square(transition: float, lag: Array = lag) -> float:
            common = _common(np.array([math.log(START_TIME_CONSTANT), math.log(transition), *lag]))
            return float(np.sum(taken.residual(common) ** 2))

        transition = minimum(square, math.exp(low[1]), math.exp(high[1]))
        if (found := square(transition)) < best:
            best = found
            begin = np.array([math.log(START_TIME_CONSTANT), math.log(transition), *lag])
    return begin


def _common(logarithms: Array) -> Common:
    tau, transition, *lag = np.exp(logarithms).tolist()
    return Common(transition, lag[0] if lag else None, tau, math.nan, 0)


class _Taken:
    """Some of the staircases, and what (1) leaves of them for given common parameters."""

    def __init__(self, stairs: Stairs, coefficient: float) -> None:
        self._all, self._coefficient = stairs, coefficient
        self._every = -(-len(stairs.setpoint) // FITTED_STAIRCASES)
        self.stairs = stairs.taken(self._every)
        # A search that moves tau alone keeps the columns of friction, and the other way round.
        self._currents = lru_cache(maxsize=2)(self._currents_for)
        self._friction = lru_cache(maxsize=2)(
            lambda s, lag: friction_columns(self.stairs, Common(s, lag, 1.0, 0.0, 0))
        )

    def _currents_for(self, time_constant: float) -> tuple[Array, Array, Array]:
        # Heat remains from the staircase before, so the heat of all of them counts.
        heat, warmth = (values[:: self._every] for values in winding(self._all, time_constant))
        drift = warmth - mean_of(warmth, self.stairs.weight)[:, None]
        current = self.stairs.current * (1 + self._coefficient * drift)
        return current, current * heat, current * np.abs(current)

    def residual(self, common: Common) -> Array:
        """Return torque minus (1) on all plateaus, (m p,) N m."""
        current, *other = self._currents(common.time_constant)
        friction = self._friction(common.transition, common.lag)
        q, _ = np.linalg.qr(np.stack([current, self.stairs.weight, *friction, *other], axis=2))
        fitted = np.einsum("mpc,mc->mp", q, np.einsum("mpc,mp->mc", q, self.stairs.torque))
        residual: Array = (self.stairs.torque - fitted).ravel()
        return residual
