"""Repeated moves to and fro, cut out of a recording and superimposed [7.2.4.2].

A move starts where the set point rises through its middle. All moves are resampled on one grid of
one period: their mean is the part that repeats, their scatter the part that does not.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from rigtool.errors import InsufficientDataError
from rigtool.numerics.arrays import Array
from rigtool.numerics.checks import require_rising, require_signals


@dataclass(frozen=True, eq=False)
class Moves:
    """Repeated moves to and fro on one period, s.

    `setpoint` (n,) rad starts where it rises through its middle; `torque` (moves, n) N m.
    """

    period: float
    setpoint: Array
    torque: Array


def cut_moves(time: Array, setpoint: Array, torque: Array, moves: int) -> Moves:
    """Cut the last `moves` moves to and fro out of a recording, signals (n,) in s, rad, N m.

    Raises `InsufficientDataError` where there are fewer whole ones, or where they differ in length.
    """
    time, setpoint, torque = require_signals(4, time=time, setpoint=setpoint, torque=torque)
    step = require_rising(time)
    starts = rising_crossings(time, setpoint, (setpoint.max() + setpoint.min()) / 2)
    if len(starts) <= moves:
        raise InsufficientDataError(
            f"{max(len(starts) - 1, 0)} whole moves to and fro in the recording, {moves} are "
            "needed: record for longer, or lower the number of moves"
        )
    starts = starts[-moves - 1 :]
    period = (starts[-1] - starts[0]) / moves
    if np.abs(np.diff(starts) - period).max() > step:
        raise InsufficientDataError(
            f"the moves last {np.diff(starts).min():.6g} to {np.diff(starts).max():.6g} s, which "
            f"differ by more than a sample ({step:.3g} s): repeat one motion, at one speed"
        )
    # A power of two above the number of samples: fast, and nothing is lost.
    count = 2 ** math.ceil(math.log2(period / step))
    phase = np.arange(count) * (period / count)
    laid_over = np.interp((starts[:-1, None] + phase).ravel(), time, torque)
    return Moves(
        period, np.interp(starts[0] + phase, time, setpoint), laid_over.reshape(moves, count)
    )


def rising_crossings(time: Array, values: Array, level: float) -> Array:
    """Return the times (m,) at which values (n,) rise through a level, linear between samples."""
    below = values < level
    before = np.flatnonzero(below[:-1] & ~below[1:])
    low, high = values[before], values[before + 1]
    part = (level - low) / (high - low)
    return time[before] + part * (time[before + 1] - time[before])


def at_positions(moves: Moves, signals: Array, position: Array, direction: int) -> Array:
    """Read signals (..., n) on the period of moves where the set point passes positions (p,), rad.

    `direction` is 1 for the rising half of the period, -1 for the falling one. Returns (..., p).
    Raises ValueError for positions outside the set point's range.
    """
    low, high = moves.setpoint.min(), moves.setpoint.max()
    if position.min() < low or position.max() > high:
        raise ValueError(f"positions must lie within the moves' range, {low} to {high} rad")
    count = len(moves.setpoint)
    bottom, top = int(np.argmin(moves.setpoint)), int(np.argmax(moves.setpoint))
    first, last = (bottom, top) if direction > 0 else (top, bottom)
    half = np.arange(first, first + (last - first) % count + 1) % count
    rising = half if direction > 0 else half[::-1]
    place = np.interp(position, moves.setpoint[rising], np.arange(float(len(rising))))
    cell = np.minimum(place.astype(np.intp), len(rising) - 2)
    part = place - cell
    return signals[..., rising[cell]] * (1 - part) + signals[..., rising[cell + 1]] * part
