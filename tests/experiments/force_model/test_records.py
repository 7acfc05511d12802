"""Recorded motions on the grid that a model is learned on."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from rigtool.experiments.force_model.records import LoadCase, repeated, single

COUNT = 2 * np.pi / 20_000


@pytest.mark.parametrize("record_every", [1, 4])
@pytest.mark.parametrize("lag", [0.0, 0.7e-3])
@pytest.mark.parametrize("averaged", [repeated, single])
def test_currents_belong_to_the_angles_at_which_they_act(averaged, lag, record_every):
    """A loop of 1 ms reads the angle at the begin of a sample and asks for a current, which acts
    over the sample, `lag` s later: here a hundredth of the angle, by the middle of the sample."""
    sample = 1e-3

    def angle(time):
        return 1.3 * (1 - np.cos(2 * np.pi * time))

    begin = sample * np.arange(8000)
    encoder = np.floor(angle(begin) / COUNT)
    current = angle(begin + sample / 2 + lag) / 100
    shape = (-1, record_every)
    signals = [s.reshape(shape).mean(axis=1) for s in (encoder, current, angle(begin))]
    under = LoadCase(0.05, 0.0, 0.0, COUNT, lead=sample / 2 + lag)
    found = averaged(*signals, sample * record_every, under)
    inner = slice(50, -50)
    assert_allclose(100 * found.current[inner], found.angle[inner], atol=3e-4)  # 8e-3 for 1 ms


def test_a_current_is_more_than_its_means():
    """At a seventh of the rate of the samples, which are means over 16 ms."""
    interval, hertz = 16e-3, 9.0

    def integral(time):
        return np.sin(2 * np.pi * hertz * time) / (2 * np.pi * hertz)

    ends = interval * np.arange(401)
    means = np.diff(integral(ends)) / interval
    turning = np.floor(ends[:-1] / COUNT)
    found = single(turning, means, turning * COUNT, interval, LoadCase(0.05, 0.0, 0.0, COUNT))
    middle = interval * np.arange(0.5, found.current.size)
    expected = np.cos(2 * np.pi * hertz * middle)
    assert_allclose(found.current[5:-5], expected[5:-5], atol=3e-3)  # means: 0.034


def test_steps_of_the_encoder_are_no_slow_torque():
    """250 counts pass in a second of a slow stroke, as many as there are points of its grid."""
    interval, hertz, period = 2e-3, 250.0, 4.0

    def integral(time):
        shaking = 0.1 * np.sin(2 * np.pi * hertz * time + 1.0) / (2 * np.pi * hertz)
        return shaking + np.sin(2 * np.pi * 5 / period * time) / (2 * np.pi * 5 / period)

    ends = interval * np.arange(12_001)
    means = np.diff(integral(ends)) / interval
    setpoint = 1.3 * np.sin(2 * np.pi / period * (ends[:-1] + interval / 2))
    under = LoadCase(0.05, 0.0, 0.0, COUNT)
    found = repeated(np.floor(setpoint / COUNT), means, setpoint, interval, under)
    assert found.current.size == period * hertz
    begin = np.flatnonzero(np.diff(np.sign(setpoint)) > 0)[0] + 0.5
    time = interval * (begin + 0.5) + found.interval * np.arange(found.current.size)
    expected = np.cos(2 * np.pi * 5 / period * time)
    assert_allclose(found.current, expected, atol=2e-3)  # 0.05 read at the points alone


@pytest.mark.parametrize("counts", [4000, 40_000])
def test_what_follows_a_turn_is_left_out_however_fine_the_encoder_is(counts):
    interval, period, count = 2e-3, 2.0, 2 * np.pi / counts
    setpoint = -1.3 * np.cos(2 * np.pi / period * interval * np.arange(0.5, 6000))
    under = LoadCase(0.05, 0.0, 0.0, count)
    found = repeated(np.floor(setpoint / count), 0 * setpoint, setpoint, interval, under)
    way = np.ptp(found.angle) / 2
    rising, falling = (found.angle[found.trusted & (s * found.speed > 0)] for s in (1, -1))
    for after in (rising.min() + way, way - falling.max()):
        assert 2 * way / 70 < after < 2 * way / 25
