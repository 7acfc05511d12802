"""Whole turns of a steadily turning shaft, laid over each other [Fig. 24, 43].

At constant speed a turn is a period both in time and in angle: learning filters it in time, the
table holds it by angle. Turns start at the zero of the set point's angle.
"""

from __future__ import annotations

import math

import numpy as np

from rigtool.errors import InsufficientDataError
from rigtool.experiments.learning.filters import Learning
from rigtool.experiments.learning.repeatable import only_kept, repeatability
from rigtool.experiments.learning.rows import Row
from rigtool.numerics.arrays import Array
from rigtool.numerics.checks import require_rising, require_signals
from rigtool.numerics.moves import Moves

TURN = 2 * math.pi

STEADY_DEVIATION = 1e-3
"""Deviation of the set point from constant speed that is allowed, of a turn."""


def cut_turns(time: Array, setpoint: Array, torque: Array, turns: int) -> Moves:
    """Cut the last `turns` turns out of a recording at constant speed, signals (n,) in s, rad, N m.

    They need not start at any angle, but are returned as if they started at angle zero: `setpoint`
    (n,) then runs from 0 to a turn, or to minus a turn. Raises `InsufficientDataError` where there
    are fewer turns, or where the speed is not constant.
    """
    time, setpoint, torque = require_signals(4, time=time, setpoint=setpoint, torque=torque)
    step = require_rising(time)
    travel = abs(setpoint[-1] - setpoint[0]) / TURN
    # A sample more or less is rounding of the recording's ends.
    if travel < turns * (1 - 2 / len(time)):
        raise InsufficientDataError(
            f"{travel:.4g} turns at constant speed in the recording, {turns} are needed: record "
            "for longer, or lower the number of revolutions"
        )
    speed = (setpoint[-1] - setpoint[0]) / (time[-1] - time[0])
    straight = setpoint[0] + speed * (time - time[0])
    worst = float(np.abs(setpoint - straight).max())
    if worst > STEADY_DEVIATION * TURN:
        raise InsufficientDataError(
            f"the set point deviates by {worst:.3g} rad from constant speed, more than "
            f"{STEADY_DEVIATION * TURN:.3g} rad: give the part of the recording at constant speed"
        )
    period = TURN / abs(speed)
    # A power of two above the number of samples: fast, and nothing is lost.
    count = 2 ** max(2, math.ceil(math.log2(period / step)))
    turned = abs(speed) / speed * setpoint / TURN  # rises, in turns
    last = math.floor(turned[-1] * count)
    place = np.arange(last - turns * count + 1, last + 1)
    laid_over: Array = np.interp(place / count, turned, torque).reshape(turns, count)
    # The column of a place is its part of the turn.
    laid_over = np.roll(laid_over, int(place[0] % count), axis=1)
    return Moves(period, math.copysign(TURN, speed) * np.arange(count) / count, laid_over)


def by_angle(turns: Moves, signals: Array, positions: int) -> Array:
    """Return signals (..., n) of turns at `positions` equal angles from zero, (..., positions).

    Orders below half the number of angles pass; between samples they are exact.
    """
    orders = np.fft.rfft(signals)
    if turns.setpoint[-1] < 0:
        orders = np.conj(orders)  # time runs against the angle
    angles: Array = np.fft.irfft(orders, positions)  # more or fewer orders, as needed
    return angles * (positions / signals.shape[-1])


def turn_angles(positions: int) -> Array:
    """Return the angles of a table with so many entries a turn, rad."""
    return np.arange(float(positions)) * (TURN / positions)


def torque_row(turns: Moves, speed: float, learning: Learning, positions: int) -> Row:
    """Return the controller's torque by angle within the band of Q; `speed` with its sign."""
    smoothed = learning.smoothed(turns.torque, turns.period)
    return Row(speed, by_angle(turns, smoothed, positions))


def learned_row(
    turns: Moves, speed: float, learning: Learning, positions: int, before: Array | float = 0.0
) -> Row:
    """Return the feed-forward torque by angle that one update learns, N m; `speed` with its sign.

    `before` (n,) is the feed-forward during the turns, N m.
    """
    learned = learning.updated(turns.torque, turns.period, before)
    return Row(speed, by_angle(turns, learned, positions))


def repeatable_row(row: Row, spread: float = 1.0) -> Row:
    """Return the orders of a row that repeat; torque zero where none does.

    `spread` as in `repeatability`.
    """
    return Row(row.speed, only_kept(row.moves, repeatability(row.moves, spread).kept()))
