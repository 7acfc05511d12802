"""Factors on the filter's deviation: from errors under known loads, by state."""

import numpy as np
import pytest

from rigtool.experiments.force.procedure_calibration import _factors
from rigtool.experiments.force_over_time.motion_states import State


def test_a_factor_makes_the_interval_hold_in_95_percent():
    rng = np.random.default_rng(3)
    states = np.repeat([State.AGAINST, State.REVERSED], 20000).astype(np.int32)
    ratio = np.abs(rng.standard_normal(40000)) * np.where(states == State.REVERSED, 2.5, 0.5)
    found = _factors([(ratio, states)])
    assert found[State.REVERSED] == pytest.approx(2.5, rel=0.05)
    assert found[State.AGAINST] == 1.0


def test_a_state_that_no_load_shows_has_the_factor_of_all():
    ratio, states = np.full(1000, 3.92), np.full(1000, State.WITH, dtype=np.int32)
    assert _factors([(ratio, states)])[State.STILL] == pytest.approx(2.0)


def test_without_recordings_there_is_no_factor():
    np.testing.assert_array_equal(_factors([]), 1.0)
