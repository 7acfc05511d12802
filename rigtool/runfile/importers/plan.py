"""The files to import, and the names of their run files."""

from __future__ import annotations

import os
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from fnmatch import fnmatchcase
from pathlib import Path

from rigtool.errors import RunFileError, UsageError
from rigtool.escapes import is_text
from rigtool.inputs import open_input, reading
from rigtool.runfile.importers.convert import stem

BINARY_SUFFIXES = (".mat", ".npy", ".npz")
TEXT_SUFFIXES = (".csv", ".txt", ".tsv", ".dat", ".asc", ".lvm", ".tab", ".prn")
"""Suffixes of files to import from a folder, in upper or lower case, also followed by .gz."""

ARRAY_MAGIC = (b"\x89HDF\r\n\x1a\n", b"\x93NUMPY", b"MATLAB 5.0", b"MATLAB 7.3")
"""First bytes of files of arrays, whatever their names."""

SPREADSHEETS = (".xlsx", ".xlsm", ".xls", ".ods")


@dataclass(frozen=True)
class Plan:
    """The name of the run file for each source file; names are relative to a folder if it is one.

    `left_out` are the files whose names are not those that a mapping is for.
    """

    names: dict[Path, Path]
    is_folder: bool
    left_out: list[Path]


def plan(
    sources: Sequence[str],
    output: Path,
    overwrite: bool,
    endings: Sequence[str] = (),
    pattern: str | None = None,
) -> Plan:
    """Return what to import under which name.

    Files of several source folders keep the folder's name. `endings` are those of further formats,
    `pattern` that of `find_files`. Raises `RunFileError` for a source that does not exist or where
    no name fits, `UsageError` for names that do not go together or exist.
    """
    folders = [source for source in sources if os.path.isdir(source)]
    if not folders and len(sources) == 1:
        if os.path.isdir(output):
            raise UsageError(f"{output}: is a folder: give the name of a run file, e.g. RUN.h5")
        return Plan({_file(Path(sources[0])): output}, False, [])
    if output.suffix == ".h5" or os.path.isfile(output):
        raise UsageError(f"{output}: each source file becomes a run file: give a folder for them")
    names: dict[Path, Path] = {}
    taken: dict[Path, Path] = {}
    files, left_out = find_files(sources, endings, pattern)
    for file, source in files:
        below = (
            Path(source.resolve().name) if len(folders) > 1 and os.path.isdir(source) else Path()
        )
        name = below / f"{stem(file)}.h5"
        if not is_text(str(file)):
            raise UsageError(f"{file}: its name is not UTF-8: give the file another name")
        if name in taken:
            raise UsageError(
                f"{file} and {taken[name]} would both become {output / name}: import them "
                "into different folders"
            )
        if os.path.exists(output / name) and not overwrite:
            raise UsageError(
                f"{output / name}: exists already: give another folder, or --overwrite"
            )
        names[file], taken[name] = name, file
    return Plan(names, True, left_out)


def find_files(
    sources: Sequence[str], endings: Sequence[str], pattern: str | None
) -> tuple[list[tuple[Path, Path]], list[Path]]:
    """Return files to import, each with its source, and those that the `pattern` leaves out.

    A file that is named alone need not fit the pattern. Raises `RunFileError` where none is left.
    """
    found: list[tuple[Path, Path]] = []
    left_out: list[Path] = []
    alone = len(sources) == 1 and not os.path.isdir(sources[0])
    for source in map(Path, sources):
        for file in _files(source, (*TEXT_SUFFIXES, *BINARY_SUFFIXES, *endings), pattern):
            if alone or pattern is None or fnmatchcase(file.name, pattern):
                found.append((file, source))
            else:
                left_out.append(file)
    if not found:
        raise RunFileError(
            f"{left_out[0]}: neither this nor {len(left_out) - 1} other files have a name that the "
            f"mapping is for, files = {pattern!r}: correct it, or take another mapping"
        )
    return found, left_out


def _files(source: Path, endings: tuple[str, ...], pattern: str | None) -> list[Path]:
    """Return the files of a folder that end in one of `endings` or fit the `pattern`."""
    if not os.path.isdir(source):
        return [_file(source)]
    with reading(source, RunFileError):
        inside = sorted(path for path in source.iterdir() if not path.name.startswith("."))
    files = [path for path in inside if os.path.isfile(path)]
    found = [
        path
        for path in files
        if path.name.lower().removesuffix(".gz").endswith(endings)
        or (pattern is not None and fnmatchcase(path.name, pattern))
    ]
    if found:
        return found
    if any(path.suffix.lower() in SPREADSHEETS for path in files):
        remedy = "export its spreadsheets as CSV"
    elif files:
        ending = files[0].suffix
        remedy = f'name files, or state which in the mapping (files = "*{ending}")'
    elif inside:
        remedy = f"give folders in it, as {inside[0]}"
    else:
        remedy = "give another folder"
    raise RunFileError(
        f"{source}: holds no file that ends in {', '.join(endings)} (or .gz): {remedy}"
    )


def _file(source: Path) -> Path:
    if not os.path.lexists(source):
        raise RunFileError(f"{source}: no such file or folder: give measured data")
    with open_input(source, RunFileError):
        pass
    return source


def is_binary(path: Path) -> bool:
    """Return whether a file holds arrays, not text: by its name, or its first bytes."""
    if path.suffix.lower() in BINARY_SUFFIXES:
        return True
    with suppress(OSError), path.open("rb") as stream:
        return stream.read(16).startswith(ARRAY_MAGIC)
    return False
