"""Recorded motions on the grid that a model is learned on."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose, assert_array_equal

from rigtool.errors import InsufficientDataError
from rigtool.experiments.force_model.records import (
    END_TIME,
    LOWPASS_HZ,
    MOTION_HZ,
    LoadCase,
    Record,
    bristle_scale,
    halved,
    lowpassed_rows,
    repeated,
    single,
    slowest_taught,
)

COUNT = 2 * np.pi / 20_000


@pytest.mark.parametrize(
    ("speeds", "slowest"), [([2.7, 1.1, 5.3], 2.7), ([2.7, 1.7], 1.7), ([1.5, 1.1], 1.1)]
)
def test_the_slowest_stroke_that_teaches_passes_160_counts_in_a_second(speeds, slowest):
    assert slowest_taught(speeds, 1e-2) == slowest


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


CASE = LoadCase(0.05, 0.06, 2e-4, COUNT)


def record(angle, current, interval, cycles):
    trusted = np.ones(angle.size, dtype=bool)
    return Record(interval, angle, current, trusted, 0.05, 0.0, 0.0, cycles, np.empty((0, 0)))


def gain(hertz, cutoff):
    """Butterworth, second order, forward and backward."""
    return 1 / (1 + (hertz / cutoff) ** 4)


@pytest.mark.parametrize("interval", [2e-3, 4e-3, 16e-3])
@pytest.mark.parametrize("hertz", [0.5, 12.0, 28.0])
def test_rows_are_a_hundred_a_second_of_what_the_low_pass_leaves(interval, hertz):
    """Of a motion of 2 s, or as many as there are samples."""
    size = round(2.0 / interval)
    time = interval * np.arange(size)
    waves = np.stack([np.cos(2 * np.pi * hertz * time), np.sin(2 * np.pi * hertz * time) + 3])
    rows = min(200, size)
    at = 2 * np.pi * hertz * np.arange(rows) * (2.0 / rows)
    left = gain(hertz, LOWPASS_HZ)
    found = lowpassed_rows(waves, interval)
    assert_allclose(found, np.stack([left * np.cos(at), left * np.sin(at) + 3]), atol=1e-12)
    own = record(time, time, interval, 1)
    assert own.count == rows
    assert_allclose(own.rows(waves), found, rtol=0, atol=0)


def test_what_rows_cannot_show_is_no_slow_signal():
    time = 2e-3 * np.arange(1000)
    assert np.abs(lowpassed_rows(np.cos(2 * np.pi * 101.0 * time), 2e-3)).max() < 1e-12


@pytest.mark.parametrize("hertz", [1.0, 30.0, 90.0])
def test_slopes_of_a_motion_that_repeats_are_those_of_its_waves(hertz):
    interval, rate = 2e-3, 2 * np.pi * hertz
    time = interval * np.arange(500)
    own = record(0.7 + np.sin(rate * time), 0.2 - np.cos(rate * time), interval, 4)
    left = gain(hertz, MOTION_HZ)
    assert_allclose(own.speed, left * rate * np.cos(rate * time), atol=1e-9 * rate)
    assert_allclose(own.acceleration, -left * rate**2 * np.sin(rate * time), atol=1e-9 * rate**2)
    assert_allclose(own.current_rate, left * rate * np.sin(rate * time), atol=1e-9 * rate)
    assert own.periodic


def test_slopes_of_other_motions_take_their_trend_apart():
    """An even speed has no ends at which the low-pass wraps around."""
    interval = 2e-3
    time = interval * np.arange(1000)
    swing = 0.1 * np.sin(2 * np.pi * time / (1000 * interval) * 5)
    own = record(3 + 1.7 * time + swing, time, interval, 0)
    rate = 2 * np.pi * 2.5
    inside = slice(50, -50)
    expected = 1.7 + 0.1 * rate * np.cos(rate * time)
    assert_allclose(own.speed[inside], expected[inside], atol=2e-3)
    assert_allclose(own.current_rate, 1.0, atol=1e-9)
    expected = -0.1 * rate**2 * np.sin(rate * time)
    assert_allclose(own.acceleration[inside], expected[inside], atol=0.1)
    assert not own.periodic


@pytest.mark.parametrize(("cycles", "times"), [(0, 0.0), (1, 0.0), (2, 1.0), (5, 1.0)])
def test_scatter_is_that_of_the_cycles_where_they_count(cycles, times):
    rng = np.random.default_rng(cycles)
    time = 2e-3 * np.arange(1000)
    own = record(time, time, 2e-3, cycles)
    trusted = time < 1.0
    torques = 1e-3 * rng.standard_normal((cycles, 200))
    torques[:, ~own.used] += 1.0
    own = replace(own, trusted=trusted, torques=torques)
    if not times:
        assert own.scatter == 0
        return
    counted = np.arange(200) * 10e-3 < 1.0
    assert_array_equal(own.used, counted)
    expected = np.sqrt(np.mean([np.var(row, ddof=1) for row in torques.T[counted]]))
    assert own.scatter == pytest.approx(expected, rel=1e-12)


def test_ends_of_a_motion_that_does_not_repeat_do_not_count():
    time = 2e-3 * np.arange(1000)
    own = record(time, time, 2e-3, 0)
    at = np.arange(200) * 10e-3
    assert_array_equal(own.used, (at >= END_TIME) & (at <= 2.0 - END_TIME))


@given(order=st.integers(1, 12), quarter=st.sampled_from([0, 1]))
def test_waves_are_those_of_the_angle(order, quarter):
    angle = np.linspace(-1, 1, 50)
    own, fast = record(angle, angle, 2e-3, 0), record(100 * angle, angle, 2e-3, 0)
    assert not fast.wave(order, quarter).any()  # it would alias
    expected = np.imag(np.exp(1j * order * angle) * (1 if quarter else 1j))
    for _ in range(2):
        assert_allclose(own.wave(order, quarter), expected, atol=1e-12)


def cycles_of(period, number, interval=2e-3):
    """Return encoder, current and set point of cycles; current is the number of the cycle, A."""
    time = interval * np.arange(0.5, round((number + 0.6) * period / interval))
    setpoint = -1.3 * np.cos(2 * np.pi * time / period)
    current = np.floor((time - period / 4) / period)
    return np.floor(setpoint / COUNT), current, setpoint


@pytest.mark.parametrize(("number", "first"), [(2, 0), (3, 1), (5, 1)])
def test_the_cycle_that_runs_in_is_left_out_of_more_than_two(number, first):
    """Cycles begin where the set point passes its middle upwards: n + 1 of them, n whole ones."""
    encoder, current, setpoint = cycles_of(1.0, number)
    found = repeated(encoder, current, setpoint, 2e-3, CASE)
    counted = np.arange(first, number)
    assert found.cycles == len(counted)
    middle = slice(10, -10)
    assert_allclose(found.current[middle], counted.mean(), atol=0.02)
    assert found.torques.shape == (len(counted), 100)
    assert_allclose(found.torques[:, 10:-10].mean(axis=1), 0.05 * counted, atol=2e-3)
    assert (found.torque_constant, found.moment, found.load_inertia) == (0.05, 0.06, 2e-4)


def test_less_than_a_cycle_is_refused():
    encoder, current, setpoint = cycles_of(1.0, 1)
    with pytest.raises(InsufficientDataError, match="no whole cycle"):
        repeated(encoder[:500], current[:500], setpoint[:500], 2e-3, CASE)
    assert repeated(encoder, current, setpoint, 2e-3, CASE).cycles == 1


@pytest.mark.parametrize(
    ("period", "hertz"), [(1.0, 500.0), (2.9, 500.0), (3.1, 250.0), (6.0, 250.0)]
)
def test_slow_motions_have_half_of_the_grid(period, hertz):
    found = repeated(*cycles_of(period, 2), 2e-3, CASE)
    assert found.angle.size * found.interval == pytest.approx(period, rel=1e-6)
    assert found.angle.size % 2 == 0
    assert 1 / found.interval == pytest.approx(hertz, rel=0.04)


def test_fine_recordings_are_thinned_to_the_grid():
    encoder, current, setpoint = cycles_of(1.0, 3, interval=0.5e-3)
    found = single(encoder, current, setpoint, 0.5e-3, CASE)
    assert found.interval == pytest.approx(2e-3)
    assert len(encoder) / 4 * 0.97 < found.angle.size <= len(encoder) / 4
    assert found.angle.size % 2 == 0
    time = 2e-3 * np.arange(0.5, found.angle.size)
    assert_allclose(found.angle - COUNT / 2, -1.3 * np.cos(2 * np.pi * time), atol=2 * COUNT)


@pytest.mark.parametrize("share", [0.9, 1.1])
@pytest.mark.parametrize("way", [1.0, -1.0])
@pytest.mark.parametrize("averaged", [repeated, single])
def test_a_rotor_slides_from_160_counts_a_second(share, way, averaged):
    """Of an even speed, to and fro, the part far from the turns slides, or nothing does."""
    count, period = 2 * np.pi / 4000, 4.0
    time = 2e-3 * np.arange(0.5, 5200)
    place = 160 * share * count * (np.abs((time / 2 + 0.5) % 2 - 1) - 0.5) * 2
    place = way * place * period / 4
    case = replace(CASE, count=count)
    found = averaged(np.floor(place / count), 0 * time, place, 2e-3, case)
    assert found.trusted.mean() == pytest.approx(0.75 if share > 1 else 0.0, abs=0.15)


@given(st.floats(1e-6, 1.0), st.floats(0.1, 1e4))
def test_lengths_are_halved_down_to_a_part(value, times):
    found = halved(value, times)
    assert_allclose(found, [value / 2 ** (n + 1) for n in range(len(found))], rtol=1e-12)
    smallest = value / max(times, 1.0)
    assert all(one >= smallest * (1 - 1e-12) for one in found)
    assert (found[-1] if found else value) / 2 < smallest


@given(st.floats(0.1, 10.0), st.floats(1e-6, 1e-1))
def test_a_short_bristle_is_some_counts_that_are_bent_within_a_seventieth_of_the_way(way, count):
    found = bristle_scale(way, count)
    assert np.log2(found / count) == pytest.approx(round(np.log2(found / count)), abs=1e-9)
    assert found == count or 25 * found <= way / 70 * (1 + 1e-9)
    assert 25 * 2 * found > way / 70 * (1 - 1e-9)
