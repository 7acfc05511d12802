"""Turns cut from recordings, and what one update makes of them."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from rigtool.control.position_loop import TransferFunction, position_loop
from rigtool.errors import InsufficientDataError
from rigtool.experiments.learning.filters import Learning, zpetc
from rigtool.experiments.learning.rows import Row
from rigtool.experiments.learning.turns import (
    TURN,
    by_angle,
    cut_turns,
    learned_row,
    repeatable_row,
    torque_row,
    turn_angles,
)
from rigtool.numerics.moves import Moves

RATE = 2000.0


def wave(angle):
    return 2e-3 + 1e-3 * np.cos(2 * angle + 0.4) + 3e-4 * np.sin(9 * angle)


def recording(speed, turns, start=0.0):
    time = np.arange(math.ceil(turns * TURN / abs(speed) * RATE) + 1) / RATE + 3.0
    angle = start + speed * (time - 3.0)
    return time, angle, wave(angle)


def filters(cutoff_hz=100.0, factor=1.0):
    loop = position_loop(
        crossover_hz=50,
        lead_ratio=3,
        integrator_hz=4,
        lowpass_hz=400,
        lowpass_damping=0.7,
        inertia=1.5e-5,
        sample_time=125e-6,
    )
    system = loop.complementary_sensitivity
    return Learning(system, zpetc(system, 0.999), cutoff_hz, 4, factor)


@settings(max_examples=60, deadline=None)
@given(
    speed=st.floats(1.0, 30.0),
    backwards=st.booleans(),
    start=st.floats(-100, 100),
    turns=st.integers(1, 4),
    positions=st.integers(50, 300),
)
def test_turns_lie_over_each_other_by_angle(speed, backwards, start, turns, positions):
    speed = -speed if backwards else speed
    cut = cut_turns(*recording(speed, turns, start), turns)
    assert cut.period == pytest.approx(TURN / abs(speed), rel=1e-9)
    assert math.copysign(1, cut.setpoint[-1]) == math.copysign(1, speed)
    found = by_angle(cut, cut.torque, positions)
    assert found.shape == (turns, positions)
    # Linear between samples: (9 steps)^2/8 of the highest order, in the angle of a sample.
    step = max(abs(speed) / RATE, TURN / cut.setpoint.size)
    bound = 1e-9 + (9 * step) ** 2 / 8 * 3e-4 + (2 * step) ** 2 / 8 * 1e-3
    expected = wave(turn_angles(positions))
    np.testing.assert_allclose(found, np.tile(expected, (turns, 1)), rtol=0, atol=2 * bound)


@pytest.mark.parametrize("positions", [20, 31, 32, 33, 90])
@pytest.mark.parametrize("direction", [1, -1])
def test_between_samples_of_a_turn_angles_have_its_orders(positions, direction):
    """More angles than samples, or fewer; as many rows as there are turns."""
    step = TURN / 32
    setpoint = direction * step * np.arange(32)
    turns = Moves(1.0, setpoint, np.stack([wave(setpoint), 2 * wave(setpoint)]))
    expected = wave(turn_angles(positions))
    found = by_angle(turns, turns.torque, positions)
    np.testing.assert_allclose(found, [expected, 2 * expected], rtol=0, atol=1e-12)
    np.testing.assert_allclose(by_angle(turns, turns.torque[0], positions), found[0], atol=1e-15)


def test_recordings_without_whole_turns_are_refused():
    time, angle, torque = recording(5.0, 3)
    with pytest.raises(InsufficientDataError, match=r"3.* turns at constant speed .* 4 are needed"):
        cut_turns(time, angle, torque, 4)
    swinging = angle + 0.1 * np.sin(time)
    with pytest.raises(InsufficientDataError, match="from constant speed"):
        cut_turns(time, swinging, torque, 2)
    with pytest.raises(InsufficientDataError, match="from constant speed"):
        cut_turns(time, angle + 2e-3 * TURN * np.sin(9 * time), torque, 2)
    # a thousandth of a turn is steady
    cut_turns(time, angle + 0.5e-3 * TURN * np.sin(9 * time), torque, 2)


@pytest.mark.parametrize("speed", [6.0, -6.0])
def test_an_update_applies_the_learning_filter_in_the_direction_of_time(speed):
    """The order n of a turn is the frequency n v/2 pi: its gain and phase are those of Q L."""
    learning = filters()
    time, angle, _ = recording(speed, 3)
    order = 30
    row = learned_row(cut_turns(time, angle, np.cos(order * angle), 3), speed, learning, 4000)
    frequency = np.array([order * abs(speed) / TURN])
    gain = (learning.robustness(frequency) * learning.inverse.response(frequency))[0]
    if speed < 0:
        gain = np.conj(gain)
    expected = np.real(gain * np.exp(1j * order * turn_angles(4000)))
    # The samples are 1/100 of this wave's period apart, and interpolated.
    np.testing.assert_allclose(row.mean, expected, rtol=0, atol=3e-3 * abs(gain))
    torque = torque_row(cut_turns(time, angle, np.cos(order * angle), 3), speed, learning, 4000)
    assert np.abs(torque.mean).max() == pytest.approx(learning.robustness(frequency)[0], rel=3e-3)
    assert row.speed == torque.speed == speed


def test_what_was_fed_forward_is_kept_by_the_next_update():
    learning = filters()
    time, angle, torque = recording(6.0, 3)
    cut = cut_turns(time, angle, 0 * torque, 3)
    before = wave(cut.setpoint)
    row = learned_row(cut, 6.0, learning, 500, before)
    np.testing.assert_allclose(row.mean, wave(turn_angles(500)), rtol=0, atol=1e-9)


def test_noise_makes_no_row():
    rng = np.random.default_rng(1)
    moves = rng.standard_normal((20, 400))
    assert not repeatable_row(Row(1.0, moves)).mean.any()
    both = repeatable_row(Row(1.0, moves + 5 * np.cos(3 * turn_angles(400))))
    orders = np.abs(np.fft.rfft(both.mean)) / 200
    assert np.flatnonzero(orders > 1e-9).tolist() == [3]
    assert orders[3] == pytest.approx(5, abs=0.1)


def test_filters_know_no_time_but_that_of_the_loop():
    """Half the sampling rate of the recording, the same row."""
    fast = recording(6.0, 3)
    slow = tuple(signal[::2] for signal in fast)
    rows = [learned_row(cut_turns(*s, 2), 6.0, filters(), 400).mean for s in (fast, slow)]
    np.testing.assert_allclose(rows[0], rows[1], rtol=0, atol=1e-6)


def test_the_identity_learns_what_is_there():
    one = TransferFunction(np.array([1.0]), np.array([1.0]), 125e-6)
    learning = Learning(one, zpetc(one, 0.999), 500.0, 4, 1.0)
    row = learned_row(cut_turns(*recording(6.0, 4), 3), 6.0, learning, 400)
    np.testing.assert_allclose(row.mean, wave(turn_angles(400)), rtol=0, atol=1e-6)
