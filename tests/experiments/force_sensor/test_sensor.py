"""What friction leaves open where the motor has no current, or its rotor rests within a count, from
the bristles' own law."""

import math

import numpy as np
import pytest

from rigtool.experiments.force_filter.motion_states import Reach, State
from rigtool.experiments.force_model.deviations import Deviations
from rigtool.experiments.force_model.force_model import ForceModel
from rigtool.experiments.force_model.learning import LearnedModel
from rigtool.experiments.force_model.model import Kind, Known, Shape, Term
from rigtool.experiments.force_sensor.sensor import SensorProperties
from tests.experiments.force_filter.plants import dahl

BEARING, STRIBECK, FACTOR = 4e-3, 2e-3, 1.2
LENGTH, HOUSING_LENGTH = 0.02, 0.5


def open_variances(count, housing):
    """Return the variances, and friction over a `count` about rest by two bristles."""
    values = {Kind.BEARING: BEARING, Kind.STRIBECK: STRIBECK, Kind.HOUSING: housing}
    shape = Shape(LENGTH, HOUSING_LENGTH, 0.01, 2.0, 5e-3, 1.0, 2e-3, 1e-3, 1e-6, 2e-3)
    terms = tuple(Term(kind, 1.0) for kind in values)
    learned = LearnedModel(
        terms, shape, Known(0.9, FACTOR, 2e-5), np.array([*values.values()]), np.eye(3), np.ones(2)
    )
    model = ForceModel(learned, Deviations(1e-4, 1e-3, 1e-5, 0.1))
    reach = Reach((0.0, 3.0), 5.0, 0.06, (10.0, 40.0))
    made = SensorProperties(model, reach, 1e-3, 1e-3, count, (0.05, 0.0), 4.0, 30.0)
    bends = [
        level * (dahl(0.0, count / 2, length) - dahl(0.0, -count / 2, length)) / 2
        for level, length in ((BEARING + STRIBECK, LENGTH), (housing, HOUSING_LENGTH))
    ]
    return made.open_variances, sum(bends)


@pytest.mark.parametrize("housing", [1e-9, 5e-3])
@pytest.mark.parametrize("count", [1e-6, 1e-3])
def test_a_short_count_leaves_open_what_the_bristles_bend(count, housing):
    """Variance of a value that is anywhere within a rectangle, at the output (GUM 4.3.7)."""
    found, bent = open_variances(count, housing)
    rests = BEARING + housing
    np.testing.assert_array_equal(found[0], 0.0)
    np.testing.assert_allclose(np.sqrt(3 * found[1:3, State.STILL]), FACTOR * rests, rtol=1e-9)
    assert found[3, State.STILL] == found[1, State.REVERSED]  # a load that hides in the count
    assert found[3, State.REVERSED] == 0
    for row in found[1:]:
        for other in (State.OUTSIDE, State.AGAINST, State.WITH):
            assert row[other] == 0
    assert math.sqrt(3 * found[1, State.REVERSED]) == pytest.approx(FACTOR * bent, rel=0.02)
    # a rotor that crawls passes a count in half the time of a rest
    assert math.sqrt(3 * found[2, State.REVERSED]) == pytest.approx(FACTOR * rests / 2, rel=1e-9)


def test_a_long_count_leaves_all_friction_open():
    found, _ = open_variances(0.1, 5e-3)
    for row in found[1:3]:
        assert math.sqrt(3 * row[State.REVERSED]) == pytest.approx(FACTOR * 9e-3, rel=1e-9)
