"""Disturbance torque by position and speed, as the learned table holds it [Fig. 49, 53].

torque(p, v) = bilinear interpolation in the table; below the lowest learned speed the row of that
speed is multiplied by the amplitude table. A table with a period holds one whole turn, and
positions are taken modulo that period. Otherwise positions are clamped to the learned range, as
speeds always are: the table does not extrapolate. `covers` returns where it is valid.

scipy's RegularGridInterpolator takes two to three times as long, and rounds differently.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rigtool.numerics.arrays import Array, Mask


def blend(flat: Array, cell: Any, count: int, across: Any, along: Any) -> Any:
    """Interpolate bilinearly in rows of `count` entries, for one cell or for n of them.

    `cell` is the index of its lower left entry, `across` and `along` are fractions of it.
    """
    lower, upper = flat[cell], flat[cell + count]
    lower = lower + across * (flat[cell + 1] - lower)
    upper = upper + across * (flat[cell + count + 1] - upper)
    return lower + along * (upper - lower)


@dataclass(frozen=True, eq=False)
class Nodes:
    """How a table is interpolated over speed, without the rows that the amplitude table makes.

    Node j (m,), at `speed` rad/s, has `factor` times row `row` of the table; linear between nodes:
    so is the product of factor and row, and one bilinear interpolation covers all speeds.
    """

    speed: Array
    row: NDArray[np.int64]
    factor: Array

    def rows(self, torque: Array) -> Array:
        """Return the rows (m, n) of a table (rows, n) written out."""
        return self.factor[:, None] * torque[self.row]


@dataclass(frozen=True, eq=False)
class LookupTable:
    """A learned table.

    `position` (n,) rad, uniform and rising; `speed` (m,) rad/s, rising, without zero; `torque`
    (m, n) N m. `low_speed` (k,) rad/s starts at 0 and ends at the lowest learned speed;
    `amplitude` (k,) multiplies the row of that speed, in either direction. A direction that was
    not learned has torque zero, and is not covered. `period` rad, where the motion is periodic:
    positions then cover it once, its end left out, and the last entry is followed by the first.
    Raises ValueError where this does not hold.
    """

    position: Array
    speed: Array
    torque: Array
    low_speed: Array
    amplitude: Array
    period: float | None = None
    _speeds: Array = field(init=False, repr=False)
    _rows: Array = field(init=False, repr=False)

    def __post_init__(self) -> None:
        self._check()
        at = self.nodes
        rows = at.rows(self.torque)
        if self.period is not None:
            rows = np.column_stack([rows, rows[:, 0]])
        object.__setattr__(self, "_speeds", at.speed)
        object.__setattr__(self, "_rows", np.ascontiguousarray(rows))

    def evaluate(self, position: Array, speed: Array) -> Array:
        """Return the torque, N m, at each set point (n,), clamped to the learned range."""
        (start, step, period), count = self.grid[2], self._rows.shape[1]
        if period:
            position = start + (position - start) % period
        # Both coordinates count entries of the table; a cell is named by its lower left entry.
        across = np.minimum(np.maximum((position - start) / step, 0.0), count - 1.0)
        along = np.interp(speed, self._speeds, self._numbers)
        column = np.minimum(across.astype(np.int64), count - 2)
        row = np.minimum(along.astype(np.int64), self._speeds.size - 2)
        return blend(self._rows.ravel(), row * count + column, count, across - column, along - row)

    @cached_property
    def _numbers(self) -> Array:
        return np.arange(float(self._speeds.size))

    @cached_property
    def grid(self) -> tuple[Array, Array, Array]:
        """Return torque (m, n) N m over speeds (m,) rad/s and positions; start and step of these,
        rad, and the period, 0 without one."""
        period, start = self.period or 0.0, self.position[0]
        span = period or self.position[-1] - start
        return self._rows, self._speeds, np.array([start, span / (self._rows.shape[1] - 1), period])

    def covers(self, position: Array, speed: Array) -> Mask:
        """Return for each set point (n,) whether it lies within the learned range."""
        # Rounding may move a set point past the edge: allow a millionth of a step.
        step = (self.position[-1] - self.position[0]) / (self.position.size - 1)
        within = np.ones(np.shape(position), dtype=np.bool_)
        if self.period is None:
            within &= position >= self.position[0] - 1e-6 * step
            within &= position <= self.position[-1] + 1e-6 * step
        slack = 1e-6 * self.low_speed[-1]
        within &= (speed >= self._speeds[0] - slack) & (speed <= self._speeds[-1] + slack)
        return within

    @property
    def nodes(self) -> Nodes:
        """Where the table is interpolated over speed: at rest, at low and at learned speeds."""
        index = np.arange(self.speed.size)
        low, amplitude = self.low_speed[1:-1], self.amplitude[1:-1]
        speeds, rows, factors = [np.zeros(1)], [np.zeros(1, dtype=np.int64)], [np.zeros(1)]
        if (forward := index[self.speed > 0]).size:
            speeds += [low, self.speed[forward]]
            rows += [np.full(low.size, forward[0]), forward]
            factors += [amplitude, np.ones(forward.size)]
        if (backward := index[self.speed < 0]).size:
            speeds[:0] = [self.speed[backward], -low[::-1]]
            rows[:0] = [backward, np.full(low.size, backward[-1])]
            factors[:0] = [np.ones(backward.size), amplitude[::-1]]
        return Nodes(np.concatenate(speeds), np.concatenate(rows), np.concatenate(factors))

    def _check(self) -> None:
        for name in ("position", "speed", "torque", "low_speed", "amplitude"):
            values = np.asarray(getattr(self, name), dtype=np.float64)
            if not np.isfinite(values).all():
                raise ValueError(f"{name} of a lookup table holds values that are not finite")
            object.__setattr__(self, name, values)
        steps = np.diff(self.position)
        if steps.size < 1 or not (steps > 0).all() or np.ptp(steps) > 1e-6 * steps.max():
            raise ValueError("positions of a lookup table must rise in equal steps")
        if self.period is not None and not np.isclose(
            steps.mean() * self.position.size, self.period, rtol=1e-6, atol=0
        ):
            raise ValueError(
                f"{self.position.size} positions of a lookup table, {steps.mean():.6g} rad apart, "
                f"must cover its period of {self.period:.6g} rad once"
            )
        if self.speed.size < 1 or not (np.diff(self.speed) > 0).all() or (self.speed == 0).any():
            raise ValueError("speeds of a lookup table must rise and not contain zero")
        shape = (self.speed.size, self.position.size)
        if self.torque.shape != shape:
            raise ValueError(f"torque of a lookup table has shape {self.torque.shape}, not {shape}")
        low = self.low_speed
        if low.size < 2 or low.shape != self.amplitude.shape or not (np.diff(low) > 0).all():
            raise ValueError("low speeds of a lookup table must rise, each with an amplitude")
        lowest = np.abs(self.speed).min()
        if low[0] != 0 or not np.isclose(low[-1], lowest, rtol=1e-9, atol=0):
            raise ValueError(
                f"low speeds of a lookup table must run from 0 to {lowest}, "
                f"got {low[0]} to {low[-1]}"
            )
        if self.amplitude[0] != 0 or self.amplitude[-1] != 1:
            raise ValueError("the amplitude table must start at 0 and end at 1")
