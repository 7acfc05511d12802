"""Rest and reversals are predicted after a motion that shows them, nothing on the output."""

from dataclasses import replace

import numpy as np
import pytest

from rigtool.experiments.force_filter.estimate import Filter
from rigtool.experiments.force_filter.plant import (
    ANGLE,
    GRASPER,
    NOISE,
    SPEED,
    STATES,
    advance,
    as_record,
)
from rigtool.experiments.force_model.drive import drive_of, plant_of
from rigtool.experiments.force_model.learning import LearnedModel
from rigtool.experiments.force_model.model import Kind, Known, Shape, Term
from rigtool.experiments.force_model.records import bristle_scale
from rigtool.experiments.force_model.rest import (
    CORNER_HZ,
    FILTER_SETTLING_TIME,
    SPEED_RATE,
    Exploration,
    PredictionProblem,
    held,
    learn_rest,
    learn_turns,
)
from rigtool.experiments.force_model.sliding_problem import SLIDING_PARAMETERS
from rigtool.numerics.compiled import compiled_allocating
from rigtool.numerics.lowpass import delayed
from tests.experiments.force_filter.plants import UNCERTAINTY

COUNT, STEP, CONSTANT = 2 * np.pi / 4000, 125e-6, 0.05
PARTS = 4
"""Of a sample, in which the truth is integrated."""

FRICTIONS = {
    Kind.VISCOUS: (8e-5, 1e-5),
    Kind.BEARING: (2e-3, 3e-3),
    Kind.STRIBECK: (1e-3, 2e-4),
    Kind.BEARING_DAMPING: (1e-6, 2e-6),
    Kind.HOUSING: (9e-3, 3e-3),
    Kind.LOAD_FRICTION: (0.1, 1e-3),
    Kind.INERTIA: (0.0, 8e-7),
    Kind.DELAY: (0.0, 1e-8),
}
"""Coefficient of each, and how well sliding shows it."""

TERMS = tuple(Term(kind, 1.0) for kind in FRICTIONS)


def model():
    """Return the truth, of which sliding shows the sum of both frictions, not their shares."""
    coefficient = np.array([value for value, _ in FRICTIONS.values()])
    u = np.array([0.05] * len(SLIDING_PARAMETERS) + [own for _, own in FRICTIONS.values()])
    correlation = np.eye(len(u))
    bearing, housing = (
        len(SLIDING_PARAMETERS) + list(FRICTIONS).index(kind)
        for kind in (Kind.BEARING, Kind.HOUSING)
    )
    correlation[bearing, housing] = correlation[housing, bearing] = -0.9999
    shape = Shape(2e-3, 8e-3, 5e-3, 0.3, 0.03, 0.2, 8e-4, 1e-3, 2e-6, 1.8e-3, 1.06)
    covariance = correlation * np.outer(u, u)
    known = Known(0.85, 1.18, 2e-5)
    return LearnedModel(TERMS, shape, known, coefficient, covariance, np.ones(2))


def with_lengths(one, bearing, housing):
    """Return a model with other lengths of its bristles."""
    return replace(one, shape=replace(one.shape, bearing_length=bearing, housing_length=housing))


def explored(truth, seconds=7.0, seed=4, period=0.9, sizes=(0.02, 0.4), width=COUNT):
    """Let a controller turn the shaft to and fro over fewer and more counts of a width, rad."""
    rng = np.random.default_rng(seed)
    count = round(seconds / STEP)
    time = np.arange(count) * STEP
    wanted = np.where(time < seconds / 2, *sizes) * np.sin(2 * np.pi * time / period) + 1.0
    plant = plant_of(truth, STEP / PARTS)
    kept = np.exp(-STEP / UNCERTAINTY.friction_noise_time)
    noise = 0.1e-3 * np.sqrt(1 - kept**2) * rng.standard_normal(count)
    encoder, drive = turned(wanted, noise, kept, as_record(plant)[0], plant.friction_map, width)
    return Exploration(encoder, drive / CONSTANT, STEP, CONSTANT, width, STEP)


@compiled_allocating
def turned(wanted, noise, kept, record, friction_map, width):
    """Return encoder and drive torque of each sample."""
    x = np.zeros(STATES)
    x[ANGLE] = 1.0
    x[GRASPER] = 1.0 / 0.85
    encoder, drive, integral = np.empty(len(wanted)), np.empty(len(wanted)), 0.0
    for k in range(len(wanted)):
        encoder[k] = np.floor(x[ANGLE] / width)
        error = wanted[k] - (encoder[k] + 0.5) * width
        integral += error * STEP
        drive[k] = 1.0 * error + 30.0 * integral - 8e-3 * x[SPEED]
        x[NOISE] = kept * x[NOISE] + noise[k]
        for _ in range(PARTS):
            advance(x, record, friction_map, drive[k], 8e-5, None, 0, 0.0, 0.0)
    return encoder, drive


def error(model, motion):
    """Return the rms of the torque that a filter finds where there is none, N m."""
    unsure, grid = replace(held(UNCERTAINTY), speed_rate=SPEED_RATE), motion.grid
    plant, rate = plant_of(model, grid.sample_time), 1 / grid.step_time
    found = Filter(plant, unsure, grid.step_samples, CORNER_HZ).add(motion.under(drive_of(model)))
    passed = delayed(rate, found.torque, CORNER_HZ)[round(FILTER_SETTLING_TIME * rate) :]
    return float(np.sqrt(np.mean(passed**2)))


@pytest.fixture(scope="module")
def learned():
    truth = model()
    motion = explored(truth)
    coefficient = truth.coefficient.copy()
    shares = [list(FRICTIONS).index(kind) for kind in (Kind.BEARING, Kind.HOUSING)]
    coefficient[shares] += np.array([1.5e-3, -1.5e-3])
    wrong = with_lengths(replace(truth, coefficient=coefficient), 3.2e-3, 16e-3)
    return truth, wrong, learn_rest(wrong, [motion], UNCERTAINTY), motion


def test_rest_and_reversals_are_predicted_as_by_the_truth(learned):
    truth, wrong, found, motion = learned
    assert error(wrong, motion) > 5 * error(truth, motion)
    assert error(found, motion) < 1.1 * error(truth, motion)


def test_they_are_predicted_in_another_motion_too(learned):
    truth, wrong, found, _ = learned
    other = explored(truth, seed=9, period=0.7)
    assert error(found, other) < 1.1 * error(truth, other) < error(wrong, other) / 5


def test_the_sum_of_friction_stays_what_sliding_showed(learned):
    truth, _, found, _ = learned
    plants = plant_of(truth, STEP), plant_of(found, STEP)
    before, after = (plant.coulomb + plant.housing_friction for plant in plants)
    assert after == pytest.approx(before, rel=0.02)


def test_friction_of_bearings_and_housing_differs_by_direction_alike(learned):
    truth, _, found, _ = learned
    assert found.shape.direction_ratio == pytest.approx(truth.shape.direction_ratio, abs=0.03)
    plant = plant_of(found, STEP)
    assert plant.asymmetry == plant.housing_asymmetry != 0.0


def test_uncertainty_shrinks_where_rest_shows_something(learned):
    truth, _, found, _ = learned
    assert np.all(found.length_u < 0.5 * truth.length_u)
    bearing = len(SLIDING_PARAMETERS) + list(FRICTIONS).index(Kind.BEARING)
    assert found.covariance[bearing, bearing] < truth.covariance[bearing, bearing]
    assert np.linalg.eigvalsh(found.covariance).min() > -1e-12


def test_a_slope_is_taken_on_the_side_that_is_physically_possible(monkeypatch):
    def errors(self, parameters):
        away = parameters - self.start
        return np.full(1, np.inf) if away[0] > 0 else 1e-4 * (1 + np.resize(away, 50))

    monkeypatch.setattr(PredictionProblem, "errors", errors)
    found = learn_rest(model(), [explored(model(), 2.0)], UNCERTAINTY)
    assert np.all(np.isfinite(found.length_u))
    assert np.all(np.isfinite(found.covariance))


@pytest.mark.parametrize("lengths", [(2e-3, 8e-3), (0.3e-3, 1.6e-3)])
def test_a_fine_encoder_shows_bristles_of_many_counts_and_of_few(lengths):
    width = COUNT / 10
    truth = with_lengths(model(), *lengths)
    motion = explored(truth, 4.0, sizes=(0.005, 0.4), width=width)
    begun = bristle_scale(2.6, width)
    found = learn_rest(with_lengths(truth, begun, 6 * begun), [motion], UNCERTAINTY)
    assert found.shape.housing_length == pytest.approx(truth.shape.housing_length, rel=0.35)
    assert error(found, motion) < 1.1 * error(truth, motion)


def turned_strokes(truth, *periods):
    """Return fast strokes of four seconds each, by the time of a cycle."""
    return [explored(truth, 4.0, period=period, sizes=(1.5, 1.5)) for period in periods]


def off_by(truth, kind, change):
    """Return a model of which a coefficient is off."""
    coefficient = truth.coefficient.copy()
    coefficient[list(FRICTIONS).index(kind)] += change
    return replace(truth, coefficient=coefficient)


def test_turns_of_fast_strokes_show_the_inertia():
    truth = replace(model(), length_u=np.full(2, 0.1))
    wrong = off_by(truth, Kind.INERTIA, -8e-7)
    found = learn_turns(wrong, turned_strokes(truth, 0.2), UNCERTAINTY)
    before, after, true = (plant_of(one, STEP).inertia for one in (wrong, found, truth))
    assert before == pytest.approx(0.96 * true)
    assert after == pytest.approx(true, rel=0.004)
    inertia = len(SLIDING_PARAMETERS) + list(FRICTIONS).index(Kind.INERTIA)
    assert found.covariance[inertia, inertia] < truth.covariance[inertia, inertia] / 4
    assert abs(after - true) < 2 * np.sqrt(found.covariance[inertia, inertia])


@pytest.mark.parametrize("counts", [5, 1])
def test_they_show_how_friction_differs_by_direction_where_a_bristle_has_counts(counts):
    truth = replace(model(), length_u=np.full(2, 0.1))
    covariance, place = truth.covariance.copy(), SLIDING_PARAMETERS.index("direction_ratio")
    covariance[place, place] = 0.3**2
    alike = replace(truth.shape, direction_ratio=1.0)
    wrong = replace(truth, shape=alike, covariance=covariance)
    width = truth.shape.housing_length / counts
    strokes = [explored(truth, 4.0, period=0.2, sizes=(1.5, 1.5), width=width)]
    found = learn_turns(wrong, strokes, UNCERTAINTY).shape.direction_ratio
    if counts == 1:
        assert found == pytest.approx(1.0, rel=1e-9)
    else:
        assert found == pytest.approx(truth.shape.direction_ratio, abs=0.03)


def test_they_show_drag_besides():
    truth = replace(model(), length_u=np.full(2, 0.1))
    wrong = off_by(truth, Kind.VISCOUS, 1.5e-5)
    drag = list(FRICTIONS).index(Kind.VISCOUS)
    found = learn_turns(wrong, turned_strokes(truth, 0.2, 0.3), UNCERTAINTY)
    assert found.coefficient[drag] == pytest.approx(truth.coefficient[drag], rel=0.05)


def test_they_show_that_torque_is_late():
    truth, late = replace(model(), length_u=np.full(2, 0.1)), 2 * STEP
    delay = list(FRICTIONS).index(Kind.DELAY)
    covariance = truth.covariance.copy()
    place = len(SLIDING_PARAMETERS) + delay
    covariance[place, place] = (0.2e-3) ** 2
    unsure = replace(truth, covariance=covariance)
    (strokes,) = turned_strokes(truth, 0.2)
    early = replace(strokes, current=np.roll(strokes.current, -round(late / STEP)))
    found = learn_turns(unsure, [early], UNCERTAINTY)
    assert late / 3 < found.coefficient[delay] < 4 / 3 * late
    assert found.covariance[place, place] < covariance[place, place] / 2
    assert error(found, early) < error(unsure, early) / 2
