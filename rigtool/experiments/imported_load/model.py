"""A drive's effort as function of motion and load, solved for the load.

    effort = f0(motion) + torque g1(motion) + torque^2 g2(motion) + torque^3 g3(motion)

The functions are those of `basis`, each a sum of smooth ones; `learning` finds their weights.
Friction that grows with load is the part of g1 that changes sign with the direction; compliance
shifts f0 along the position, which to first order is part of g1, too.

Outside the region that was learned there is no estimate (`region`). Near standstill friction
is undetermined: a dead band bounds the load.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from rigtool.experiments.force_filter.accuracy import COVERAGE_FACTOR
from rigtool.experiments.force_filter.motion_states import State, States
from rigtool.experiments.imported_load.basis import (
    LOAD_POWER,
    LoadSignals,
    Scales,
    ShaftPath,
    motion_functions,
)
from rigtool.experiments.imported_load.loop import StrokeLoop
from rigtool.experiments.imported_load.noise import LearnedNoise
from rigtool.experiments.imported_load.region import (
    DRIVEN,
    Region,
    beside_known,
    beside_known_strokes,
    of_known_strokes,
    reached,
)
from rigtool.numerics.arrays import TINY, Array, Mask

SIDE_SIGNS = (1, -1)
"""Signs of the speed, in the order of a model's sides."""

FLAT_SLOPE = 0.25
"""Where the slope of effort by torque is below this part of the usual one in its direction, such as
after a reversal, friction hides the load as it does at standstill."""

FLATTEST = 1e-100
"""Slopes below this one count as this, so that u is huge where effort does not depend on load."""

APART_SPEED = 0.1
"""Part of the highest speed by which speeds of strokes differ, at least."""

APART_STROKE = 0.1
"""Part of a stroke by which the middles of strokes at different places differ, at least."""

HIGHEST_POWER = max(LOAD_POWER.values())

SLOWEST_SCATTER = 1e-3
"""Speed below which scatter does not change any more, as part of the highest."""

TORQUE_HALVINGS = 40
"""Halvings of the range of torques to find one: far finer than any uncertainty."""


@dataclass(frozen=True, eq=False)
class TorqueEstimate:
    """Torque, N m, its standard uncertainty and the state of each row (n,).

    Near standstill, and so soon after a reversal that effort hardly depends on the load yet, the
    torque is the middle of a dead band and u that of a rectangular distribution (GUM 4.3.7).
    Outside what was learned, and where nothing bounds the torque, both are NaN. `compared` shows
    the mounting: without unit, all that moves at learned places and speeds. An effort that no load
    of the range explains counts as the nearest one: strokes disagree by as much at least.
    `noisier` is what noise of the effort that was not learned multiplies u by.
    """

    torque: Array
    u: Array
    states: States
    compared: Array
    noisier: float

    @property
    def inside(self) -> Mask:
        """Rows with a value while moving."""
        return (self.states == State.AGAINST) | (self.states == State.WITH)

    @property
    def moving(self) -> Array:
        """The torque of these rows, NaN in others."""
        return np.where(self.inside, self.torque, np.nan)

    def widened(self, factor: float = 1.0, doubt: Array | float = 0.0) -> TorqueEstimate:
        """Return the estimate with u times a factor, and more doubt (n,), N m, while moving."""
        return replace(self, u=np.where(self.inside, np.hypot(factor * self.u, doubt), self.u))


@dataclass(frozen=True, eq=False)
class Side:
    """What was learned of one direction, of `groups` of functions in the order of columns.

    `weights` (k,) and their `covariance` (k, k) are without unit; `scatter` (3,) is the logarithm
    of the scatter's variance: constant, by the logarithm of speed, by torque; `factors` (l,)
    multiply uncertainties at torques `levels` (l,), which rise; between two they go in a line.
    `slope` is the usual one of effort by torque; `elsewhere` multiplies u of strokes at a place of
    which none was learned; `other_speeds` is how many times u errors are at the first or the last
    speed where that is left out. Where two loads were learned, the effort between them may be off a
    line: bend t (1 - t) is the standard uncertainty of that at the part t of the way.
    """

    groups: tuple[str, ...]
    weights: Array
    covariance: Array
    scatter: Array
    levels: Array
    factors: Array
    slope: float
    elsewhere: float = 1.0
    other_speeds: float = 1.0
    bend: float = 0.0

    def at_other_speeds(self, share: float) -> float:
        """Return the factor on u where such a `share` of that change counts, see `LoadModel`."""
        return math.sqrt(1 + share * (self.other_speeds**2 - 1))

    def factor(self, torque: Array) -> Array:
        """Return the factor on uncertainties at torques (n,)."""
        return np.interp(torque, self.levels, self.factors)

    def design(self, functions: Mapping[str, Array]) -> DesignMatrix:
        """Return the functions in use."""
        return DesignMatrix.joined({name: functions[name] for name in self.groups})

    def spread(self, design: DesignMatrix, speed: Array, torque: Array) -> tuple[Array, Array]:
        """Return the standard uncertainty (n,) of torques (n,) at speeds (n,), and the slope of
        effort by torque (n,) there, without unit."""
        row = design.at(torque)
        variance = np.einsum("ij,ij->i", row @ self.covariance, row)
        variance += scatter_variance(self.scatter, speed, torque)
        slope = np.maximum(np.abs(design.slope(self.weights, torque)), FLATTEST)
        low, high = self.levels[0], self.levels[-1]
        bent = self.bend * (torque - low) * (high - torque) / max(high - low, TINY) ** 2
        u: Array = np.hypot(self.factor(torque) * np.sqrt(variance), bent) / slope
        return u, slope


@dataclass(frozen=True, eq=False)
class Paces:
    """Speeds (p,), rad/s, at which strokes were recorded, rising, see `pace_of`; and the `lowest`
    and `highest` torque (p,) there, margins included, without unit."""

    speeds: Array
    lowest: Array
    highest: Array

    def change(self, pace: float) -> float:
        """Return the part of the variance that changes from one speed to the next, at another
        speed; 0 at one of these.

        As in a Wiener process, by the distance beyond the last speed over that of the last two;
        between two speeds t (1 - t) at the part t of the way, where these are all: with more, those
        between others were left out.
        """
        if len(self.speeds) < 2 or self._is_near(pace):
            return 0.0
        first, last = np.diff(self.speeds)[[0, -1]]
        beyond = float(max((self.speeds[0] - pace) / first, (pace - self.speeds[-1]) / last))
        if beyond < 0 and len(self.speeds) > 2:
            return 0.0
        return beyond if beyond > 0 else -beyond * (1 + beyond)

    def between(self, pace: float) -> tuple[float, float]:
        """Return the lowest and the highest torque that were learned at a speed, or on a line
        between those at a lower and at a higher one: with what changes by speed elsewhere, effort
        by load is not known there."""
        speeds = self.speeds
        if len(speeds) < 2:
            return -math.inf, math.inf
        near = speeds[np.argmin(np.abs(speeds - pace))]
        pace = near if self._is_near(pace) else min(max(pace, speeds[0]), speeds[-1])
        slower, faster = (np.flatnonzero(which) for which in (speeds <= pace, speeds >= pace))
        way = np.maximum(speeds[faster] - speeds[slower, None], TINY)
        share = (pace - speeds[slower, None]) / way
        low, high = (
            torque[slower, None] * (1 - share) + torque[faster] * share
            for torque in (self.lowest, self.highest)
        )
        return float(low.min()), float(high.max())

    def _is_near(self, pace: float) -> bool:
        return bool(np.abs(pace - self.speeds).min() <= APART_SPEED * self.speeds[-1])


@dataclass(frozen=True, eq=False)
class LoadModel:
    """A model of both directions, positive speed first, from strokes with middles `strokes` (s,)
    at `paces`.

    Effort is in units of `effort_scale`; `torque_range` are the lowest and highest torque that are
    looked at, without unit; `direction` is the sign of the speed against which the load acts;
    `loop` is what shows that runs are of the mounting that was learned; dead bands are wider by
    `slack` at either end, without unit.
    """

    scales: Scales
    strokes: Array
    bandwidth_hz: float
    effort_scale: float
    sides: tuple[Side, Side]
    torque_range: tuple[float, float]
    direction: int
    region: Region
    loop: StrokeLoop
    noise: LearnedNoise
    paces: Paces
    slack: float = 0.0

    def place(self, path: ShaftPath) -> Array:
        """Return the position (n,) as part of the learned stroke."""
        return (path.position - self.scales.low) / (self.scales.high - self.scales.low)

    def elsewhere(self, path: ShaftPath) -> bool:
        """Return whether strokes are at a place of which none was learned."""
        middle, length = stroke_of(path)
        return bool(np.abs(middle - self.strokes).min() > APART_STROKE * length)

    def read(self, signals: LoadSignals) -> TorqueEstimate:
        """Return the torque at the rows (n,) of a recording."""
        noise = signals.noise.by(self.effort_scale)
        variance, lag = self.noise.beyond(noise, self.bandwidth_hz)
        rate = np.gradient(signals.effort / self.effort_scale, signals.path.time)
        doubt = np.sqrt(variance + (lag * rate) ** 2)
        return self.estimate(signals.effort, signals.path, doubt)

    def estimate(
        self, effort: Array, path: ShaftPath, doubt: Array | float = 0.0
    ) -> TorqueEstimate:
        """Return the torque at the rows (n,) of a path whose effort is given; `doubt` (n,) is its
        standard uncertainty beside what was learned, without unit."""
        doubt = np.broadcast_to(doubt, effort.shape)
        speed, unit = path.speed / self.scales.speed, self.scales.torque
        torque, nearest, u, share, doubted = (np.full(len(speed), np.nan) for _ in range(5))
        elsewhere, change = self.elsewhere(path), self.paces.change(pace_of(path))
        lightest, heaviest = self.paces.between(pace_of(path))
        for sign, side in zip(SIDE_SIGNS, self.sides, strict=True):
            mask = speed < 0 if sign < 0 else speed >= 0
            design = side.design(motion_functions(path, self.scales, sign))
            found, known = design.solve(side.weights, effort / self.effort_scale, self.torque_range)
            spread, slope = side.spread(design, speed, found)
            torque[mask], nearest[mask] = np.where(known, found, np.nan)[mask], found[mask]
            spread *= side.elsewhere if elsewhere else 1.0
            spread *= side.at_other_speeds(change)
            wider = np.hypot(spread, doubt / slope)
            u[mask], share[mask] = wider[mask], slope[mask] / side.slope
            doubted[mask] = (wider / spread)[mask]
        still = np.abs(path.speed) < self.scales.standstill
        hidden = still | (share < FLAT_SLOPE)
        place = self.place(path)
        moving = path.regular & reached(place) & ~hidden
        known = self.region.holds(place, speed, torque) & moving
        known &= (torque >= lightest) & (torque <= heaviest)
        way = np.where(still, 0.0, np.sign(speed))
        usual = moving & self.region.moves(place, speed)
        against = self.direction * speed >= 0
        most = against | of_known_strokes(known, usual, way, DRIVEN)
        known = of_known_strokes(known, moving, way)
        # A heavier load shows in the strokes against it
        most &= against | beside_known_strokes(known, moving & against, way)
        compared = np.where(usual, nearest, np.nan)
        known &= most
        states = np.where(against, State.AGAINST, State.WITH)
        states[hidden] = np.where(still, State.STILL, State.REVERSED)[hidden]
        low, high = self._dead_band(effort, path, hidden, doubt)
        bounded = hidden & path.regular & reached(place) & np.isfinite(low + high)
        # At an end of the range a load beyond it may act, unless strokes beside show one within
        within = (low > self.torque_range[0]) & (high < self.torque_range[1])
        bounded &= within | beside_known(known, way)
        states[~known & ~bounded] = State.OUTSIDE
        torque = np.where(known, torque, (low + high) / 2)
        u = np.where(known, u, (high - low) / math.sqrt(12))
        torque, u = np.where(states == State.OUTSIDE, np.nan, unit * np.stack([torque, u]))
        noisier = float(np.sqrt(np.mean(doubted[known] ** 2))) if known.any() else 1.0
        return TorqueEstimate(torque, u, states, compared, noisier)

    def _dead_band(
        self, effort: Array, path: ShaftPath, hidden: Mask, doubt: Array
    ) -> tuple[Array, Array]:
        """Return the torques (n,), without unit, between which the load is where friction may act
        either way: at most the range that was learned."""
        edges, half = np.full((2, 2, len(effort)), np.nan)
        if hidden.any():
            speed = path.speed[hidden] / self.scales.speed
            for number, (sign, side) in enumerate(zip(SIDE_SIGNS, self.sides, strict=True)):
                functions = motion_functions(path, self.scales, sign, alone=True)
                design = side.design({name: functions[name][hidden] for name in side.groups})
                scaled = effort[hidden] / self.effort_scale
                found, _ = design.solve(side.weights, scaled, self.torque_range)
                edges[number, hidden] = found
                spread, slope = side.spread(design, speed, found)
                wider = np.hypot(spread, doubt[hidden] / slope)
                half[number, hidden] = COVERAGE_FACTOR * wider
        order = np.argsort(edges, axis=0)
        low, high = np.take_along_axis(edges, order, axis=0)
        low = np.where(low < high, low, np.nan)  # else both are beyond one end of the range
        wider = np.take_along_axis(half, order, axis=0) + self.slack
        lowest, highest = self.torque_range
        return np.maximum(low - wider[0], lowest), np.minimum(high + wider[1], highest)


@dataclass(frozen=True, eq=False)
class DesignMatrix:
    """Functions of motion as columns (n, k); each goes with the torque to its `power` (k,)."""

    columns: Array
    power: NDArray[np.intp]

    @staticmethod
    def joined(functions: Mapping[str, Array]) -> DesignMatrix:
        """Return the columns of all groups, (n, columns) each, side by side."""
        power = [np.full(f.shape[1], LOAD_POWER.get(name, 0)) for name, f in functions.items()]
        return DesignMatrix(np.hstack(list(functions.values())), np.concatenate(power))

    def polynomial(self, weights: Array) -> Array:
        """Return the effort's parts by power of the torque, (powers, n)."""
        powers = np.arange(HIGHEST_POWER + 1)[:, None]
        return np.where(self.power == powers, weights, 0.0) @ self.columns.T

    def solve(
        self, weights: Array, effort: Array, torque_range: tuple[float, float]
    ) -> tuple[Array, Mask]:
        """Return the torque (n,) that makes an effort (n,), and where the range holds it.

        By halving the range of torques: beyond it, the torque is the nearer end.
        """
        parts = self.polynomial(weights)
        low, high = (np.full(len(effort), edge) for edge in torque_range)
        bottom, top = polynomial_at(parts, low), polynomial_at(parts, high)
        rising = np.sign(top - bottom)
        known = (rising * (effort - bottom) >= 0) & (rising * (top - effort) >= 0)
        for _ in range(TORQUE_HALVINGS):
            middle = (low + high) / 2
            beyond = rising * (polynomial_at(parts, middle) - effort) > 0
            low, high = np.where(beyond, low, middle), np.where(beyond, middle, high)
        return (low + high) / 2, known

    def at(self, torque: Array) -> Array:
        """Return rows (n, k) at a torque, so that rows @ weights is the effort."""
        return self.columns * torque[:, None] ** self.power

    def slope(self, weights: Array, torque: Array) -> Array:
        """Return the slope (n,) of effort by torque at a torque."""
        parts = self.polynomial(weights)
        return polynomial_at(parts[1:] * np.arange(1, len(parts))[:, None], torque)


def stroke_of(path: ShaftPath) -> tuple[float, float]:
    """Return middle and length of what a path covers, rad, transients left out."""
    position = path.position[path.regular]
    if not position.size:
        return 0.0, 0.0
    low, high = float(position.min()), float(position.max())
    return (low + high) / 2, high - low


def pace_of(path: ShaftPath) -> float:
    """Return the root mean square of a path's speed, rad/s, transients left out."""
    speed = path.speed[path.regular]
    return float(np.sqrt(np.mean(speed**2))) if speed.size else 0.0


def polynomial_at(parts: Array, torque: Array) -> Array:
    """Return the sum of parts (powers, n) times the torque's powers, (n,)."""
    total: Array = parts[-1]
    for part in parts[-2::-1]:
        total = total * torque + part
    return total


def scatter_rows(speed: Array, torque: Array) -> Array:
    """Return what the logarithm of the scatter's variance is linear in, (n, 3)."""
    magnitude = np.maximum(np.abs(speed), SLOWEST_SCATTER)
    return np.column_stack([np.ones_like(speed), np.log(magnitude), np.abs(torque)])


def scatter_variance(scatter: Array, speed: Array, torque: Array) -> Array:
    """Return the variance (n,) that scatter alone makes."""
    # Beyond what was learned the logarithm of the variance must not run away.
    return np.exp(np.minimum(scatter_rows(speed, np.nan_to_num(torque)) @ scatter, 50.0))
