"""Delimited text, also gzipped: parsed by numpy, and line by line only to locate errors.

Every line must have the number of fields that most lines have. A line that was cut short is thus
found even if it still holds the columns that are read. pandas reports neither its line number among
comments nor an exact value without its slower parser.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np

from rigtool.errors import RunFileError
from rigtool.recipe import mapping as mappings
from rigtool.recipe.mapping import FileLayout
from rigtool.recipe.units import DATE
from rigtool.runfile.importers.arrays import columns_of
from rigtool.runfile.importers.dates import is_date, seconds_of
from rigtool.runfile.importers.header import (
    Lines,
    decoded_text,
    header_of,
    require_lines_of_samples,
    require_undivided,
    split_lines,
)
from rigtool.runfile.importers.labels import labelled
from rigtool.runfile.importers.marks import (
    BLANK,
    NUMBER,
    THOUSANDS,
    WHITESPACE,
    Marks,
    fields_of,
    marks_of,
    plain,
    unquoted,
)
from rigtool.runfile.importers.raw import (
    BINARY_REMEDY,
    MAX_LINE,
    MAX_NUMBERS,
    Array,
    ColumnKey,
    Raw,
    has_own_lines,
    missing_column,
    read_bytes,
    require_good,
)
from rigtool.runfile.importers.stacked import json_arrays, read_stacked

Words = Mapping[ColumnKey, tuple[Callable[[Sequence[str]], Array], str]]
"""What makes numbers of the texts of columns, NaN for any other text, and what that then is."""

EXPONENT = str.maketrans("dD", "ee")
"""Of double precision as Fortran writes it."""

FIELD_SEPARATOR = "\x1f"
"""Delimiter of lines whose fields in quotes were taken apart: a control character for it."""


def read_text(
    path: Path, mapping: mappings.Mapping, skip_bad: bool, columns: Sequence[ColumnKey] = ()
) -> tuple[Raw, list[str]]:
    """Read the columns of a mapping, or `columns`, as numbers; also return notes on what the lines
    show.

    Raises `RunFileError` for a missing column, and, unless `skip_bad`, for lines that are cut
    short, or hold something else than numbers.
    """
    layout = mapping.file
    text = decoded_text(path, read_bytes(path))
    asked = list(columns) or mapping.columns
    if (arrays := json_arrays(text)) is not None:
        return columns_of(path, arrays, None, asked, skip_bad), []
    lines = split_lines(text, layout.comment)
    if (longest := max(map(len, lines.text), default=0)) > MAX_LINE:
        raise RunFileError(
            f"{path}: a line has {longest} characters, above {MAX_LINE}: {BINARY_REMEDY}"
        )
    if (found := labelled(lines, {str(column) for column in asked})) is not None:
        names, lines, marks = found
        return read_numbers(path, lines, marks, asked, names, skip_bad, words_of(mapping)), []
    require_lines_of_samples(path, lines)
    marks = marks_of(lines.text[len(lines.text) // 2 :], layout)

    def read(
        data: Lines, asked: Sequence[ColumnKey], names: Sequence[str], more: Words | None = None
    ) -> Raw:
        words = {**words_of(mapping), **(more or {})}
        return read_numbers(path, data, marks, asked, names, skip_bad, words)

    if (stacked := read_stacked(lines, marks, asked, read)) is not None:
        return stacked, marks.notes(layout)
    head, names = header_of(path, lines, marks, layout, asked)
    notes = marks.notes(layout)
    if layout.header_lines is None and head != bool(names):
        notes.append(f"as the lines show, header_lines = {head}: state it in [file]")
    data = lines.after(head)
    if not names and layout.decimal is None and data.text:
        require_undivided(path, lines.text[head - 1] if head else "", data, marks)
    if layout.sampling_rate_hz is None:
        data = data.without(set(lines.text[:head]))
    return read(data, asked, names), notes


def words_of(mapping: mappings.Mapping) -> Words:
    """Return what makes numbers of the columns of a mapping that hold text."""
    date = seconds_of, "no date with a clock time, and no clock time"
    found: dict[ColumnKey, tuple[Callable[[Sequence[str]], Array], str]]
    found = dict.fromkeys(mapping.dates, date)
    for column, values in mapping.words.items():
        found[column] = partial(_by_word, values), f"none of {', '.join(values)}"
    return found


def _by_word(values: Mapping[str, float], texts: Sequence[str]) -> Array:
    return np.array([values.get(text, np.nan) for text in texts])


def read_numbers(
    path: Path,
    lines: Lines,
    marks: Marks,
    columns: Sequence[ColumnKey],
    names: Sequence[str],
    skip_bad: bool,
    words: Words,
) -> Raw:
    """Read columns of lines that hold numbers; `names` are those of all columns, or none.

    A last line without its end is left out where its last field may be cut short. Raises
    `RunFileError` for bad lines, and where no line holds numbers.
    """
    if not lines.text:
        raise RunFileError(f"{path}: holds no line of numbers: check comment and header_lines")
    if (amount := len(lines.text) * len(columns)) > MAX_NUMBERS:
        raise RunFileError(
            f"{path}: has {amount} numbers, above {MAX_NUMBERS} of a text: {BINARY_REMEDY}"
        )
    delimiter = marks.delimiter
    if any('"' in line for line in lines.text):
        joined = [FIELD_SEPARATOR.join(fields_of(line, delimiter)) for line in lines.text]
        lines, delimiter = replace(lines, text=joined), FIELD_SEPARATOR
    split = None if delimiter == WHITESPACE else delimiter
    counts, usual = _field_counts(lines.text, split, len(names))
    try:
        indices = [_index(path, column, names, usual) for column in columns]
    except RunFileError as error:
        shown = marks_of(lines.text, FileLayout())
        if shown == marks:
            raise
        hint = f"delimiter = {shown.delimiter!r} and decimal = {shown.decimal!r} in [file]"
        raise RunFileError(f"{error}; its lines look like {hint}") from None
    joined_by = ", or has decimal commas, which need another delimiter" * (split == ",")
    bad = {
        number: f"has {count} {'field' if count == 1 else 'fields'}, the others have {usual}: "
        f"it was cut short or joined{joined_by * (count > usual)}"
        for number, count in zip(lines.number, counts, strict=True)
        if count != usual
    }
    cut = {}
    if not lines.whole and lines.number[-1] not in bad and not _as_long(lines.text, split):
        cut = {lines.number[-1]: "the file ends within this line: it may be cut short"}
        lines = lines.before(-1)
    table = _columns(
        lines, split, marks.decimal, dict(zip(columns, indices, strict=True)), bad, words
    )
    if not skip_bad:
        require_good(path, "line", bad)
    place = np.flatnonzero([number not in bad for number in lines.number]).astype(np.int64)
    line = np.array(lines.number, dtype=np.int64)[place]
    return Raw(table, place, line, "line", {**bad, **cut})


def _as_long(lines: Sequence[str], split: str | None) -> bool:
    """Return whether the last field of the last line has as many decimals as those before it."""
    decimals = {len(re.split("[.,]", line.split(split)[-1].strip())[-1]) for line in lines[-3:]}
    return len(lines) > 2 and len(decimals) == 1 and bool(re.search(r"[.,]\d+\W*$", lines[-1]))


def _columns(
    lines: Lines,
    split: str | None,
    decimal: str,
    places: Mapping[ColumnKey, int],
    bad: dict[int, str],
    words: Words,
) -> dict[ColumnKey, Array]:
    """Return the columns of the lines that hold numbers; add the others to `bad`."""
    texts = {column: at for column, at in places.items() if column in words}
    numeric = {column: at for column, at in places.items() if column not in words}

    def good() -> list[tuple[str, int]]:
        both = zip(lines.text, lines.number, strict=True)
        return [(line, number) for line, number in both if number not in bad]

    said: dict[ColumnKey, dict[int, float]] = {}
    for column, at in texts.items():
        fields = [(unquoted(line.split(split)[at]), number) for line, number in good()]
        numbers_of, other = words[column]
        values = numbers_of([text for text, _ in fields])
        said[column] = {n: v for (_, n), v in zip(fields, values.tolist(), strict=True)}
        blank = {number for text, number in fields if text.lower() in BLANK}
        blank = blank if has_own_lines(len(blank), len(fields)) else set()
        for (text, number), value in zip(fields, values, strict=True):
            if not np.isfinite(value) and number not in blank:
                bad[number] = f"column {at + 1} holds {text[:40]!r}, {other}"
    rows, asked = good(), list(numeric.values())
    table = _parse([line for line, _ in rows], split, decimal, asked) if asked else []
    if table is None:
        table = _parse_exactly(rows, split, decimal, asked, bad)
    numbers = [number for _, number in rows if number not in bad]
    return dict(zip(numeric, table, strict=True)) | {
        column: np.array([by_line[number] for number in numbers])
        for column, by_line in said.items()
    }


def _field_counts(lines: Sequence[str], delimiter: str | None, named: int) -> tuple[list[int], int]:
    """Return how many fields each line has, and how many all should have; `named` columns have a
    name."""
    if delimiter is None:
        counts = [len(line.split()) for line in lines]
        return counts, named or _most_common(counts)
    counts = [line.count(delimiter) + 1 for line in lines]
    most = _most_common(counts)
    if most == named + 1 > 1:
        # Some programs end each line, but not the names, with a delimiter.
        ended = [line.rstrip(" ").endswith(delimiter) for line in lines]
        counts = [n - end for n, end in zip(counts, ended, strict=True)]
    # Nothing may be written in the last columns.
    return counts, min(named or most, most)


def _most_common(counts: Sequence[int]) -> int:
    return Counter(counts).most_common(1)[0][0]


def _index(path: Path, column: ColumnKey, names: Sequence[str], count: int) -> int:
    if isinstance(column, str):
        if column not in names:
            raise missing_column(path, column, names, count)
        if list(names).count(column) > 1:
            raise RunFileError(f"{path}: two columns are called {column!r}: give its number")
        return list(names).index(column)
    if column > count:
        raise missing_column(path, column, names, count)
    return column - 1


def _parse(
    lines: Sequence[str], delimiter: str | None, decimal: str, indices: Sequence[int]
) -> list[Array] | None:
    """Return the columns by numpy's parser; None where one of them is not all finite numbers."""
    if not lines:
        return None
    if decimal != ".":
        if any("." in line for line in lines):
            return None  # a point may divide thousands
        lines = [line.replace(decimal, ".") for line in lines]
    try:
        table = np.loadtxt(lines, delimiter=delimiter, comments=None, usecols=indices, ndmin=2)
    except ValueError:
        return None
    return list(table.T) if np.isfinite(table).all() else None


def _parse_exactly(
    rows: Sequence[tuple[str, int]],
    delimiter: str | None,
    decimal: str,
    indices: Sequence[int],
    bad: dict[int, str],
) -> list[Array]:
    """Return the columns of the lines, each with its number, that hold numbers; add the others to
    `bad`."""
    found = []
    parts = [line.split(delimiter) for line, _ in rows]
    blanks = [sum(unquoted(part[index]).lower() in BLANK for part in parts) for index in indices]
    sparse = {i for i, n in zip(indices, blanks, strict=True) if has_own_lines(n, len(rows))}
    for fields, (_, number) in zip(parts, rows, strict=True):
        row = []
        for index in indices:
            if index in sparse and unquoted(fields[index]).lower() in BLANK:
                row.append(np.nan)
                continue
            text = plain(fields[index], decimal)
            thousands = decimal != "." and THOUSANDS.fullmatch(unquoted(fields[index]))
            good = NUMBER.fullmatch(text) and not thousands
            value = float(text.translate(EXPONENT)) if good else np.nan
            if not np.isfinite(value):
                bad[number] = _no_number(index, fields[index].strip())
                break
            row.append(value)
        else:
            found.append(row)
    return list(np.array(found, dtype=np.float64).reshape(-1, len(indices)).T)


def _no_number(index: int, text: str) -> str:
    hints = {
        f': a date or clock time has unit = "{DATE}"': is_date(text),
        ": a list: give each of its elements a column": text[:2].strip("\"'")[:1] in ("[", "("),
        ": write it with base 10": text[:2].lower() == "0x",
        ": take the unit out of the fields": NUMBER.match(text) and text[-1:].isalpha(),
    }
    hint = next((hint for hint, fits in hints.items() if fits), "")
    return f"column {index + 1} holds {text[:40]!r}, no number{hint}"
