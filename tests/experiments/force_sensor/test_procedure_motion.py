"""Motions for force over time."""

import tracemalloc

import numpy as np
import pytest

from rigtool.errors import RecipeError
from rigtool.experiments.force_filter.motion_states import Reach
from rigtool.experiments.force_sensor.procedure_motion import (
    path,
    path_from_start,
    path_of,
    require_learned,
)
from rigtool.recipe import load_recipe
from tests.experiments.virtual_runs import RECIPE

REACH = Reach((0.0, 2.67), 10.0, 60e-3, (20.0, 50.0))


def recipe(*sets):
    return load_recipe(RECIPE, [f"measure_force.motion.{value}" for value in sets])[0]


@pytest.mark.parametrize("kind", ["strokes", "sine", "hold"])
def test_each_motion_lasts_as_long_as_asked_and_stays_within_the_range(kind):
    start, motion = path_from_start(recipe(f"kind={kind}"), 10.0)
    assert motion.duration >= 10.0
    position, _, _ = motion.setpoint(np.linspace(0, motion.duration, 5000))
    assert position.min() + (start or 0.0) > -1e-6
    assert position.max() + (start or 0.0) < 2.671
    require_learned(start, motion, REACH, 1.0)


def test_a_path_passes_through_its_points_and_begins_and_ends_at_rest():
    time, angle = np.array([0.0, 1.0, 1.5, 3.0]), np.array([0.3, 1.2, 0.9, 2.0])
    motion = path(time, angle)
    position, speed, _ = motion.setpoint(time)
    np.testing.assert_allclose(position + 0.3, angle, atol=0.01)
    np.testing.assert_allclose(speed[[0, -1]], 0.0, atol=1e-9)


def test_a_path_within_what_was_learned_stays_there():
    time, angle = np.array([0.0, 2.0, 4.0, 5.0]), np.array([0.0, 2.67, 0.0, 0.0])
    motion = path(time, angle)
    position, _, _ = motion.setpoint(np.linspace(0, 5, 5001))
    assert position.min() > -1e-9
    assert position.max() < 2.67 * 1.001
    require_learned(0.0, motion, REACH, 0.0)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("time,angle\n0,1\n", "first line must be time_s,angle_deg, it is 'time,angle'"),
        ("time_s,angle_deg\n0,1\n", "1 points, two"),
        ("time_s,angle_deg\n0,1\n\n0,2\n", "line 4: 0 s follows 0 s"),
        ("time_s,angle_deg\n0,1\n1,nan\n", "line 3, '1,nan', must be two numbers"),
        ("time_s,angle_deg\n0,1\n1,x\n", "line 3, '1,x', must"),
        ("time_s,angle_deg\n0,1\n1\n", "line 3, '1', must"),
        ("time_s,angle_deg\n0,2,5\n1,3,5\n", "line 2, '0,2,5', must"),
        ("", "cannot be used"),
        ("time_s,angle_deg\n0,\xb5\n", "byte 19 is not UTF-8; give a text, saved in UTF-8"),
    ],
)
def test_a_file_that_is_no_path_is_refused(tmp_path, text, message):
    file = tmp_path / "path.csv"
    file.write_text(text, encoding="latin-1")
    with pytest.raises(RecipeError, match=message):
        path_of(file)


def test_a_path_that_ends_before_the_time_to_record_is_refused(tmp_path):
    (file := tmp_path / "path.csv").write_text("time_s,angle_deg\n1.1,20\n2.6,90\n4.1,20\n")
    own = recipe("kind=path", f"file={file}")
    for seconds in (2.0, 3.0):  # 4.1 - 1.1 is not quite 3
        assert path_from_start(own, seconds)[1].duration == pytest.approx(3.0)
    with pytest.raises(RecipeError, match=r"60 s are .*path.csv lasts 3 s: give --record 3 at"):
        path_from_start(own, 60.0)


def test_a_path_may_begin_with_a_byte_order_mark(tmp_path):
    (file := tmp_path / "path.csv").write_bytes(b"\xef\xbb\xbftime_s,angle_deg\r\n0,0\r\n1,90\r\n")
    np.testing.assert_allclose(path_of(file), [[0.0, 1.0], [0.0, np.pi / 2]])


@pytest.mark.parametrize("motion", [["kind=sine", "frequency_hz=1e-4"], ["kind=path"], []])
def test_a_motion_that_lasts_too_long_is_refused(tmp_path, motion):
    (file := tmp_path / "path.csv").write_text("time_s,angle_deg\n0,20\n1e9,90\n")
    sets = [*motion, f"file={file}"] if motion == ["kind=path"] else [*motion, "time_max=5"]
    with pytest.raises(RecipeError, match="time_max is"):
        path_from_start(recipe(*sets), 5.0)


def test_motions_beyond_what_was_learned_are_refused():
    start, motion = path_from_start(recipe("kind=sine", "frequency_hz=3"), 2.0)
    with pytest.raises(RecipeError, match="learned up to 10 rad/s"):
        require_learned(start, motion, REACH, 0.0)
    wide = path(np.array([0.0, 5.0]), np.array([0.0, 3.0]))
    with pytest.raises(RecipeError, match=r"learned from 0 to 2\.67 rad"):
        require_learned(0.0, wide, REACH, 0.0)


def test_a_leap_within_a_millisecond_is_refused():
    leap = path(np.array([0.0, 2.0, 2.0004, 5.0]), np.array([0.3, 0.3, 2.4, 0.3]))
    with pytest.raises(RecipeError, match="learned up to 10 rad/s"):
        require_learned(0.0, leap, REACH, 0.0)


def test_a_long_motion_is_looked_at_in_pieces():
    long = path(np.array([0.0, 150.0, 299.9, 300.0]), np.array([0.0, 2.6, 2.5, 3.0]))
    tracemalloc.start()
    try:
        with pytest.raises(RecipeError, match=r"learned from 0 to 2\.67 rad"):
            require_learned(0.0, long, REACH, 0.0)
        assert tracemalloc.get_traced_memory()[1] < 20e6
    finally:
        tracemalloc.stop()
