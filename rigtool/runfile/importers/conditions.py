"""Conditions of recordings: the rig, names of files, and columns by which a file is split."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np

from rigtool.errors import RunFileError
from rigtool.recipe.mapping import RIG_CONDITIONS, Condition, Mapping
from rigtool.runfile.importers.convert import stem
from rigtool.runfile.importers.raw import Raw
from rigtool.runfile.schema import TIME

MOST_PARTS = 1000
"""A column that changes more often is a signal, no condition."""

COUNTERS, NEARLY = (2**16, 2**32), 0.01
"""Ranges of clocks that count, and the part of it by which the fall of one differs."""

FEWEST_SAMPLES = 2
"""In a part: a single sample between two changes is left out."""


@dataclass(frozen=True)
class Part:
    """Samples `start` to `stop` (excluded) of a file, under their own conditions."""

    start: int
    stop: int
    conditions: dict[str, tuple[float, str]]


def conditions(path: Path, mapping: Mapping) -> tuple[dict[str, tuple[float, str]], list[str]]:
    """Return properties of the rig and conditions of a whole file, by name: (value, SI unit).

    Also returns notes on conditions that a name does not contain; those are left out.
    """
    notes = []
    found = {
        name: (float(value), unit)
        for name, unit in RIG_CONDITIONS.items()
        if (value := getattr(mapping.rig, name)) is not None
    }
    for condition in mapping.conditions:
        if condition.value is not None:
            found[condition.name] = condition.si(condition.value)
        elif condition.pattern is not None:
            value, text = _in_name(path, condition, condition.pattern)
            if value is None:
                notes.append(text)
            else:
                found[condition.name] = condition.si(value)
    return found, notes


def _in_name(path: Path, condition: Condition, pattern: str) -> tuple[float | None, str]:
    """Return the value that a name contains; None, and why, where it contains none."""
    what = "name" if condition.of == "file" else "folder's name"
    where = stem(path) if condition.of == "file" else path.resolve().parent.name
    match = re.search(pattern, where)
    text = None if match is None else match[1]
    try:
        return (float(text or "") if condition.values is None else condition.values[text or ""]), ""
    except (KeyError, ValueError):
        shown = "nothing" if text is None else repr(text)
        return None, (
            f"its {what} does not state the condition {condition.name!r}: {pattern!r} finds {shown}"
        )


def unchanged_parts(path: Path, raw: Raw, mapping: Mapping) -> tuple[list[Part], list[str]]:
    """Return the parts of a file in which no condition of a column changes, and notes.

    One part without such conditions; time that starts anew ends a part, too. Raises `RunFileError`
    where one changes too often.
    """
    whole, notes = conditions(path, mapping)
    by_column = [item for item in mapping.conditions if item.column is not None]
    if raw.starts:
        lines = ", ".join(map(str, raw.starts[:5])) + (", ..." if len(raw.starts) > 5 else "")
        notes.append(
            f"time starts anew at {raw.what} {lines}: a recording begins there"
            + _overflow(raw, mapping)
        )
    if not by_column:
        return [Part(a, b, whole) for a, b in pairwise(raw.edges)], notes
    values = [_values(path, raw, item) for item in by_column]
    changes = np.flatnonzero(np.any([np.diff(value) != 0 for value in values], axis=0)) + 1
    if len(changes) >= MOST_PARTS:
        names = ", ".join(repr(item.column) for item in by_column)
        raise RunFileError(
            f"{path}: column {names} changes {len(changes)} times, a condition holds for a while "
            f"(at most {MOST_PARTS} parts): map it as a signal, or state its `values`"
        )
    found = []
    for start, stop in pairwise(sorted({*raw.edges, *changes.tolist()})):
        if stop - start >= FEWEST_SAMPLES:
            here = {
                item.name: item.si(float(value[start]))
                for item, value in zip(by_column, values, strict=True)
            }
            found.append(Part(start, stop, {**whole, **here}))
    left_out = len(raw.line) - sum(part.stop - part.start for part in found)
    if not found:
        raise RunFileError(f"{path}: its conditions change at each sample: map them as signals")
    if left_out:
        notes.append(f"{left_out} samples alone between two changes of a condition were left out")
    return found, [*notes, *_stated(found, by_column)]


def _overflow(raw: Raw, mapping: Mapping) -> str:
    """Return a hint where the time falls by the range of a counter."""
    clock = raw.columns[mapping.signals[TIME].column]
    first = np.searchsorted(raw.line, raw.starts)
    fallen = clock[first - 1] - clock[first]
    for size in COUNTERS:
        if np.all(np.abs(fallen / size - 1) < NEARLY):
            return f"; if the clock overflows there, state wraps_at = {size} for `{TIME}`"
    return ""


def _values(path: Path, raw: Raw, condition: Condition) -> np.ndarray:
    """Return the numbers (n,) of a column; the texts of files of text are numbers already."""
    assert condition.column is not None
    column = raw.columns[condition.column]
    if condition.values is None or raw.what == "line":
        return column
    try:
        known = {float(text): value for text, value in condition.values.items()}
        return np.array([known[value] for value in column.tolist()])
    except (KeyError, ValueError):
        raise RunFileError(
            f"{path}: column {condition.column!r} holds numbers that `values` of the condition "
            f"{condition.name!r} does not state: give each of {np.unique(column)[:5]}"
        ) from None


def _stated(found: Sequence[Part], by_column: Sequence[Condition]) -> list[str]:
    """Return a note on the parts of a file."""
    names = [item.name for item in by_column]
    sets = {tuple(part.conditions[name][0] for name in names) for part in found}
    listed = "; ".join(
        ", ".join(f"{name} {value:g}" for name, value in zip(names, values, strict=True))
        for values in sorted(sets)[:5]
    )
    more = f"; and {len(sets) - 5} more" if len(sets) > 5 else ""
    return [f"split into {len(found)} recordings, under {len(sets)} conditions: {listed}{more}"]
