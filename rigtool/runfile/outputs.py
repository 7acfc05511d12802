"""Outputs: checks of their names, and temporary files that take the name when complete.

A temporary file is in the folder of the output. O_EXCL creates it under a unique name, so that no
file or link of another program is touched. Its name contains computer and process: the next run
recognises and removes the files of a killed process.
"""

from __future__ import annotations

import contextlib
import os
import re
import secrets
import shutil
import socket
import zlib
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path

from rigtool.errors import UsageError
from rigtool.escapes import is_text
from rigtool.inputs import PathName
from rigtool.runfile.storage import storage_errors

MAX_NAME = 250
"""Bytes of a file's name: file systems take 255, and `.part` is added."""

MAX_PATH = 4000
"""Bytes of a path: Linux takes 4095, and names of temporary files are added."""


def _computer() -> str:
    """Return a name of this computer, or container: what numbers its own processes."""
    known = [socket.gethostname()]
    with contextlib.suppress(OSError):
        known.append(os.readlink("/proc/self/ns/pid"))
    with contextlib.suppress(OSError):
        known.append(Path("/etc/machine-id").read_text())
    return f"{zlib.crc32(' '.join(known).encode()):08x}"


_HOST = _computer()
_OURS = re.compile(rf"\.rigtool-{_HOST}-(\d+)-[0-9a-f]{{8}}")


def require_output(path: PathName, *, overwrite: bool, inputs: Iterable[PathName] = ()) -> Path:
    """Return the file to write, links followed; nothing is changed yet.

    Raises `UsageError` where the folder is missing or cannot be written, where `path` is a folder,
    a device, a link to itself or one of the `inputs`, and where it exists, unless `overwrite`.
    """
    if not is_text(os.fspath(path)):
        raise UsageError(f"{path!r}: is not UTF-8, or holds a NUL: give another name")
    try:
        found = Path(os.path.realpath(path))
        found.parent.is_dir()
    except OSError as error:  # a path that is too long, or a working directory that was removed
        raise UsageError(f"{path}: {error.strerror}: choose another folder") from None
    require_place(path, found)
    if found.is_symlink():
        raise UsageError(f"{path}: is a link that leads to itself: give another name")
    if found.is_dir() or os.fspath(path).endswith(os.sep):
        raise UsageError(f"{path}: is a folder: give the name of a file")
    if found.exists() and not found.is_file():
        raise UsageError(f"{path}: is a device or a pipe, no file: give the name of a file")
    for name in inputs:
        if found.exists() and os.path.exists(name) and os.path.samefile(name, found):
            raise UsageError(f"{path}: is an input of this run: give the output another name")
    if found.exists() and not overwrite:
        raise UsageError(f"{path}: exists already: give another name, or --overwrite")
    return found


def require_place(path: PathName, found: Path) -> None:
    """Raise `UsageError` where nothing can be written at `found`, which the user calls `path`.

    Its folder is missing or cannot be written, or its name leaves no room for `.part`.
    """
    folder = found.parent
    if not os.path.isdir(folder):
        if os.path.exists(folder):
            raise UsageError(f"{path}: {folder} is a file, no folder: choose another folder")
        raise UsageError(f"{path}: the folder {folder} does not exist: create it first")
    if not os.access(folder, os.W_OK):
        raise UsageError(f"{path}: the folder {folder} cannot be written: choose another")
    size, whole = (len(os.fsencode(name)) for name in (found.name, found))
    if size > MAX_NAME or whole > MAX_PATH:
        raise UsageError(
            f"{found}: its name has {size} bytes, the whole path {whole}; at most "
            f"{MAX_NAME} and {MAX_PATH} leave room for the .part of a run: choose a shorter one"
        )


def own_name(folder: Path) -> Path:
    """Return a new hidden name of this process in a folder; removes what killed processes left."""
    with contextlib.suppress(OSError):
        for path in folder.iterdir():
            if (match := _OURS.match(path.name)) and not _runs(int(match[1])):
                _remove(path)
    return folder / f".rigtool-{_HOST}-{os.getpid()}-{secrets.token_hex(4)}"


@contextmanager
def own_file(output: Path) -> Iterator[Path]:
    """Give a new, empty file beside `output`; it is removed where it did not take another name.

    Raises `RigtoolError` where the disk refuses.
    """
    path = own_name(output.parent)
    with storage_errors(output):
        try:
            path.touch(exist_ok=False)
            yield path
        finally:
            path.unlink(missing_ok=True)


@contextmanager
def own_folder(parent: Path) -> Iterator[Path]:
    """Give a new, empty folder in `parent`; it is removed with its contents.

    Raises `RigtoolError` where the disk refuses.
    """
    path = own_name(parent)
    with storage_errors(parent):
        try:
            path.mkdir()
            yield path
        finally:
            shutil.rmtree(path, ignore_errors=True)


@contextmanager
def replacing(output: Path) -> Iterator[Path]:
    """Give a new file that takes the name `output` where the block of code ends well.

    Raises `RigtoolError` where the disk refuses.
    """
    with own_file(output) as path:
        yield path
        os.replace(path, output)


def _runs(process: int) -> bool:
    """Return whether a process of this computer runs; in doubt it does."""
    if os.name != "posix":
        return True  # a signal of 0 would end it there
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return False
    except OSError:
        return True
    return True


def _remove(path: Path) -> None:
    if path.is_dir() and not path.is_symlink():
        shutil.rmtree(path, ignore_errors=True)
    else:
        with contextlib.suppress(OSError):
            path.unlink()
