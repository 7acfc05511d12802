"""Set points: position, speed and acceleration belong together, and the ends are where they say."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from rigtool.rigs.motion import CurrentRamp, CurrentSteps, Move, SpeedProfile, Triangle

positive = st.floats(0.1, 30)


def assert_consistent(motion):
    """Check that speed integrates to position and acceleration to speed (trapezoidal rule)."""
    time = np.linspace(0, motion.duration, 40001)
    position, speed, acceleration = motion.setpoint(time)
    for place in (0, 7_000, 25_000, 40_000):  # as a controller asks
        for one, whole in zip(
            motion.setpoint(time[place : place + 1]), (position, speed, acceleration), strict=True
        ):
            within = 1e-12 * np.abs(whole).max()
            np.testing.assert_allclose(one, whole[place : place + 1], rtol=0, atol=within)
    step = time[1] - time[0]
    travelled = position[0] + np.concatenate([[0], np.cumsum((speed[1:] + speed[:-1]) / 2 * step)])
    gained = speed[0] + np.concatenate(
        [[0], np.cumsum((acceleration[1:] + acceleration[:-1]) / 2 * step)]
    )
    reach = np.ptp(position) + np.abs(speed).max() * step
    np.testing.assert_allclose(travelled, position, rtol=0, atol=2e-4 * reach)
    # a kink of the speed lies within one step: the trapezoid misses at most a step's worth
    worst = 20 * np.abs(acceleration).max() * step + 2e-4 * np.abs(speed).max()
    np.testing.assert_allclose(gained, speed, rtol=0, atol=worst)


@settings(deadline=None, max_examples=40)
@given(low=st.floats(-5, 5), span=positive, speed=positive, part=st.floats(0.05, 0.45))
def test_triangle(low, span, speed, part):
    motion = Triangle(low, low + span, speed, part * span, cycles=2)
    assert_consistent(motion)
    turn, stroke = motion.turn_time, motion.stroke_time
    ends, _, _ = motion.setpoint(np.array([0.0, stroke, 2 * stroke, 3 * stroke]))
    np.testing.assert_allclose(ends, [0, span, 0, span], rtol=0, atol=1e-9 * span)
    at_turn, speeds, accelerations = motion.setpoint(np.array([turn, stroke - turn]))
    np.testing.assert_allclose(at_turn, [part * span, span - part * span], rtol=1e-9)
    np.testing.assert_allclose(speeds, speed, rtol=1e-9)
    np.testing.assert_allclose(accelerations, 0, atol=1e-9 * speed / turn)


@settings(deadline=None, max_examples=40)
@given(
    steps=st.lists(st.floats(0.2, 5), min_size=1, max_size=6),
    speeds=st.lists(st.floats(-30, 30), min_size=7, max_size=7),
)
def test_speed_profile(steps, speeds):
    times = (0.0, *np.cumsum(steps))
    motion = SpeedProfile(times, tuple(speeds[: len(times)]))
    assert_consistent(motion)
    _, at_points, _ = motion.setpoint(np.array(times))
    np.testing.assert_allclose(at_points, motion.speeds, rtol=1e-9, atol=1e-9)


def test_a_speed_held_twice_takes_no_time_between():
    twice = SpeedProfile((0, 1, 2, 2, 3, 4), (0, 5, 5, 5, 5, 0))
    once = SpeedProfile((0, 1, 3, 4), (0, 5, 5, 0))
    time = np.linspace(0, 4, 401)
    np.testing.assert_allclose(twice.setpoint(time), once.setpoint(time), rtol=0, atol=1e-12)
    assert_consistent(twice)


@settings(deadline=None, max_examples=20)
@given(angle=st.floats(-10, 10, allow_subnormal=False), duration=positive)
def test_move_ends_at_rest(angle, duration):
    motion = Move(angle, duration)
    assert_consistent(motion)
    position, speed, acceleration = motion.setpoint(np.array([0.0, duration]))
    np.testing.assert_allclose(position, [0, angle], rtol=1e-12)
    np.testing.assert_allclose(speed, 0, atol=1e-12)
    np.testing.assert_allclose(acceleration, 0, atol=1e-9)


def test_current_steps_hold_each_level_for_the_same_number_of_samples():
    motion = CurrentSteps((0.0, 1.5, -2.0), step_time=0.4)
    time = (np.arange(round(motion.duration * 8000)) + 0.5) / 8000
    np.testing.assert_array_equal(motion.current(time), np.repeat([0.0, 1.5, -2.0], 3200))


def test_current_ramp_reaches_its_limit():
    motion = CurrentRamp(rate=-0.02, limit=-0.25)
    assert motion.duration == pytest.approx(12.5, rel=1e-12)
    assert motion.current(np.array([12.5])) == pytest.approx(-0.25, rel=1e-12)


def test_whole_numbers_make_the_same_strokes_as_fractions():
    time = np.linspace(0, 1, 500)
    whole, fractions = Triangle(0, 2, 4, 0.3, 1), Triangle(0.0, 2.0, 4.0, 0.3, 1)
    for found, expected in zip(whole.setpoint(time), fractions.setpoint(time), strict=True):
        np.testing.assert_array_equal(found, expected)
