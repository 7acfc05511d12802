"""Sums, residuals and costs of sliding, against generalised least squares with whole matrices."""

import math
from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose

from rigtool.experiments.force_model.deviations import Deviations
from rigtool.experiments.force_model.model import (
    Kind,
    Known,
    Prediction,
    RecordState,
    Shape,
    Term,
    functions,
)
from rigtool.experiments.force_model.paths import bristle
from rigtool.experiments.force_model.sliding_problem import (
    LEAST_RMS,
    SHAPE_SPREAD,
    SLIDING_PARAMETERS,
    Problem,
    logarithms,
    measured,
    slopes,
    stepped_shape,
)
from tests.experiments.force_model import known_plant as plant

KNOWN = Known(plant.RATIO, plant.FACTOR, plant.INERTIA, 2e-3)
SHAPE = Shape(0.02, 0.1, 0.01, 2.0, 0.05, 0.3, 1e-3, 1e-3, 1e-6, 1.5e-3)
DEVIATION = Deviations(3e-4, 0.02, 1e-4, 0.1)
FRICTION = 12e-3
TERMS = (
    Term(Kind.OFFSET, 1e-4),
    Term(Kind.VISCOUS, 1e-3),
    Term(Kind.BEARING, 1e-2),
    Term(Kind.LOAD_FRICTION, 0.3),
    Term(Kind.RIPPLE, 1e-3, 2, 0),
)
COEFFICIENT = np.array([5e-5, 1.4e-4, 11e-3, 0.12, 7e-4])
COUNT = len(SLIDING_PARAMETERS)


@pytest.fixture(scope="module")
def problem():
    records = [
        plant.strokes(moment, 4.0, cycles=cycles, noise=(1e-4, 0.1), seed=cycles)
        for moment, cycles in ((0.0, 3), (40e-3, 5))
    ]
    records[1] = replace(records[1], passes=2)
    return Problem(records, TERMS, KNOWN, SHAPE, DEVIATION, FRICTION)


def covariance(problem, number):
    """Return the covariance of the noise of a record's used rows: white, and of each stroke that of
    what it draws, less by the cycles that were averaged."""
    record = problem.records[number]
    z = bristle(record.angle, SHAPE.housing_length, record.periodic)
    output = record.angle / KNOWN.angle_ratio
    shapes = [z * np.sin(output), z * np.cos(output)]
    spreads = [DEVIATION.stroke, DEVIATION.stroke]
    if record.moment:
        shapes.append(z * np.abs(record.moment * np.sin(output)) / KNOWN.torque_factor)
        spreads.append(DEVIATION.load)
    rows = record.rows(np.stack(shapes))[:, record.used]
    whole = problem.variance[number] * np.eye(rows.shape[1])
    own = problem._strokes[number]
    assert 2 <= len(own) <= 3
    assert sum(one.shapes.shape[1] for one in own) == rows.shape[1]
    for stroke in own:
        part = stroke.inside
        drawn = rows[:, part].T * np.array(spreads)
        whole[part, part] += drawn @ drawn.T / record.cycles
    return whole


def rows_of(problem, number):
    """Return the derivatives by coefficients and what is measured, at used rows (t + 1, r)."""
    record = problem.records[number]
    state = RecordState.of(SHAPE, KNOWN, record)
    own = KNOWN.inertia * record.acceleration
    right = record.torque_constant * (record.current + KNOWN.offset) - own
    values = np.vstack([functions(TERMS, state), right - state.carried / KNOWN.torque_factor])
    return record.rows(values)[:, record.used]


def test_white_noise_is_a_tenth_of_the_friction_of_few_independent_rows(problem):
    assert_allclose(problem.variance, (0.1 * FRICTION) ** 2 * 30 * np.array([1, 2]))


@pytest.mark.parametrize("number", [0, 1])
def test_sums_are_those_with_the_whole_covariance(problem, number):
    rows, whole = rows_of(problem, number), covariance(problem, number)
    expected = rows @ np.linalg.solve(whole, rows.T)
    assert_allclose(problem.sums(number, SHAPE, None), expected, rtol=1e-6)


@pytest.mark.parametrize("number", [0, 1])
def test_the_influence_of_rows_is_that_with_the_whole_covariance(problem, number):
    """Along a stroke's deviation a row moves little, as least squares does not trust it there."""
    x, whole = problem.derivatives(number, SHAPE, COEFFICIENT), covariance(problem, number)
    expected = np.linalg.solve(whole, x.T).T
    strokes = whole - problem.variance[number] * np.eye(len(whole))
    found, deviating = problem.influence(number, SHAPE, COEFFICIENT)
    size = np.abs(expected).max(axis=1, keepdims=True)
    assert_allclose(found / size, expected / size, rtol=1e-5, atol=1e-8)
    scale = np.sqrt(np.diag(expected @ strokes @ expected.T))
    each = np.outer(scale, scale)
    assert_allclose(deviating / each, expected @ strokes @ expected.T / each, atol=1e-5)


@pytest.mark.parametrize("number", [0, 1])
def test_the_shape_comes_first_in_sums_with_its_derivatives(problem, number):
    rows, whole = rows_of(problem, number), covariance(problem, number)
    every = np.vstack([problem.derivatives(number, SHAPE, COEFFICIENT), rows[-1]])
    assert every.shape[0] == COUNT + len(TERMS) + 1
    assert_allclose(every[COUNT:], rows, rtol=1e-9, atol=1e-15)
    expected = every @ np.linalg.solve(whole, every.T)
    scale = np.sqrt(np.diag(expected))
    found = problem.sums(number, SHAPE, COEFFICIENT)
    assert_allclose(found / np.outer(scale, scale), expected / np.outer(scale, scale), atol=1e-7)


def test_derivatives_are_those_of_the_prediction(problem):
    """Central differences over a few thousandths of a logarithm."""
    at = problem._at(1, SHAPE)
    predicted = Prediction(TERMS, COEFFICIENT, at.values, SHAPE, at.state)
    found = slopes(predicted, at.state)
    for number, name in enumerate(SLIDING_PARAMETERS):
        unit = 0.002 * np.eye(COUNT)[number]
        ends = [predicted.torque(stepped_shape(SHAPE, way * unit)) for way in (1, -1)]
        central = (ends[0] - ends[1]) / 0.004
        size = max(np.abs(central).max(), 1e-7)
        assert_allclose(found[number], central, atol=0.03 * size, err_msg=name)


@pytest.mark.parametrize("number", [0, 1])
def test_what_remains_is_the_white_part_of_the_residuals(problem, number):
    """The best guess of white noise w in e = w + s is v V^-1 e, as all is normal."""
    rows, whole = rows_of(problem, number), covariance(problem, number)
    left = rows[-1] - COEFFICIENT @ rows[:-1]
    expected = problem.variance[number] * np.linalg.solve(whole, left)
    found = problem.remaining(number, SHAPE, COEFFICIENT)
    assert_allclose(found, expected, atol=1e-6 * np.abs(left).max())


def test_the_solution_is_the_mean_under_the_priors(problem):
    """Of coefficients alone, and with a step of the shape from a place away from its own prior."""
    spread = np.array([term.spread for term in TERMS])
    normal = problem.normal(SHAPE, None).sum(axis=0)
    found, u2 = problem.solved(normal, SHAPE, 0)
    expected = np.linalg.inv(normal[:-1, :-1] + np.diag(1 / spread**2))
    assert_allclose(u2, expected, rtol=1e-6)
    assert_allclose(found, expected @ normal[:-1, -1], rtol=1e-6)

    shape_spread = np.array([SHAPE_SPREAD[name] for name in SLIDING_PARAMETERS])
    away = 0.1 * np.arange(1, COUNT + 1)
    there = stepped_shape(SHAPE, away)
    normal = problem.normal(there, COEFFICIENT).sum(axis=0)
    for lift in (0.0, 3.0):
        found, u2 = problem.solved(normal, there, COUNT, lift)
        prior = np.diag(np.concatenate([1 / shape_spread**2, 1 / spread**2]))
        whole = normal[:-1, :-1] + prior
        whole[range(COUNT), range(COUNT)] *= 1 + lift
        right = normal[:-1, -1].copy()
        right[:COUNT] -= away / shape_spread**2
        inverse = np.linalg.inv(whole)
        scale = np.sqrt(np.diag(inverse))
        assert_allclose(u2 / np.outer(scale, scale), inverse / np.outer(scale, scale), atol=1e-5)
        assert_allclose(found / scale, inverse @ right / scale, rtol=1e-4, atol=1e-5)


def test_the_cost_is_the_sum_of_squares_of_residuals_and_priors(problem):
    away = 0.1 * np.arange(1, COUNT + 1)
    shape_spread = np.array([SHAPE_SPREAD[name] for name in SLIDING_PARAMETERS])
    solution, cost = problem.cost(SHAPE)
    expected = 0.0
    for number in range(2):
        rows = rows_of(problem, number)
        left = rows[-1] - solution @ rows[:-1]
        expected += left @ np.linalg.solve(covariance(problem, number), left)
    expected += np.sum((solution / np.array([term.spread for term in TERMS])) ** 2)
    assert cost == pytest.approx(expected, rel=1e-6)
    there = stepped_shape(SHAPE, away)
    begun = Problem(problem.records, TERMS, KNOWN, there, DEVIATION, FRICTION)
    # the same data at the same place, with a prior that is elsewhere or there
    begun._strokes = problem._strokes
    assert problem.cost(there)[1] - begun.cost(there)[1] == pytest.approx(
        np.sum((away / shape_spread) ** 2), rel=1e-6
    )
    problem.cost(SHAPE)


def test_waves_of_a_kind_get_the_size_of_those_that_the_records_determine():
    """What is learned of them over the prior is then as much as they are determined."""
    waves = [Term(Kind.COGGING, 0.01, order, quarter) for order in (1, 3, 5) for quarter in (0, 1)]
    record = plant.strokes(0.0, 4.0, cycles=3, noise=(1e-4, 0.1), seed=3)
    felt = sum(1e-3 * np.cos(order * record.angle + order) for order in (1, 3, 5))
    records = [replace(record, current=record.current + felt / record.torque_constant)]
    problem = Problem(records, (*TERMS[:4], *waves), KNOWN, SHAPE, DEVIATION, FRICTION)
    before = problem.spread.copy()
    problem.size_waves(SHAPE)
    assert_allclose(problem.spread[:4], before[:4])
    ratio = problem.spread[4:] / before[4:]
    assert_allclose(ratio, ratio[0])
    assert 0.03 < ratio[0] < 0.2
    assert [term.spread for term in problem.terms] == problem.spread.tolist()
    solution, left = problem.solved(problem.normal(SHAPE, None).sum(axis=0), SHAPE, 0)
    prior = problem.spread[4:] ** 2
    determined = np.sum(1 - np.diag(left)[4:] / prior)
    assert 1 < determined < 6
    assert np.sum(solution[4:] ** 2 / prior) == pytest.approx(determined, rel=0.02)


def test_records_are_weighed_alike_until_the_end_where_larger_residuals_count_less(problem):
    before, own = problem.variance.copy(), problem._rows
    power = [np.mean(problem.remaining(n, SHAPE, COEFFICIENT) ** 2) for n in range(2)]
    assert power[1] != pytest.approx(power[0], rel=0.2)
    middle = np.median(power)
    assert middle > (LEAST_RMS * FRICTION) ** 2
    problem.weigh(SHAPE, COEFFICIENT, False)
    assert_allclose(problem.variance, middle * own)
    problem.variance = before.copy()
    problem.weigh(SHAPE, COEFFICIENT, True)
    assert_allclose(problem.variance, np.maximum(middle, power) * own)
    problem.variance, problem.friction = before.copy(), 1e3
    problem.weigh(SHAPE, COEFFICIENT, True)
    assert_allclose(problem.variance, (LEAST_RMS * 1e3) ** 2 * own)
    problem.variance, problem.friction = before, FRICTION


def test_what_is_measured_is_the_torque_of_the_current_less_the_rotors_own(problem):
    record = problem.records[1]
    expected = plant.CONSTANT * (record.current + 2e-3) - plant.INERTIA * record.acceleration
    assert_allclose(measured(record, KNOWN), expected, rtol=1e-12)


def test_shapes_move_by_their_logarithms():
    step = np.linspace(-0.5, 0.5, COUNT)
    found = stepped_shape(SHAPE, step)
    for name, by in zip(SLIDING_PARAMETERS, step, strict=True):
        assert getattr(found, name) == pytest.approx(getattr(SHAPE, name) * math.exp(by))
    assert (found.bearing_length, found.housing_length) == (0.02, 0.1)
    assert_allclose(logarithms(found) - logarithms(SHAPE), step, atol=1e-12)
