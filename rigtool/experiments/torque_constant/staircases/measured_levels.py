"""Plateaus of a measured current, where no set point states them.

The current stays within a band as wide as its noise, or leaves it, by its second differences d2:

    noise = std(d2) / sqrt(6).

The step from level a to level b is after the sample k that leaves the smallest sum of (i_j - a)2
up to k and of (i_j - b)2 behind it.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from rigtool.errors import InsufficientDataError
from rigtool.experiments.torque_constant.staircases.plateaus import LEVEL_TOLERANCE
from rigtool.numerics.arrays import Array
from rigtool.numerics.plateaus import find_plateaus, group_numbers

MAX_BLOCKS = 2000
"""Parts of a recording in which plateaus are looked for first."""

FINER = 4
"""Ratio of the numbers of parts that are tried one after the other: plateaus may be short."""

FLAT_RANGE = 5.0
"""Standard deviations of noise within which the current does not change."""

MAX_PLATEAU_CHANGE = 0.02
"""Largest change of current on a plateau, relative to the span."""

FEWEST_PLATEAUS = 5
"""Fewer plateaus are no staircase."""

ON_PLATEAUS = 0.3
"""Smallest part of the time on plateaus of a staircase."""

MAX_ALONG, MAX_ALONG_OF_TORQUE = 0.1, 0.3
"""Largest change along a plateau, in terms of the step to it: torque may settle, and drift."""

SETTLING_PART = 0.25
"""Part of each plateau that is left out at its start."""

QUIET_PART, QUIET_VALUE = 0.25, 0.3186 * math.sqrt(6)
"""Quantile of second differences that steps of every fourth sample leave alone, and its value for
noise of unit standard deviation."""


@dataclass(frozen=True, eq=False)
class MeasuredLevels:
    """A current in k parts: `edges` (k + 1,) in samples, mean `level` (k,) in A.

    `band` in A is the range within which it does not change, `span` in A its range; `plateaus` are
    first and last + 1 sample of each, none for a ramp.
    """

    edges: NDArray[np.int64]
    level: Array
    band: float
    span: float
    plateaus: list[tuple[int, int]]


def find_levels(current: Array, torque: Array) -> MeasuredLevels:
    """Return the levels of a current (n,) A that a torque (n,) N m follows.

    The parts become finer until they show plateaus, or are single samples: plateaus may be short,
    and their steps many, which then count as noise unless its smallest values state it. Raises
    `InsufficientDataError` for a constant current.
    """
    second = np.abs(np.diff(current, 2))
    rms = float(np.sqrt(np.mean(second**2) / 6))
    quiet = float(np.quantile(second, QUIET_PART)) / QUIET_VALUE
    count = min(MAX_BLOCKS, len(current) // 4)
    found = _levels(current, count, rms)
    if found.span <= 10 * rms * math.sqrt(count / len(current)):
        raise InsufficientDataError(
            f"the current changes by {found.span:.3g} A, its noise is "
            f"{rms * math.sqrt(count / len(current)):.2g} A: step it, or ramp it"
        )
    while True:
        for noise in (rms, quiet):
            tried = _levels(current, count, noise)
            if _are_stairs(tried, current, torque):
                return tried
        if count == len(current):
            return replace(found, plateaus=[])
        count = min(FINER * count, len(current))


def _levels(current: Array, count: int, noise: float) -> MeasuredLevels:
    """Return the levels in `count` parts; `noise` in A is the standard deviation of a sample."""
    edges = np.linspace(0, len(current), count + 1).round().astype(np.int64)
    level = np.add.reduceat(current, edges[:-1]) / np.diff(edges)
    span = float(np.ptp(level))
    noise *= math.sqrt(count / len(current))
    band = max(FLAT_RANGE * math.sqrt(2) * noise, 1e-3 * span)
    parts = find_plateaus(level, band, max(MAX_PLATEAU_CHANGE * span, 2 * band))
    plateaus = [(int(edges[a]), int(edges[b])) for a, b in parts]
    return MeasuredLevels(edges, level, band, span, plateaus)


def _are_stairs(found: MeasuredLevels, current: Array, torque: Array) -> bool:
    """Return whether current and torque change between plateaus, and not along them as on a ramp.

    The current of a ramp may be read in steps: the torque has none.
    """
    on_them = sum(b - a for a, b in found.plateaus)
    if len(found.plateaus) < FEWEST_PLATEAUS or on_them < ON_PLATEAUS * len(current):
        return False
    settled = list(settled_parts(found.plateaus))
    return _along(current, settled) <= MAX_ALONG and _along(torque, settled) <= MAX_ALONG_OF_TORQUE


def _along(values: Array, parts: Sequence[tuple[int, int]]) -> float:
    """Return the change along a part in the direction of the last step, relative to the steps."""
    middle = [(a + b) // 2 for a, b in parts]
    halves = [
        (values[a:m].mean(), values[m:b].mean()) for (a, b), m in zip(parts, middle, strict=True)
    ]
    first, second = np.array(halves).T
    step = np.diff((first + second) / 2)
    along = 2 * (second - first)[1:] * np.sign(step)
    return float(np.median(along) / max(float(np.median(np.abs(step))), np.finfo(float).tiny))


def settled_parts(plateaus: Sequence[tuple[int, int]]) -> Iterator[tuple[int, int]]:
    """Return first and last + 1 sample of the settled part of each plateau."""
    for a, b in plateaus:
        yield min(a + math.ceil(SETTLING_PART * (b - a)), b - 2), b


def stepped(current: Array, plateaus: Sequence[tuple[int, int]]) -> Array:
    """Return the mean of the plateau at each sample (n,), as a set point would step.

    The step is where it leaves the smallest squares between the middles of two plateaus. Raises
    `InsufficientDataError` where the current changes slowly from one to the next.
    """
    ways = np.array([b - a for (_, a), (b, _) in pairwise(plateaus)])
    longest = float(np.median([b - a for a, b in plateaus])) * SETTLING_PART
    if np.median(ways) > longest:
        raise InsufficientDataError(
            f"the current takes {np.median(ways):.0f} samples from plateau to plateau, more than "
            f"{longest:.0f}, a quarter of their length"
        )
    middles = [slice(a + (b - a) // 4, b - (b - a) // 4) for a, b in plateaus]
    means = [float(current[middle].mean()) for middle in middles]
    ends = [0]
    for (before, after), (low, high) in zip(pairwise(middles), pairwise(means), strict=True):
        between = current[before.stop : after.start]
        gained = np.cumsum((between - low) ** 2 - (between - high) ** 2)
        ends.append(before.stop + int(np.argmin(np.append(0.0, gained))))
    return np.repeat(means, np.diff([*ends, len(current)]))


def common_levels(level: Array) -> Array:
    """Return levels (n,) of which those within the tolerance of a set point are equal."""
    number = group_numbers(level, LEVEL_TOLERANCE * float(np.ptp(level)))
    return (np.bincount(number, weights=level) / np.bincount(number))[number]
