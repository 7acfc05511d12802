"""The files to import, and the names of their run files."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from fnmatch import fnmatchcase
from pathlib import Path

from rigtool.errors import RunFileError, UsageError
from rigtool.escapes import is_text
from rigtool.runfile.importers.convert import stem

BINARY = (".mat", ".npy", ".npz")
TEXT = (".csv", ".txt", ".tsv", ".dat", ".asc")
"""Suffixes of files to import from a folder, in upper or lower case, also followed by .gz."""

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
    folders = [source for source in sources if Path(source).is_dir()]
    if not folders and len(sources) == 1:
        if output.is_dir():
            raise UsageError(f"{output}: is a folder: give the name of a run file, e.g. RUN.h5")
        return Plan({_file(Path(sources[0])): output}, False, [])
    if output.suffix == ".h5" or output.is_file():
        raise UsageError(f"{output}: each source file becomes a run file: give a folder for them")
    names: dict[Path, Path] = {}
    taken: dict[Path, Path] = {}
    files, left_out = find_files(sources, endings, pattern)
    for file, source in files:
        below = Path(source.resolve().name) if len(folders) > 1 and source.is_dir() else Path()
        name = below / f"{stem(file)}.h5"
        if not is_text(str(file)):
            raise UsageError(f"{file}: its name is not UTF-8: give the file another name")
        if name in taken:
            raise UsageError(
                f"{file} and {taken[name]} would both become {output / name}: import them "
                "into different folders"
            )
        if (output / name).exists() and not overwrite:
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
    alone = len(sources) == 1 and not Path(sources[0]).is_dir()
    for source in map(Path, sources):
        for file in _files(source, (*TEXT, *BINARY, *endings)):
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


def _files(source: Path, endings: tuple[str, ...]) -> list[Path]:
    if not source.is_dir():
        return [_file(source)]
    found = sorted(path for path in source.iterdir() if path.is_file() and _is_data(path, endings))
    if not found:
        sheets = any(path.suffix.lower() in SPREADSHEETS for path in source.iterdir())
        raise RunFileError(
            f"{source}: holds no file that ends in {', '.join(endings)} (or .gz): "
            + ("export its spreadsheets as CSV" if sheets else "give another folder, or name files")
        )
    return found


def _file(source: Path) -> Path:
    if not source.is_file():
        raise RunFileError(f"{source}: no such file or folder: give measured data")
    return source


def _is_data(path: Path, endings: tuple[str, ...]) -> bool:
    name = path.name.lower().removesuffix(".gz")
    return not name.startswith(".") and name.endswith(endings)


def is_binary(path: Path) -> bool:
    """Return whether a file holds arrays, not text."""
    return path.suffix.lower() in BINARY
