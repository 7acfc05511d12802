"""Least squares of records of known loads: sums over rows at a shape, priors, and weights.

The deviation of the friction of a stroke is integrated out stroke by stroke. With rows A of
a stroke, deviations X b, b ~ N(0, S), and white noise of variance v,

    A' (v I + X S X')^-1 A = (A'A - A'X (v S^-1 + X'X)^-1 X'A) / v.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, fields, replace

import numpy as np
from numpy.typing import NDArray

from rigtool.experiments.force_model.deviations import Deviations
from rigtool.experiments.force_model.model import (
    FIXED,
    Kind,
    Known,
    Prediction,
    RecordState,
    Shape,
    Term,
    functions,
)
from rigtool.experiments.force_model.paths import bristle
from rigtool.experiments.force_model.records import Record
from rigtool.numerics.arrays import Array

SLIDING_PARAMETERS = tuple(
    f.name for f in fields(Shape) if f.name not in ("bearing_length", "housing_length")
)
"""Parameters of a shape that sliding determines."""

SHAPE_SPREAD = {
    "tip_length": 0.7,
    "stribeck_speed": 1.0,
    "ripple_time": 1.5,
    "stiffness": 2.0,
    "damping": 1.5,
    "tip_friction": 1.0,
    "grasper_inertia": 1.0,
    "load_onset": 1.5,
    "direction_ratio": 0.2,
}
"""Prior standard deviation of the logarithm of each parameter."""

DERIVATIVE_STEP = 0.002
"""Step for derivatives by the logarithms: about the accuracy of a tendon's stiffness."""

ROWS_PER_INDEPENDENT_ROW = 30.0
"""Rows that count as one independent row: the noise of friction lasts longer than a row."""

SIZED = (Kind.COGGING, Kind.RIPPLE)
"""Kinds of waves whose prior the records size: there are many, and along a part of a turn they look
alike. Ripple by current has too few that are determined."""

SIZING_ROUNDS, LEAST_SIZE, LEAST_DETERMINED = 10, 0.01, 1.0
"""Rounds in which the priors of waves are sized; the smallest size, in parts of that before; and
the number of determined waves below which they show no size."""

LEAST_RMS = 2e-3
"""Smallest rms residual that is assumed for a record, in parts of the friction."""


@dataclass(frozen=True, eq=False)
class _Stroke:
    """A stroke's used rows `inside` those of a record, the `shapes` in which it deviates (k, rows),
    the sums of their squares (k, k), and the `variances` of the deviations (k,)."""

    inside: slice
    shapes: Array
    squares: Array
    variances: Array

    def with_noise(self, variance: float) -> Array:
        """Return v S^-1 + X'X of the module (k, k) for a variance of white noise."""
        return np.diag(variance / self.variances) + self.squares


@dataclass(frozen=True, eq=False)
class _AtShape:
    """A record at one shape: its state, the terms' functions `values` (t, n), used `rows` of them
    and, last, of what is measured (t + 1, r), sums of their `squares` (t + 1, t + 1), and products
    with each stroke's shapes (t + 1, k)."""

    state: RecordState
    values: Array
    rows: Array
    squares: Array
    crosses: list[Array]


class Problem:
    """Records, terms and priors; see the module. `friction` N m is that of the rig, about."""

    def __init__(
        self,
        records: Sequence[Record],
        terms: tuple[Term, ...],
        known: Known,
        start: Shape,
        deviation: Deviations,
        friction: float,
    ) -> None:
        self.records, self.terms, self.known = records, terms, known
        self.start, self.deviation = start, deviation
        self.friction = friction
        self.spread = np.array([term.spread for term in terms])
        self.shape_spread = np.array([SHAPE_SPREAD[name] for name in SLIDING_PARAMETERS])
        self._rows = ROWS_PER_INDEPENDENT_ROW * np.array(
            [float(record.passes) for record in records]
        )
        self.variance = (0.1 * friction) ** 2 * self._rows
        self._at_shape: dict[int, _AtShape] = {}
        self._strokes = [self._own(record) for record in records]
        self._bent = [n for n, term in enumerate(terms) if term.kind not in FIXED]

    def beside(self, terms: tuple[Term, ...]) -> Problem:
        """Return the problem with more terms; all records weigh alike."""
        return self._other(self.records, (*self.terms, *terms))

    def only(self, number: int) -> Problem:
        """Return the problem of one record alone, with the weight that all have alike."""
        return self._other(self.records[number : number + 1], self.terms)

    def _other(self, records: Sequence[Record], terms: tuple[Term, ...]) -> Problem:
        found = Problem(records, terms, self.known, self.start, self.deviation, self.friction)
        found.variance = float(np.median(self.variance / self._rows)) * found._rows
        return found

    def _at(self, number: int, shape: Shape) -> _AtShape:
        """Return a record's values at a shape; those that no shape changes are kept from the
        last."""
        record, last = self.records[number], self._at_shape.get(number)
        if last is not None and last.state.shape == shape:
            return last
        state = RecordState.of(shape, self.known, record)
        carried = state.carried / self.known.torque_factor
        right = record.rows(measured(record, self.known) - carried)[record.used]
        if last is None:
            values = functions(self.terms, state)
            rows = record.rows(values)[:, record.used]
        else:
            values, rows = last.values, last.rows[:-1]
            values[self._bent] = functions([self.terms[n] for n in self._bent], state)
            rows[self._bent] = record.rows(values[self._bent])[:, record.used]
        rows = np.vstack([rows, right])
        crosses = [rows[:, one.inside] @ one.shapes.T for one in self._strokes[number]]
        found = self._at_shape[number] = _AtShape(state, values, rows, rows @ rows.T, crosses)
        return found

    def _own(self, record: Record) -> list[_Stroke]:
        """Return the strokes of a record."""
        z = bristle(record.angle, self.start.housing_length, record.periodic)
        a = record.angle / self.known.angle_ratio
        shapes = [z * np.sin(a), z * np.cos(a)]
        variances = [self.deviation.stroke**2] * 2
        if record.moment:
            shapes.append(z * record.moment * np.abs(np.sin(a)) / self.known.torque_factor)
            variances.append(self.deviation.load**2)
        rows = record.rows(np.stack(shapes))[:, record.used]
        stroke = _strokes(record, self.start.housing_length)[record.used]
        bounds = np.flatnonzero(np.diff(stroke)) + 1
        own = np.array(variances) / max(record.cycles, 1)
        found = []
        for first, last in zip([0, *bounds], [*bounds, len(stroke)], strict=True):
            x = rows[:, int(first) : int(last)]
            found.append(_Stroke(slice(int(first), int(last)), x, x @ x.T, own))
        return found

    def derivatives(self, number: int, shape: Shape, coefficient: Array) -> Array:
        """Return the derivatives by each parameter at a record's used rows (p, r), N m."""
        moves = self._moves(number, shape, coefficient)
        return np.vstack([moves, self._at(number, shape).rows[:-1]])

    def influence(self, number: int, shape: Shape, coefficient: Array) -> tuple[Array, Array]:
        """Return how a record's used rows move the right-hand side, V^-1 X (p, r), and the
        covariance (p, p) that the deviations of its strokes give it."""
        x, v = self.derivatives(number, shape, coefficient), self.variance[number]
        deviating = np.zeros((len(x), len(x)))
        for one in self._strokes[number]:
            own = x[:, one.inside]
            own -= np.linalg.solve(one.with_noise(v), one.shapes @ own.T).T @ one.shapes
            moved = own @ one.shapes.T / v
            deviating += (moved * one.variances) @ moved.T
        return x / v, deviating

    def _moves(self, number: int, shape: Shape, coefficient: Array) -> Array:
        """Return the derivatives by the shape's logarithms at used rows."""
        at, record = self._at(number, shape), self.records[number]
        predicted = Prediction(self.terms, coefficient, at.values, shape, at.state)
        return record.rows(slopes(predicted, at.state))[:, record.used]

    def sums(self, number: int, shape: Shape, coefficient: Array | None) -> Array:
        """Return the record's normal matrix, right-hand side last, weighted.

        Where coefficients (t,) are given, the shape's derivatives come first.
        """
        at, v = self._at(number, shape), self.variance[number]
        normal, crosses, strokes = at.squares, at.crosses, self._strokes[number]
        if coefficient is not None:
            moves = self._moves(number, shape, coefficient)
            beside = moves @ at.rows.T
            normal = np.block([[moves @ moves.T, beside], [beside.T, normal]])
            crosses = [
                np.vstack([moves[:, one.inside] @ one.shapes.T, cross])
                for one, cross in zip(strokes, crosses, strict=True)
            ]
        weighted: Array = normal / v
        for one, cross in zip(strokes, crosses, strict=True):
            weighted -= cross @ np.linalg.solve(one.with_noise(v), cross.T) / v
        return weighted

    def normal(self, shape: Shape, coefficient: Array | None) -> Array:
        """Return the normal matrices of all records (records, p + 1, p + 1), see `sums`."""
        return np.stack([self.sums(n, shape, coefficient) for n in range(len(self.records))])

    def solved(
        self, normal: Array, shape: Shape, first: int, lift: float = 0.0
    ) -> tuple[Array, Array]:
        """Solve a normal matrix (p + 1, p + 1) at a shape, the `first` parameters being its step.

        A `lift` increases the diagonal elements of the step by that part of themselves, which
        shortens the step. Returns the solution (p,) and its covariance (p, p).
        """
        count = first + len(self.terms)
        scale = np.concatenate([self.shape_spread[:first], self.spread])
        away = logarithms(shape) - logarithms(self.start)
        prior = np.zeros(count)
        prior[:first] = -away[:first] / self.shape_spread[:first]
        left = normal[:count, :count] * np.outer(scale, scale) + np.eye(count)
        left[range(first), range(first)] *= 1 + lift
        right = normal[:count, count] * scale + prior
        inverse: Array = np.asarray(np.linalg.inv(left), dtype=np.float64)
        solution = scale * np.linalg.solve(left, right)
        covariance: Array = inverse * np.outer(scale, scale)
        return solution, covariance

    def size_waves(self, shape: Shape) -> None:
        """Set the priors of ripple and cogging to the size that the records show at a shape.

        With coefficients c of prior variance v and posterior variance P, those that the records
        determine count: v is multiplied by the sum of c^2 / v over that of 1 - P / v, until it
        stays (D. J. C. MacKay, Neural Computation 4(3) 415-447, 1992).
        """
        normal, first = self.normal(shape, None).sum(axis=0), self.spread
        groups = [
            [n for n, t in enumerate(self.terms) if t.kind is kind and t.spread > 0]
            for kind in SIZED
        ]
        for _ in range(SIZING_ROUNDS):
            solution, covariance = self.solved(normal, shape, 0)
            sized = self.spread.copy()
            for own in groups:
                determined = np.sum(1 - np.diag(covariance)[own] / self.spread[own] ** 2)
                shown = np.sum((solution[own] / self.spread[own]) ** 2)
                sized[own] *= math.sqrt(shown / max(determined, LEAST_DETERMINED))
            self.spread = np.clip(sized, LEAST_SIZE * first, first)
        self.terms = tuple(
            replace(term, spread=spread)
            for term, spread in zip(self.terms, self.spread.tolist(), strict=True)
        )

    def cost(self, shape: Shape) -> tuple[Array, float]:
        """Return the best coefficients (t,) at a shape, and the sum of squares, in standard
        deviations, of the residuals and of the distances of coefficients and shape from their
        priors."""
        normal = self.normal(shape, None).sum(axis=0)
        solution, _ = self.solved(normal, shape, 0)
        away = (logarithms(shape) - logarithms(self.start)) / self.shape_spread
        return solution, float(normal[-1, -1] - normal[-1, :-1] @ solution + away @ away)

    def weigh(self, shape: Shape, coefficient: Array, near: bool) -> None:
        """Weigh the records by the residuals of a model with coefficients (t,).

        All alike while the search is far off. `near` its end, a record with larger residuals than
        most is weighed by its own.
        """
        power = np.array(
            [
                float(np.mean(self.remaining(number, shape, coefficient) ** 2))
                for number in range(len(self.records))
            ]
        )
        pooled = max(float(np.median(power)), (LEAST_RMS * self.friction) ** 2)
        self.variance = np.maximum(pooled, power * near) * self._rows

    def remaining(self, number: int, shape: Shape, coefficient: Array) -> Array:
        """Return the residuals of coefficients (t,) and strokes' deviations at used rows (r,)."""
        rows, v = self._at(number, shape).rows, self.variance[number]
        left: Array = rows[-1] - coefficient @ rows[:-1]
        for one in self._strokes[number]:
            x, inside = one.shapes, one.inside
            left[inside] -= np.linalg.solve(one.with_noise(v), x @ left[inside]) @ x
        return left


def measured(record: Record, known: Known) -> Array:
    """Return the motor's torque along a record, less that of its own inertia (n,), N m."""
    current = record.current + known.offset
    return record.torque_constant * current - known.inertia * record.acceleration


def slopes(predicted: Prediction, state: RecordState) -> Array:
    """Return derivatives of a prediction by the logarithms of `SLIDING_PARAMETERS` (p, n), N m."""
    here, units = predicted.along(state), np.eye(len(SLIDING_PARAMETERS))
    moves = [
        predicted.torque(stepped_shape(state.shape, DERIVATIVE_STEP * unit)) - here
        for unit in units
    ]
    return np.stack(moves) / DERIVATIVE_STEP


def _strokes(record: Record, length: float) -> NDArray[np.intp]:
    """Return the number of the stroke at each row (rows,).

    A stroke begins at the turn after which its friction changes its side.
    """
    z = bristle(record.angle, length, record.periodic)
    sided = np.flatnonzero(np.abs(z) > 0.5)
    changes = sided[1:][np.diff(np.sign(z[sided])) != 0]
    begins = []
    for change in changes:
        sign, start = np.sign(z[change]), change
        step = np.diff(record.angle[max(0, change - round(2 / record.interval)) : change + 1])
        against = np.flatnonzero(step * sign < 0)
        if len(against):
            start = change - (len(step) - 1 - against[-1])
        begins.append(start)
    place = np.arange(record.count) * (z.size / record.count)
    return np.searchsorted(begins, place, side="right")


def logarithms(shape: Shape) -> Array:
    """Return the logarithms of a shape in the order of `SLIDING_PARAMETERS`."""
    return np.log([getattr(shape, name) for name in SLIDING_PARAMETERS])


def stepped_shape(shape: Shape, step: Array) -> Shape:
    """Return a shape whose logarithms are moved by a step (p,)."""
    values = np.exp(logarithms(shape) + step)
    return replace(shape, **dict(zip(SLIDING_PARAMETERS, values.tolist(), strict=True)))
