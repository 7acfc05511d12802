"""Means of any slow course of current against a torque sensor: of plateaus, or of parts of a ramp.

    x_k = mean(x[a_k:b_k])

of current, torque, temperature and speed; the parts of a ramp take equal times. Friction follows
the current between its turns, m of `current_levels`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from rigtool.experiments.torque_constant.staircases.measured_levels import (
    find_levels,
    settled_parts,
)
from rigtool.experiments.torque_constant.staircases.swings import friction_state
from rigtool.numerics.arrays import Array
from rigtool.numerics.checks import require_rising, require_signals

RAMP_PARTS = 120
"""Parts of a ramp."""


@dataclass(frozen=True, eq=False)
class Course:
    """Signals (n,) of a recording: s, A, N m; degC and rad/s where they are known."""

    time: Array
    current: Array
    torque: Array
    temperature: Array | None = None
    speed: Array | None = None


@dataclass(frozen=True, eq=False)
class Points:
    """Means of (n,) plateaus or parts of a ramp.

    `swings` (m,) in A are the steps of the current that friction follows, from the first on, of
    which each point ends before `ends` (n,).
    """

    current: Array
    torque: Array
    temperature: Array | None
    speed: Array | None
    swings: Array
    ends: NDArray[np.int64]
    plateaus: bool

    @property
    def ways(self) -> tuple[float, float]:
        """Way of the current up and down, A."""
        up = float(self.swings[self.swings > 0].sum())
        return up, up - float(self.swings.sum())

    def states(self, lengths: Array) -> tuple[Array, Array]:
        """Return m of (1) with 0 at the start, and what it is per state there, (s, n) each."""
        count = np.diff(self.ends, prepend=0)
        found = friction_state(self.swings[None], lengths, 1.0)
        first, kept = (np.add.reduceat(each, self.ends - count, axis=1) / count for each in found)
        return first, kept


def find_points(course: Course) -> Points:
    """Return the means of a recording; `InsufficientDataError` where its current is constant."""
    signals = {"time": course.time, "current": course.current, "torque": course.torque}
    signals |= {
        name: values
        for name, values in (("temperature", course.temperature), ("speed", course.speed))
        if values is not None
    }
    t, current, torque, *_ = require_signals(50, **signals)
    require_rising(t)
    found = find_levels(current, torque)
    if found.plateaus:
        parts = list(settled_parts(found.plateaus))
        followed, place = _one_way(_means(current, parts), found.band), np.arange(len(parts) + 1)
    else:
        followed = _one_way(found.level, found.band)
        count = len(followed)
        place = np.linspace(0, count, min(RAMP_PARTS, count) + 1).round().astype(np.int64)
        parts = list(pairwise(found.edges[place].tolist()))
    return Points(
        _means(current, parts),
        _means(torque, parts),
        None if course.temperature is None else _means(course.temperature, parts),
        None if course.speed is None else _means(course.speed, parts),
        np.diff(followed, prepend=followed[0]),
        place[1:],
        bool(found.plateaus),
    )


def _means(values: Array, parts: Sequence[tuple[int, int]]) -> Array:
    return np.array([values[a:b].mean() for a, b in parts])


def _one_way(values: Array, band: float) -> Array:
    """Return values (n,) that go one way between turns by more than a band.

    A turn is at the extreme itself, which later values show.
    """
    turns, way, high, low = [0], 0, 0, 0
    for index, value in enumerate(values.tolist()):
        high, low = (
            (index if value > values[high] else high),
            (index if value < values[low] else low),
        )
        if way >= 0 and values[high] - value > band:
            turns.append(high)
            way, low = -1, index
        elif way <= 0 and value - values[low] > band:
            turns.append(low)
            way, high = 1, index
    followed = values.copy()
    for start, stop in pairwise([*turns, len(values) - 1]):
        rises = values[stop] >= values[start]
        along = np.maximum if rises else np.minimum
        followed[start : stop + 1] = along.accumulate(values[start : stop + 1])
    return followed
