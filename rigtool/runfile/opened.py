"""Opening HDF5 files for reading, and limiting how many are open at once.

A file that cannot be read raises `RunFileError` with the reason and a remedy.
"""

from __future__ import annotations

import os
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import ClassVar

import h5py

from rigtool.errors import RigtoolError, RunFileError
from rigtool.inputs import PathName, open_input
from rigtool.runfile import schema, tree
from rigtool.runfile.storage import open_file

MAX_OPEN = 8
"""Files that are kept open between two reads: each takes most of a megabyte, and h5py takes longer
to close one the more there are."""

_CHUNK_CACHE = {"rdcc_nbytes": 2 * 8 * schema.CHUNK, "rdcc_nslots": 101}
"""Two chunks for each open signal: blocks end where chunks do, so that no chunk is read twice. The
8 MiB of HDF5's default would only displace the samples from the processor's cache."""

CHANGED_MEANWHILE = "was replaced or changed while it was being read: run the command again"
IMPORT_HINT = "; `rigtool import` makes one of data that other programs recorded"
DAMAGED_REMEDY = "restore it from a copy, or make it anew"


class OpenFile:
    """An HDF5 file that stays open from one use to the next."""

    def __init__(self, file: h5py.File) -> None:
        self._file = file

    @contextmanager
    def use(self) -> Iterator[h5py.File]:
        """Lend the file for one read."""
        yield self._file

    def close(self) -> None:
        """Close the file."""
        self._file.close()


class SharedFile:
    """A stored file; of all such files, only the `MAX_OPEN` last used stay open.

    A file that was closed is opened again at its next use, and refused if it has changed: the
    checks of its first opening would not hold.
    """

    _lock = threading.RLock()
    _in_use: ClassVar[dict[SharedFile, h5py.File]] = {}

    def __init__(self, path: PathName) -> None:
        self._path = path
        self._identity: tuple[int, ...] | None = None
        self._closed = False

    @contextmanager
    def use(self) -> Iterator[h5py.File]:
        """Lend the file for one read; raises `RunFileError` where it was replaced meanwhile."""
        with self._lock:  # HDF5 admits one thread at a time anyway
            assert not self._closed, "a closed run is not read"
            file = self._in_use.pop(self, None) or self._open()
            self._in_use[self] = file  # behind all others
            for oldest in list(self._in_use)[:-MAX_OPEN]:
                oldest._shut()
            yield file

    def close(self) -> None:
        """Close the file for good."""
        with self._lock:
            self._shut()
            self._closed = True

    def _shut(self) -> None:
        # No object of the file may stay open: each close in h5py searches all open objects.
        if (file := self._in_use.pop(self, None)) is not None:
            file.close()

    def _open(self) -> h5py.File:
        file = open_hdf5(self._path)
        identity = _identity(file)
        if self._identity not in (None, identity):
            file.close()
            raise RunFileError(f"{self._path}: {CHANGED_MEANWHILE}")
        self._identity = identity
        return file


def _identity(file: h5py.File) -> tuple[int, ...]:
    found = os.fstat(file.id.get_vfd_handle())
    return found.st_dev, found.st_ino, found.st_size, found.st_mtime_ns


def open_hdf5(path: PathName) -> h5py.File:
    """Open an HDF5 file for reading only; raises `RunFileError` with the reason."""
    path = Path(path)
    require_file(path)
    with open_input(path, RunFileError) as stream:
        size, magic = os.fstat(stream.fileno()).st_size, stream.read(8)
    if magic != b"\x89HDF\r\n\x1a\n":
        what = "is empty" if size == 0 else "is not an HDF5 file"
        hint = "" if size == 0 or path.suffix in (".h5", ".part", ".toml") else IMPORT_HINT
        raise RunFileError(
            f"{path}: {what}; give a run file (.h5) that a rigtool command wrote{hint}"
        )
    try:
        return open_file(path, "r", **_CHUNK_CACHE)
    except Exception as error:
        raise RunFileError(f"{path}: {_open_problem(path, str(error))}") from error


def require_file(path: Path) -> None:
    """Raise `RunFileError` unless there is a file; what is left of its run is named."""
    if os.path.isfile(path):
        return
    if not os.path.exists(path) and os.path.isfile(f"{path}.part"):
        raise RunFileError(
            f"{path}: no such file; its run was interrupted, or goes on: `rigtool recover "
            f"{path}.part` brings back its signals"
        )
    what = "a folder" if os.path.isdir(path) else "a device or a pipe"
    what = f"is {what}, not a file" if os.path.exists(path) else "no such file"
    hint = "; recipes end in .toml" if path.suffix not in (".h5", ".part") else ""
    if os.path.isdir(path):
        hint = f": {path}/*.h5 names all of a folder"
    raise RunFileError(f"{path}: {what}; give a run file (.h5) that a rigtool command wrote{hint}")


def require_schema(file: h5py.File, path: PathName) -> None:
    """Raise `RunFileError` unless the file is a run file of a version that this rigtool reads."""
    if tree.root_text(file, "schema") != schema.SCHEMA:
        raise RunFileError(
            f"{path}: is HDF5 but not a run file of rigtool (no attribute schema = "
            f"{schema.SCHEMA}); other people's data come in through `rigtool import`"
        )
    found = str(tree.root_text(file, "schema_version"))
    try:
        major, _ = map(int, found.split("."))
    except ValueError:
        raise RunFileError(
            f"{path}: its schema version {found!r} is no version; {DAMAGED_REMEDY}"
        ) from None
    if major > schema.VERSION[0]:
        raise RunFileError(
            f"{path}: has schema version {found}, this rigtool reads versions up to "
            f"{schema.VERSION[0]}.x: use a newer rigtool"
        )


def _open_problem(path: Path, reason: str) -> str:
    if "truncated" in reason:
        return f"is truncated: its end is missing; {DAMAGED_REMEDY}"
    if "already open for write" in reason or "consistency flags" in reason:
        return (
            "was not closed: it is being written, or its writer was killed; wait, or "
            f"`rigtool recover {path}`"
        )
    if "unable to lock file" in reason:
        return "is locked by another program: wait until that program has closed it"
    return f"cannot be read as HDF5: {reason}; {DAMAGED_REMEDY}"


@contextmanager
def guard(path: PathName, what: str) -> Iterator[None]:
    """Turn any exception of h5py about a damaged file into `RunFileError`."""
    try:
        yield
    except RigtoolError:
        raise
    except Exception as error:  # damaged files make h5py raise nearly anything
        raise RunFileError(f"{path}: {what} is damaged: {error}; {DAMAGED_REMEDY}") from error
