"""Texts in which one column names the signal of each line, and JSON documents."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from rigtool.runfile.importers.header import COMMENT_CHARACTERS, Lines
from rigtool.runfile.importers.marks import NUMBER, Marks, plain, split_fields
from rigtool.runfile.importers.raw import Array, ColumnKey, Raw

MAX_JSON = 2**25
"""Most characters of a JSON document: its objects take some tens of times as many bytes."""

ReadColumns = Callable[[Lines, Sequence[ColumnKey], Sequence[str], Mapping[ColumnKey, Any]], Raw]
"""Reads columns of lines, given their names and what makes numbers of texts."""


def read_stacked(
    lines: Lines, marks: Marks, asked: Sequence[ColumnKey], read: ReadColumns
) -> Raw | None:
    """Return the columns (n,) of a text with one value a line, NaN on the lines of others.

    The names that no column has are texts of one column; one more holds the numbers. None for any
    other text.
    """
    first = lines.text[0].lstrip().lstrip(COMMENT_CHARACTERS) if lines.text else ""
    names = split_fields(first, marks.delimiter)
    signals = [str(column) for column in asked if column not in names]
    if not signals or any(isinstance(column, int) for column in asked) or len(names) < 2:
        return None
    rows = [split_fields(line, marks.delimiter) for line in lines.text[1:]]
    rows = [row for row in rows if len(row) == len(names)]
    keys = [n for n, column in enumerate(zip(*rows, strict=True)) if set(signals) <= set(column)]
    if len(keys) != 1:
        return None
    key = keys[0]
    numbers = [
        name
        for n, name in enumerate(names)
        if n != key and name not in asked and NUMBER.fullmatch(plain(rows[-1][n], marks.decimal))
    ]
    values = [name for name in numbers if name.lower() == "value"] or numbers
    if len(values) != 1:
        return None
    places = {name: float(n) for n, name in enumerate(signals)}
    words: dict[ColumnKey, Any] = {names[key]: (partial(_places, places), "no name of a signal")}
    common = [column for column in asked if column in names]
    raw = read(lines.after(1), [*common, names[key], values[0]], names, words)
    which, value = raw.columns[names[key]], raw.columns[values[0]]
    columns: dict[ColumnKey, Array] = {column: raw.columns[column] for column in common}
    columns |= {name: np.where(which == places[name], value, np.nan) for name in signals}
    return replace(raw, columns=columns).only(which >= 0)


def _places(places: Mapping[str, float], texts: Sequence[str]) -> Array:
    return np.array([places.get(text, -1.0) for text in texts])


def json_arrays(text: str) -> dict[str, Any] | None:
    """Return the numbers of a JSON document: of its lists, or of a list of objects, by `a.b`.

    Null, and a name that an object lacks, are NaN. None for a text that is no such document.
    """
    if text.lstrip()[:1] not in ("[", "{") or len(text) > MAX_JSON:
        return None
    try:
        document = json.loads(text)
    except (ValueError, RecursionError):
        return None
    if isinstance(document, list):
        rows = [_flat("", row) for row in document if isinstance(row, dict)]
        names = list(dict.fromkeys(name for row in rows for name in row))
        found = {name: [row.get(name) for row in rows] for name in names}
    else:
        found = {name: v for name, v in _flat("", document).items() if isinstance(v, list)}
    short = [name.rpartition(".")[2] for name in found]
    arrays = {name: _numbers(values) for name, values in found.items()}
    alone = {last: arrays[name] for last, name in zip(short, found, strict=True)}
    return {**{last: a for last, a in alone.items() if short.count(last) == 1}, **arrays} or None


def _flat(prefix: str, values: Mapping[str, Any]) -> dict[str, Any]:
    found: dict[str, Any] = {}
    for name, value in values.items():
        found |= (
            _flat(f"{prefix}{name}.", value) if isinstance(value, dict) else {prefix + name: value}
        )
    return found


def _numbers(values: Sequence[Any]) -> Any:
    """Return numbers (n,); texts where one of the values is none."""
    if all(value is None or isinstance(value, int | float) for value in values):
        return np.array([np.nan if value is None else value for value in values], dtype=np.float64)
    return np.array([str(value) for value in values])
