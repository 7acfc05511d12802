"""How the model's coefficients and shape are learned from records of known loads.

Gauss-Newton over shape (in logarithms) and coefficients together. Only the shape enters other than
linearly: a step solves the linear part again and moves the shape along the derivative of the
prediction (variable projection in L. Kaufman's form, BIT 15, 49-57, 1975). Every coefficient and
every logarithm has a normal prior.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from rigtool.errors import InsufficientDataError
from rigtool.experiments.force_model.deviations import Deviations
from rigtool.experiments.force_model.distinct_cogging import distinct_cogging
from rigtool.experiments.force_model.model import Kind, Known, Shape, Sizes, Term, terms_for
from rigtool.experiments.force_model.records import SLIDING_COUNT_RATE, Record, bristle_scale
from rigtool.experiments.force_model.sliding_problem import (
    SLIDING_PARAMETERS,
    Problem,
    stepped_shape,
)
from rigtool.experiments.force_model.sliding_scatter import moments
from rigtool.numerics.arrays import Array
from rigtool.quantity import STANDARD_GRAVITY

LONGEST_STEP = 0.7
"""Length of the longest step, in logarithms."""

ROUNDS, ENOUGH = 15, 0.3
"""Most steps, and the length of the last step, in standard deviations."""

MIN_LIFT = 0.05
"""First lift of a step that raised the cost."""

REWEIGHED_STEP = 0.3
"""Step, in logarithms, below which records have weights of their own."""

LENGTH_SPREAD = 1.0
"""Prior standard deviation of the logarithm of a bristle's length."""

TENDON_STRETCHES = np.geomspace(1e-2, 1.0, 9)
"""Stretches of the tendon under the largest load, rad: the search begins at the best."""

DAMPING_RATIO, GRASPER_HZ, LOAD_ARM = 0.1, 70.0, 0.02
"""Other values at the beginning of the search: the damping ratio under the largest load, the
resonance of the bare output, and the arm of a load, m."""


@dataclass(frozen=True, eq=False)
class LearnedModel:
    """A learned model.

    `covariance` is that of the logarithms of the shape, in the order of `SLIDING_PARAMETERS`, then
    of the coefficients; `length_u` (2,) that of the logarithms of the two bristles' lengths, which
    a search begins with: a model that was stored has none, 0.
    """

    terms: tuple[Term, ...]
    shape: Shape
    known: Known
    coefficient: Array
    covariance: Array
    length_u: Array

    def total(self, kind: Kind) -> float:
        """Return the sum of the coefficients of a kind's terms that no angle modulates."""
        own = zip(self.terms, self.coefficient, strict=True)
        return sum(float(value) for term, value in own if term.kind is kind and not term.order)


@dataclass(frozen=True, eq=False)
class SlidingFit:
    """A model `learned` from sliding, and the `problem` with its normal equations there (records,
    p + 1, p + 1), right-hand side last; `count` rad is that of the encoder."""

    learned: LearnedModel
    problem: Problem
    normal: Array
    count: float

    def learned_from(self, chosen: Sequence[bool]) -> LearnedModel:
        """Return the model that some of the records give, one step from that of all.

        `chosen` (records,) is in the order of `problem.records`.
        """
        model, normal = self.learned, self.normal[np.asarray(chosen)].sum(axis=0)
        solution, covariance = self.problem.solved(normal, model.shape, len(SLIDING_PARAMETERS))
        step = np.clip(solution[: len(SLIDING_PARAMETERS)], -LONGEST_STEP, LONGEST_STEP)
        return replace(
            model,
            shape=stepped_shape(model.shape, step),
            coefficient=solution[len(SLIDING_PARAMETERS) :],
            covariance=covariance,
        )

    def covariance_of(self, model: LearnedModel, chosen: Sequence[bool]) -> Array:
        """Return the covariance (p, p) of a model that `chosen` records give, see
        `learned_from`, as their residuals are correlated (`sliding_scatter`)."""
        own = self.problem
        priors = np.concatenate([own.shape_spread, own.spread]) ** -2.0
        return (
            model.covariance
            @ (np.diag(priors) + self.moments[np.asarray(chosen)].sum(axis=0))
            @ model.covariance
        )

    @cached_property
    def moments(self) -> Array:
        """Covariance of each record's right-hand side (records, p, p)."""
        learned = self.learned
        return moments(self.problem, learned.shape, learned.coefficient, self.count)

    def moved_by(self, records: Sequence[Record], known: Known) -> Array:
        """Return the change of the logarithms of the shape (p,), to first order, if loads and rig
        are others than stated."""
        own, model = self.problem, self.learned
        other = Problem(records, own.terms, known, own.start, own.deviation, own.friction)
        other.variance = own.variance
        there, here = (
            own.solved(normal.sum(axis=0), model.shape, len(SLIDING_PARAMETERS))[0]
            for normal in (other.normal(model.shape, model.coefficient), self.normal)
        )
        return (there - here)[: len(SLIDING_PARAMETERS)]


def learn_sliding(
    records: Sequence[Record], known: Known, count: float, deviation: Deviations
) -> SlidingFit:
    """Learn from records of known loads; `count` rad is that of the encoder.

    Raises `InsufficientDataError` where nothing slides in any record.
    """
    if not any(record.used.any() for record in records):
        raise InsufficientDataError(
            "the rotor never slides evenly in the recordings: learn at higher speeds"
        )
    records = [record for record in records if record.used.any()]
    sizes = sizes_of(records)
    terms = terms_for(sizes, known)
    bristle = bristle_scale(max(float(np.ptp(record.angle)) for record in records), count)
    tried = [_start(sizes, known, count, bristle, stretch) for stretch in TENDON_STRETCHES.tolist()]
    showing = _showing_tendon(records)
    scan = Problem(showing, terms, known, tried[0], deviation, sizes.friction)
    shape = min(tried, key=lambda shape: scan.cost(shape)[1])
    problem = Problem(records, terms, known, shape, deviation, sizes.friction)
    shape, _ = _searched(problem, shape)
    while found := distinct_cogging(problem, shape, sizes.ripple):
        terms, shape = found
        problem = problem.beside(terms)
        shape, _ = _searched(problem, shape)
    problem.size_waves(shape)
    shape, coefficient = _searched(problem, shape)
    normal = problem.normal(shape, coefficient)
    _, covariance = problem.solved(normal.sum(axis=0), shape, len(SLIDING_PARAMETERS))
    learned = LearnedModel(
        problem.terms, shape, known, coefficient, covariance, np.full(2, LENGTH_SPREAD)
    )
    return SlidingFit(learned, problem, normal, count)


def _searched(problem: Problem, shape: Shape) -> tuple[Shape, Array]:
    """Return the shape of least cost near one, and its coefficients (t,).

    A step that raises the cost is repeated, shorter (D. W. Marquardt, J. SIAM 11(2), 431, 1963):
    where a load swings with little damping, the model is linear over a small part of a step only.
    Once near its end, records keep weights of their own: otherwise the search would alternate
    between those and equal weights.
    """
    count, lift, near = len(SLIDING_PARAMETERS), 0.0, False
    coefficient, cost = problem.cost(shape)
    for _ in range(ROUNDS):
        normal = problem.normal(shape, coefficient).sum(axis=0)
        solution, covariance = problem.solved(normal, shape, count)
        enough = ENOUGH * np.sqrt(np.diag(covariance))[:count]
        while True:
            lifted = solution if not lift else problem.solved(normal, shape, count, lift)[0]
            step = np.clip(lifted[:count], -LONGEST_STEP, LONGEST_STEP)
            there = stepped_shape(shape, step)
            coefficient_there, cost_there = problem.cost(there)
            # without any number that is larger: NaN ends the search as well
            if cost_there < cost or not np.any(np.abs(step) >= enough):
                break
            lift = max(4 * lift, MIN_LIFT)
        if cost_there < cost:
            shape, coefficient = there, coefficient_there
        ended = not np.any(np.abs(step) >= enough)
        if ended and near:
            break
        lift /= 4
        near = near or ended or bool(np.all(np.abs(step) < REWEIGHED_STEP))
        problem.weigh(shape, coefficient, near)
        coefficient, cost = problem.cost(shape)
    return shape, coefficient


def _showing_tendon(records: Sequence[Record]) -> list[Record]:
    """Return the records that show a tendon: the largest load, and equal strokes without load."""
    largest = max(record.moment for record in records)
    sizes = {record.angle.size for record in records if record.moment == largest}
    return [r for r in records if r.moment in (0.0, largest) and r.angle.size in sizes]


def sizes_of(records: Sequence[Record]) -> Sizes:
    """Return the sizes to which priors are relative, from the records.

    Raises `InsufficientDataError` where none without load slides in both directions.
    """
    friction, ripple = [], []
    for record in records:
        if record.moment:
            continue
        torque = record.rows(record.torque_constant * record.current)[record.used]
        up = record.rows(record.speed)[record.used] > 0
        if up.any() and not up.all():
            friction.append(float(torque[up].mean() - torque[~up].mean()) / 2)
            ripple.append(float(torque[up].std() + torque[~up].std()) / 2)
    if not friction:
        raise InsufficientDataError(
            "no recording without load slides in both directions: record strokes without load"
        )
    return Sizes(
        friction=float(np.median(friction)),
        ripple=float(np.median(ripple)),
        load=max(record.moment for record in records),
        current=max(float(np.abs(record.current).max()) for record in records),
        speed=max(float(np.abs(record.speed).max()) for record in records),
    )


def _start(sizes: Sizes, known: Known, count: float, bristle: float, stretch: float) -> Shape:
    """Return the shape at which the search begins, from the sizes of the rig.

    `bristle` rad is the length of the short bristle, `stretch` rad that of the tendon under the
    largest load.
    """
    load = sizes.load or sizes.friction * known.torque_factor
    stiffness = load / stretch
    return Shape(
        bearing_length=bristle,
        housing_length=6 * bristle,
        tip_length=6 * count,
        stribeck_speed=2 * SLIDING_COUNT_RATE * count,
        ripple_time=0.03,
        stiffness=stiffness,
        damping=2 * DAMPING_RATIO * math.sqrt(stiffness * load * LOAD_ARM / STANDARD_GRAVITY),
        tip_friction=0.1 * sizes.friction,
        grasper_inertia=stiffness / (2 * math.pi * GRASPER_HZ) ** 2,
        load_onset=load / 64,
    )
