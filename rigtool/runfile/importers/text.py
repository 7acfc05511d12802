"""Delimited text, also gzipped: parsed by numpy, and line by line only to locate errors.

Every line must have the number of fields that most lines have. A line that was cut short is thus
found even if it still holds the columns that are read. pandas reports neither its line number among
comments nor an exact value without its slower parser.
"""

from __future__ import annotations

import csv
import re
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from rigtool.errors import RunFileError
from rigtool.recipe.mapping import FileLayout
from rigtool.runfile.importers.raw import (
    BINARY,
    MAX_LINE,
    Array,
    ColumnKey,
    Raw,
    missing_column,
    read_bytes,
    require_good,
)

WHITESPACE = "whitespace"

MINUS = "\u2212"
"""The minus sign of typesetting, which some programs write for a hyphen."""

MARKS = tuple(
    (delimiter, decimal) for delimiter in (",", ";", "\t", WHITESPACE) for decimal in ".,"
)
"""Delimiters and decimal marks that the lines of a text may show, the usual ones first."""

LOOKED_AT = 50
"""Most lines that are looked at for them."""

MOSTLY = 0.3
"""Smallest part of numbers among the fields of lines of measurements."""

Words = Mapping[ColumnKey, Mapping[str, float]]
"""Numbers for the texts of columns."""

_NUMBER = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?")


@dataclass(frozen=True)
class Lines:
    """The lines of a text that are not comments, each with its number from 1.

    `whole` is False where the last one has no end of line.
    """

    text: list[str]
    number: list[int]
    whole: bool

    def after(self, count: int) -> Lines:
        """Return all but the first `count` lines."""
        return Lines(self.text[count:], self.number[count:], self.whole)


def read_text(
    path: Path,
    layout: FileLayout,
    columns: Sequence[ColumnKey],
    skip_bad: bool,
    words: Words | None = None,
) -> tuple[Raw, list[str]]:
    """Read columns of a text file as numbers; also return notes on what its lines show.

    `words` are the numbers for the texts of columns that hold text.

    Raises `RunFileError` for a missing column, and, unless `skip_bad`, for lines that are cut
    short, hold something else than numbers, or end with the file.
    """
    lines = split_lines(decode(read_bytes(path)), layout.comment)
    if (longest := max(map(len, lines.text), default=0)) > MAX_LINE:
        raise RunFileError(f"{path}: a line has {longest} characters, above {MAX_LINE}: {BINARY}")
    named = any(isinstance(column, str) for column in columns)
    head = layout.header_lines if layout.header_lines is not None else int(named)
    if named and not 0 < head <= len(lines.text):
        raise RunFileError(
            f"{path}: has no line that names its columns (header_lines = {head}): give columns by "
            "number, or correct the mapping"
        )
    marks = marks_of(lines.after(head).text, layout)
    names = split_fields(lines.text[head - 1], marks.delimiter) if named else []
    if (better := _line_of_names(lines, marks, columns)) is not None and better != head:
        missing = [column for column in columns if isinstance(column, str) and column not in names]
        if missing:
            raise RunFileError(
                f"{path}: line {lines.number[head - 1]} names no column {missing[0]!r}, line "
                f"{lines.number[better - 1]} names all: state header_lines = {better} in [file]"
            )
    raw = read_numbers(path, lines.after(head), marks, columns, names, skip_bad, words)
    return raw, marks.notes(layout)


def _line_of_names(lines: Lines, marks: Marks, columns: Sequence[ColumnKey]) -> int | None:
    """Return which of the first lines, from 1, names all columns that are given by name."""
    asked = {column for column in columns if isinstance(column, str)}
    for number, line in enumerate(lines.text[:LOOKED_AT], start=1):
        if asked and asked <= set(split_fields(line, marks.delimiter)):
            return number
    return None


@dataclass(frozen=True)
class Marks:
    """Delimiter and decimal mark of a text."""

    delimiter: str
    decimal: str

    def notes(self, layout: FileLayout) -> list[str]:
        """Return what a mapping leaves to the lines and they show otherwise than plain CSV does."""
        stated = {"delimiter": layout.delimiter, "decimal": layout.decimal}
        usual = {"delimiter": ",", "decimal": "."}
        found = [
            f"{key} = {getattr(self, key)!r}"
            for key, value in stated.items()
            if value is None and getattr(self, key) != usual[key]
        ]
        return [f"as the lines show, {', '.join(found)}: state it in [file]"] if found else []


def marks_of(lines: Sequence[str], layout: FileLayout) -> Marks:
    """Return delimiter and decimal mark: as stated, else those with most numbers a line."""
    best, most = Marks(layout.delimiter or ",", layout.decimal or "."), 0.0
    shown = lines[:LOOKED_AT]
    for delimiter, decimal in MARKS:
        marks = Marks(layout.delimiter or delimiter, layout.decimal or decimal)
        if marks.delimiter == marks.decimal:
            continue
        rows = [_fields(line, marks.delimiter) for line in shown]
        usual = Counter(map(len, rows)).most_common(1)[0][0] if rows else 0
        numbers = [
            bool(_NUMBER.fullmatch(_plain(field, marks.decimal)))
            for row in rows
            if len(row) == usual
            for field in row
        ]
        # A mark that splits numbers leaves text, or makes more fields of which some are no number.
        part = float(np.mean(numbers)) if numbers else 0.0
        if part >= MOSTLY and (score := sum(numbers) * part) > most:
            best, most = marks, score
    return best


def _fields(line: str, delimiter: str) -> list[str]:
    return line.split(None if delimiter == WHITESPACE else delimiter)


def _plain(field: str, decimal: str) -> str:
    """Return a field without the quotes around it; one quote alone is a part of a longer field."""
    text = field.strip()
    if len(text) > 1 and text[0] == text[-1] == '"':
        text = text[1:-1]
    return text.replace(decimal, ".")


def read_numbers(
    path: Path,
    lines: Lines,
    marks: Marks,
    columns: Sequence[ColumnKey],
    names: Sequence[str],
    skip_bad: bool,
    words: Words | None = None,
) -> Raw:
    """Read columns of lines that hold numbers; `names` are those of all columns, or none.

    `words` as in `read_text`.

    Raises `RunFileError` for bad lines, and where no line holds numbers.
    """
    if not lines.text:
        raise RunFileError(f"{path}: holds no line of numbers: check comment and header_lines")
    delimiter = None if marks.delimiter == WHITESPACE else marks.delimiter
    counts = _field_counts(lines.text, delimiter)
    most = Counter(counts).most_common(1)[0][0]
    if most == len(names) + 1 > 1 and delimiter is not None:
        # Some programs end each line, but not the names, with a delimiter.
        ended = [line.rstrip().endswith(delimiter) for line in lines.text]
        counts = [n - end for n, end in zip(counts, ended, strict=True)]
    usual = len(names) or most
    try:
        indices = [_index(path, column, names, usual) for column in columns]
    except RunFileError as error:
        shown = marks_of(lines.text, FileLayout())
        if shown == marks:
            raise
        hint = f"delimiter = {shown.delimiter!r} and decimal = {shown.decimal!r} in [file]"
        raise RunFileError(f"{error}; its lines look like {hint}") from None
    bad = {
        number: f"has {count} fields, the others have {usual}: it was cut short or joined"
        for number, count in zip(lines.number, counts, strict=True)
        if count != usual
    }
    if not lines.whole:
        bad[lines.number[-1]] = "the file ends within this line: its end is missing"
    said = {
        column: _translate(lines, delimiter, index, words[column], bad)
        for column, index in zip(columns, indices, strict=True)
        if words and column in words
    }
    numeric = [
        (column, index)
        for column, index in zip(columns, indices, strict=True)
        if column not in said
    ]
    good = [
        text for text, number in zip(lines.text, lines.number, strict=True) if number not in bad
    ]
    numbers = [number for number in lines.number if number not in bad]
    asked = [index for _, index in numeric]
    table = _parse(good, delimiter, marks.decimal, asked)
    if table is None:
        table = _parse_exactly(good, numbers, delimiter, marks.decimal, asked, bad)
    if not skip_bad:
        require_good(path, "line", bad)
    place = np.flatnonzero([number not in bad for number in lines.number]).astype(np.int64)
    line = np.array(lines.number, dtype=np.int64)[place]
    found = dict(zip((column for column, _ in numeric), table, strict=True))
    found |= {
        column: np.array([by_line[number] for number in line.tolist()])
        for column, by_line in said.items()
    }
    return Raw(found, place, line, "line", bad)


def _translate(
    lines: Lines,
    delimiter: str | None,
    index: int,
    words: Mapping[str, float],
    bad: dict[int, str],
) -> dict[int, float]:
    """Return the number for a text column by line; add lines with any other text to `bad`."""
    found = {}
    for line, number in zip(lines.text, lines.number, strict=True):
        if number in bad:
            continue
        text = line.split(delimiter)[index].strip().strip('"')
        if text in words:
            found[number] = words[text]
        else:
            known = ", ".join(words)
            bad[number] = f"column {index + 1} holds {text[:40]!r}, none of {known}"
    return found


def decode(data: bytes) -> str:
    """Return text: UTF-16 with a byte order mark, else UTF-8 or, for any other bytes, Latin-1."""
    data = data.removesuffix(b"\x1a")  # the end of a file for DOS
    if data[:2] in (b"\xff\xfe", b"\xfe\xff"):
        return data.decode("utf-16", "replace").replace(MINUS, "-")
    try:
        return data.decode("utf-8-sig").replace(MINUS, "-")
    except UnicodeDecodeError:
        return data.decode("latin-1")


def split_lines(text: str, comment: str | None) -> Lines:
    """Return the lines of a text without comments and empty lines; ends of any system."""
    if "\r" in text:
        text = text.replace("\r\n", "\n").replace("\r", "\n")
    whole = text.endswith("\n")
    everything = text.split("\n")
    if comment is not None and comment in text:
        everything = [line.partition(comment)[0] for line in everything]
    numbered = [(line, number) for number, line in enumerate(everything, 1) if line.strip()]
    # A file that ends within a comment lacks no number.
    whole = whole or not numbered or numbered[-1][1] < len(everything)
    return Lines([line for line, _ in numbered], [number for _, number in numbered], whole)


def split_fields(line: str, delimiter: str) -> list[str]:
    """Return the fields of one line without surrounding quotes and spaces."""
    if delimiter == WHITESPACE:
        return line.split()
    return [field.strip() for field in next(csv.reader([line], delimiter=delimiter))]


def _field_counts(lines: Sequence[str], delimiter: str | None) -> list[int]:
    if delimiter is None:
        return [len(line.split()) for line in lines]
    return [line.count(delimiter) + 1 for line in lines]


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
        lines = [line.replace(decimal, ".") for line in lines]
    try:
        table = np.loadtxt(lines, delimiter=delimiter, comments=None, usecols=indices, ndmin=2)
    except ValueError:
        return None
    return list(table.T) if np.isfinite(table).all() else None


def _parse_exactly(
    lines: Sequence[str],
    numbers: Sequence[int],
    delimiter: str | None,
    decimal: str,
    indices: Sequence[int],
    bad: dict[int, str],
) -> list[Array]:
    """Return the columns of the lines that hold numbers; add the others to `bad`."""
    rows = []
    for line, number in zip(lines, numbers, strict=True):
        fields = line.split(delimiter)
        row = []
        for index in indices:
            text = _plain(fields[index], decimal)
            value = float(text) if _NUMBER.fullmatch(text) else np.nan
            if not np.isfinite(value):
                bad[number] = f"column {index + 1} holds {fields[index].strip()[:40]!r}, no number"
                break
            row.append(value)
        else:
            rows.append(row)
    return list(np.array(rows, dtype=np.float64).reshape(-1, len(indices)).T)
