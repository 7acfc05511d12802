"""What every importer works with: columns as they stand in a file, and the errors they share."""

from __future__ import annotations

import gzip
import os
import zlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rigtool.errors import RunFileError
from rigtool.inputs import open_input
from rigtool.numerics.arrays import Array
from rigtool.recipe.mapping import Mapping

ColumnKey = int | str
"""A column by its number from 1, or by its name."""

MAX_BYTES = 2**31
"""Most bytes of a source file, uncompressed."""

FREE_BYTES, MAX_RATIO = 2**24, 100
"""A compressed source may unpack to `MAX_RATIO` times its own size, and to `FREE_BYTES` anyway."""

MAX_TEXT, MAX_LINES, MAX_NUMBERS, MAX_LINE = 2**28, 2**21, 2**23, 2**18
"""Most bytes, lines and numbers of a text, and characters of one of its lines."""

MAX_OBJECTS, MAX_NESTED = 10_000, 2**27
"""Most arrays, groups or members of a binary file, and bytes of its cells and structures."""

BINARY_REMEDY = "save the numbers as .npy, .npz or a matrix in .mat, or split the file"

NO_TEXT = {
    b"PK\x03\x04": "a spreadsheet or an archive",
    b"\xd0\xcf\x11\xe0\xa1\xb1\x1a\xe1": "a spreadsheet",
    b"PAR1": "a Parquet file (pandas.read_parquet and to_csv make text of it)",
    b"ARROW1": "a Feather file (pandas.read_feather and to_csv make text of it)",
    b"FEA1": "a Feather file (pandas.read_feather and to_csv make text of it)",
    b"TDSm": "a TDMS file of LabVIEW",
    b"MDF ": "an MDF file",
    b"#ROSBAG": "a ROS bag",
    b"SQLite format 3": "a database",
    b"\x80\x04": "a pickle of Python",
    b"\x80\x05": "a pickle of Python",
    b"%PDF": "a PDF",
}
"""First bytes of files that people give for text, and what they are."""

OWN_LINES, FEWEST_BLANK = 0.05, 10
"""Part and number of blanks in a column from which on its samples have lines of their own; fewer
blanks are damage."""

LISTED_LINES = 5
"""Most bad lines that a message lists."""


@dataclass(frozen=True, eq=False)
class Raw:
    """Columns (n,) of a file, the numbers of their lines, and what was left out.

    `place` (n,) counts the samples of the file from 0, with gaps for samples that were left out.
    `line` (n,) holds line numbers from 1 in text, sample numbers from 1 elsewhere; `what` names
    either. `left_out` maps the number of each line left out to the reason. `starts` are the
    numbers of the lines at which the time starts anew, each the first of another recording.
    """

    columns: dict[ColumnKey, Array]
    place: NDArray[np.int64]
    line: NDArray[np.int64]
    what: str
    left_out: dict[int, str] = field(default_factory=dict)
    starts: tuple[int, ...] = ()

    def only(self, rows: NDArray[Any]) -> Raw:
        """Return the samples that these indices, or this mask, select."""
        return replace(
            self,
            columns={name: values[rows] for name, values in self.columns.items()},
            place=self.place[rows],
            line=self.line[rows],
        )

    def without(self, bad: dict[int, str]) -> Raw:
        """Return the same without the lines in `bad`."""
        kept = self.only(~np.isin(self.line, list(bad)))
        return replace(kept, left_out={**self.left_out, **bad})

    @property
    def edges(self) -> list[int]:
        """First samples of the recordings of the file, and the number of samples."""
        inner = np.searchsorted(self.line, self.starts).tolist()
        return sorted({0, *inner, len(self.line)})


@dataclass(frozen=True)
class Importer:
    """A format whose files state themselves what their columns mean.

    `recognises` looks at the first bytes of a file. `read` takes the file, a mapping (without
    signals where the user gives none) and whether bad lines are skipped; it returns the columns,
    the mapping with its signals, and notes. `endings` of such files, ".log" for instance, make
    them count as data in a folder.
    """

    recognises: Callable[[Path], bool]
    read: Callable[[Path, Mapping, bool], tuple[Raw, Mapping, list[str]]]
    endings: tuple[str, ...] = ()


def has_own_lines(blank: int, count: int) -> bool:
    """Return whether a column with blanks on so many lines was sampled on the others."""
    return max(OWN_LINES * count, FEWEST_BLANK) <= blank < count


def require_good(path: Path, what: str, bad: dict[int, str]) -> None:
    """Raise `RunFileError` that names the first bad lines and what to do about them."""
    if not bad:
        return
    numbers = sorted(bad)
    listed = [f"  {path}, {what} {number}: {bad[number]}" for number in numbers[:LISTED_LINES]]
    if len(numbers) > LISTED_LINES:
        listed.append(f"  and {len(numbers) - LISTED_LINES} more")
    count = len(numbers)
    head = f"{path}: {count} bad {what}{'s' if count > 1 else ''}"
    layout = "state comment or header_lines in [file], " if what == "line" else ""
    remedy = f"correct the file, {layout}or read the rest of it by --skip-bad-lines"
    raise RunFileError("\n".join([head, *listed, remedy]))


def read_bytes(path: Path) -> bytes:
    """Return a file's bytes, unpacked where it is gzipped; `RunFileError` where that fails."""
    with open_input(path, RunFileError) as stream:
        packed = stream.read(2) == b"\x1f\x8b"
        stream.seek(0)
        if not packed:
            require_size(path, os.fstat(stream.fileno()).st_size)
        source = gzip.GzipFile(fileobj=stream) if packed else stream
        try:
            data = source.read(unpacked_limit(path) + 1)
        except (EOFError, zlib.error, gzip.BadGzipFile) as error:
            raise RunFileError(f"{path}: is a damaged gzip file: {error}; fetch it again") from None
    require_size(path, len(data))
    _require_text(path, data)
    return data


def _require_text(path: Path, data: bytes) -> None:
    """Raise `RunFileError` for files that are known to be no text, or more than is read."""
    kind = next((kind for start, kind in NO_TEXT.items() if data.startswith(start)), None)
    if kind is not None:
        raise RunFileError(
            f"{path}: is {kind}, no text: export it as CSV in the program that wrote it, and "
            "import that"
        )
    lines = data.count(b"\n") + data.count(b"\r") - data.count(b"\r\n")
    for count, limit, what in ((len(data), MAX_TEXT, "bytes"), (lines, MAX_LINES, "lines")):
        if count > limit:
            raise RunFileError(
                f"{path}: has {count} {what}, above {limit} of a text: {BINARY_REMEDY}"
            )


def require_objects(path: Path, count: int) -> None:
    """Raise `RunFileError` where a binary file has more arrays, groups or members than are read."""
    if count > MAX_OBJECTS:
        raise RunFileError(
            f"{path}: has more than {MAX_OBJECTS} arrays, groups or members: {BINARY_REMEDY}"
        )


def unpacked_limit(path: Path) -> int:
    """Return the most bytes that are unpacked from a file: more than its size makes credible."""
    return min(MAX_BYTES, max(FREE_BYTES, MAX_RATIO * path.stat().st_size))


def require_size(path: Path, size: int) -> None:
    """Raise `RunFileError` where a file is empty or unpacks to more than is read."""
    if size == 0:
        raise RunFileError(f"{path}: is empty: fetch it again")
    if size > (limit := unpacked_limit(path)):
        raise RunFileError(f"{path}: is larger than {limit} bytes unpacked: split it, or unpack it")


def missing_column(
    path: Path, column: ColumnKey, there: Sequence[ColumnKey], count: int
) -> RunFileError:
    """Return the error for a column that a file does not have."""
    named = [str(name) for name in there if isinstance(name, str)]
    known = f"{count} columns" if not named else ", ".join(named[:30])
    if "" in there:  # of a .npy file
        known = "an array without a name, whose columns go by their number from 1"
    return RunFileError(
        f"{path}: has no column {column!r}, only {known}: correct the mapping, or take a file that "
        "has it"
    )
