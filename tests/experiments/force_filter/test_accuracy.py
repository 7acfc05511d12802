"""Errors and coverage by load and state."""

import numpy as np
import pytest

from rigtool.experiments.force_filter.accuracy import (
    JUDGED_STATES,
    LOAD_BAND_EDGES,
    accuracy,
    by_band_and_state,
)
from rigtool.experiments.force_filter.motion_states import State


def test_accuracy_of_given_errors():
    error = np.array([3.0, -4.0, np.nan, 0.0])
    found = accuracy(error, np.abs(error) < 3.5, np.array([True, True, True, False]))
    assert found.rmse == pytest.approx(np.sqrt(12.5))
    assert (found.bias, found.coverage, found.share) == (-0.5, 0.5, pytest.approx(2 / 3))


def test_every_sample_with_a_value_is_in_one_band_and_state():
    rng = np.random.default_rng(1)
    reference = rng.uniform(-2, 2, 500)
    states = rng.choice([int(state) for state in State], 500)
    error = np.where(states == State.OUTSIDE, np.nan, rng.standard_normal(500))
    cells = by_band_and_state(error, np.abs(error) < 2, reference, states, 1.0)
    assert (len(cells), len(cells[0])) == (len(LOAD_BAND_EDGES) - 1, len(JUDGED_STATES))
    assert sum(cell.share for row in cells for cell in row) == pytest.approx(1.0)
