"""Learning the disturbance that repeats with position and speed [7.2.4.2].

Moves to and fro at one speed are cut where the set point rises through its middle, and laid over
each other on one period: their mean is repeatable, their scatter is not. One learning update
(eq. 9) turns the controller's torque into feed-forward torque; read at the set point's positions it
is a row of the table [Fig. 49]. Below the lowest learned speed an amplitude table scales that
speed's row [Fig. 53].

Everything is a function of the set point, not of the encoder, since the set point addresses the
table.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rigtool.control.lookup_table import LookupTable
from rigtool.errors import InsufficientDataError
from rigtool.experiments.learning.filters import Learning
from rigtool.numerics.arrays import Array
from rigtool.numerics.jackknife import jackknife
from rigtool.numerics.moves import Moves, at_positions
from rigtool.quantity import Quantity, scattered


@dataclass(frozen=True, eq=False)
class Row:
    """A row of a table: one speed and direction, at the positions of the table (n,).

    `speed` rad/s carries the direction's sign; `moves` (m, n) N m holds each move by itself.
    """

    speed: float
    moves: Array

    @property
    def mean(self) -> Array:
        """Repeatable part (n,), N m."""
        return self.moves.mean(axis=0)

    @property
    def u(self) -> Array:
        """Standard uncertainty of the mean (n,), N m: scatter/sqrt(moves)."""
        return self.moves.std(axis=0, ddof=1) / math.sqrt(len(self.moves))

    @property
    def dof(self) -> int:
        """Degrees of freedom of `u`: the moves but one."""
        return len(self.moves) - 1

    @property
    def non_repeatable_rms(self) -> float:
        """Rms scatter of a single move around the mean, N m."""
        return float(np.sqrt(self.moves.var(axis=0, ddof=1).mean()))


def learned_rows(
    moves: Moves, speed: float, learning: Learning, position: Array, before: Array | float = 0.0
) -> list[Row]:
    """Return the feed-forward torque that one update learns at positions (p,), falling part first.

    `before` (n,) is the feed-forward during the moves, N m.
    """
    learned = learning.updated(moves.torque, moves.period, before)
    return _both_directions(moves, speed, learned, position)


def torque_rows(moves: Moves, speed: float, learning: Learning, position: Array) -> list[Row]:
    """Return the controller's torque in the band of Q at positions (n,), falling part first."""
    smoothed = learning.smoothed(moves.torque, moves.period)
    return _both_directions(moves, speed, smoothed, position)


def _both_directions(moves: Moves, speed: float, signals: Array, position: Array) -> list[Row]:
    return [
        Row(sign * abs(speed), at_positions(moves, signals, position, sign)) for sign in (-1, 1)
    ]


@dataclass(frozen=True, eq=False)
class Amplitudes:
    """Amplitude table: factor on the lowest learned speed's row, by speed, rad/s (k,).

    Zero at rest and one at the lowest learned speed by definition, with uncertainty zero there.
    `dof` (k,) are those of `u`.
    """

    speed: Array
    amplitude: Array
    u: Array
    dof: Array

    @staticmethod
    def fading(lowest: float) -> Amplitudes:
        """Return the table that fades to zero in proportion to speed, from the lowest speed."""
        ends, exact = np.array([0.0, 1.0]), np.zeros(2)
        return Amplitudes(lowest * ends, ends, exact, np.full(2, math.inf))


def fit_amplitudes(low: Sequence[Row], learned: Sequence[Row]) -> Amplitudes:
    """Fit the amplitude table to rows at low speeds, both directions of a speed together.

    The factor of a move is the least-squares one on the row of the same direction at the lowest
    speed of the `learned` rows. Standard uncertainty: the factors' scatter/sqrt(their number).
    Raises `InsufficientDataError` where the rows to be scaled are zero.
    """
    lowest = min(abs(row.speed) for row in learned)
    reference = {np.sign(row.speed): row.mean for row in learned if abs(row.speed) == lowest}
    speeds = sorted({abs(row.speed) for row in low})
    factors, us, dof = [], [], []
    for speed in speeds:
        each: list[float] = []
        for row in (row for row in low if abs(row.speed) == speed):
            shape = reference[np.sign(row.speed)]
            energy = float(shape @ shape)
            if energy == 0:
                raise InsufficientDataError(
                    "the torque learned at the lowest speed is zero: there is nothing to scale "
                    "at lower speeds; leave the low speeds out"
                )
            each.extend(row.moves @ shape / energy)
        factors.append(float(np.mean(each)))
        us.append(float(np.std(each, ddof=1) / math.sqrt(len(each))))
        dof.append(len(each) - 1.0)
    return Amplitudes(
        np.array([0.0, *speeds, lowest]),
        np.array([0.0, *factors, 1.0]),
        np.array([0.0, *us, 0.0]),
        np.array([math.inf, *dof, math.inf]),
    )


def assemble(
    position: Array, rows: Sequence[Row], amplitudes: Amplitudes, period: float | None = None
) -> LookupTable:
    """Put rows of rising speed, at positions (n,), and the amplitude table together."""
    return LookupTable(
        position=position,
        speed=np.array([row.speed for row in rows]),
        torque=np.stack([row.mean for row in rows]),
        low_speed=amplitudes.speed,
        amplitude=amplitudes.amplitude,
        period=period,
    )


def residual(before: Sequence[Row], after: Sequence[Row]) -> dict[str, Quantity]:
    """Compare the controller's torque without and with the table, rows of equal speeds.

    Returns `residual_peak`, the largest value of any row's mean, `residual_rms` of all rows
    together, and `reduction`, the part of the rms that the table removed, 1 - rms/(rms before).
    Uncertainties by the jackknife over moves: move i is left out at all speeds at once. Raises
    `InsufficientDataError` where there is no torque to remove.
    """
    count = min(len(row.moves) for row in (*before, *after))

    def means(rows: Sequence[Row], keep: NDArray[np.intp]) -> Array:
        return np.stack([row.moves[keep].mean(axis=0) for row in rows])

    def rms(rows: Sequence[Row], keep: NDArray[np.intp]) -> float:
        return float(np.sqrt(np.mean(means(rows, keep) ** 2)))

    def quantity(statistic: Callable[[NDArray[np.intp]], float], unit: str) -> Quantity:
        value, u = jackknife(count, statistic)
        return scattered(value, unit, u, count - 1, "scatter over the moves")

    if rms(before, np.arange(count)) == 0:
        raise InsufficientDataError(
            "the controller's torque is zero throughout with the table off: there is nothing to "
            "remove; see that the current is recorded"
        )
    return {
        "residual_peak": quantity(lambda keep: float(np.abs(means(after, keep)).max()), "N m"),
        "residual_rms": quantity(lambda keep: rms(after, keep), "N m"),
        "reduction": quantity(lambda keep: 1 - rms(after, keep) / rms(before, keep), "1"),
    }
