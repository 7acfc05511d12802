"""Moves cut out of a recording and laid over each other: closed forms of the set point."""

import numpy as np
import pytest

from rigtool.errors import InsufficientDataError
from rigtool.numerics.moves import Moves, at_positions, cut_moves
from rigtool.rigs.motion import Triangle

DT = 125e-6
POSITION = np.arange(200, 1500) * (2 * np.pi / 4000)


def motion(speed=7.3, cycles=5):
    return Triangle(low=0.0, high=2.67, speed=speed, turn_angle=0.3, cycles=cycles)


def recorded(cycles=5):
    """Return time, set point and a torque that depends on position and direction."""
    moves = motion(cycles=cycles)
    time = np.arange(round(moves.duration / DT)) * DT
    setpoint, velocity, _ = moves.setpoint(time)
    return time, setpoint, 1e-3 * np.cos(2 * setpoint + 0.4) + 2e-3 * np.tanh(velocity)


def test_moves_are_cut_where_the_set_point_rises_through_its_middle():
    time, setpoint, torque = recorded()
    moves = cut_moves(time, setpoint, torque, 4)
    assert moves.period == pytest.approx(2 * motion().stroke_time, rel=1e-9, abs=0)
    assert moves.setpoint[0] == pytest.approx(2.67 / 2, rel=1e-9, abs=0)
    assert moves.setpoint[1] > moves.setpoint[0]
    assert len(moves.torque) == 4
    # One function of position and direction: alike from move to move, but for the interpolation
    assert np.ptp(moves.torque, axis=0).max() < 1e-3 * np.abs(moves.torque).max()


@pytest.mark.parametrize("direction", [1, -1])
def test_positions_are_read_on_the_half_that_was_asked_for(direction):
    time = np.arange(40000) * DT
    setpoint, velocity, _ = motion().setpoint(time)
    moves = cut_moves(time, setpoint, np.sign(velocity) * np.exp(setpoint), 3)
    found = at_positions(moves, moves.torque, POSITION, direction)
    expected = np.broadcast_to(direction * np.exp(POSITION), found.shape)
    np.testing.assert_allclose(found, expected, rtol=1e-6, atol=0)
    with pytest.raises(ValueError, match="within the moves' range"):
        at_positions(moves, moves.torque, POSITION + 2, direction)


def test_too_few_or_unlike_moves_are_refused():
    time, setpoint, torque = recorded(cycles=3)
    with pytest.raises(InsufficientDataError, match=r"2 whole moves.* 3 are needed"):
        cut_moves(time, setpoint, torque, 3)
    with pytest.raises(InsufficientDataError, match="torque is nan at sample 7"):
        cut_moves(time, setpoint, np.where(np.arange(len(time)) == 7, np.nan, torque), 1)
    with pytest.raises(InsufficientDataError, match="0 whole moves"):
        cut_moves(time, np.zeros(len(time)), torque, 1)
    slower, _, _ = motion(5.0, 3).setpoint(time)
    both = np.concatenate([setpoint, slower])
    with pytest.raises(InsufficientDataError, match="differ by more than a sample"):
        cut_moves(np.arange(len(both)) * DT, both, np.zeros(len(both)), 3)


@pytest.mark.parametrize("direction", [1, -1])
def test_what_is_read_at_the_positions_of_samples_are_the_samples(direction):
    """From end to end of either half of the period."""
    setpoint = np.array([0.0, 1.0, 2.5, 3.0, 2.0, 1.5, -1.0, -0.5])
    signals = np.random.default_rng(1).standard_normal((2, 8))
    moves = Moves(1.0, setpoint, signals)
    half = [6, 7, 0, 1, 2, 3] if direction > 0 else [6, 5, 4, 3]
    found = at_positions(moves, signals, setpoint[half], direction)
    np.testing.assert_allclose(found, signals[:, half], rtol=1e-12)
    between = (setpoint[half][1:] + setpoint[half][:-1]) / 2
    expected = (signals[:, half][:, 1:] + signals[:, half][:, :-1]) / 2
    np.testing.assert_allclose(
        at_positions(moves, signals, between, direction), expected, rtol=1e-12
    )
