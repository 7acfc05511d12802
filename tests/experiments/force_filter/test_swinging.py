"""How far a torque swings shows while the rotor slides, and is kept while it is held."""

import numpy as np
import pytest

from rigtool.experiments.force_filter.motion_states import State
from rigtool.experiments.force_filter.swinging import Swinging

STEP, LEAST = 1e-3, (0.3e-3) ** 2
TIME = STEP * np.arange(20_000.0)


def follow(torque, state=State.AGAINST):
    states = np.broadcast_to(np.int32(state), torque.shape).copy()
    return Swinging(LEAST, STEP).add(torque, states)


@pytest.mark.parametrize("hz", [2.0, 5.0, 10.0])
@pytest.mark.parametrize("constant", [0.0, 20e-3])
def test_a_sine_has_its_variance_whatever_it_swings_about(hz, constant):
    found = follow(constant + 4e-3 * np.sin(2 * np.pi * hz * TIME))[10_000:].mean()
    away = (2 * np.pi * hz * 0.1) ** 2 / (1 + (2 * np.pi * hz * 0.1) ** 2)
    assert found == pytest.approx(8e-6 * away - LEAST, rel=0.1)


def test_pulses_are_no_swing():
    pulses = np.where(TIME % 3 < 1, 30e-3, 0.0)
    assert (follow(pulses)[5000:] < (0.05 * 30e-3) ** 2).all()


def test_a_torque_that_rests_has_none():
    noise = np.random.default_rng(1).normal(0, 0.1e-3, TIME.size)
    assert follow(10e-3 + noise)[5000:].max() < LEAST / 100


def test_it_is_kept_while_the_rotor_is_held_and_forgotten_while_it_slides_without():
    torque = np.where(TIME < 5, 4e-3 * np.sin(2 * np.pi * 5 * TIME), 0.0)
    states = np.full(TIME.size, State.WITH, dtype=np.int32)
    states[5000:15_000] = State.STILL
    found = Swinging(LEAST, STEP).add(torque, states)
    assert found[4999] > 5e-6
    assert (found[5000:15_000] == found[4999]).all()
    assert (found[17_000:] == 0).all()


def test_steps_outside_change_nothing_and_blocks_do_not_matter():
    torque = 4e-3 * np.sin(2 * np.pi * 5 * TIME)
    states = np.full(TIME.size, State.AGAINST, dtype=np.int32)
    states[7000:9000] = State.OUTSIDE
    inside = states != State.OUTSIDE
    whole = Swinging(LEAST, STEP).add(torque, states)
    np.testing.assert_array_equal(whole[inside], follow(torque[inside]))
    own = Swinging(LEAST, STEP)
    pieces = [
        own.add(torque[a:b], states[a:b]) for a, b in ((0, 1), (1, 1), (1, 8000), (8000, None))
    ]
    np.testing.assert_array_equal(np.concatenate(pieces), whole)
