"""Recordings of a bare motor: when they are steady, and the motions that make them."""

import math
from types import SimpleNamespace

import numpy as np
import pytest

from rigtool.experiments.learning.implementations import bare_motor
from rigtool.experiments.learning.implementations.bare_motor import (
    ACCELERATION,
    SETTLE_TIME,
    STOP_MARGIN,
    both,
    revolutions,
    steady_specs,
    sweep_specs,
    task,
)
from rigtool.recipe import load_recipe
from rigtool.rigs import Feedforward
from tests.experiments.virtual_runs import RECIPE

SETTINGS = (
    "ilc_learn.turning.speeds_rev_per_s=[1, 5]",
    "ilc_learn.turning.low_speeds_rev_per_s=[0.3]",
    "ilc_learn.turning.revolutions=20",
    "ilc_learn.turning.low_speed_revolutions=4",
    "ilc_learn.turning.sweep_time=8",
)


@pytest.fixture(scope="module")
def recipe():
    return load_recipe(RECIPE, SETTINGS)[0]


def speed_of(motion, time):
    pieces = np.interp(time, motion.times, motion.speeds)
    return pieces


def test_a_steady_recording_holds_its_turns_after_run_up_and_settling(recipe):
    specs = steady_specs(recipe, "learn", both([5.0, 0.3]))
    assert [spec.name for spec in specs] == [f"learn_{n:03d}" for n in range(4)]
    for spec, (rev, turns) in zip(specs, [(0.3, 4), (-0.3, 4), (5, 20), (-5, 20)], strict=True):
        given = {name: value for name, (value, _) in spec.conditions.items()}
        speed = 2 * math.pi * rev
        assert given["speed"] == pytest.approx(speed)
        assert given["revolutions"] == turns == revolutions(recipe, rev)
        run_up = abs(speed) / ACCELERATION
        assert given["steady_from"] == pytest.approx(run_up + SETTLE_TIME)
        way = (given["steady_until"] - given["steady_from"]) * abs(rev)
        assert turns < way < turns + 0.1
        motion = task(spec, Feedforward()).motion
        assert motion.duration == pytest.approx(given["steady_until"] + STOP_MARGIN + run_up)
        time = np.linspace(run_up, given["steady_until"] + STOP_MARGIN, 50)
        np.testing.assert_allclose(speed_of(motion, time), speed, rtol=1e-9)
        slope = np.diff(motion.speeds) / np.diff(motion.times)
        np.testing.assert_allclose(np.abs(slope[[0, -1]]), ACCELERATION, rtol=1e-9)
        assert motion.speeds[0] == motion.speeds[-1] == 0


def test_a_sweep_goes_from_the_highest_speed_backwards_to_that_forwards(recipe):
    specs = sweep_specs(recipe)
    assert list(specs) == ["sweep_off", "sweep_plain", "sweep_on"]
    (spec,) = specs["sweep_on"]
    given = {name: value for name, (value, _) in spec.conditions.items()}
    top = 2 * math.pi * 5
    assert given["speed"] == pytest.approx(top)
    assert given["steady_from"] == pytest.approx(top / ACCELERATION + SETTLE_TIME)
    assert given["steady_until"] == pytest.approx(given["steady_from"] + 8)
    motion = task(spec, Feedforward()).motion
    begin, end = given["steady_from"], given["steady_until"]
    found = speed_of(motion, [begin - SETTLE_TIME, begin, (begin + end) / 2, end])
    np.testing.assert_allclose(found, [-top, -top, 0, top], atol=1e-9)
    assert motion.duration == pytest.approx(end + SETTLE_TIME + top / ACCELERATION)
    slope = np.diff(motion.speeds) / np.diff(motion.times)
    np.testing.assert_allclose(slope[[0, -1]], -ACCELERATION, rtol=1e-9)


def test_speeds_between_are_half_way_in_both_directions(recipe):
    assert bare_motor.between(recipe) == pytest.approx([0.65, -0.65, 3.0, -3.0])


def test_the_steady_part_is_counted_from_the_first_sample():
    conditions = {"steady_from": 0.95, "steady_until": 1.95}
    recording = SimpleNamespace(condition=conditions.get)
    time = 7.0 + 0.1 * np.arange(30)
    assert bare_motor._steady_part(recording, time) == slice(10, 20)
    assert bare_motor._steady_part(recording, time[:15]) == slice(10, 15)
    assert bare_motor._steady_part(recording, time[:0]) == slice(0, 0)
