"""The lines of a text, and its header: what stands before the numbers."""

from __future__ import annotations

import re
from collections.abc import Container, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from rigtool.errors import RunFileError
from rigtool.recipe.mapping import FileLayout
from rigtool.runfile.importers.dates import is_date
from rigtool.runfile.importers.marks import (
    LOOKED_AT,
    NUMBER,
    WHITESPACE,
    Marks,
    fields_of,
    plain,
    split_fields,
)
from rigtool.runfile.importers.raw import ColumnKey

MINUS = "\u2212"
"""The minus sign of typesetting, which some programs write for a hyphen."""

COMMENT_CHARACTERS = "#%;!"
"""Characters that begin the line of names in some files."""

_WORD = re.compile(r"\W*(?!nan|inf)[^\W\d_]{2}", re.IGNORECASE)
_STAMP = re.compile(r"^([\d:.]+) -> (?=[^,;\n]*([,;]))", re.MULTILINE)
"""What a terminal puts before a line; and the delimiter of the line."""

_KEY = re.compile(r"\s*(?:- )?(\w+):(?: [^:]*)?")
"""A line that holds one name, and perhaps its value."""

MOST_KEYS = 0.5
"""Part of lines that hold one name each from which on a sample takes several."""

_DIGITS, _GROUP, _PADDED = map(re.compile, (r"\d+", r"\d{3}([.,]\d+)?", r"0\d+"))
SHOWN_ROWS = 1000
"""Lines over the whole text of which the fields show whether a delimiter divides numbers."""

MAX_CONTROL_PART = 0.05
"""Part of control characters from which on a file is no text."""


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

    def before(self, count: int) -> Lines:
        """Return the first `count` lines."""
        return Lines(self.text[:count], self.number[:count], True)

    def without(self, texts: Container[str]) -> Lines:
        """Return the lines that hold none of the texts: names that are repeated further down."""
        kept = [
            (text, number)
            for text, number in zip(self.text, self.number, strict=True)
            if text not in texts
        ]
        return Lines([text for text, _ in kept], [number for _, number in kept], self.whole)


def decoded_text(path: Path, data: bytes) -> str:
    """Return the text of a file's bytes; `RunFileError` for bytes that are none."""
    text = decode(data)
    start = text[:1000]
    odd = sum(char < " " and char not in "\t\n\r\f" for char in start)
    if odd > MAX_CONTROL_PART * len(start):
        raise RunFileError(f"{path}: is no text: export it as CSV in the program that wrote it")
    return text


def decode(data: bytes) -> str:
    """Return text: UTF-16, known by its byte order mark or its zeros, else UTF-8 or, for any other
    bytes, Latin-1."""
    data = data.removesuffix(b"\x1a")  # the end of a file for DOS
    start = data[:1000]
    zeros = start[1::2].count(0), start[::2].count(0)
    if start[:2] in (b"\xff\xfe", b"\xfe\xff"):
        code = "utf-16"
    elif max(zeros) > len(start) // 4:
        code = "utf-16-le" if zeros[0] > zeros[1] else "utf-16-be"
    else:
        try:
            return data.decode("utf-8-sig").replace(MINUS, "-")
        except UnicodeDecodeError:
            return data.decode("latin-1")
    return data.decode(code, "replace").replace(MINUS, "-")


def require_lines_of_samples(path: Path, lines: Lines) -> None:
    """Raise `RunFileError` where a sample takes several lines, each with a name, as in YAML."""
    matches = [_KEY.fullmatch(line) for line in lines.text[:LOOKED_AT]]
    keys = {match[1] for match in matches if match is not None}
    if len(keys) > 1 and sum(match is not None for match in matches) > MOST_KEYS * len(matches):
        raise RunFileError(
            f"{path}: a sample takes several lines, as in YAML: write each sample in a line of its "
            "own; of ROS by `ros2 topic echo --csv` or `rostopic echo -p`"
        )


def split_lines(text: str, comment: str | None) -> Lines:
    """Return the lines of a text without comments and empty lines; ends of any system."""
    if "\r" in text:
        text = text.replace("\r\n", "\n").replace("\r", "\n")
    if " -> " in text:
        text = _STAMP.sub(r"\1\2", text)
    whole = text.endswith("\n")
    everything = text.split("\n")
    if comment is not None and comment in text:
        everything = [line.partition(comment)[0] for line in everything]
    numbered = [(line, number) for number, line in enumerate(everything, 1) if line.strip()]
    # A file that ends within a comment lacks no number.
    whole = whole or not numbered or numbered[-1][1] < len(everything)
    return Lines([line for line, _ in numbered], [number for _, number in numbered], whole)


def require_undivided(path: Path, head: str, data: Lines, marks: Marks) -> None:
    """Raise `RunFileError` where the delimiter divides numbers, too: decimals, or thousands.

    Then fewer columns have a name in the line `head` before the numbers, or digits behind a comma
    begin with a zero, or follow a lone -0: no program writes whole numbers so.
    """
    if marks.delimiter not in (",", WHITESPACE):
        return
    shown = data.text[:: 1 + len(data.text) // SHOWN_ROWS]
    columns = list(zip(*(fields_of(line, marks.delimiter) for line in shown), strict=False))
    marked = any(mark in line for line in shown for mark in {".", ","} - {marks.delimiter})
    part = _GROUP if marked else _DIGITS  # a decimal mark of its own leaves thousands
    digits = [n > 0 and all(map(part.fullmatch, own)) for n, own in enumerate(columns)]
    names = len(split_fields(head, marks.delimiter))
    parts = names > 1 and 0 < len(columns) - names <= sum(digits)
    if not parts and marks.delimiter == "," and not marked:
        zeros = [any(map(_PADDED.fullmatch, own)) for own in columns]
        minus = [False, *("-0" in own for own in columns[:-1])]
        begun = [a and (b or c) for a, b, c in zip(digits, zeros, minus, strict=True)]
        parts = any(begun) and not zeros[0]
    if parts:
        raise RunFileError(
            f"{path}: the delimiter {marks.delimiter!r} seems to divide numbers as well, as decimal"
            f" mark or in thousands: line {data.number[0]} has {len(columns)} fields, "
            f"{shown[0][:60]!r}: write the file with another delimiter, with decimal points, or "
            'with quotes; where each field is a number, state decimal = "." in [file]'
        )


def header_of(
    path: Path, lines: Lines, marks: Marks, layout: FileLayout, asked: Sequence[ColumnKey]
) -> tuple[int, list[str]]:
    """Return the number of lines before the numbers, and the names of all columns.

    Names only where columns are `asked` by name. Raises `RunFileError` where no line names them.
    """
    wanted = {column for column in asked if isinstance(column, str)}
    at, names = _names(lines, marks, wanted)
    head = layout.header_lines
    if head is not None:
        if at > head:
            raise RunFileError(
                f"{path}: line {lines.number[at - 1]} names all columns, after the first {head} "
                f"lines: state header_lines = {at} in [file]"
            )
        begin = head
    elif wanted and not at:
        # What stands before the first number names the columns, if anything does.
        begin = max(1, before_numbers(lines, marks, range(LOOKED_AT)))
    else:
        places = [names.index(c) if isinstance(c, str) else c - 1 for c in asked]
        begin = before_numbers(lines, marks, places, at)
        begin = begin if begin < len(lines.text) else at
    if wanted and not names:
        if not 0 < begin <= len(lines.text):
            raise RunFileError(
                f"{path}: has no line that names its columns (header_lines = {begin}): give "
                "columns by number, or correct the mapping"
            )
        names = split_fields(lines.text[begin - 1], marks.delimiter)
    return begin, names


def _names(lines: Lines, marks: Marks, wanted: set[str]) -> tuple[int, list[str]]:
    """Return which of the first lines, from 1, names all wanted columns, and its names.

    Names as many as the last line has fields come first. 0 where no line does.
    """
    usual = len(fields_of(lines.text[-1], marks.delimiter)) if lines.text else 0
    for number, line in enumerate(lines.text[:LOOKED_AT] if wanted else [], start=1):
        found = [names for names in _readings(line, marks.delimiter) if wanted <= set(names)]
        if found:
            return number, min(found, key=lambda names: abs(len(names) - usual))
    return 0, []


def _readings(line: str, delimiter: str) -> Iterator[list[str]]:
    """Yield the names that a line may hold: a mark of a comment before them, spaces in them."""
    for text in dict.fromkeys([line, line.lstrip().lstrip(COMMENT_CHARACTERS)]):
        yield split_fields(text, delimiter)
        if delimiter == WHITESPACE:
            yield re.split(r"\s{2,}|\t", text.strip())


def before_numbers(lines: Lines, marks: Marks, places: Sequence[int], at: int = 0) -> int:
    """Return how many of the first lines hold no number in the places of columns, `at` or more.

    A damaged line holds some. Behind the names, lines that begin with a word are no numbers either,
    unless the last one does.
    """
    worded = at > 0 and not _WORD.match(lines.text[-1])
    for number, line in enumerate(lines.text[at : at + LOOKED_AT], start=at):
        if worded and _WORD.match(line):
            continue
        fields = fields_of(line, marks.delimiter)
        here = [plain(fields[place], marks.decimal) for place in places if place < len(fields)]
        if any(NUMBER.fullmatch(text) or text.lower() == "nan" or is_date(text) for text in here):
            return number
    return at if len(lines.text) > at + LOOKED_AT else len(lines.text)
