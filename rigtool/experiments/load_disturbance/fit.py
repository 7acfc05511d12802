"""Fit of the disturbance of a load to recordings at known loads.

Stiffness, damping and friction of the tendon enter as they are, coefficients linearly: least
squares over the first three, the rest being solved for at each step (variable projection: G. H.
Golub and V. Pereyra, SIAM J. Numer. Anal. 10(2) 413-432, 1973). Each coefficient has a spread, see
`terms`, which acts as one more observation of zero: where the data do not determine a coefficient,
it stays near zero, with an uncertainty near its spread.

What changes from one recording to the next (the friction level of each direction: 'instrument
friction changes in time') is fitted for each recording and dropped; so is the scatter of the cycles
without load, which all loads of a speed have in common.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from scipy import constants

from rigtool.experiments.load_disturbance.model import (
    Disturbance,
    LoadedPair,
    state_under,
    tendon_parameters,
)
from rigtool.experiments.load_disturbance.tendon import Tendon
from rigtool.experiments.load_disturbance.terms import Sizes, State, Term, depends_on_load, terms
from rigtool.numerics.arrays import Array

MODEL_ERROR = 2e-3
"""Error of the model at a single point, relative to the peak of a load."""

SOFTEST, STIFFEST = 1.0, 1e-3
"""Stretch of the tendon under the largest load with which the search begins and ends, rad."""

SCANNED_STIFFNESSES = 13
"""Number of stiffnesses between these at which the search begins."""

DAMPING, DAMPING_SPREAD = 0.1, 1.5
"""Damping ratio of the largest load that the search starts with, and its logarithm's spread."""

TIP_FRICTION = 0.1
"""Friction of the far joint that the search starts with, and its spread, in parts of the friction
without load."""

STEP = 1e-3
"""For derivatives by the tendon's parameters, relative to what the search starts with."""


def fit_disturbance(pairs: Sequence[LoadedPair], moments: Sequence[float]) -> Disturbance:
    """Learn from pairs whose loads have these moments, N m.

    The loads of one speed are compared with one and the same motion without load.
    """
    problem = _Problem(pairs, moments)
    tendon = problem.fit()
    coefficient, covariance = problem.solution(tendon)
    return Disturbance(problem.terms, tendon, coefficient, covariance, max(moments), problem.speeds)


def refit_disturbance(
    disturbance: Disturbance, pairs: Sequence[LoadedPair], moments: Sequence[float]
) -> Disturbance:
    """Learn the coefficients again with the same tendon from other, or fewer, pairs."""
    problem = _Problem(pairs, moments, disturbance.terms)
    coefficient, covariance = problem.solution(disturbance.tendon)
    return Disturbance(
        problem.terms, disturbance.tendon, coefficient, covariance, max(moments), problem.speeds
    )


class _Problem:
    """Rows of all pairs, weighted; columns: terms, and what a recording has by itself."""

    def __init__(
        self,
        pairs: Sequence[LoadedPair],
        moments: Sequence[float],
        listed: tuple[Term, ...] | None = None,
    ) -> None:
        self.pairs, self.moments = pairs, moments
        self.sizes = sizes_of(pairs, moments)
        self.speeds = tuple(sorted({c.loaded.speed for c in pairs}))
        self.terms = terms(self.sizes, self.speeds) if listed is None else listed
        self._moving = np.array([depends_on_load(term) for term in self.terms])
        self._weight, self._rows, spread = [], [], []
        for pair, moment in zip(pairs, moments, strict=True):
            sigma = math.hypot(pair.noise(), MODEL_ERROR * moment)
            share = pair.independent / len(pair.rows)
            self._weight.append(math.sqrt(share) / sigma)
            self._rows.append(len(pair.rows))
            spread += [pair.scatter()] * 3
        zeros = {each.loaded.speed: each.zero_noise() for each in pairs}
        self._zero = {speed: number for number, speed in enumerate(zeros)}
        self._spread = np.array([t.spread for t in self.terms] + spread + list(zeros.values()))
        self._still = self._still_part()
        self._right = np.concatenate(
            [
                weight * pair.torque[pair.rows]
                for weight, pair in zip(self._weight, pairs, strict=True)
            ]
        )
        self._basis = self._projection()

    def _still_part(self) -> Array:
        """Return the columns that do not depend on the tendon, (rows, columns)."""
        count = len(self.terms)
        matrix = np.zeros((sum(self._rows), len(self._spread)))
        first = 0
        still = [t for t, moves in zip(self.terms, self._moving, strict=True) if not moves]
        for number, pair in enumerate(self.pairs):
            block = matrix[first : (first := first + self._rows[number])]
            rest = np.zeros(len(pair.loaded.setpoint))
            states = [State.of(c, rest, rest) for c in (pair.loaded, pair.unloaded[0])]
            rows = pair.rows
            block[:, np.flatnonzero(~self._moving)] = pair.design(still, *states)[:, rows].T
            own = count + 3 * number
            block[:, own : own + 3] = pair.nuisance[:, rows].T
            zero = count + 3 * len(self.pairs)
            zero += self._zero[pair.loaded.speed]
            block[:, zero] = pair.zero_error[rows]
            block *= self._weight[number]
        return matrix

    def moving_part(self, tendon: Tendon) -> tuple[Array, Array]:
        """Return the columns that depend on the tendon, and the right-hand side, weighted."""
        moving = [t for t, moves in zip(self.terms, self._moving, strict=True) if moves]
        columns, right = np.empty((len(self._right), len(moving))), self._right.copy()
        rest = {
            speed: state_under(cycles, tendon, 0.0)
            for speed, cycles in {c.loaded.speed: c.unloaded[0] for c in self.pairs}.items()
        }
        first = 0
        for number, (each, moment) in enumerate(zip(self.pairs, self.moments, strict=True)):
            here = slice(first, first := first + self._rows[number])
            loaded, unloaded = state_under(each.loaded, tendon, moment), rest[each.loaded.speed]
            rows, weight = each.rows, self._weight[number]
            columns[here] = weight * each.design(moving, loaded, unloaded)[:, rows].T
            right[here] -= weight * each.loaded.lowpass(loaded.carried - unloaded.carried)[rows]
        return columns, right

    def system(self, tendon: Tendon) -> tuple[Array, Array]:
        """Return matrix and right-hand side, weighted, for a tendon."""
        matrix = self._still.copy()
        matrix[:, np.flatnonzero(self._moving)], right = self.moving_part(tendon)
        return matrix, right

    def _projection(self) -> Array:
        """Return an orthonormal basis of the still columns with their spreads' rows below."""
        still = np.ones(len(self._spread), dtype=bool)
        still[np.flatnonzero(self._moving)] = False
        scaled = (self._still * self._spread)[:, still]
        basis: Array = np.linalg.qr(np.vstack([scaled, np.eye(scaled.shape[1])]))[0]
        return basis

    def residual(self, tendon: Tendon) -> Array:
        """Return what is left of the right-hand side, spreads included: least squares' own length.

        The still columns are projected out; what remains is a small problem.
        """
        moving, right = self.moving_part(tendon)
        count = moving.shape[1]
        block = np.zeros((len(self._basis), count + 1))
        block[: len(right), :count] = moving * self._spread[: len(self.terms)][self._moving]
        block[: len(right), count] = right
        block -= self._basis @ (self._basis.T @ block)
        matrix = np.vstack([block[:, :count], np.eye(count)])
        target = np.concatenate([block[:, count], np.zeros(count)])
        left: Array = target - matrix @ np.linalg.lstsq(matrix, target)[0]
        return left

    def fit(self) -> Tendon:
        """Return the tendon with the least sum of squares."""
        from scipy.optimize import least_squares

        load, tip = self.sizes.load, TIP_FRICTION * self.sizes.friction
        inertia = load * self.pairs[0].loaded.transmission.arm / constants.g
        tried = [
            Tendon(k, 2 * DAMPING * math.sqrt(k * inertia), tip)
            for k in (load / np.geomspace(STIFFEST, SOFTEST, SCANNED_STIFFNESSES)).tolist()
        ]
        start = min(tried, key=lambda each: float(np.sum(self.residual(each) ** 2)))

        def there(x: Array) -> Tendon:
            stiffness, damping = start.stiffness * math.exp(x[0]), start.damping * math.exp(x[1])
            return Tendon(stiffness, damping, float(1 + x[2]) * tip)

        def cost(x: Array) -> Array:
            return np.append(self.residual(there(x)), [x[1] / DAMPING_SPREAD, x[2]])

        def slopes(x: Array) -> Array:
            here = cost(x)
            return np.column_stack([(cost(x + step) - here) / STEP for step in STEP * np.eye(3)])

        found = least_squares(
            cost,
            np.zeros(3),
            jac=slopes,
            bounds=([-np.inf, -np.inf, -1.0], np.inf),
            xtol=1e-4,
            ftol=1e-5,
        )
        return there(found.x)

    def solution(self, tendon: Tendon) -> tuple[Array, Array]:
        """Return the coefficients and the covariance of tendon and coefficients together.

        Where residuals are larger than scatter and model error explain, they count.
        """
        matrix, right = self.system(tendon)
        scaled = matrix * self._spread
        normal = scaled.T @ scaled + np.eye(len(self._spread))
        value = self._spread * np.linalg.solve(normal, scaled.T @ right)
        left = right - matrix @ value
        parameters, tip = tendon_parameters(tendon), TIP_FRICTION * self.sizes.friction
        size = np.array([parameters[0], parameters[1], tip])
        slopes = []
        for number in range(3):
            moved = parameters.copy()
            moved[number] += STEP * size[number]
            matrix_there, right_there = self.system(Tendon(*moved.tolist()))
            slopes.append((left - right_there + matrix_there @ value) / STEP)
        whole = np.column_stack([*slopes, scaled])
        known = np.concatenate([[0.0, 1 / DAMPING_SPREAD, 1.0], np.ones(len(self._spread))])
        every = np.concatenate([size, self._spread])
        normal = whole.T @ whole + np.diag(known**2)
        covariance = np.linalg.inv(normal) * np.outer(every, every)
        chi2 = float(np.sum(left**2)) / sum(c.independent for c in self.pairs)
        kept = 3 + len(self.terms)
        return value[: len(self.terms)], max(1.0, chi2) * covariance[:kept, :kept]


def sizes_of(pairs: Sequence[LoadedPair], moments: Sequence[float]) -> Sizes:
    """Return what spreads are relative to, from the cycles themselves."""
    friction, ripple = [], []
    for pair in pairs:
        cycles, rows = pair.unloaded[0], pair.rows
        torque = cycles.lowpass(pair.unloaded_torque)[rows]
        direction = cycles.turning[rows]
        up, down = torque[direction > 0], torque[direction < 0]
        friction.append((up.mean() - down.mean()) / 2)
        ripple.append(float(np.std(up) + np.std(down)) / 2)
    return Sizes(
        load=max(moments),
        friction=max(float(np.mean(friction)), MODEL_ERROR * max(moments)),
        ripple=max(float(np.mean(ripple)), MODEL_ERROR * max(moments)),
        current=max(float(np.abs(c.loaded.current).max()) for c in pairs),
        speed=max(float(np.abs(c.loaded.rotor_speed).max()) for c in pairs),
    )
