"""An inertia that was not learned, by the torque at the turns of strokes."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from rigtool.experiments.force_sensor.unknown_inertia import Turns, unknown_inertia

STEP, U = 5e-3, 0.45e-3
TIME = STEP * np.arange(4000)
COUNT = 2 * np.pi / 4000 / 0.85


def strokes(turn=0.1, period=1.6, way=2.5):
    """Angle of strokes with constant acceleration within `turn` s, as the encoder shows it, and
    that acceleration, rad and rad/s2."""
    phase = (TIME / period) % 1
    half = turn / 2 / period
    speed = np.interp(phase, [0, half, 0.5 - half, 0.5 + half, 1 - half, 1], [0, 1, 1, -1, -1, 0])
    speed *= way / (period / 2)
    angle = np.cumsum(speed) * STEP
    return np.floor(angle / COUNT) * COUNT, np.gradient(speed, STEP), speed


def turns(torque, known=True, angle=None):
    own = strokes()[0] if angle is None else angle
    return Turns.of(STEP, own, np.full(len(TIME), known), torque, np.full(len(TIME), U))


def drawn(rng):
    """Errors of the torque: noise, and friction that is off in each direction by as much."""
    speed = strokes()[2]
    return 0.2e-3 * rng.standard_normal(len(TIME)) + 0.4e-3 * np.sign(speed)


@settings(max_examples=10)
@given(seed=st.integers(0, 2**31), inertia=st.floats(10e-6, 60e-6))
def test_an_inertia_is_found_with_its_torque(seed, inertia):
    acceleration = strokes()[1]
    torque = drawn(np.random.default_rng(seed)) + inertia * acceleration
    found = unknown_inertia([turns(torque)])
    assert found is not None
    assert found.inertia == pytest.approx(inertia, rel=0.35)
    assert found.torque == pytest.approx(inertia * np.abs(acceleration).max(), rel=0.5)


@settings(max_examples=10)
@given(seed=st.integers(0, 2**31), stiffness=st.floats(0, 0.05), friction=st.floats(-5e-3, 5e-3))
def test_springs_at_both_ends_and_friction_are_no_inertia(seed, stiffness, friction):
    """A spring pushes back at each end, which less inertia than was learned would do; an inertia
    takes torque the other way. Friction changes with the direction."""
    angle, _, speed = strokes()
    middle, half = np.ptp(angle) / 2 + angle.min(), np.ptp(angle) / 2
    beyond = np.maximum(np.abs(angle - middle) - 0.8 * half, 0) * np.sign(angle - middle)
    torque = drawn(np.random.default_rng(seed)) + stiffness * beyond + friction * np.sign(speed)
    assert unknown_inertia([turns(torque)]) is None


def test_a_spring_at_one_end_and_pulses_that_push_the_rotor_are_no_inertia():
    angle, acceleration, _ = strokes()
    one_end = 0.1 * np.maximum(angle - 0.8 * angle.max(), 0)
    assert unknown_inertia([turns(-one_end)]) is None
    assert unknown_inertia([turns(np.where(acceleration > 0, 40e-6 * acceleration, 0.0))]) is None
    pushed = 0.05 * np.sin(2 * np.pi * 5 * TIME) * (TIME % 2 < 0.2)
    found = turns(1e-3 * np.gradient(np.gradient(pushed, STEP), STEP), angle=pushed)
    assert not len(found.inertia)


@pytest.mark.parametrize("hangs", [False, True])
def test_a_slow_swing_under_a_force_is_no_inertia_where_quick_motion_shows_none(hangs):
    """A force of 1.2 Hz swings the rotor within its loop for 8 s; before, a hand moves it."""
    swings = TIME > 12
    angle = np.where(swings, 1.5 * np.sin(7.5 * TIME), 0.4 * np.sin(20 * TIME))
    acceleration = np.where(swings, 7.5**2, 20**2) * -angle
    torque = drawn(np.random.default_rng(5)) + 280e-6 * acceleration * (swings | hangs)
    own = turns(torque, angle=np.floor(angle / COUNT) * COUNT)
    assert (acceleration[swings].max() > 80) & (len(own.inertia) > 8)
    found = unknown_inertia([own])
    assert (found is not None) == hangs
    if hangs:
        assert found.inertia == pytest.approx(280e-6, rel=0.2)


@pytest.mark.parametrize(("hertz", "size"), [(7.1, 10e-3), (10.2, 10e-3), (10.2, 20e-3)])
def test_a_force_that_swings_the_rotor_in_its_strokes_is_no_inertia(hertz, size):
    """The loop yields by as much as an inertia of 275e-6 kg m2 would take, at any moment."""
    force = size * np.sin(2 * np.pi * hertz * TIME)
    yields = -force / (275e-6 * (2 * np.pi * hertz) ** 2)
    torque = drawn(np.random.default_rng(3)) + force
    own = turns(torque, angle=strokes()[0] + np.floor(yields / COUNT) * COUNT)
    assert len(own.inertia) >= 8
    assert unknown_inertia([own]) is None


@pytest.mark.parametrize("part", ["few", "unknown", "coarse", "short"])
def test_where_turns_are_not_seen_nothing_is_said(part):
    angle, acceleration, _ = strokes()
    torque, u, known = 40e-6 * acceleration, np.full(len(TIME), U), np.ones(len(TIME), bool)
    span = slice(0, {"few": 900, "short": 70}.get(part, 4000), {"coarse": 4}.get(part, 1))
    if part == "unknown":
        known = np.abs(acceleration) < 1
    step = STEP * (span.step or 1)
    own = Turns.of(step, angle[span], known[span], torque[span], u[span])
    assert unknown_inertia([own]) is None
    if part == "few":
        assert unknown_inertia([own, own]) is not None
