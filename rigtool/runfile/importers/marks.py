"""Delimiter and decimal mark of a text, and the fields of a line."""

from __future__ import annotations

import csv
import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from rigtool.recipe.mapping import FileLayout

WHITESPACE = "whitespace"

MARKS = tuple(
    (delimiter, decimal) for delimiter in (",", ";", "\t", "|", WHITESPACE) for decimal in ".,"
)
"""Delimiters and decimal marks that the lines of a text may show, the usual ones first."""

SURE = (";", "\t", "|")
"""What is a delimiter wherever each line has as many: numbers and texts seldom hold it."""

LOOKED_AT = 50
"""Most lines that are looked at for them."""

MIN_NUMBER_PART = 0.3
"""Smallest part of numbers among the fields of lines of measurements."""

BLANK = ("", "nan", "null", "none")
"""What programs write, in lower case, where a column has no value on a line."""

NUMBER = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eEdD][+-]?\d+)?")
THOUSANDS = re.compile(r"[+-]?[1-9]\d{0,2}(\.\d{3})+")
"""Digits that points may divide into thousands."""

_GROUPS = re.compile(
    r"([+-]?[1-9]\d{0,2})((?:([.,' \u00a0\u2009\u202f\u2019])\d{3})(?:\3\d{3})*)([.,]\d+)?"
)
"""A number whose digits are in groups of three: what divides them, and the decimals."""


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
    counts = {mark: {line.count(mark) for line in shown} for mark in SURE}
    sure = [mark for mark, found in counts.items() if len(found) == 1 and 0 not in found]
    for delimiter, decimal in MARKS:
        marks = Marks(layout.delimiter or delimiter, layout.decimal or decimal)
        if len(sure) == 1 and layout.delimiter is None and delimiter != sure[0]:
            continue
        if marks.delimiter == marks.decimal and not any('"' in line for line in shown):
            continue
        rows = [fields_of(line, marks.delimiter) for line in shown]
        usual = Counter(map(len, rows)).most_common(1)[0][0] if rows else 0
        numbers = [
            _is_number(field, marks.decimal)
            for row in rows
            if len(row) == usual
            for field in row
            if field.strip()
        ]
        # A mark that splits numbers leaves text, or makes more fields of which some are no number.
        part = float(np.mean(numbers)) if numbers else 0.0
        if part >= MIN_NUMBER_PART and (score := sum(numbers) * part) > most:
            best, most = marks, score
    return best


def fields_of(line: str, delimiter: str) -> list[str]:
    """Return the fields of a line; a delimiter within a pair of quotes is a part of its field."""
    if delimiter == WHITESPACE:
        return line.split()
    quoted = '"' in line and line.count('"') % 2 == 0
    if quoted and len(line) < csv.field_size_limit():  # a longer field is no number
        return next(csv.reader([line], delimiter=delimiter, skipinitialspace=True))
    return line.split(delimiter)


def plain(field: str, decimal: str) -> str:
    """Return a field with a point as decimal mark, and without what divides thousands."""
    return ungrouped(field, decimal).replace(decimal, ".")


def _is_number(field: str, decimal: str) -> bool:
    """Return whether a field is a number with this decimal mark, and none of the other."""
    text = ungrouped(field, decimal)
    other = decimal != "." and "." in text and not THOUSANDS.fullmatch(text)
    return bool(NUMBER.fullmatch(text.replace(decimal, "."))) and not other


def ungrouped(field: str, decimal: str) -> str:
    """Return a field without the quotes around it; one quote alone is a part of a longer field.

    What divides thousands goes, unless it may be a decimal mark.
    """
    text = unquoted(field)
    found = _GROUPS.fullmatch(text)
    if found is not None:
        whole, groups, mark, decimals = found.groups(default="")
        if mark not in ".," or (mark != decimal and decimals[:1] == decimal):
            text = whole + groups.replace(mark, "") + decimals
    return text


def unquoted(field: str) -> str:
    """Return a field without spaces and a pair of quotes around it."""
    text = field.strip()
    if len(text) > 1 and text[0] == text[-1] and text[0] in "\"'":
        text = text[1:-1]
    return text


def split_fields(line: str, delimiter: str) -> list[str]:
    """Return the fields of one line without surrounding quotes and spaces."""
    return [unquoted(field) for field in fields_of(line, delimiter)]
