"""Where a load model was learned: speeds v and torques M in each cell of the stroke, by direction.

    inside  =  v_min / 1.1 <= |v| <= 1.1 v_max  and  M_min - margin <= M <= M_max + margin

Slower than learned is outside as well as faster: friction of slow motion is another one. Where all
recordings had one speed and stroke, speed follows from the position, and no other one is inside:
nothing separates what friction owes to either.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rigtool.experiments.force_filter.motion_states import LARGEST_LEARNED_RATIO
from rigtool.numerics.arrays import Array, Mask

STROKE_CELLS = 20
"""Parts of the stroke."""

POSITION_SLACK = 0.03
"""Position beyond the learned ones, as part of the stroke."""

MARGIN, NARROW = 0.75, 0.25
"""Load beyond the learned levels, in spacings of the levels: where an interval held at the last
level when that was left out, and where not. The second is for scatter, not for other loads."""


MIN_INSIDE_PART, DRIVEN = 0.5, 0.8
"""Parts of a stroke that must be inside: a heavier load passes the learned ones while it comes, and
scatter alone takes some of its samples among them. The second is of torques at learned speeds while
the load drives the motor: effort hardly depends on heavy loads there, so many seem lighter."""


@dataclass(frozen=True, eq=False)
class Region:
    """Lowest and highest magnitude of speed, and torque, in each cell of the stroke: (2, CELLS)
    each, of positive and negative speeds; NaN where nothing was learned."""

    slowest: Array
    fastest: Array
    lowest: Array
    highest: Array

    def moves(self, place: Array, speed: Array) -> Mask:
        """Return which points (n,) are at learned places and speeds."""
        side, cell = (speed < 0).astype(int), cells_of(place)
        magnitude = np.abs(speed)
        return (
            reached(place)
            & (magnitude >= self.slowest[side, cell])
            & (magnitude <= self.fastest[side, cell])
        )

    def holds(self, place: Array, speed: Array, torque: Array) -> Mask:
        """Return which points (n,) are inside; NaN is outside."""
        side, cell = (speed < 0).astype(int), cells_of(place)
        within = (torque >= self.lowest[side, cell]) & (torque <= self.highest[side, cell])
        return self.moves(place, speed) & within


def reached(place: Array) -> Mask:
    """Return which places (n,) are on the learned stroke."""
    return (place >= -POSITION_SLACK) & (place <= 1 + POSITION_SLACK)


def of_known_strokes(
    known: Mask, moving: Mask, direction: Array, share: float = MIN_INSIDE_PART
) -> Mask:
    """Return which of the `known` rows (n,) belong to strokes of which such a share is known.

    `moving` (n,) marks rows that count, `direction` (n,) changes from one stroke to the next. The
    first and the last stroke are parts of strokes, and count together with the nearest that has
    their direction.
    """
    stroke = strokes_of(direction)
    inside, every = (np.bincount(stroke, rows) for rows in (known & moving, moving))
    for counts in (inside, every):
        if counts.size > 3:
            counts[[0, -1]] += counts[[2, -3]]
    return known & (inside >= share * every)[stroke]


def beside_known(known: Mask, direction: Array) -> Mask:
    """Return which rows (n,) are in a stroke with a `known` row, or next to one."""
    return _beside(known, direction) > 0


def beside_known_strokes(known: Mask, counted: Mask, direction: Array) -> Mask:
    """Return which rows (n,) are in strokes beside which half of the `counted` rows (n,) are
    `known`, or where none counts."""
    return _beside(known & counted, direction) >= MIN_INSIDE_PART * _beside(counted, direction)


def _beside(rows: Mask, direction: Array) -> NDArray[np.intp]:
    """Return for each row (n,) how many `rows` are in its stroke and in those next to it."""
    stroke = strokes_of(direction)
    return np.convolve(np.bincount(stroke, rows), np.ones(3, int), "same")[stroke]


def strokes_of(direction: Array) -> NDArray[np.intp]:
    """Return the number of the stroke of each row (n,); a standstill belongs to the stroke before,
    also where the motion goes on in the same `direction` (n,)."""
    decided = np.flatnonzero(direction)
    if not decided.size:
        return np.zeros(len(direction), dtype=np.intp)
    latest = np.searchsorted(decided, np.arange(len(direction)), side="right") - 1
    way = direction[decided[np.maximum(latest, 0)]]
    return np.cumsum(np.diff(way, prepend=way[:1]) != 0)


def cells_of(place: Array) -> NDArray[np.intp]:
    """Return the cell (n,) of each place on the stroke."""
    return np.clip(np.floor(np.nan_to_num(place) * STROKE_CELLS), 0, STROKE_CELLS - 1).astype(
        np.intp
    )


def cell_means(place: Array, values: Array, rows: Mask, fewest: int = 1) -> Array:
    """Return the mean of values (n,) over `rows` (n,) in each cell, NaN in those with too few."""
    cell = cells_of(place[rows])
    count = np.bincount(cell, minlength=STROKE_CELLS)
    total = np.bincount(cell, weights=values[rows], minlength=STROKE_CELLS)
    return np.where(count >= fewest, total / np.maximum(count, 1), np.nan)


def learn_region(
    place: Array, speed: Array, torque: Array, margins: Array, *, several: bool = True
) -> Region:
    """Return the region of learned points (n,), without unit; unless there are `several` speeds, no
    other one is inside.

    `margins` (2, 2) are those of torque, of positive and negative speeds, at the lower and at the
    higher end.
    """
    found = np.full((4, 2, STROKE_CELLS), np.nan)
    cell, beyond = cells_of(place), LARGEST_LEARNED_RATIO if several else 1.0
    for side, rows in enumerate((speed > 0, speed < 0)):
        for number in np.unique(cell[rows]):
            # Speed changes along a cell: its neighbours' count as well
            near = rows & (np.abs(cell - number) <= 1)
            magnitude, own = np.abs(speed[near]), torque[near]
            if not several:
                magnitude = np.abs(speed[rows & (cell == number)])
            found[:, side, number] = (
                magnitude.min() / beyond,
                magnitude.max() * beyond,
                own.min() - margins[side, 0],
                own.max() + margins[side, 1],
            )
    return Region(*found)
