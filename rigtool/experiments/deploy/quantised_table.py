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
