"""A learned table at one speed, around the turn, as drives store it.

A drive reads its cogging table by position alone. The mean of a table over both directions,

    map(position) = (torque(position, +speed) + torque(position, -speed))/2 - mean,

holds no friction, which has the sign of the speed; the mean over the turn is reported separately.
Where one direction was learned, friction that varies with position stays in the map.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from rigtool.control.lookup_table import LookupTable
from rigtool.errors import UsageError
from rigtool.numerics.arrays import Array

TURN = 2 * math.pi


@dataclass(frozen=True, eq=False)
class PositionMap:
    """Values (n,) at equal steps of a turn from `start`, rad, their mean over the turn removed.

    `u` (n,) is their standard uncertainty, in the same unit. `mean` is the removed mean, `speed`
    that of the map, rad/s, negative where only that direction was learned; `both_directions` is
    true for the mean of two.
    """

    start: float
    values: Array
    u: Array
    mean: float
    speed: float
    both_directions: bool

    def at(self, position: Array) -> Array:
        """Return the map at any positions, rad: linear between its own, periodic."""
        count = self.values.size
        place = np.mod(position - self.start, TURN) * (count / TURN)
        cell = place.astype(np.intp)
        part = place - cell
        found: Array = self.values[cell % count] * (1 - part)
        found += self.values[(cell + 1) % count] * part
        return found

    def remarks(self, unit: str) -> list[str]:
        """Return what a drive's map leaves out of the table, and what it holds too much."""
        found = []
        if self.mean:
            found.append(f"the mean over the turn, {self.mean:.4g} {unit}, is left out")
        if not self.both_directions:
            found.append("one direction alone: friction that varies with position is in the map")
        return found

    def scaled(self, factor: float) -> PositionMap:
        """Return the map in another unit, `factor` times as large."""
        return replace(
            self, values=self.values * factor, u=self.u * abs(factor), mean=self.mean * factor
        )

    def by_encoder(self, sign: int, offset: float) -> PositionMap:
        """Return the map by the angle of an encoder that shows sign*position + offset, rad."""
        if sign > 0:
            return replace(self, start=self.start + offset)
        last = self.start + (self.values.size - 1) * (TURN / self.values.size)
        return replace(self, start=offset - last, values=self.values[::-1], u=self.u[::-1])


def position_map(table: LookupTable, u: Array, speed: float | None) -> PositionMap:
    """Return the map of a table at one speed, rad/s; `u` has the shape of its torque.

    Without `speed` it is the only one that was learned. Raises `UsageError` where the table does
    not cover a turn, holds several speeds and none is chosen, or was not learned at this one.
    """
    _require_turn(table)
    chosen = _choose(table, speed)
    position = table.position
    uncertain = replace(table, torque=u)
    covered = [
        sign * chosen
        for sign in (1, -1)
        if (sign * table.speed > 0).any()
        and table.covers(position[:1], np.array([sign * chosen])).all()
    ]
    if not covered:
        raise UsageError(
            f"--speed {chosen:.4g}: was learned {_range(table)}; choose a speed within that"
        )
    rows = [table.evaluate(position, np.full(position.size, v)) for v in covered]
    us = [uncertain.evaluate(position, np.full(position.size, v)) for v in covered]
    values = np.mean(rows, axis=0)
    mean = float(values.mean())
    return PositionMap(
        start=float(position[0]),
        values=values - mean,
        u=np.sqrt(np.sum(np.square(us), axis=0)) / len(us),
        mean=mean,
        speed=covered[0],
        both_directions=len(covered) == 2,
    )


def _require_turn(table: LookupTable) -> None:
    if table.period is None:
        low, high = np.degrees(table.position[[0, -1]])
        raise UsageError(
            f"the table holds {low:.4g} to {high:.4g} deg, not a whole turn, so no map of the turn "
            "can be made of it: learn whole turns (ilc-learn --implementation A or B), or export "
            "a .h, .csv, .json or .mat"
        )
    if not math.isclose(table.period, TURN, rel_tol=1e-9):
        raise UsageError(
            f"the table repeats after {table.period:.6g} rad, a drive's map after {TURN:.6g} rad: "
            "export a .h, .csv, .json or .mat"
        )


def _choose(table: LookupTable, speed: float | None) -> float:
    learned = np.unique(np.abs(table.speed))
    if speed is None:
        if learned.size > 1:
            raise UsageError(
                f"the table holds {learned.size} speeds, a map of the turn has one: choose by "
                f"--speed, e.g. the lowest learned one, {learned[0]:.6g} rad/s"
            )
        return float(learned[0])
    if not (math.isfinite(speed) and speed > 0):
        raise UsageError(f"--speed {speed:g}: must be above zero, in rad/s of the motor shaft")
    return speed


def _range(table: LookupTable) -> str:
    parts = []
    for sign, name in ((1, "forward"), (-1, "backward")):
        there = np.abs(table.speed[sign * table.speed > 0])
        if there.size:
            parts.append(f"{name} up to {there.max():.6g} rad/s")
    return " and ".join(parts)
