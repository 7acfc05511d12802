"""Closing strokes of imported runs: a Table 8 at one position, and how far repeats disagree.

Strokes of one run repeat each other: same positions, same speeds, same load. The difference of the
torque from effort between them, less that of the sensor, is a limit for any function of motion and
effort.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from rigtool.experiments.force.results import LOAD_COLUMNS, LoadRow, loads_table
from rigtool.experiments.imported_load.basis import LoadSignals
from rigtool.numerics.arrays import Array, Mask
from rigtool.numerics.plateaus import runs_of
from rigtool.quantity import Quantity
from rigtool.runfile import Table

STROKE_CELLS = 25
"""Positions along the stroke at which repeats are compared."""

MIN_REPEATS = 2
"""Strokes, or runs, that have a scatter."""


@dataclass(frozen=True, eq=False)
class Strokes:
    """Closing strokes of one run by position of the load: (s, n), NaN where a stroke is not.

    `place` (n,) is common to all runs; torque and sensor are in N m.
    """

    place: Array
    torque: Array
    sensor: Array


def read_strokes(items: Sequence[tuple[LoadSignals, Array, Mask]]) -> list[Strokes]:
    """Return the fast strokes of each run at common positions.

    `items` are signals, the torque as measured (n,) N m, NaN without one, and where the strokes are
    (n,).
    """
    found = []
    for *_, fast in items:
        found.append([slice(a, b) for a, b in runs_of(fast) if b - a > 2])
    places = [
        own.place[part] for (own, *_), parts in zip(items, found, strict=True) for part in parts
    ]
    if not places:
        return []
    low, high = min(p.min() for p in places), max(p.max() for p in places)
    grid = low + (np.arange(2 * STROKE_CELLS + 1) / (2 * STROKE_CELLS)) * (high - low)
    strokes = []
    for (signals, measured, _), parts in zip(items, found, strict=True):
        rows = np.full((2, len(parts), len(grid)), np.nan)
        for number, part in enumerate(parts):
            place = signals.place[part]
            order = np.argsort(place, kind="stable")
            for values, of in zip(rows[:, number], (measured, signals.sensor), strict=True):
                values[:] = np.interp(
                    grid, place[order], of[part][order], left=np.nan, right=np.nan
                )
        strokes.append(Strokes(grid, *rows))
    return strokes


def stroke_loads(strokes: Sequence[Strokes], numbers: Sequence[int]) -> Table | None:
    """Return applied and measured torque at the middle of the closing strokes, by level [Table 8].

    Torque that resists closing counts as positive. `numbers` are the levels of the runs. None where
    no stroke passes the middle.
    """
    if not strokes:
        return None
    middle = len(strokes[0].place) // 2
    rows: list[LoadRow] = []
    pooled = np.concatenate([item.sensor[:, middle] for item in strokes])
    sign = math.copysign(1.0, float(np.nansum(pooled)))
    for level in sorted(set(numbers)):
        torque, sensor, errors = [], [], []
        for item, number in zip(strokes, numbers, strict=True):
            known = np.isfinite(item.torque[:, middle] + item.sensor[:, middle])
            if number == level and known.any():
                torque.append(sign * item.torque[known, middle])
                sensor.append(sign * item.sensor[known, middle])
                errors.append(float(np.mean(torque[-1] - sensor[-1])))
        if torque:
            rows.append(_row(np.concatenate(torque), np.concatenate(sensor), np.array(errors)))
    if not rows:
        return None
    place = strokes[0].place[middle]
    about = (
        f"closing strokes where the load is at {place:.4g} rad; torque against closing is positive"
    )
    return loads_table(rows, {k: v for k, v in {**LOAD_COLUMNS, **_OWN}.items() if v}, about)


_OWN = {
    "applied_force": ("N", "NaN: a torque is applied"),
    "applied_torque": ("N m", "the sensor's mean"),
    "applied_torque_u": None,
    "mean_torque": ("N m", "measured, mean of all strokes"),
    "mean_torque_u": ("N m", "standard uncertainty of the error, from how runs disagree"),
    "error_torque_u": None,
    "cycles": ("1", "strokes of all runs"),
    "effective_cycles": ("1", "runs"),
}
"""What differs from other tables of loads; None: not there."""


def _row(torque: Array, sensor: Array, errors: Array) -> LoadRow:
    """Return one load from strokes (n,) and the mean errors of runs (r,), N m.

    Runs disagree by more than the strokes of one: they are what repeats the measurement.
    """
    runs, mean = len(errors), float(torque.mean())
    shown = Quantity(mean, "N m", reason="of one run: its scatter is not known")
    if runs >= MIN_REPEATS:
        shown = Quantity(mean, "N m", float(errors.std(ddof=1)) / math.sqrt(runs), float(runs - 1))
    std = float(torque.std(ddof=1)) if torque.size >= MIN_REPEATS else math.nan
    applied = Quantity(float(sensor.mean()), "N m", reason="by the sensor")
    # S / sqrt(2 (n - 1)) for normal readings (GUM E.4.3)
    std_u = std / math.sqrt(2 * max(torque.size - 1, 1))
    return LoadRow(math.nan, applied, shown, std, std_u, float(torque.size), float(runs))


def scatter_results(strokes: Sequence[Strokes]) -> tuple[dict[str, Quantity], list[str]]:
    """Return how far repeated strokes of a run disagree, and how far the means of runs do."""
    squares, dof, means = 0.0, 0, []
    for item in strokes:
        error = item.torque - item.sensor
        if np.isfinite(error).any():
            means.append(float(np.nanmean(error)))
        for cell in error.T:
            known = cell[np.isfinite(cell)]
            if known.size >= MIN_REPEATS:
                squares += float(np.sum((known - known.mean()) ** 2))
                dof += known.size - 1
    found, notes = {}, []
    reason = "itself a scatter"
    if dof:
        within = math.sqrt(squares / dof)
        found["scatter_between_strokes"] = Quantity(within, "N m", reason=reason)
    if len(means) >= MIN_REPEATS:
        between = float(np.std(means, ddof=1))
        found["scatter_between_runs"] = Quantity(between, "N m", reason=reason)
    if len(found) == 2:
        limit = math.hypot(within, between)
        found["repeatability"] = Quantity(limit, "N m", reason=reason)
        notes.append(
            f"closing strokes of one run differ by {within * 1e3:.3g} mN m at the same position, "
            f"speed and load, below which no function of motion and effort gets; runs as wholes "
            f"are off by {between * 1e3:.3g} mN m, which holds friction that changes from run to "
            f"run: {limit * 1e3:.3g} mN m together"
        )
    return found, notes
