"""One time axis for columns that are filled on different lines, or have times of their own.

Loggers of several buses write a line whenever one of their channels has a value. The axis is that
of the effort with most samples, so that nothing is invented about forces: what moves is smooth, and
lies on straight lines between its own samples.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from rigtool.errors import RunFileError
from rigtool.recipe.mapping import Mapping
from rigtool.runfile.importers.contradictions import EFFORT_ORDER
from rigtool.runfile.importers.counters import unwrapped
from rigtool.runfile.importers.raw import Array, ColumnKey, Raw
from rigtool.runfile.schema import TIME

FILLED = 2
"""Smallest number of values that a column holds."""


def on_one_axis(path: Path, raw: Raw, mapping: Mapping) -> tuple[Raw, list[str]]:
    """Return columns (n,) without blanks, NaN before, on the lines of one of them, and a note.

    Set points and conditions hold until the next. Lines before the first sample of a signal, or
    after its last one, are left out, up to one of its intervals. Raises `RunFileError` where a
    column has too few values, or its time does not rise.
    """
    if not mapping.own_times and not any(np.isnan(values).any() for values in raw.columns.values()):
        return raw, []
    clock = mapping.signals[TIME].column if TIME in mapping.signals else None
    common = raw.columns[clock] if clock is not None else raw.place.astype(np.float64)
    courses = dict(_courses(path, raw, mapping, common))
    asked = [n for n in courses if n in mapping.signals and not n.endswith("_setpoint")] or courses
    leader = max(
        [n for n in asked if n in EFFORT_ORDER] or asked, key=lambda n: len(courses[n].line)
    )
    axis = courses[leader]
    inside = np.ones(len(axis.line), dtype=np.bool_)
    filled: dict[ColumnKey, Array] = {}
    for name, course in courses.items():
        held = name not in mapping.signals or name.endswith("_setpoint")
        filled[course.column] = course.at(axis.time, held=held)
        if not held:
            margin = float(np.median(np.diff(course.time)))
            inside &= (axis.time >= course.time[0] - margin) & (
                axis.time <= course.time[-1] + margin
            )
    if np.count_nonzero(inside) < FILLED:
        raise RunFileError(f"{path}: its columns have no time in common: map columns that have")
    if clock is not None:
        filled[clock] = axis.time
    # The lines of other columns are no gaps in this one.
    found = replace(raw.only(axis.line), columns=filled).only(inside)
    counts = ", ".join(f"{name} {len(course.line)}" for name, course in courses.items())
    note = (
        f"columns are filled on different lines ({counts}): on those of {leader}, the others on "
        "straight lines between their own samples; set points and conditions hold"
    )
    return found, [note]


class _Course:
    """The values of a column where it is filled: on the lines `line` (n,), at `time` (n,)."""

    def __init__(
        self, column: ColumnKey, line: NDArray[np.intp], time: Array, values: Array
    ) -> None:
        self.column, self.line, self.time, self.values = column, line, time, values

    def at(self, time: Array, *, held: bool) -> Array:
        """Return the values at times (m,): on straight lines, or each until the next."""
        if not held:
            return np.interp(time, self.time, self.values)
        before = np.searchsorted(self.time, time, side="right") - 1
        return self.values[np.maximum(before, 0)]


def _courses(
    path: Path, raw: Raw, mapping: Mapping, common: Array
) -> Iterator[tuple[str, _Course]]:
    """Yield signals and conditions by name, each where its column is filled."""
    wanted = [
        (name, signal.column, signal.time, signal.wraps_at)
        for name, signal in mapping.signals.items()
        if name != TIME
    ]
    by_column = [item for item in mapping.conditions if item.column is not None]
    wanted += [(item.name, item.column or 0, None, None) for item in by_column]
    for name, column, own, wraps_at in wanted:
        time = common if own is None else raw.columns[own]
        line = np.flatnonzero(np.isfinite(raw.columns[column]) & np.isfinite(time))
        if len(line) < FILLED:
            raise RunFileError(
                f"{path}: column {column!r} has {len(line)} values, at least {FILLED} are needed"
            )
        fallen = np.flatnonzero(np.diff(time[line]) <= 0)
        if fallen.size:
            raise RunFileError(
                f"{path}, {raw.what} {raw.line[line[fallen[0] + 1]]}: the time of column "
                f"{column!r} does not rise: sort the file by time, give each recording a file of "
                "its own, and take out samples that are there twice"
            )
        values = raw.columns[column][line]
        if wraps_at is not None:
            values = unwrapped(values, wraps_at)
        yield name, _Course(column, line, time[line], values)
