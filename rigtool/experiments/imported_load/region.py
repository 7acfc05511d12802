"""Where a load model was learned: a convex region of position, speed and load in each direction.

The region is the intersection of half-spaces n.x <= h in `FACES` directions n, h being the furthest
that learned points go, plus a margin: convex, and never smaller than the hull of the points.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from rigtool.numerics.arrays import Array, Mask

FACES = 200
"""Half-spaces."""

MARGIN = 0.75
"""Load beyond the learned levels, in spacings of the levels."""

SLACK = 0.03
"""Position and speed beyond the learned ones, as part of the stroke and of the highest speed."""


@dataclass(frozen=True, eq=False)
class Region:
    """Half-spaces of each direction: `reach` (2, FACES) of positive and negative speeds."""

    reach: Array

    def holds(self, place: Array, speed: Array, torque: Array) -> Mask:
        """Return which points (n,) are inside; NaN is outside."""
        points = np.column_stack([place, speed, torque])
        finite = np.isfinite(points).all(axis=1)
        far = np.nan_to_num(points, nan=0.0, posinf=0.0, neginf=0.0) @ normals().T
        side = (speed < 0).astype(int)
        inside: Mask = finite & (far <= self.reach[side]).all(axis=1)
        return inside


def torque_range(torque: Array, levels: int) -> tuple[float, float]:
    """Return the lowest and highest torque that can be inside, by those learned (n,)."""
    margin = MARGIN * _spacing(torque, levels)
    return float(torque.min()) - margin, float(torque.max()) + margin


def _spacing(torque: Array, levels: int) -> float:
    return float(np.ptp(torque)) / max(levels - 1, 1)


def learn_region(place: Array, speed: Array, torque: Array, levels: int) -> Region:
    """Return the region of learned points (n,): numbers near 1, whatever their units."""
    margin = np.abs(normals()) @ np.array([SLACK, SLACK, MARGIN * _spacing(torque, levels)])
    points = np.column_stack([place, speed, torque])
    sides = [points[speed > 0], points[speed < 0]]
    return Region(np.stack([(side @ normals().T).max(axis=0) + margin for side in sides]))


def normals() -> Array:
    """Return the directions, (FACES, 3): a spiral on the sphere, and the axes themselves."""
    count = FACES - 6
    z = 1 - (2 * np.arange(count) + 1) / count
    turn = np.pi * (3 - 5**0.5) * np.arange(count)
    radius = np.sqrt(1 - z**2)
    spiral = np.column_stack([radius * np.cos(turn), radius * np.sin(turn), z])
    return np.vstack([spiral, np.eye(3), -np.eye(3)])
