"""A model is learned from strokes that formulas made, and gives them back."""

import math

import numpy as np
import pytest

from rigtool.errors import InsufficientDataError
from rigtool.experiments.force_model.deviations import Deviations, deviations, kept_by_mean
from rigtool.experiments.force_model.learning import SLIDING_PARAMETERS, learn_sliding
from rigtool.experiments.force_model.model import Kind, Known
from tests.experiments.force_model import known_plant as plant
from tests.experiments.force_model.known_plant import strokes

KNOWN = Known(plant.RATIO, plant.FACTOR, plant.INERTIA)
CALM = Deviations(2e-4, 1e-3, 1e-4, 0.1)
LOADS, SPEEDS = (0.0, 2e-3, 10e-3, 50e-3), (1.0, 4.0)


def coefficient(model, kind, order=0, quarter=0):
    (found,) = (
        value
        for term, value in zip(model.terms, model.coefficient, strict=True)
        if (term.kind, term.order, term.quarter) == (kind, order, quarter)
    )
    return found


@pytest.fixture(scope="module")
def learned():
    records = [strokes(load, speed) for load in LOADS for speed in SPEEDS]
    return learn_sliding(records, KNOWN, plant.COUNT, CALM).learned


def test_tendon_and_load_friction_are_given_back(learned):
    assert learned.shape.stiffness == pytest.approx(plant.STIFFNESS, rel=0.01)
    carried = np.array([5e-3, 20e-3, 50e-3])
    onset = learned.shape.load_onset
    upright = sum(  # at 90 degrees
        coefficient(learned, Kind.LOAD_FRICTION, order, quarter) * value
        for order, quarter, value in ((0, 0, 1), (1, 1, 1), (2, 0, -1))
    )
    found = upright * (np.hypot(carried, onset) - onset)
    expected = plant.LOAD_FRICTION * (np.hypot(carried, plant.ONSET) - plant.ONSET)
    np.testing.assert_allclose(found, expected, rtol=0.03)


def test_friction_is_given_back_wherever_it_slides(learned):
    """What belongs to which term is not seen while sliding; their sum is."""
    angle = np.linspace(0.6, 2.0, 30)
    for speed in SPEEDS:
        total = np.full(angle.size, learned.shape.tip_friction / plant.FACTOR)
        for term, value in zip(learned.terms, learned.coefficient, strict=True):
            wave = (np.sin if term.quarter else np.cos)(term.order * angle / plant.RATIO)
            if term.kind in (Kind.BEARING, Kind.HOUSING):
                total += value * wave
            elif term.kind is Kind.STRIBECK:
                total += value * math.exp(-((speed / learned.shape.stribeck_speed) ** 2))
            elif term.kind is Kind.VISCOUS:
                turned = (np.sin if term.quarter else np.cos)(term.order * angle)
                total += value * speed * turned
        expected = plant.COULOMB + plant.VISCOUS * speed
        np.testing.assert_allclose(total, expected, rtol=0.02)


@pytest.mark.parametrize("factor", [0.2, 2.0])
def test_any_stiffness_is_found_from_the_same_begin(monkeypatch, factor):
    monkeypatch.setattr(plant, "STIFFNESS", factor * plant.STIFFNESS)
    records = [strokes(load, speed) for load in (0.0, 20e-3, 50e-3) for speed in SPEEDS]
    found = learn_sliding(records, KNOWN, plant.COUNT, CALM).learned
    u = np.sqrt(
        found.covariance[
            SLIDING_PARAMETERS.index("stiffness"), SLIDING_PARAMETERS.index("stiffness")
        ]
    )
    assert u < 0.35
    assert np.log(found.shape.stiffness / plant.STIFFNESS) == pytest.approx(0, abs=max(0.03, 2 * u))


def test_what_friction_deviates_is_measured():
    records = [
        strokes(load, 1.0, cycles=30, deviation=0.4e-3, noise=(0.1e-3, 0.15), seed=seed)
        for seed, load in enumerate((0.0, 0.0, 20e-3, 50e-3))
    ]
    found = deviations(records, plant.RATIO, plant.FACTOR)
    assert found.stroke == pytest.approx(0.4e-3, rel=0.15)
    assert found.noise == pytest.approx(0.1e-3, rel=0.3)
    assert 0.05 < found.noise_time < 0.45
    assert 50e-3 / plant.FACTOR * found.load < found.stroke / 2  # nothing grew with the load


@pytest.mark.parametrize(("payback", "low", "high"), [(0.0, 0.8, 1.0), (0.9, 0.01, 0.04)])
def test_what_strokes_pay_back_hardly_moves_their_mean(payback, low, high):
    """By its weights, a mean of 30 keeps 1.2 or 0.013 of the variance of independent ones."""
    records = [
        strokes(0.0, 1.0, cycles=30, deviation=0.4e-3, payback=payback, seed=seed)
        for seed in range(4)
    ]
    assert low <= kept_by_mean(records, plant.RATIO) <= high


def test_without_cycles_nothing_is_claimed_to_be_measured():
    assert deviations([], plant.RATIO, plant.FACTOR).stroke > 0


def test_too_slow_strokes_are_refused():
    with pytest.raises(InsufficientDataError, match="higher speeds"):
        learn_sliding([strokes(0.0, 0.1, cycles=1)], KNOWN, plant.COUNT, CALM)


def test_loads_alone_are_refused():
    with pytest.raises(InsufficientDataError, match="without load"):
        learn_sliding([strokes(10e-3, 2.0)], KNOWN, plant.COUNT, CALM)
