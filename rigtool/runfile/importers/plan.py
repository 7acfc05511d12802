"""The files to import, and the names of their run files."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from rigtool.errors import RunFileError, UsageError
from rigtool.escapes import is_text
from rigtool.runfile.importers.convert import stem

BINARY = (".mat", ".npy", ".npz")
TEXT = (".csv", ".txt", ".tsv", ".dat", ".asc")
"""Suffixes of files to import from a folder, in upper or lower case, also followed by .gz."""


def plan(
    sources: Sequence[str], output: Path, overwrite: bool, endings: Sequence[str] = ()
) -> tuple[dict[Path, Path], bool]:
    """Return the name of the run file for each source file, and whether `output` is a folder.

    Names are relative to that folder; files of several source folders keep the folder's name.
    `endings` are those of further formats. Raises `RunFileError` for a source that does not exist,
    `UsageError` for names that do not go together or exist.
    """
    folders = [source for source in sources if Path(source).is_dir()]
    if not folders and len(sources) == 1:
        if output.is_dir():
            raise UsageError(f"{output}: is a folder: give the name of a run file, e.g. RUN.h5")
        return {_file(Path(sources[0])): output}, False
    if output.suffix == ".h5" or output.is_file():
        raise UsageError(f"{output}: each source file becomes a run file: give a folder for them")
    names: dict[Path, Path] = {}
    taken: dict[Path, Path] = {}
    for source in map(Path, sources):
        below = Path(source.resolve().name) if len(folders) > 1 and source.is_dir() else Path()
        for file in _files(source, (*TEXT, *BINARY, *endings)):
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
    return names, True


def _files(source: Path, endings: tuple[str, ...]) -> list[Path]:
    if not source.is_dir():
        return [_file(source)]
    found = sorted(path for path in source.iterdir() if path.is_file() and _is_data(path, endings))
    if not found:
        raise RunFileError(
            f"{source}: holds no file that ends in {', '.join(endings)} (or .gz): "
            "give another folder, or name the files"
        )
    return found


def _file(source: Path) -> Path:
    if not source.is_file():
        raise RunFileError(f"{source}: no such file or folder: give measured data")
    return source


def _is_data(path: Path, endings: tuple[str, ...]) -> bool:
    name = path.name.lower().removesuffix(".gz")
    return not name.startswith(".") and name.endswith(endings)
