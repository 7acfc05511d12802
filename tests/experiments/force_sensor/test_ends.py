"""The last rows of a recording: what would follow is expected to stay, and u states its doubt."""

import math

import numpy as np
import pytest

from rigtool.experiments.force_filter.motion_states import State
from rigtool.experiments.force_model.contacts import Contact
from rigtool.experiments.force_sensor.results_over_time import TorqueRows, over_time_tables
from rigtool.experiments.force_sensor.results_recordings import _events
from rigtool.experiments.force_sensor.stretch import held_lowpass, weight_ahead

RATE, CORNER_HZ = 1000.0, 30.0


@pytest.mark.parametrize("before", [3, 8, 20])
def test_a_load_that_comes_just_before_the_end_is_not_overshot(before):
    torque = np.repeat([0.0, 42e-3], [400, before])
    found = held_lowpass(RATE, torque, CORNER_HZ)
    assert found.shape == torque.shape
    assert 21e-3 < found[-1] < 44.5e-3


def test_the_doubt_of_the_last_value_is_that_of_the_rows_that_it_is_held_in():
    """Random walks that go on: the error of the last rows against what they become."""
    rng = np.random.default_rng(5)
    deviation = 3e-3
    torque = np.zeros((200, 600))
    torque[:, 300:] = deviation * rng.standard_normal((200, 1))  # not yet seen at row 299
    seen = torque[:, :300].copy()
    errors = np.array([held_lowpass(RATE, own, CORNER_HZ)[-33:] for own in seen]) - np.array(
        [held_lowpass(RATE, own, CORNER_HZ)[267:300] for own in torque]
    )
    stated = deviation * np.abs(weight_ahead(RATE, 300, CORNER_HZ))
    assert stated.shape == (33,)
    np.testing.assert_allclose(errors.std(axis=0), stated, rtol=0.15, atol=1e-5)


def test_the_peak_is_not_that_of_a_row_that_knows_little():
    torque = np.array([0.0, 10e-3, 42e-3, 41e-3, 50e-3])
    u = np.array([0.5e-3, 0.5e-3, 0.5e-3, 0.5e-3, 6e-3])
    time, states = 5e-3 * np.arange(5), np.full(5, State.AGAINST, dtype=np.int32)
    row = TorqueRows("made", 5e-3, time, torque, u, states)
    results, _ = over_time_tables([row], 60e-3, 30.0)
    assert results["peak_torque"].value == 42e-3
    alike = 0.5e-3 * math.hypot(1, 1 / math.sqrt(math.pi))  # the larger of two normal errors
    assert results["peak_torque"].u == pytest.approx(
        math.hypot(alike, 8e-3 / math.sqrt(3)), rel=1e-3
    )


def test_a_contact_that_the_whole_recording_does_not_show_is_not_listed():
    """Contacts are found by samples so far: behind a strong one, by its own end."""
    torque = np.repeat([0.0, 30e-3, -0.7e-3, 2e-3], 50)
    time, states = 5e-3 * np.arange(200), np.full(200, State.AGAINST, dtype=np.int32)
    found = (Contact(50, 51, 99), Contact(100, 101, 149), Contact(150, 151, 199))
    row = TorqueRows("made", 5e-3, time, torque, np.full(200, 0.4e-3), states, contacts=found)
    peaks = _events([(0, row)])["events"].columns["peak"].values
    np.testing.assert_allclose(peaks, [30e-3, 2e-3])
