"""The disturbance of a load by position, speed, direction and torque: learned at known loads.

The motor's torque with a load, less that of the same motion without, is

    y = s - s0 + sum over terms of coefficient (function with load - function without load)

s and s0 are the torques that the tendon carries (`tendon`), the functions those of
`disturbance_terms`. Both sides pass the same low-pass and are compared over the straight part of
the strokes. What differs from one recording to the next by itself (friction level, by direction:
'instrument friction changes in time') is fitted for each recording and forgotten; so is the scatter
of the cycles without load, which all loads of a speed have in common.

Stiffness, damping and friction of the tendon enter as they are, coefficients linearly: least
squares over the first three, the rest being solved for at each step (variable projection: G. H.
Golub and V. Pereyra, SIAM J. Numer. Anal. 10(2) 413-432, 1973). Each coefficient has a spread, see
`disturbance_terms`, which acts as one more observation of zero: where the data tell nothing it
stays near zero, and its uncertainty says so.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from rigtool.analysis.disturbance_terms import Sizes, State, Term, depends_on_load, functions, terms
from rigtool.analysis.loaded_cycles import LoadedCycles
from rigtool.analysis.steady_mean import steady_u
from rigtool.analysis.tendon import Tendon, swing

Array = NDArray[np.float64]

MODEL_ERROR = 2e-3
"""Of the peak of a load: what such a model is trusted to describe at a single point, relative."""

ROWS = 4
"""Points that are compared, for each period of the bandwidth."""

SOFTEST, STIFFEST = 1.0, 1e-3
"""Stretch of the tendon under the largest load with which the search begins and ends, rad."""

DAMPING, DAMPING_SPREAD = 0.1, 1.5
"""Damping ratio of the largest load that the search starts with, and its logarithm's spread."""

TIP_FRICTION = 0.1
"""Friction of the far joint that the search starts with, and its spread, in parts of the friction
without load."""


@dataclass(frozen=True, eq=False)
class Comparison:
    """A load beside the same motion without it.

    `unloaded` are all recordings of the motion without load, `rows` (r,) the points of the period
    that are compared.
    """

    loaded: LoadedCycles
    unloaded: tuple[LoadedCycles, ...]
    rows: NDArray[np.intp]

    @staticmethod
    def of(loaded: LoadedCycles, unloaded: Sequence[LoadedCycles], margin: float) -> Comparison:
        """Compare with recordings of the same motion without load.

        `margin` is the output angle, rad, that is left out at both ends of the stroke.
        """
        left_out = margin * loaded.drive.angle_ratio
        low, high = loaded.setpoint.min() + left_out, loaded.setpoint.max() - left_out
        inside = np.flatnonzero((loaded.setpoint > low) & (loaded.setpoint < high))
        wanted = ROWS * loaded.drive.bandwidth_hz * loaded.period
        step = max(1, int(len(loaded.setpoint) / wanted))
        return Comparison(loaded, tuple(unloaded), inside[::step])

    @cached_property
    def unloaded_torque(self) -> Array:
        """Torque of the mean cycle without load (n,), N m, not low-passed."""
        mean: Array = np.mean([each.mean for each in self.unloaded], axis=0)
        return mean

    @cached_property
    def torque(self) -> Array:
        """What the load adds to the motor's torque, low-passed (n,), N m."""
        return self.loaded.lowpass(self.loaded.mean - self.unloaded_torque)

    @cached_property
    def nuisance(self) -> Array:
        """Friction levels of a recording by itself, low-passed (3, n)."""
        d, a = self.loaded.direction, self.loaded.output_angle
        return self.loaded.lowpass(np.stack([d, d * np.sin(a), d * np.cos(a)]))

    @cached_property
    def zero_error(self) -> Array:
        """The shape in which a wrong zero looks like a load, low-passed (n,)."""
        return self.loaded.lowpass(np.sin(self.loaded.output_angle))

    @property
    def independent(self) -> float:
        """Points among the compared ones that the low-pass leaves independent."""
        used = len(self.rows) * self.rows_apart / len(self.loaded.setpoint)
        return min(len(self.rows), 2 * self.loaded.drive.bandwidth_hz * self.loaded.period * used)

    @property
    def rows_apart(self) -> int:
        """Points of the period from one row to the next."""
        return int(np.min(np.diff(self.rows))) if len(self.rows) > 1 else 1

    def scatter(self) -> float:
        """Return the standard deviation of a single cycle's torque at a point, low-passed, N m."""
        cycles = self.loaded.lowpass(self.loaded.torque - self.loaded.torque.mean(axis=0))
        return float(np.sqrt(np.mean(cycles[:, self.rows] ** 2)))

    def noise(self) -> float:
        """Return the standard uncertainty of the mean cycle with the load at a point, N m."""
        u, _ = steady_u(self.loaded.lowpass(self.loaded.torque)[:, self.rows])
        return float(np.sqrt(np.mean(u**2)))

    def zero_noise(self) -> float:
        """Return the standard uncertainty of the torque without load as it acts on a load, N m."""
        shape = np.vstack([self.zero_error, self.nuisance])[:, self.rows]
        weight = np.linalg.pinv(shape.T)[0]
        us = [
            steady_u(each.lowpass(each.torque)[:, self.rows] @ weight)[0] for each in self.unloaded
        ]
        return math.hypot(*us) / len(us)

    def design(self, listed: Sequence[Term], loaded: State, unloaded: State) -> Array:
        """Return the terms' differences, low-passed (t, n), N m for a coefficient of 1."""
        speed = self.loaded.speed
        difference = functions(listed, loaded, speed) - functions(listed, unloaded, speed)
        return self.loaded.lowpass(difference)

    def states(self, tendon: Tendon, moment: float) -> tuple[State, State]:
        """Return the states with a load of this moment, N m, and without."""
        return state_under(self.loaded, tendon, moment), state_under(self.unloaded[0], tendon, 0.0)


def state_under(cycles: LoadedCycles, tendon: Tendon, moment: float) -> State:
    """Return the state along a cycle with a load of this moment, N m."""
    angle, arm = cycles.output_angle, cycles.drive.arm
    return State.of(cycles, *swing(angle, cycles.period, tendon, moment, arm))


@dataclass(frozen=True, eq=False)
class Disturbance:
    """A learned disturbance.

    `coefficient` (t,) of the `terms`; `covariance` (3 + t, 3 + t) of the tendon's stiffness,
    damping and tip friction, in SI units, and of the coefficients. `torque` N m is the largest
    learned load, `speeds` rad/s those of the motor.
    """

    terms: tuple[Term, ...]
    tendon: Tendon
    coefficient: Array
    covariance: Array
    torque: float
    speeds: tuple[float, ...]

    def expected(self, comparison: Comparison, moment: float) -> Array:
        """Return what a load of this moment, N m, adds to the motor's torque, low-passed (n,)."""
        loaded, unloaded = comparison.states(self.tendon, moment)
        carried = comparison.loaded.lowpass(loaded.carried - unloaded.carried)
        expected: Array = carried + self.coefficient @ comparison.design(
            self.terms, loaded, unloaded
        )
        return expected

    def sensitivity(self, comparison: Comparison, moment: float) -> Array:
        """Return the derivatives of `expected` by all that is uncertain, (3 + t, n)."""
        loaded, unloaded = comparison.states(self.tendon, moment)
        design = comparison.design(self.terms, loaded, unloaded)
        middle = self.expected(comparison, moment)
        parameters = _parameters(self.tendon)
        by_tendon = []
        for number, u in enumerate(np.sqrt(np.diag(self.covariance)[:3])):
            step = max(float(u), 1e-6 * parameters[number])
            if step == 0:
                by_tendon.append(np.zeros_like(middle))
                continue
            moved = parameters.copy()
            moved[number] += step
            other = Disturbance(
                self.terms,
                Tendon(*moved.tolist()),
                self.coefficient,
                self.covariance,
                self.torque,
                self.speeds,
            )
            by_tendon.append((other.expected(comparison, moment) - middle) / step)
        return np.vstack([by_tendon, design])


def learn(comparisons: Sequence[Comparison], moments: Sequence[float]) -> Disturbance:
    """Learn from comparisons whose loads have these moments, N m.

    The loads of one speed are compared with one and the same motion without load.
    """
    problem = _Problem(comparisons, moments)
    tendon = problem.fit()
    coefficient, covariance = problem.solution(tendon)
    return Disturbance(problem.terms, tendon, coefficient, covariance, max(moments), problem.speeds)


def relearned(
    disturbance: Disturbance, comparisons: Sequence[Comparison], moments: Sequence[float]
) -> Disturbance:
    """Learn the coefficients again with the same tendon from other, or fewer, comparisons."""
    problem = _Problem(comparisons, moments, disturbance.terms)
    coefficient, covariance = problem.solution(disturbance.tendon)
    return Disturbance(
        problem.terms, disturbance.tendon, coefficient, covariance, max(moments), problem.speeds
    )


class _Problem:
    """Rows of all comparisons, weighted; columns are terms, then what each recording has by
    itself."""

    def __init__(
        self,
        comparisons: Sequence[Comparison],
        moments: Sequence[float],
        listed: tuple[Term, ...] | None = None,
    ) -> None:
        self.comparisons, self.moments = comparisons, moments
        self.sizes = sizes_of(comparisons, moments)
        self.speeds = tuple(sorted({c.loaded.speed for c in comparisons}))
        self.terms = terms(self.sizes, self.speeds) if listed is None else listed
        self._moving = np.array([depends_on_load(term) for term in self.terms])
        self._weight, self._rows, spread = [], [], []
        for comparison, moment in zip(comparisons, moments, strict=True):
            sigma = math.hypot(comparison.noise(), MODEL_ERROR * moment)
            share = comparison.independent / len(comparison.rows)
            self._weight.append(math.sqrt(share) / sigma)
            self._rows.append(len(comparison.rows))
            spread += [comparison.scatter()] * 3
        zeros = {each.loaded.speed: each.zero_noise() for each in comparisons}
        self._zero = {speed: number for number, speed in enumerate(zeros)}
        self._spread = np.array([t.spread for t in self.terms] + spread + list(zeros.values()))
        self._still = self._still_part()
        self._right = np.concatenate(
            [
                weight * comparison.torque[comparison.rows]
                for weight, comparison in zip(self._weight, comparisons, strict=True)
            ]
        )

    def _still_part(self) -> Array:
        """Fill in the columns that do not depend on the tendon, (rows, columns)."""
        count = len(self.terms)
        matrix = np.zeros((sum(self._rows), len(self._spread)))
        first = 0
        still = [t for t, moves in zip(self.terms, self._moving, strict=True) if not moves]
        for number, comparison in enumerate(self.comparisons):
            block = matrix[first : (first := first + self._rows[number])]
            rest = np.zeros(len(comparison.loaded.setpoint))
            states = [State.of(c, rest, rest) for c in (comparison.loaded, comparison.unloaded[0])]
            rows = comparison.rows
            block[:, np.flatnonzero(~self._moving)] = comparison.design(still, *states)[:, rows].T
            own = count + 3 * number
            block[:, own : own + 3] = comparison.nuisance[:, rows].T
            zero = count + 3 * len(self.comparisons)
            zero += self._zero[comparison.loaded.speed]
            block[:, zero] = comparison.zero_error[rows]
            block *= self._weight[number]
        return matrix

    def system(self, tendon: Tendon) -> tuple[Array, Array]:
        """Return matrix and right-hand side, weighted, for a tendon."""
        matrix, right = self._still.copy(), self._right.copy()
        moving = [t for t, moves in zip(self.terms, self._moving, strict=True) if moves]
        columns = np.flatnonzero(self._moving)
        first = 0
        rest = {
            speed: state_under(cycles, tendon, 0.0)
            for speed, cycles in {
                each.loaded.speed: each.unloaded[0] for each in self.comparisons
            }.items()
        }
        for number, (comparison, moment) in enumerate(
            zip(self.comparisons, self.moments, strict=True)
        ):
            here = slice(first, first := first + self._rows[number])
            loaded = state_under(comparison.loaded, tendon, moment)
            unloaded = rest[comparison.loaded.speed]
            rows, weight = comparison.rows, self._weight[number]
            design = comparison.design(moving, loaded, unloaded)[:, rows]
            matrix[here, columns] = weight * design.T
            carried = comparison.loaded.lowpass(loaded.carried - unloaded.carried)
            right[here] -= weight * carried[rows]
        return matrix, right

    def residual(self, tendon: Tendon) -> tuple[Array, Array]:
        """Return what is left, weighted, spreads included, and the columns' values."""
        matrix, right = self.system(tendon)
        scaled = matrix * self._spread
        normal = scaled.T @ scaled + np.eye(len(self._spread))
        value = np.linalg.solve(normal, scaled.T @ right)
        return np.concatenate([right - scaled @ value, value]), value * self._spread

    def fit(self) -> Tendon:
        """Return the tendon with the least sum of squares."""
        from scipy.optimize import least_squares

        load, tip = self.sizes.load, TIP_FRICTION * self.sizes.friction
        arm = self.comparisons[0].loaded.drive.arm

        def damping(stiffness: float) -> float:
            return 2 * DAMPING * math.sqrt(stiffness * load * arm / 9.81)

        tried = load / np.geomspace(STIFFEST, SOFTEST, 13)
        costs = [float(np.sum(self.residual(Tendon(k, damping(k), tip))[0] ** 2)) for k in tried]
        start = float(tried[int(np.argmin(costs))])

        def cost(x: Array) -> Array:
            left, _ = self.residual(_tendon(x, tip))
            return np.append(left, [(x[1] - begin[1]) / DAMPING_SPREAD, x[2] - 1])

        begin = np.array([math.log(start), math.log(damping(start)), 1.0])
        found = least_squares(
            cost,
            begin,
            bounds=([-np.inf, -np.inf, 0.0], np.inf),
            x_scale=[0.1, 1.0, 1.0],
            diff_step=np.full(3, 1e-3),
            xtol=1e-4,
            ftol=1e-5,
        )
        return _tendon(found.x, tip)

    def solution(self, tendon: Tendon) -> tuple[Array, Array]:
        """Return the coefficients and the covariance of tendon and coefficients together.

        Where residuals are larger than scatter and model error explain, they count.
        """
        left, value = self.residual(tendon)
        matrix, _ = self.system(tendon)
        parameters = _parameters(tendon)
        tip = TIP_FRICTION * self.sizes.friction
        steps = np.array([1e-3 * parameters[0], 1e-2 * parameters[1], 1e-2 * tip])
        slopes = []
        for number, step in enumerate(steps):
            moved = parameters.copy()
            moved[number] += step
            there = self.system(Tendon(*moved.tolist()))
            here = self.system(tendon)
            change = (there[1] - there[0] @ value) - (here[1] - here[0] @ value)
            slopes.append(-change / step)
        spread = np.concatenate([[np.inf, DAMPING_SPREAD * parameters[1], tip], self._spread])
        whole = np.column_stack([*slopes, matrix])
        size = np.concatenate([parameters[:2], [tip], self._spread])
        scaled = whole * size
        normal = scaled.T @ scaled + np.diag((size / spread) ** 2)
        covariance = np.linalg.inv(normal) * np.outer(size, size)
        rows = len(left) - len(value)
        chi2 = float(np.sum(left[:rows] ** 2)) / sum(c.independent for c in self.comparisons)
        kept = 3 + len(self.terms)
        return value[: len(self.terms)], max(1.0, chi2) * covariance[:kept, :kept]


def sizes_of(comparisons: Sequence[Comparison], moments: Sequence[float]) -> Sizes:
    """Return what spreads are relative to, from the cycles themselves."""
    friction, ripple = [], []
    for comparison in comparisons:
        cycles, rows = comparison.unloaded[0], comparison.rows
        torque = cycles.lowpass(comparison.unloaded_torque)[rows]
        direction = cycles.turning[rows]
        up, down = torque[direction > 0], torque[direction < 0]
        friction.append((up.mean() - down.mean()) / 2)
        ripple.append(float(np.std(up) + np.std(down)) / 2)
    return Sizes(
        load=max(moments),
        friction=max(float(np.mean(friction)), MODEL_ERROR * max(moments)),
        ripple=max(float(np.mean(ripple)), MODEL_ERROR * max(moments)),
        current=max(float(np.abs(c.loaded.current).max()) for c in comparisons),
        speed=max(float(np.abs(c.loaded.rotor_speed).max()) for c in comparisons),
    )


def _tendon(x: Array, tip: float) -> Tendon:
    return Tendon(math.exp(x[0]), math.exp(x[1]), float(x[2]) * tip)


def _parameters(tendon: Tendon) -> Array:
    return np.array([tendon.stiffness, tendon.damping, tendon.tip_friction])
