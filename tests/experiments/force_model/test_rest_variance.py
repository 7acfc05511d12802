"""How friction differs by direction shows while the rotor slides and misses in a rest: u holds what
is not known of it."""

from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np
import pytest

from rigtool.experiments.controller_torque import LoopSignals
from rigtool.experiments.force_filter.accuracy import COVERAGE_FACTOR
from rigtool.experiments.force_filter.motion_states import State
from rigtool.experiments.force_model import procedure_learning as module
from rigtool.experiments.force_model.deviations import Deviations
from rigtool.experiments.force_model.force_model import ForceModel
from rigtool.experiments.force_model.intervals import beyond
from rigtool.experiments.force_model.learning import LearnedModel
from rigtool.experiments.force_model.model import Kind, Known, Shape, Term
from rigtool.experiments.force_model.records import LoadCase
from rigtool.experiments.force_model.sliding_problem import SLIDING_PARAMETERS
from rigtool.experiments.force_sensor.stretch import Stretch
from rigtool.recipe import load_recipe
from tests.experiments.deploy.sensors import INTERVAL, instrument, moved
from tests.experiments.force_sensor.test_rest_between_forms import Certain
from tests.experiments.virtual_runs import RECIPE

FRICTION = {Kind.BEARING: 2e-3, Kind.STRIBECK: 1e-3, Kind.HOUSING: 9e-3}
FACTOR, RELATIVE_U = 1.18, 0.04


def model(ratio):
    """Return a model of a ratio of both directions, of which only that is uncertain."""
    shape = Shape(2e-3, 8e-3, 5e-3, 0.3, 0.03, 0.2, 8e-4, 1e-3, 2e-6, 1.8e-3, ratio)
    covariance = np.zeros((len(SLIDING_PARAMETERS) + len(FRICTION),) * 2)
    place = SLIDING_PARAMETERS.index("direction_ratio")
    covariance[place, place] = RELATIVE_U**2
    terms, values = tuple(Term(kind, 1.0) for kind in FRICTION), np.array([*FRICTION.values()])
    known = Known(0.85, FACTOR, 2e-5)
    learned = LearnedModel(terms, shape, known, values, covariance, np.zeros(2))
    return ForceModel(learned, Deviations(1e-4, 1e-3, 1e-5, 0.1))


@pytest.mark.parametrize("ratio", [1.0, 1.4, 0.6])
def test_a_rest_is_uncertain_by_half_the_difference_of_both_directions(ratio):
    """What all friction adds to a constant torque while the rotor slides, to first order."""
    sliding = FRICTION[Kind.BEARING] + FRICTION[Kind.HOUSING]

    def constant(own):
        forward, back = 2 * own / (1 + own), -2 / (1 + own)
        return FACTOR * sliding * (forward + back) / 2

    change = (constant(ratio * 1.001) - constant(ratio / 1.001)) / (2 * np.log(1.001))
    assert model(ratio).rest_variance == pytest.approx((RELATIVE_U * change) ** 2, rel=1e-4, abs=0)


def test_factors_leave_to_a_known_variance_what_it_holds():
    rng = np.random.default_rng(5)
    error, deviation = rng.standard_normal((2, 2, 500)) * 1e-3
    variance = np.repeat([0.0, 4e-7], 250)
    for factor in (0.4, 1.0):
        own = factor * np.abs(deviation)
        held = np.abs(error) <= COVERAGE_FACTOR * np.sqrt(own**2 + variance)
        left = beyond(error, variance) <= COVERAGE_FACTOR * own
        np.testing.assert_array_equal(left, held)
        assert 50 < held.sum() < 950


def test_errors_at_rest_are_what_it_does_not_hold(monkeypatch):
    """A load that the model knows nothing of shakes a rotor that stays in its count."""
    time = 1e-3 * np.arange(6000)
    current = 0.04 * np.sin(2 * np.pi * 0.4 * time)
    values = {name: np.zeros(len(time)) for name in LoopSignals.__dataclass_fields__}
    signals = LoopSignals(**{**values, "time": time, "total": current})
    under = LoadCase(0.05, 0.0, 0.0, 2e-3, 0.5e-3)
    monkeypatch.setattr(module, "_known", lambda *given: (signals, under))
    doubtful, recipe = model(1.0), load_recipe(RECIPE)[0]
    learned = replace(doubtful.learned, covariance=0 * doubtful.learned.covariance)
    whole, left = (
        module._errors(None, recipe, None, own, 1.0)
        for own in (replace(doubtful, learned=learned), doubtful)
    )
    assert np.all(whole.kinds == State.STILL)
    assert 0 < np.count_nonzero(left.error) < left.error.size
    held = beyond(whole.error, np.full(whole.error.shape[1], doubtful.rest_variance))
    np.testing.assert_array_equal(left.error, held)


@dataclass(frozen=True)
class Doubtful(Certain):
    """The same, with another asymmetry of friction."""

    rest_variance: ClassVar = 1e-6


def test_u_is_wider_at_rest_alone_in_both_forms():
    time = np.arange(round(6.0 / INTERVAL)) * INTERVAL
    strokes = np.abs(1.6 * np.minimum(time, 3.6) % 2 - 1) - 0.5
    samples, found = moved(strokes, 0 * time), []
    for own in (Certain(), Doubtful()):
        with ThreadPoolExecutor(1) as worker:
            reader = Stretch("rest", instrument(model=own), 0.0, len(time), (worker, worker))
            reader.add(samples)
            found += reader.reading()
    (one, other), more = found, Doubtful.rest_variance - Certain.rest_variance
    for name in ("u", "causal_u"):
        still = getattr(one, "states" if name == "u" else "causal_states") == State.STILL
        added = getattr(other, name) ** 2 - getattr(one, name) ** 2
        assert still.sum() > 100
        assert (~still).sum() > 100
        np.testing.assert_allclose(added[still], more, rtol=1e-6)
        np.testing.assert_allclose(added[~still], 0.0, atol=1e-18)
