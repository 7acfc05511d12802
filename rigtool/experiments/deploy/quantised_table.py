"""A learned table in the codes of a drive, and the loss by rounding.

code = round(value/scale),  scale = largest |value| / largest code

The loss is measured, not bounded: the difference between the receiver's value from the codes
and the table itself, on a grid finer than both.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rigtool.control.lookup_table import LookupTable
from rigtool.experiments.deploy.position_map import TURN, PositionMap
from rigtool.numerics.arrays import Array

LOSS_POSITIONS = 2**16
"""Positions of the turn at which the loss is computed."""


@dataclass(frozen=True)
class Loss:
    """Error of a coarser table: largest and rms difference, in the unit of the table."""

    largest: float
    rms: float

    def text(self, unit: str, by: str) -> str:
        """State the loss of each step, in the unit of the table."""
        return f"by {by}, largest {self.largest:.2g} {unit}, rms {self.rms:.2g} {unit}"


def loss(difference: Array) -> Loss:
    """Return the loss of differences (n,)."""
    return Loss(float(np.abs(difference).max()), float(np.sqrt(np.mean(difference**2))))


@dataclass(frozen=True, eq=False)
class Quantised:
    """Codes of any shape; value = code*scale."""

    codes: NDArray[np.int64]
    scale: float

    @property
    def values(self) -> Array:
        """Values of the codes."""
        return self.codes.astype(np.float64) * self.scale


def quantise(values: Array, largest_code: int, step: float = 0.0) -> Quantised:
    """Round values (..., n) to codes from -`largest_code` to `largest_code`; zeros stay zero.

    With `step` the scale is a multiple of it, for a receiver that prints it in such steps.
    """
    peak = float(np.abs(values).max(initial=0.0))
    scale = peak / largest_code
    if step:
        scale = math.ceil(scale / step) * step
    # The receiver reads the scale as a 4-byte float: round with that value.
    scale = float(np.float32(scale))
    if scale == 0:
        return Quantised(np.zeros(values.shape, dtype=np.int64), 0.0)
    codes = np.clip(np.rint(values / scale), -largest_code, largest_code).astype(np.int64)
    return Quantised(codes, scale)


@dataclass(frozen=True, eq=False)
class Nodes:
    """How a table is interpolated over speed, without the rows that the amplitude table makes.

    Node j (m,), at `speed` rad/s, has `factor` times row `row` of the table; linear between nodes.
    """

    speed: Array
    row: NDArray[np.int64]
    factor: Array

    def rows(self, torque: Array) -> Array:
        """Return the rows (m, n) of a table (rows, n) written out."""
        return self.factor[:, None] * torque[self.row]


def nodes(table: LookupTable) -> Nodes:
    """Return the nodes of a table, rest and low speeds included."""
    index = np.arange(table.speed.size)
    low, amplitude = table.low_speed[1:-1], table.amplitude[1:-1]
    speeds, rows, factors = [np.zeros(1)], [np.zeros(1, dtype=np.int64)], [np.zeros(1)]
    if (forward := index[table.speed > 0]).size:
        speeds += [low, table.speed[forward]]
        rows += [np.full(low.size, forward[0]), forward]
        factors += [amplitude, np.ones(forward.size)]
    if (backward := index[table.speed < 0]).size:
        speeds[:0] = [table.speed[backward], -low[::-1]]
        rows[:0] = [backward, np.full(low.size, backward[-1])]
        factors[:0] = [np.ones(backward.size), amplitude[::-1]]
    return Nodes(np.concatenate(speeds), np.concatenate(rows), np.concatenate(factors))


@dataclass(frozen=True, eq=False)
class Sampled:
    """A map of the turn at equal angles: (count,) values as stored, and the loss of using them."""

    stored: Quantised
    loss: Loss


def interpolated_codes(
    turn: PositionMap, count: int, largest_code: int, step: float = 0.0
) -> Sampled:
    """Sample a map at i/count of a turn for a drive that interpolates linearly between codes.

    `step` is that of the scale, see `quantise`.
    """
    stored = quantise(turn.at(_angles(count, 0.0)), largest_code, step)
    used = PositionMap(0.0, stored.values, np.zeros(count), 0.0, turn.speed, True)
    fine = _angles(LOSS_POSITIONS, 0.5)
    return Sampled(stored, loss(used.at(fine) - turn.at(fine)))


def held_values(turn: PositionMap, count: int) -> tuple[NDArray[np.float32], Loss]:
    """Sample a map for a drive that holds value i from i/count to (i+1)/count of a turn.

    The values are those of the middles: at the beginnings they would come half a cell late.
    """
    values = turn.at(_angles(count, 0.5)).astype(np.float32)
    fine = count * math.ceil(LOSS_POSITIONS / count)
    held = np.repeat(values.astype(np.float64), fine // count)
    return values, loss(held - turn.at(_angles(fine, 0.5)))


def _angles(count: int, first: float) -> Array:
    """Return equal steps of a turn, rad, beginning at `first` of a step."""
    return (np.arange(float(count)) + first) * (TURN / count)
