"""Motions for force over time: their shape, their time, and how far they may go."""

import math
from types import SimpleNamespace

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.interpolate import PchipInterpolator

from rigtool.errors import RecipeError
from rigtool.experiments.force_filter.motion_states import Reach
from rigtool.experiments.force_sensor.procedure_motion import (
    path,
    path_from_start,
    require_learned,
    require_time,
)
from rigtool.recipe import load_recipe
from rigtool.rigs.motion import SpeedProfile
from tests.experiments.virtual_runs import RECIPE

REACH = Reach((0.5, 3.0), 10.0, 60e-3, (20.0, 50.0))


def recipe(*sets):
    motion = [f"measure_force.motion.{value}" for value in sets]
    return load_recipe(RECIPE, ["rig.attachment=instrument", *motion])[0]


def test_a_sine_goes_over_the_whole_stroke_in_whole_periods():
    own = recipe("kind=sine", "frequency_hz=0.8")
    start, motion = path_from_start(own, 6.1)
    high = math.radians(own.measure_force.angle) * own.rig.angle_ratio
    assert start == 0.0
    assert motion.duration == pytest.approx(math.ceil(6.1 * 0.8) / 0.8)
    time = np.linspace(0, motion.duration, 3001)
    place, speed, _ = motion.setpoint(time)
    assert_allclose(place, high / 2 * (1 - np.cos(2 * np.pi * 0.8 * time)), atol=5e-3 * high)
    assert_allclose(speed, high * np.pi * 0.8 * np.sin(2 * np.pi * 0.8 * time), atol=0.02 * high)


def test_strokes_are_whole_cycles_at_the_speed_of_the_output():
    own = recipe("kind=strokes")
    start, motion = path_from_start(own, 20.0)
    settings, ratio = own.measure_force, own.rig.angle_ratio
    place, speed, _ = motion.setpoint(np.linspace(0, motion.duration, 20001))
    high = math.radians(settings.angle) * ratio
    assert start == 0.0
    assert_allclose([place.min(), place.max()], [0, high], atol=1e-3)
    fast = 2 * math.pi * settings.speed_rev_per_s * ratio
    assert np.abs(speed).max() == pytest.approx(fast)
    middle = np.abs(place - high / 2) < high / 2 - math.radians(settings.turn_angle) * ratio * 1.01
    assert_allclose(np.abs(speed[middle]), fast, rtol=1e-6)
    near = np.abs(place - high / 2) > high / 2 - math.radians(settings.turn_angle) * ratio * 0.9
    assert np.abs(speed[near]).max() < fast * 0.999
    once = path_from_start(own, 0.1)[1].duration
    assert motion.duration == pytest.approx(math.ceil(20.0 / once) * once)


def test_a_hold_stays_where_the_rotor_is():
    start, motion = path_from_start(recipe("kind=hold"), 7.0)
    assert start is None
    assert motion.duration == 7.0
    assert not motion.setpoint(np.linspace(0, 7, 50))[0].any()


def test_a_path_is_that_of_its_file_at_the_motor(tmp_path):
    (file := tmp_path / "path.csv").write_text("time_s,angle_deg\n1,20\n3,90\n4,60\n")
    own = recipe("kind=path", f"file={file}")
    start, motion = path_from_start(own, 1.0)
    ratio = own.rig.angle_ratio
    assert start == pytest.approx(math.radians(20) * ratio)
    assert motion.duration == pytest.approx(3.0)
    place = start + motion.setpoint(np.array([0.0, 2.0, 3.0]))[0]
    assert_allclose(place, np.radians([20, 90, 60]) * ratio, atol=0.01)


def test_a_path_is_a_monotone_cubic_between_its_points():
    """At rest at both ends; within a thousandth of the spline of scipy elsewhere."""
    time, angle = np.array([2.0, 3.0, 3.4, 5.0, 6.0]), np.array([0.0, 1.0, 1.7, 2.0, 1.2])
    motion, at = path(time, angle), np.linspace(1.0, 3.0, 200)
    assert motion.duration == pytest.approx(4.0)
    expected = PchipInterpolator(time - 2, angle)(at)
    assert_allclose(motion.setpoint(at)[0], expected, atol=4e-3)
    ends = motion.setpoint(np.array([0.0, 4.0]))[1]
    assert_allclose(ends, 0.0, atol=1e-12)


@pytest.mark.parametrize(
    ("least", "seconds", "longest", "message"),
    [(2.0, 2.0, 2.0, None), (2.0, 1.9, 9.0, "needs 2 s"), (1.0, 9.1, 9.0, "time_max is 9 s")],
)
def test_a_recording_is_neither_shorter_nor_longer_than_allowed(least, seconds, longest, message):
    if message is None:
        require_time(least, seconds, longest)
        return
    with pytest.raises(RecipeError, match=message):
        require_time(least, seconds, longest)


def moved(to, fastest=1.0):
    """Go to an angle from where the rotor is, and stay."""
    seconds = abs(to) / fastest
    pace = math.copysign(fastest, to)
    return SpeedProfile((0.0, 1e-9, seconds, seconds + 1e-9, seconds + 1), (0, pace, pace, 0, 0))


@pytest.mark.parametrize(
    ("begin", "to", "refused"),
    [(1.0, 1.99, False), (1.0, 2.05, True), (1.0, -0.49, False), (1.0, -0.55, True)],
)
@pytest.mark.parametrize("known", [True, False])
def test_the_range_is_that_of_the_motor_from_where_it_begins(begin, to, refused, known):
    given = (begin, moved(to), REACH, 9.0) if known else (None, moved(to), REACH, begin)
    if not refused:
        require_learned(*given)
        return
    low, high = sorted((begin, begin + to))
    with pytest.raises(RecipeError, match=f"covers {low:.4g} to {high:.4g} rad"):
        require_learned(*given)


@pytest.mark.parametrize(("speed", "refused"), [(10.0, False), (10.2, True)])
@pytest.mark.parametrize("way", [1.0, -1.0])
def test_the_speed_is_that_of_what_was_learned(speed, refused, way):
    own = moved(way * 0.4, speed)
    if not refused:
        require_learned(1.0, own, REACH, 1.0)
        return
    with pytest.raises(RecipeError, match=r"reaches 10\.2 rad/s.*learned up to 10 rad/s"):
        require_learned(1.0, own, REACH, 1.0)


def test_each_millisecond_of_a_motion_is_looked_at():
    seen = []

    def setpoint(time):
        seen.append(time)
        return 0 * time, 0 * time, 0 * time

    for seconds, points in ((0.2, 1000), (700.0, 700_000)):
        seen.clear()
        require_learned(1.0, SimpleNamespace(duration=seconds, setpoint=setpoint), REACH, 0.0)
        every = np.concatenate(seen)
        assert_allclose(every, np.linspace(0, seconds, points), atol=1e-9)
