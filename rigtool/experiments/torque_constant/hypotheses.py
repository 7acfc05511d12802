"""What all staircases share, as hypotheses: each with its probability and its torque constant.

A hypothesis is a transition s of friction, a lag of the arm's swings and a time constant tau of the
winding. On the mean staircases it leaves, by least squares in all else of (1) of
`rigtool.experiments.torque_constant.staircase_model`, a sum of squares Q. Where the size of the
scatter is unknown, its probability for n independent residuals is

    p = Q^(-n/2) / sum over all hypotheses,

even in the logarithms of s, lag and tau (A. Gelman et al., Bayesian Data Analysis, 3rd ed., 2013,
section 3.2). Friction opposes motion: hypotheses that want the opposite have none; those in which
heat raises the constant count without heat, since no magnet gains by it. The spread of
the torque constants of all hypotheses is the uncertainty due to what the data do not show: friction
whose contacts bend further than the arm moves is a spring beside the arm, and no staircase shows
its stiffness.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import product

import numpy as np
from numpy.typing import ArrayLike

from rigtool.errors import InsufficientDataError
from rigtool.experiments.torque_constant.staircase_model import Common, Stairs, mean_of, winding
from rigtool.experiments.torque_constant.swings import (
    friction_state,
    longest_lag,
    paths,
    straight_path,
)
from rigtool.numerics.arrays import Array
from rigtool.numerics.residual_covariance import independent_samples

SHORTEST_TIME_CONSTANT, LONGEST_TIME_CONSTANT = 2.0, 300.0
"""Range in which the winding's thermal time constant tau is searched, s."""

LONGEST_TRANSITION = 10.0
"""Largest transition of friction, as a multiple of the span of the torque."""

LARGEST_FRICTION = 0.25
"""Largest friction, relative to the span of the torque."""

PARAMETERS = 7
"""Linear parameters of a mean staircase."""

LOWEST_EXPONENT, HIGHEST_EXPONENT = 0.5, 2.0
"""Range of the exponent of the law of friction: below 1 for brittle contacts, which slide after a
finite way, above 1 for ductile ones (Dahl 1968; AIAA J. 14(12) 1675-1682, 1976)."""

COARSE, FINE = (16, 6, 3, 5), (7, 4, 5, 4)
"""Values of s, tau, exponent and lag over all of their range, and in each finer grid."""

TAU, ALL_OF_TAU = 1, 11
"""Place of tau among these, and its values over all of its range in the last grid: hypotheses whose
friction is less well tried would count against their tau."""

TAU_STEP = math.log(LONGEST_TIME_CONSTANT / SHORTEST_TIME_CONSTANT) / (COARSE[1] - 1) / 2
"""Distance of the values of tau that are tried, logarithm: finer grids add the middles."""

FINER_GRIDS = 3
"""Grids that each cover the best of the one before."""

SHORTER_LAG = 12.0
"""Ratio of the longest lag of the arm's swings to the shortest."""

FEWEST_RESIDUALS = 4.0
"""Fewest independent residuals that are assumed."""


@dataclass(frozen=True)
class Hypotheses:
    """The most probable hypothesis, and what all of them do to the torque constants.

    `stairs` have courses without noise. `constant` in N m/A is the mean of all hypotheses on the
    mean staircases, `spread` their standard deviation, `drift` in N m/(A K) that of the constants'
    change with temperature. `heat_loss` in 1/A2 is the mean of the relative loss of the constant
    within `HEATING_TIME`, over the square of the current, `heat_loss_spread` its standard
    deviation; `untried` is the relative standard uncertainty of that, as tau is tried in steps.
    """

    stairs: Stairs
    best: Common
    constant: float
    spread: float
    drift: float
    heat_loss: float
    heat_loss_spread: float
    untried: float


def weigh_hypotheses(stairs: Stairs, coefficient: float, trend: Array) -> Hypotheses:
    """Try all hypotheses; `coefficient` is c of (1), 1/K.

    `trend` (m,) combines the constants of the staircases to their change with temperature, 1/K.
    Raises `InsufficientDataError` where the plateaus leave no degree of freedom.
    """
    means = _Means(stairs, coefficient, trend)
    if means.dof < 1:
        raise InsufficientDataError(
            f"{int(stairs.weight.sum())} plateaus in {len(stairs.setpoint)} staircases leave no "
            "degree of freedom to the fit: use more steps"
        )
    ways = _ways(stairs)
    # The gauge's noise is also in the path, where it would count as evidence against friction.
    coarse = _joined([_search(means, way, 0) for way in ways])
    means.smooth(coarse.commons[int(np.argmin(coarse.square))])
    tried = _joined([_search(means, way, FINER_GRIDS) for way in ways])
    number = int(np.argmin(tried.square))
    count = max(means.independent(tried.commons[number]), FEWEST_RESIDUALS)
    probable = tried.volume * (tried.square / tried.square[number]) ** (-count / 2)
    probable /= probable.sum()
    mean = probable @ tried.slope
    spread = np.sqrt(probable @ (tried.slope - mean) ** 2)
    best = tried.commons[number]
    length = float(np.mean(stairs.end.max(axis=1) - stairs.begin.min(axis=1)))
    return Hypotheses(
        means.stairs,
        best,
        constant=float(mean[0]),
        spread=float(spread[0]),
        drift=float(spread[1]),
        heat_loss=float(mean[2]),
        heat_loss_spread=float(spread[2]),
        untried=_untried(best, length),
    )


def _untried(best: Common, length: float) -> float:
    """Return the relative standard uncertainty of a loss by heat, as tau is tried in steps.

    The loss is known at the end of a staircase of `length` s, whatever tau is; from there to
    `HEATING_TIME` it grows by tau, which lies anywhere within a step (GUM 4.3.7).
    """
    edges = [
        replace(best, time_constant=best.time_constant * math.exp(side * TAU_STEP / 2))
        for side in (-1, 1)
    ]
    low, high = (math.log(edge.warming() / edge.warming(length)) for edge in edges)
    return abs(high - low) / math.sqrt(12)


@dataclass(frozen=True)
class _Tried:
    """Hypotheses (n,), at places (n, 3 or 4) of a grid, and what they leave.

    `volume` (n,) is the part of the grid that each represents, `square` (n,) is Q, `slope` (n, 3)
    the mean of the torque constants, their change with temperature, and the loss by heat.
    """

    commons: list[Common]
    place: Array
    volume: Array
    square: Array
    slope: Array


def _joined(parts: list[_Tried]) -> _Tried:
    """Return all hypotheses of several grids; their places stay behind."""
    return _Tried(
        [common for part in parts for common in part.commons],
        np.empty((0, 0)),
        np.concatenate([part.volume for part in parts]),
        np.concatenate([part.square for part in parts]),
        np.concatenate([part.slope for part in parts]),
    )


def _ways(stairs: Stairs) -> list[tuple[float, float] | None]:
    """Return ranges of the lag along which friction may follow, s; None for straight steps.

    A gauge that shows no swings may be too slow for them: then friction may follow its torque
    from plateau to plateau, or straight steps of the current.
    """
    longest = longest_lag(stairs.courses)
    if longest is not None:
        return [(longest / SHORTER_LAG, longest)]
    fastest = float(np.min(stairs.courses.part)) / 20
    return [(fastest, fastest), None]


def _search(means: _Means, lag: tuple[float, float] | None, finer: int) -> _Tried:
    """Try hypotheses with lags of this range on a coarse grid, and on so many finer ones."""
    low, high = _ranges(means.stairs, lag)
    centre, half, wide = (low + high) / 2, (high - low) / 2, high > low
    found: list[_Tried] = []
    for level in range(1 + finer):
        begin, end = np.maximum(centre - half, low), np.minimum(centre + half, high)
        counts = list(FINE if level else COARSE)
        if level and level == finer:
            begin[TAU], end[TAU], counts[TAU] = low[TAU], high[TAU], ALL_OF_TAU
        numbers = [n if e > b else 1 for n, b, e in zip(counts, begin, end, strict=False)]
        axes = [np.linspace(b, e, n) for b, e, n in zip(begin, end, numbers, strict=True)]
        step = (end - begin) / np.maximum(np.array(numbers) - 1, 1)
        for part in found:  # the finer grid stands for its part of the coarse one
            part.volume[np.all((part.place >= begin) & (part.place <= end), axis=1)] = 0.0
        place = np.array(list(product(*axes)))
        volume = np.full(len(place), np.prod(step[wide] / (high - low)[wide]))
        commons, square, slope = means.try_all(axes)
        found.append(_Tried(commons, place, volume, square, slope))
        centre, half = place[int(np.argmin(square))], 1.5 * step
    return _joined(found)


def _ranges(stairs: Stairs, lag: tuple[float, float] | None) -> tuple[Array, Array]:
    """Return bounds of the logarithms of s, tau, the exponent and the lag, if there is one."""
    courses = stairs.courses
    span = float(np.ptp(courses.torque[0]))
    step = span * float(np.median(np.abs(np.diff(courses.setpoint[0]))))
    step /= float(np.ptp(courses.setpoint[0]))
    low = [step / 4, SHORTEST_TIME_CONSTANT, LOWEST_EXPONENT]
    high = [LONGEST_TRANSITION * span, LONGEST_TIME_CONSTANT, HIGHEST_EXPONENT]
    if lag is not None:
        low.append(lag[0])
        high.append(lag[1])
    return np.log(low), np.log(high)


class _Means:
    """Mean staircases, one of each kind, and what hypotheses leave of them."""

    def __init__(self, stairs: Stairs, coefficient: float, trend: Array) -> None:
        self.stairs, self._coefficient = stairs, coefficient
        kind = stairs.courses.kind
        self._members = [kind == number for number in range(int(kind.max()) + 1)]
        self._share = np.array([np.mean(those) for those in self._members])
        self._weight, self._step = self._mean(stairs.weight), self._mean(stairs.last_step)
        torque = self._mean(stairs.torque)
        combined = [
            np.sum(trend[those, None] * stairs.torque[those], axis=0) for those in self._members
        ]
        self._torque = np.stack([torque, np.stack(combined)], axis=2)  # (g, p, 2)
        self._span = float(np.ptp(torque))
        self.dof = int(self._weight.sum()) - PARAMETERS * len(self._members)

    def _mean(self, values: Array) -> Array:
        return np.stack([values[those].mean(axis=0) for those in self._members])

    def _thermal(self, time_constant: float) -> tuple[Array, Array]:
        """Return current, warmed, and its loss by heat, (2, g, p)."""
        heat, warmth = winding(self.stairs, time_constant)
        drift = warmth - mean_of(warmth, self.stairs.weight)[:, None]
        current = self.stairs.current * (1 + self._coefficient * drift)
        return self._mean(current), self._mean(current * heat)

    def _ways(self, lags: Sequence[float | None]) -> list[Array]:
        """Return the path of each lag; None alone, there is no lag, has that of straight steps."""
        courses = self.stairs.courses
        some = [lag for lag in lags if lag is not None]
        if not some:
            return [straight_path(courses)]
        return list(paths(courses, courses.torque, courses.course, some))

    def _friction(
        self, way: Array, transition: ArrayLike, exponent: ArrayLike
    ) -> tuple[Array, Array]:
        a, b = friction_state(way, transition, exponent)
        return -a * self._weight, -b * self._weight  # (..., g, p)

    def try_all(self, axes: list[Array]) -> tuple[list[Common], Array, Array]:
        """Return all hypotheses of a grid, their Q (n,) and slopes (n, 3): mean, trend, loss by
        heat."""
        transition, tau, exponents = (np.exp(axis) for axis in axes[:3])
        lags: list[float | None] = [None]
        if len(axes) > 3:
            lags = list(np.exp(axes[3]).tolist())
        ways = np.stack(self._ways(lags), axis=1)
        columns = self._friction(ways, transition[:, None, None], exponents[:, None, None, None])
        shape = (len(tau), *columns[0].shape[:3])
        fits = [
            self._fit(*thermal, [each.reshape(-1, *self._weight.shape) for each in pair])
            for thermal in map(self._thermal, tau.tolist())
            for pair in zip(*columns, strict=True)
        ]
        square, slope, free = (
            np.moveaxis(np.reshape(parts, (*shape, *parts[0].shape[1:])), 2, 0)
            for parts in zip(*fits, strict=True)
        )
        commons = [
            Common(None if without else float(s), float(exponent), lag, float(t))
            for (s, t, exponent, lag), without in zip(
                product(transition, tau, exponents, lags), free.ravel(), strict=True
            )
        ]
        slope = slope.reshape(-1, 3)
        slope[:, 2] *= [common.warming() for common in commons]
        return commons, square.ravel(), slope

    def _fit(
        self, current: Array, lost: Array, friction: Sequence[Array]
    ) -> tuple[Array, Array, Array]:
        """Return Q (s,), slopes (s, 3), and which transitions are without friction (s,)."""
        square, slope, free, added = self._fit_columns(current, [lost], friction)
        gains = added > 0  # as no magnet does by heat
        if not gains.any():
            return square, slope, free
        cold, cold_slope, cold_free, _ = self._fit_columns(current, [], friction)
        slope = np.where(gains[:, None], cold_slope, slope)
        return np.where(gains, cold, square), slope, np.where(gains, cold_free, free)

    def _fit_columns(
        self, current: Array, lost: list[Array], friction: Sequence[Array]
    ) -> tuple[Array, Array, Array, Array]:
        """Return Q (s,), slopes (s, 3), without friction (s,), and what heat adds (s,)."""
        smooth = np.stack([current, self._weight, self._step, *lost], axis=2)[None]
        saturation = (current * np.abs(current))[None, :, :, None]
        plain = np.broadcast_to(smooth, (len(friction[0]), *smooth.shape[1:]))
        slid = np.concatenate([plain, *(column[..., None] for column in friction)], axis=3)
        more = np.broadcast_to(saturation, (*slid.shape[:3], 1))
        square, found, of_slid = self._least_squares(np.concatenate([slid, more], axis=3))
        none, bare, of_smooth = self._least_squares(np.concatenate([smooth, saturation], axis=3))
        level = found[..., 3 + len(lost), 0] @ self._share
        free = level <= 0
        square = np.where(free, none, square)
        square = np.where(level > LARGEST_FRICTION * self._span, np.inf, square)
        added = np.where(free, bare[..., 3, 0] @ self._share, found[..., 3, 0] @ self._share)
        # The ripple's i |i| averages out over angles; as a column it would take most of the slope.
        slope, without = (self._slopes(of, bool(lost)) for of in (of_slid, of_smooth))
        return square, np.where(free[:, None], without, slope), free, added

    def _slopes(self, found: Array, warmed: bool) -> Array:
        """Return mean slope, trend and relative loss by heat (s, 3) from parameters (s, g, c, 2),
        the fourth of which is that loss where the winding is `warmed`."""
        mean = found[..., 0, 0] @ self._share
        loss = -found[..., 3, 0] @ self._share / mean if warmed else np.zeros(mean.shape)
        slopes: Array = np.stack([mean, np.sum(found[..., 0, 1], axis=1), loss], axis=1)
        return slopes

    def _least_squares(self, design: Array) -> tuple[Array, Array, Array]:
        """Return Q (s,) of the mean torque and parameters (s, g, c, 2) of designs (s, g, p, c); and
        the parameters (s, g, c - 1, 2) without the last column, whose factors are in the others."""
        q, r = np.linalg.qr(design)
        projected = np.swapaxes(q, 2, 3) @ self._torque
        rest = self._torque[..., 0] - (q @ projected[..., :1])[..., 0]
        square = np.sum(rest**2, axis=2) @ self._share
        fewer = np.linalg.solve(r[..., :-1, :-1], projected[..., :-1, :])
        return square, np.linalg.solve(r, projected), fewer

    def smooth(self, common: Common) -> None:
        """Take off the courses what a hypothesis leaves of the mean torques, as noise; and off
        their rates what its columns, and the ripple's i |i|, leave of these: noise and rounding."""
        noise = self.residual(common).reshape(self._weight.shape)
        courses = self.stairs.courses
        columns = self._columns(common)
        columns.append(columns[0] * np.abs(columns[0]))
        rest = [_left(columns, rate) for rate in np.moveaxis(courses.torque_rate, 1, 0)]
        self.stairs = replace(self.stairs, courses=courses.less(noise, np.stack(rest, axis=1)))

    def _columns(self, common: Common) -> list[Array]:
        """Return the columns of (1) on the mean staircases, current first, (g, p) each."""
        current, lost = self._thermal(common.time_constant)
        columns = [current, self._weight, self._step, lost]
        if common.transition is not None:
            (way,) = self._ways([common.lag])
            columns += self._friction(way, common.transition, common.exponent)
        return columns

    def residual(self, common: Common) -> Array:
        """Return the residual of (1) with the ripple's i |i| on the mean staircases, (g p,) N m."""
        columns = self._columns(common)
        curved = columns[0] * np.abs(columns[0])
        return _left([*columns, curved], self._torque[..., 0]).ravel()

    def independent(self, common: Common) -> float:
        """Return how many independent residuals a hypothesis leaves, less its parameters."""
        residual, used = self.residual(common), self._weight.ravel() > 0
        return independent_samples(residual, used, 1) - PARAMETERS * len(self._members)


def _left(columns: list[Array], torque: Array) -> Array:
    """Return what least squares leave of torques (g, p) by columns (g, p) of each kind."""
    q, _ = np.linalg.qr(np.stack(columns, axis=2))
    rest: Array = torque - np.einsum("gpc,gc->gp", q, np.einsum("gpc,gp->gc", q, torque))
    return rest
