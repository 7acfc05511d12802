"""A filter that begins in motion has to find it: until then, the torque has no value."""

from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

from rigtool.experiments.force_filter.motion_states import LIMIT_TIME, State
from rigtool.experiments.force_sensor.stretch import Stretch
from tests.experiments.deploy.sensors import INTERVAL, instrument, moved
from tests.experiments.force_sensor.test_changing_load import Whole

TIME = np.arange(round(2.5 / INTERVAL)) * INTERVAL


@pytest.mark.parametrize("cuts", [(), (1, 2, 600)])
def test_behind_a_begin_there_is_no_value_in_either_form(cuts):
    samples = moved(0.5 * np.sin(3.1 * TIME), np.where(TIME < 1.5, 0.0, 0.02))
    with ThreadPoolExecutor(1) as one, ThreadPoolExecutor(1) as other:
        stretch = Stretch("", instrument(model=Whole()), 0.0, len(TIME), (one, other))
        for piece in np.split(samples, cuts, axis=1):
            stretch.add(piece)
        (rows,) = stretch.reading()
    for states in (rows.states, rows.causal_states):
        without = rows.time < LIMIT_TIME
        np.testing.assert_array_equal(states[without], State.OUTSIDE)
        assert without.sum() > 5
        assert (states[rows.time > LIMIT_TIME + 0.02] != State.OUTSIDE).all()
