"""`rigtool import --preview`: the first rows of a file as they would be understood."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Iterable, Sequence
from collections.abc import Mapping as Texts
from pathlib import Path

import numpy as np

from rigtool.recipe.mapping import FileLayout, Mapping
from rigtool.runfile.importers import importers, recognised, understand
from rigtool.runfile.importers.arrays import load_arrays
from rigtool.runfile.importers.conditions import unchanged_parts
from rigtool.runfile.importers.convert import intervals
from rigtool.runfile.importers.header import (
    before_numbers,
    decoded_text,
    require_lines_of_samples,
    split_lines,
)
from rigtool.runfile.importers.labels import names_in
from rigtool.runfile.importers.marks import marks_of, split_fields
from rigtool.runfile.importers.plan import find_files, is_binary
from rigtool.runfile.importers.raw import Array, read_bytes

PREVIEW_ROWS = 5
"""Rows of a file that are shown."""

FIELD_WIDTH = 25
"""Most characters of a field that are shown."""

NAME_LINES = 2
"""Most lines before the numbers that are shown: names, and units."""

GAP_RATIO = 1.5
"""Smallest interval that is a gap, relative to the median."""

SHOWN_SIGNALS = 8
"""Most signals of the mapping that is proposed."""

COMMON_NAMES = ("encoder", "position", "speed", "current", "torque", "reference_torque")
"""Names of signals that most files hold, for a reader who meets them for the first time."""


def preview(sources: Sequence[str], mapping: Mapping | None, skip_bad: bool) -> list[str]:
    """Return lines of text on the first file: signals, units, first rows, rate, gaps, conditions.

    Without a mapping that states columns, what the file itself shows. Raises `RunFileError` for a
    file that cannot be imported.
    """
    endings = [ending for importer in importers().values() for ending in importer.endings]
    files, _ = find_files(sources, endings, None if mapping is None else mapping.files)
    source = files[0][0]
    return [f"{source}, the first of {len(files)}:", *_file(source, mapping, skip_bad)]


def _file(source: Path, mapping: Mapping | None, skip_bad: bool) -> list[str]:
    if (mapping is None or not mapping.signals) and recognised(source) is None:
        return _columns(source, mapping)
    signals, raw, known, notes = understand(source, mapping, skip_bad)
    names = list(signals)
    head = [f"{name} [{known.unit(name) if name in known.signals else 's'}]" for name in names]
    first = range(min(PREVIEW_ROWS, len(signals["time"])))
    rows = [[f"{signals[name][row]:.6g}" for name in names] for row in first]
    found, missing = unchanged_parts(source, raw, known)
    split = {item.name for item in known.conditions if item.column is not None}
    stated = [
        f"{name} = {value:.6g} {unit}"
        for name, (value, unit) in found[0].conditions.items()
        if name not in split
    ]
    ranges = [
        f"{title}: {values.min():.6g} to {values.max():.6g}"
        for title, values in zip(head, signals.values(), strict=True)
    ]
    return [
        *_aligned([head, *rows]),
        _rate(signals["time"], intervals(signals["time"], raw)),
        *ranges,
        *stated,
        *(f"note: {note}" for note in [*notes, *missing]),
    ]


def _rate(time: Array, steps: Array) -> str:
    usual = float(np.median(steps))
    gaps = np.flatnonzero(steps > GAP_RATIO * usual)
    text = f"{len(time)} samples over {steps.sum():.6g} s, {1 / usual:.6g} Hz, "
    if gaps.size == 0:
        return text + "no gaps"
    longest = gaps[np.argmax(steps[gaps])]
    return text + (
        f"{gaps.size} gap{'s' if gaps.size > 1 else ''}, the longest {steps[longest]:.4g} s at "
        f"{time[longest]:.6g} s"
    )


def _columns(source: Path, mapping: Mapping | None) -> list[str]:
    """Return what a file shows that no mapping states the columns of, and a mapping to fill in."""
    if is_binary(source):
        arrays = load_arrays(source)
        what = {n: repr(a) if isinstance(a, str) else str(np.shape(a)) for n, a in arrays.items()}
        return [
            *(f"{name or 'array'}: {text}" for name, text in what.items()),
            *_proposed(_quoted(filter(None, what)), {}),
        ]
    layout = FileLayout() if mapping is None else mapping.file
    lines = split_lines(decoded_text(source, read_bytes(source)), layout.comment)
    require_lines_of_samples(source, lines)
    marks = marks_of(lines.text[len(lines.text) // 2 :], layout)
    rows = [split_fields(line, marks.delimiter) for line in lines.text]
    count = Counter(map(len, rows)).most_common(1)[0][0] if rows else 0
    begin = before_numbers(lines, marks, range(count))
    if begin == len(rows):
        lines_of = "1 line" if len(rows) == 1 else f"{len(rows)} lines"
        if labels := names_in(lines):
            return [f"{lines_of} of names and numbers", *_proposed(_quoted(labels), {})]
        return [f"{lines_of}, none of numbers; delimiter = {marks.delimiter!r}"]
    shown = [[str(number) for number in range(1, count + 1)]]
    shown += [
        [_short(field) for field in row]
        for row in [*rows[max(0, begin - NAME_LINES) : begin], *rows[begin : begin + PREVIEW_ROWS]]
        if len(row) == count
    ]
    numbers = shown[0]
    names = dict(zip(numbers, rows[begin - 1], strict=False)) if begin else {}
    return [
        f"{len(rows)} lines, numbers from line {lines.number[begin]} on; "
        f"delimiter = {marks.delimiter!r}, decimal = {marks.decimal!r}; columns by number:",
        *_aligned(shown),
        *_proposed(numbers, names),
    ]


def _quoted(names: Iterable[str]) -> list[str]:
    return [json.dumps(name, ensure_ascii=False) for name in names]


def _proposed(columns: Sequence[str], names: Texts[str, str]) -> list[str]:
    """Return a mapping in which names and units of these columns are to be filled in.

    `names` are those that the file gives to columns, where they are numbers.
    """
    lines = []
    for index, column in enumerate(columns[:SHOWN_SIGNALS] or ["1"]):
        name = f"NAME{index + 1}" if index else "time"
        line = f'{name} = {{ column = {column}, unit = "UNIT" }}'
        remark = _short(names.get(column, "").strip())
        lines.append(f"{line}  # {remark}" if remark else line)
    if len(columns) > SHOWN_SIGNALS:
        lines.append(f"# and so on: the file has {len(columns)} columns")
    return [
        "",
        "A mapping states what the columns mean. Fill this one in, and give it by --map:",
        "",
        "mapping = 1",
        "[rig]",
        'name = "my rig"',
        "[signals]",
        *lines,
        "",
        f"NAME is a signal: {', '.join(COMMON_NAMES)},",
        "or any other; UNIT is that of the file: ms, rpm, count, mA, N m. Leave out what is not",
        "needed.",
    ]


def _short(field: str) -> str:
    return field if len(field) <= FIELD_WIDTH else field[: FIELD_WIDTH - 1] + "…"


def _aligned(rows: Sequence[Sequence[str]]) -> list[str]:
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    return [
        "  ".join(text.rjust(width) for text, width in zip(row, widths, strict=True))
        for row in rows
    ]
