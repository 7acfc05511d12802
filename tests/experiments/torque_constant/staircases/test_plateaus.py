"""Means, courses, noise and steps of readings on plateaus; runs one after the other in time."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.stats import linregress

from rigtool.errors import InsufficientDataError
from rigtool.experiments.torque_constant.staircases.model import _course_noise, arrange
from rigtool.experiments.torque_constant.staircases.plateaus import (
    ALIKE,
    SWING_PARTS,
    _course,
    _noise,
    _resolution,
    amplifier_linearity,
    plateaus_of_set_point,
    pool,
)
from tests.experiments.torque_constant.bench import Bench


@pytest.mark.parametrize("step", [1e-3, 0.25])
def test_the_step_of_an_instrument_is_that_of_all_its_readings(step):
    """Also where no two readings are neighbours, and stored in single precision."""
    number = np.array([0, 6, 10, 25, 90, 154, 6, 25])
    assert _resolution(step * number) == pytest.approx(step, rel=1e-9)
    stored = (step * number + 0.1).astype(np.float32).astype(np.float64)
    assert _resolution(stored) == pytest.approx(step, rel=1e-3)
    assert _resolution(np.random.default_rng(1).standard_normal(200)) == 0.0
    assert _resolution(np.full(5, 3.0)) == 0.0


def test_noise_is_that_of_settled_readings_whatever_their_swing():
    rng = np.random.default_rng(2)
    number = np.repeat([0, 1, 2], [4000, 3000, 1])
    settled = np.ones(number.size, dtype=bool)
    settled[:1000] = False
    size = np.where(number == 0, 0.1, 0.3)
    values = size * rng.standard_normal(number.size) + np.sin(np.arange(number.size) / 50)
    values[:900] += 50 * rng.standard_normal(900)
    found = _noise(values, number, settled)
    np.testing.assert_allclose(found[:2], [0.1, 0.3], rtol=0.05)
    assert found[2] == 0  # the last stretch is one reading, which has no second difference


def test_a_course_has_the_means_of_equal_parts():
    values = np.random.default_rng(3).standard_normal(SWING_PARTS * 5)
    start, stop = np.array([0, 2 * SWING_PARTS]), np.array([SWING_PARTS, 5 * SWING_PARTS])
    found = _course(values, start, stop)
    np.testing.assert_allclose(found[0], values[:SWING_PARTS], atol=1e-12)
    expected = values[2 * SWING_PARTS :].reshape(SWING_PARTS, 3).mean(axis=1)
    np.testing.assert_allclose(found[1], expected, atol=1e-12)
    # a part of a sample counts by its part
    (short,) = _course(np.array([1.0, 4.0]), np.array([0]), np.array([2]))
    np.testing.assert_allclose(short, np.repeat([1.0, 4.0], SWING_PARTS // 2))


def plateaus(**more):
    signals = Bench().record((20,), angles=2)
    position = signals.pop("position")
    given = {"arm_length": 0.5, "settle_time": 0.08, "position": position, "count": 1e-3}
    return plateaus_of_set_point(**signals, **(given | more))


def test_runs_are_one_series_in_time():
    one = plateaus()
    both = pool([one, one])
    count = len(one.begin)
    assert both.begin[count] - both.end[count - 1] == pytest.approx(3600.0)
    np.testing.assert_allclose(np.diff(both.begin[count:]), np.diff(one.begin), atol=1e-9)
    np.testing.assert_allclose((both.end - both.begin)[count:], one.end - one.begin, atol=1e-9)
    np.testing.assert_allclose(
        (both.middle - both.begin)[count:], one.middle - one.begin, atol=1e-9
    )
    assert both.staircase.tolist() == [*one.staircase, *(one.staircase + 2)]
    np.testing.assert_array_equal(both.torque[count:], one.torque)


def test_a_gauge_resolves_no_more_than_is_stated_or_seen():
    assert plateaus().resolution.max() == 0.0
    assert plateaus(gauge_resolution=0.02).resolution.max() == pytest.approx(0.01)
    signals = Bench().record((20,), angles=2)
    signals["force"] = 0.05 * np.round(signals["force"] / 0.05)
    signals.pop("position")
    seen = plateaus_of_set_point(**signals, arm_length=0.5, settle_time=0.08, gauge_resolution=0.02)
    np.testing.assert_allclose(seen.resolution, 0.05 * 0.5, rtol=1e-6)


def test_a_value_of_a_course_has_the_noise_of_its_readings_and_rounding():
    one = replace(
        plateaus(),
        noise=np.full(82, 2e-3),
        resolution=np.full(82, 3e-3),
        readings=np.full(82, 4.0 * SWING_PARTS),
    )
    expected = np.sqrt((2e-3**2 + 3e-3**2 / 12) / 4)
    assert _course_noise(one) == pytest.approx(expected, rel=1e-9)
    few = replace(one, readings=np.full(82, SWING_PARTS / 3))
    assert _course_noise(few) == pytest.approx(2 * expected, rel=1e-9)


def test_staircases_are_rows_and_shorter_ones_end_without_weight():
    one = plateaus()
    last = np.flatnonzero(one.staircase == 0)[-3:]
    kept = {name: np.delete(values, last, axis=0) for name, values in vars(one).items()}
    stairs = arrange(type(one)(**kept))
    assert stairs.torque.shape == (2, 41)
    np.testing.assert_array_equal(stairs.weight[0], [1] * 38 + [0] * 3)
    np.testing.assert_array_equal(stairs.weight[1], 1)
    np.testing.assert_array_equal(stairs.torque[0, 38:], 0)
    np.testing.assert_array_equal(stairs.current[0, 38:], 0)
    np.testing.assert_allclose(stairs.torque[0, :38], one.torque[:38])
    np.testing.assert_array_equal((stairs.end - stairs.begin)[0, 38:], 0)
    np.testing.assert_array_equal((stairs.end - stairs.middle)[0, 38:], 0)
    np.testing.assert_allclose(stairs.middle[1], (stairs.begin[1] + 0.08 + stairs.end[1]) / 2)
    np.testing.assert_array_equal(stairs.last_step[:, 0], 0)
    np.testing.assert_allclose(stairs.last_step[1, 1:], np.diff(stairs.setpoint[1]))
    np.testing.assert_array_equal(stairs.last_step[0, 38:], 0)
    assert stairs.count == 1e-3
    assert stairs.noise == pytest.approx(5e-4 * 0.5, rel=0.05)  # of the bench's gauge
    rising = np.flatnonzero(np.diff(one.current_setpoint, append=9.0) > 0)
    kept = {name: values[rising] for name, values in vars(one).items()}
    with pytest.raises(InsufficientDataError, match="staircase 0 has 1 steps in one of its"):
        arrange(type(one)(**kept))
    # plateaus at the same current are steps of neither direction
    level = one.current_setpoint.copy()
    level[:41] = np.concatenate([np.arange(10.0), np.full(29, 9.0), [8.0, 7.0]])
    with pytest.raises(InsufficientDataError, match="staircase 0 has 2 steps in one of its"):
        arrange(replace(one, current_setpoint=level))


@pytest.mark.parametrize("bend", [0.0, 4e-4])
def test_an_amplifier_is_a_line_through_means_of_levels(bend):
    """Of scipy, by what lies off the line, or by repeats where these scatter more; a staircase has
    fewer plateaus at its ends than between them."""
    rng, levels = np.random.default_rng(3), np.linspace(-4, 4, 9)
    count = np.array([3, 6, 6, 6, 6, 6, 6, 6, 2])
    setpoint = np.repeat(levels, count)
    current = 0.01 + 1.02 * setpoint + bend * np.abs(setpoint) + 2e-4 * rng.standard_normal(47)
    found = amplifier_linearity(SimpleNamespace(current_setpoint=setpoint, current=current))
    each = np.split(current, np.cumsum(count)[:-1])
    mean = np.array([one.mean() for one in each])
    line = linregress(levels, mean)
    assert (found.gain, found.offset) == pytest.approx((line.slope, line.intercept), rel=1e-9)
    np.testing.assert_allclose(found.current, mean)
    np.testing.assert_allclose(found.current_setpoint, levels, atol=1e-12)
    off = mean - line.intercept - line.slope * levels
    np.testing.assert_allclose(found.deviations, off, atol=1e-12)
    repeats = sum(np.sum((one - one.mean()) ** 2) for one in each) / 38
    inverse = np.linalg.pinv(np.column_stack([levels, np.ones(9)]))
    own = np.sqrt(np.diag(inverse @ np.diag(repeats / count) @ inverse.T))
    stated = [line.stderr, line.intercept_stderr] if bend else own
    assert (line.stderr > own[0]) == bool(bend)
    assert found.dof == (7 if bend else 38)
    assert (found.gain_u, found.offset_u) == pytest.approx(tuple(stated), rel=1e-6)
    own_u = np.sqrt(repeats / count[np.argmax(np.abs(off))])  # of that level's mean
    worst = np.abs(off).max()
    alike = np.sum(np.abs(off) >= worst - ALIKE * own_u)
    assert alike > 1
    assert (found.deviation, found.deviation_dof) == (pytest.approx(worst, rel=1e-9), 38)
    # the largest of n is too large by up to sqrt(2 ln n) of them
    expected = np.hypot(own_u, own_u * np.sqrt(2 * np.log(alike)))
    assert found.deviation_u == pytest.approx(expected, rel=1e-9)


@pytest.mark.parametrize("samples", [10, 11])
def test_a_plateau_has_three_settled_samples_at_least(samples):
    """The first eight, within 0.08 s, are left out."""
    level = np.repeat(np.arange(10.0), samples)
    time = 0.01 * np.arange(level.size)
    late = np.tile(np.arange(samples) >= 8, 10)
    signals = {
        "time": time,
        "current_setpoint": level,
        "current": level,
        "force": np.where(late, 2 * level, 100.0),
        "temperature": np.full(level.size, 20.0),
        "rotor_angle": None,
    }
    if samples < 11:
        with pytest.raises(InsufficientDataError, match="has 0 plateaus longer than"):
            plateaus_of_set_point(**signals, arm_length=0.5, settle_time=0.08)
        return
    found = plateaus_of_set_point(**signals, arm_length=0.5, settle_time=0.08)
    np.testing.assert_allclose(found.torque, np.arange(10.0))
    assert found.readings.tolist() == [11] * 10
