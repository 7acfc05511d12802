"""Somebody else moves the virtual rig: free motion keeps to its bounds, and is only observed."""

import math
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from rigtool.recipe import load_recipe
from rigtool.recipe.virtual import Hand, Tissue
from rigtool.rigs import Task, open_rig
from rigtool.rigs.motion import Observe
from rigtool.rigs.virtual import hand
from tests.rigs.performed import perform

RECIPE = Path(__file__).parents[3] / "recipes" / "briaire-2006.toml"
RATIO = 0.85
STEADY = (  # nothing is drawn that depends on the length of a block
    "virtual.motor.friction_noise=0",
    "virtual.instrument.drift=0",
    "virtual.instrument.stroke_noise=0",
    "virtual.instrument.load_stroke_noise=0",
)


def observed(duration=20.0, every=8, touching=(), **settings_of_hand):
    recipe, _ = load_recipe(RECIPE, STEADY)
    changes = {"hand": Hand(**settings_of_hand), "contact": touching}
    virtual = recipe.virtual.model_copy(update=changes)
    rig = open_rig(recipe.model_copy(update={"virtual": virtual}), 0.0454, "test")
    return perform(rig, Task(Observe(duration), record_every=every, touched=True))


@settings(deadline=None, max_examples=40)
@given(
    seed=st.integers(0, 2**32 - 1),
    low=st.floats(-200, 100),
    span=st.floats(10, 400),
    slowest=st.floats(0.01, 1),
    times=st.floats(1, 20),
    share=st.floats(0, 0.8),
)
def test_free_motion_keeps_to_its_range_and_speed(seed, low, span, slowest, times, share):
    fastest = slowest * times
    settings_of_hand = Hand(
        angle_deg=(low, low + span), speed_rev_per_s=(slowest, fastest), pause_share=share
    )
    motion = hand.draw(settings_of_hand, RATIO, 30.0, np.random.default_rng(seed))
    time = np.linspace(0, 30.0, 60001)
    position, speed, acceleration = motion.setpoint(time)
    angle = position + motion.start
    limit = math.radians(span) * RATIO * 1e-9
    assert math.radians(low) * RATIO - limit <= angle.min()
    assert angle.max() <= math.radians(low + span) * RATIO + limit
    assert np.abs(speed).max() <= 2 * np.pi * fastest * (1 + 1e-9)
    assert (position[0], speed[0]) == (pytest.approx(0.0, abs=1e-12), 0.0)
    assert speed[-1] == pytest.approx(0.0, abs=1e-9 * fastest)
    # speed is the slope of position, acceleration that of speed
    step = time[1]
    largest = np.abs(acceleration).max()
    slope = np.diff(position) / step
    np.testing.assert_allclose(slope, (speed[1:] + speed[:-1]) / 2, rtol=0, atol=largest * step)
    gained = np.concatenate([[0.0], np.cumsum((acceleration[1:] + acceleration[:-1]) / 2 * step)])
    np.testing.assert_allclose(gained, speed, rtol=0, atol=0.02 * fastest + largest * step)


def test_free_motion_rests_and_reverses():
    motion = hand.draw(Hand(), RATIO, 300.0, np.random.default_rng(3))
    _, speed, _ = motion.setpoint(np.arange(0, 300.0, 1e-3))
    rests = np.abs(speed) < 1e-9
    assert 0.15 < rests.mean() < 0.45  # 0.3 of the stretches
    moving = np.sign(speed[~rests])
    assert np.count_nonzero(np.diff(moving)) > 60
    assert np.abs(speed).max() > 2 * np.pi * 1.0  # of at most 2 rev/s


def test_another_controller_moves_and_its_current_is_what_is_measured():
    got = observed()
    assert set(got) == {
        "time",
        "encoder",
        "current_setpoint",
        "current",
        "temperature",
        "reference_torque",
    }
    assert len(got["time"]) == 20 * 1000
    np.testing.assert_array_equal(got["reference_torque"], 0.0)  # nothing touches
    assert np.ptp(got["encoder"]) > 400
    assert np.abs(got["current_setpoint"]).max() > 0.2
    np.testing.assert_allclose(got["current"], got["current_setpoint"], rtol=0, atol=0.2)


def test_contacts_act_while_it_is_observed():
    tissue = Tissue(kind="tissue", at=(0.0,), angle_deg=90.0, stiffness=0.05)
    got = observed(touching=(tissue,))
    pushed = got["reference_torque"] > 1e-3
    assert 0.05 < pushed.mean() < 0.95
    assert (got["encoder"][pushed] * 2 * np.pi / 4000 / RATIO).min() > math.radians(90.0)


def test_a_hand_at_the_output_drives_the_motor_back_without_current():
    got = observed(moves="output", speed_rev_per_s=(0.1, 0.5))
    np.testing.assert_array_equal(got["current_setpoint"], 0.0)
    assert np.ptp(got["encoder"]) > 400
    # it overcomes friction: against motion, more than Coulomb friction of motor and housing
    slip = np.gradient(got["encoder"], 1e-3) * 2 * np.pi / 4000
    slow = np.convolve(slip, np.ones(200) / 200, "same")
    work = -(got["reference_torque"] * slow)
    moving = np.abs(slow) > 0.3
    assert np.mean(work[moving] > 0) > 0.95
    against = np.abs(got["reference_torque"])[moving]
    assert np.median(against) > 1.18 * (2.3e-3 + 0.8 * 10.5e-3)


def test_observing_goes_on_over_blocks():
    whole, means = observed(duration=6.0, every=1), observed(duration=6.0, every=24)
    expected = whole["encoder"].reshape(-1, 24).mean(axis=1)
    np.testing.assert_allclose(means["encoder"], expected, rtol=0, atol=1e-9)
