"""The search of `rest` where errors are a known function of the parameters."""

import math
from types import SimpleNamespace

import numpy as np
import pytest
from numpy.testing import assert_allclose

from rigtool.experiments.force_model import rest
from rigtool.experiments.force_model.learning import LearnedModel
from rigtool.experiments.force_model.model import Kind, Known, Shape, Term
from rigtool.experiments.force_model.rest import (
    ANGLE_ERROR,
    BY_REST,
    FILTER_SETTLING_TIME,
    HUBER_THRESHOLD,
    LEAST_INFORMED,
    SHARES,
    UNTOUCHED_RANDOM_WALK,
    Exploration,
    PredictionProblem,
    held,
    plant_is_sound,
)
from rigtool.experiments.force_model.sliding_problem import SLIDING_PARAMETERS
from tests.experiments.force_filter.plants import UNCERTAINTY

SHAPE = Shape(2e-3, 8e-3, 5e-3, 0.3, 0.03, 0.2, 8e-4, 1e-3, 2e-6, 1.8e-3)
TERMS = tuple(
    Term(kind, 1.0)
    for kind in (Kind.OFFSET, Kind.BEARING, Kind.STRIBECK, Kind.BEARING_DAMPING, Kind.HOUSING)
)
COEFFICIENT = np.array([1e-4, 2e-3, 1e-3, 5e-7, 9e-3])
SIZE = len(SLIDING_PARAMETERS) + len(TERMS)
STEP = 1e-3


def learned():
    rng = np.random.default_rng(1)
    deviations = np.concatenate([0.3 * np.ones(len(SLIDING_PARAMETERS)), 0.1 * COEFFICIENT])
    root = deviations[:, None] * (np.eye(SIZE) + 0.2 * rng.standard_normal((SIZE, SIZE)))
    known = Known(0.85, 1.18, 2e-5)
    return LearnedModel(TERMS, SHAPE, known, COEFFICIENT, root @ root.T, np.array([0.5, 0.4]))


def problem(count=1e-3, length=9):
    own = Exploration(np.zeros(length), np.zeros(length), STEP, 0.05, count, STEP)
    return PredictionProblem(learned(), [own], UNCERTAINTY, BY_REST)


def linear(own, truth, slopes):
    """Let errors grow evenly with the distance from a truth."""
    own.errors = lambda parameters: slopes @ (parameters - truth)
    return own


def test_parameters_are_the_lengths_and_what_rest_shows():
    own = problem()
    assert_allclose(own.start[:2], np.log([2e-3, 8e-3]))
    assert_allclose(own.start[2:4], np.log([5e-3, 0.3]))
    assert_allclose(own.start[4:], COEFFICIENT[1:])
    assert own.friction == pytest.approx(2e-3 + 9e-3)
    assert_allclose(np.diag(own.covariance)[:2], [0.25, 0.16])
    assert_allclose(own.covariance[2:, 2:], learned().covariance[np.ix_(own.shown, own.shown)])
    assert_allclose(own.parameters(learned()), own.start)


def test_other_parameters_follow_by_their_covariance():
    """As the mean of a normal distribution does, given those that are shown."""
    own, before = problem(), learned()
    moved = own.start + np.array([0.1, -0.2, 0.05, -0.1, 1e-4, -1e-4, 1e-8, 5e-4])
    found = own.model(moved)
    assert_allclose(own.parameters(found), moved, rtol=1e-9)
    c = before.covariance
    away = (
        c[:, own.shown] @ np.linalg.inv(c[np.ix_(own.shown, own.shown)]) @ (moved - own.start)[2:]
    )
    offset = SIZE - len(TERMS)
    assert found.coefficient[0] == pytest.approx(COEFFICIENT[0] + away[offset])
    stiffness = SLIDING_PARAMETERS.index("stiffness")
    assert math.log(found.shape.stiffness / SHAPE.stiffness) == pytest.approx(away[stiffness])


@pytest.mark.parametrize("far", [0.5, 6.0])
def test_the_solution_is_the_mean_of_errors_and_prior(far):
    """Errors of `ANGLE_ERROR` count as one deviation; a step has a limit, a way has none."""
    own, rng = problem(), np.random.default_rng(2)
    size = len(own.start)
    deviation = np.sqrt(np.diag(own.covariance))
    truth = own.start + far * deviation * rng.choice([-1, 1], size)
    # errors stay small against the threshold of Huber's weights
    slopes = 0.02 * ANGLE_ERROR / far * rng.standard_normal((4000, size)) / deviation
    found = linear(own, truth, slopes).solution([])
    normal = slopes.T @ slopes / ANGLE_ERROR**2
    u2 = np.linalg.inv(normal + np.linalg.inv(own.covariance))
    expected = own.start + u2 @ normal @ (truth - own.start)
    assert_allclose((own.parameters(found) - expected) / deviation, 0, atol=0.02 * max(far, 1))
    assert_allclose(found.length_u, np.sqrt(np.diag(u2)[:2]), rtol=0.03)
    before, shown = learned().covariance, own.shown
    gain = before[:, shown] @ np.linalg.inv(before[np.ix_(shown, shown)])
    left = before + gain @ (u2[2:, 2:] - before[np.ix_(shown, shown)]) @ gain.T
    spread = np.sqrt(np.diag(before))
    assert_allclose(
        found.covariance / np.outer(spread, spread), left / np.outer(spread, spread), atol=0.02
    )


def test_large_errors_count_by_their_size_and_not_by_its_square():
    """One parameter in the mean of errors, of which some are far off: the mean by Huber's weights
    1 / sqrt(1 + (e / (2 scale))^2)."""
    own, rng = problem(), np.random.default_rng(3)
    errors = ANGLE_ERROR * np.concatenate(
        [rng.standard_normal(3000), 40 + rng.standard_normal(300)]
    )
    slope = 20 * ANGLE_ERROR / math.sqrt(own.covariance[0, 0])
    own.errors = lambda parameters: errors - slope * (parameters[0] - own.start[0])
    found = math.log(own.solution([]).shape.bearing_length) - own.start[0]
    here = 0.0
    for _ in range(500):
        left = errors - slope * here
        weight = 1 / np.hypot(1, left / ANGLE_ERROR / HUBER_THRESHOLD)
        normal = weight.sum() * slope**2 / ANGLE_ERROR**2
        right = weight @ errors * slope / ANGLE_ERROR**2
        here = right / (normal + 1 / own.covariance[0, 0])
    assert found == pytest.approx(here, rel=0.05)
    assert here < 0.3 * errors.mean() / slope


def test_motions_too_short_to_show_anything_leave_what_was_learned():
    """Of strokes that end before the filter has settled, no error is left."""
    own = problem()
    own.errors = lambda parameters: np.zeros(0)
    found = own.solution([])
    assert_allclose(own.parameters(found), own.start)
    assert_allclose(found.covariance, learned().covariance)


def test_the_search_begins_at_the_best_place():
    """Errors with two valleys: the one that another begin lies in is deeper."""
    own = problem()
    deviation = math.sqrt(own.covariance[0, 0])

    def errors(parameters):
        x = (parameters[0] - own.start[0]) / deviation
        depth = np.minimum(np.abs(x) + 0.5, 4 * np.abs(x - 1.5))
        return ANGLE_ERROR * depth * np.ones(30)

    own.errors = errors
    other = own.start.copy()
    other[0] += 1.4 * deviation
    there = (own.parameters(own.solution([other]))[0] - own.start[0]) / deviation
    assert there == pytest.approx(1.5, abs=0.1)


def test_impossible_parameters_are_stepped_around():
    """Where one side has no errors, slopes come from the other one and steps are shorter."""
    own, rng = problem(), np.random.default_rng(4)
    deviation = np.sqrt(np.diag(own.covariance))
    slopes = 0.02 * ANGLE_ERROR * rng.standard_normal((4000, len(own.start))) / deviation
    truth = own.start + deviation

    def errors(parameters):
        if parameters[0] > truth[0] + 0.02 * deviation[0]:
            return np.array([np.inf])
        return slopes @ (parameters - truth)

    own.errors = errors
    found = (own.parameters(own.solution([])) - own.start) / deviation
    normal = slopes.T @ slopes / ANGLE_ERROR**2
    u2 = np.linalg.inv(normal + np.linalg.inv(own.covariance))
    expected = (u2 @ normal @ deviation) / deviation
    assert_allclose(found, expected, atol=0.1)


@pytest.mark.parametrize(("count", "halves"), [(2e-3, 0), (1e-3, 1), (0.5e-3, 2)])
def test_the_search_tries_lengths_and_shares_of_the_friction(count, halves):
    """Least lengths are halved as long as the short one stays above half a count."""
    own = problem(count=count)
    tried = np.array([*own.tried()])
    assert len(tried) == (3 + halves) * (4 + halves) * 2
    short, long = np.exp(tried[:, :2]).T / np.array([[2e-3], [8e-3]])
    finer = [2.0**-n for n in range(1, halves + 1)]
    assert_allclose(np.unique(short.round(9)), sorted([0.5, 1, 2, *(0.5 * f for f in finer)]))
    assert_allclose(
        np.unique(long.round(9)),
        sorted([0.33, 0.66, 1.33, 2.66, *(0.33 * f for f in finer)]),
        rtol=1e-6,
    )
    bearing, housing = tried[:, 4], tried[:, 7]
    assert_allclose(np.unique((bearing / 11e-3).round(9)), SHARES)
    assert_allclose(bearing + housing, 11e-3)
    rest = [2, 3, 5, 6]
    assert_allclose(tried[:, rest], np.tile(own.start[rest], (len(tried), 1)))


def test_the_search_begins_with_friction_at_rest_whatever_sliding_showed_of_its_rise():
    own = problem()
    rise, bearing = 5, 4
    own.start[rise] = -10 * own.friction
    tried = np.array([*own.tried()])
    assert_allclose(tried[:, rise], -tried[:, bearing] / 2)


@pytest.mark.parametrize("rise_u", [6e-3, 1e-4])
def test_a_rise_that_sliding_does_not_show_begins_at_most_as_large_as_the_friction(rise_u):
    """With far too much, the filter loses counts, and the search does not find back."""
    own = problem()
    rise, bearing = 5, 4
    own.start[rise] = 6e-3
    own.covariance[rise, rise] = rise_u**2
    tried = np.array([*own.tried()])
    assert_allclose(tried[:, rise], np.maximum(tried[:, bearing], 6e-3 - 2 * rise_u))


def test_errors_are_corrections_in_deviations_of_what_they_show(monkeypatch):
    rng = np.random.default_rng(6)
    moved, variance = rng.standard_normal(1500), rng.uniform(1, 2, 1500)
    informed = rng.uniform(0, 0.5, 1500)

    class Known:
        def __init__(self, *_):
            pass

        def add(self, _, keep):
            assert keep
            return SimpleNamespace(kept=(None, None, moved, informed, variance))

    monkeypatch.setattr(rest, "Filter", Known)
    own = problem(length=1500)
    expected = moved * np.sqrt(variance / np.maximum(informed, LEAST_INFORMED))
    assert_allclose(own.errors(own.start), expected[round(FILTER_SETTLING_TIME / STEP) :])


def test_frictions_and_inertia_are_above_zero():
    names = ("coulomb", "static", "housing_friction", "inertia")
    sound = dict.fromkeys(names, 1e-9)
    assert plant_is_sound(SimpleNamespace(**sound))
    for name in names:
        assert not plant_is_sound(SimpleNamespace(**{**sound, name: 0.0}))


def test_while_learning_hardly_any_torque_acts_and_each_step_uses_its_whole_count():
    found = held(UNCERTAINTY)
    for name in ("torque_rate", "slow_torque_rate", "step_torque_rate"):
        assert getattr(found, name) == UNTOUCHED_RANDOM_WALK
    assert found.repeats == 1.0
    assert found.friction_noise == UNCERTAINTY.friction_noise
