"""Errors of a disk as messages, and making sure that written data are on the disk.

HDF5 does not survive a write that fails: it cannot close the file any more, and may take the
process with it. So space is reserved before HDF5 is given anything to write; where that fails, HDF5
knows nothing of it and still closes the file in order.
"""

from __future__ import annotations

import contextlib
import errno
import os
import re
import struct
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, BinaryIO

import h5py

from rigtool.errors import RigtoolError, UsageError, refusal
from rigtool.inputs import PathName

_ERRNO = re.compile(r"errno = (\d+)")


@contextmanager
def storage_errors(path: Path) -> Iterator[None]:
    """Turn an error of the disk, by way of Python or of HDF5, into `RigtoolError`."""
    try:
        yield
    except RigtoolError:
        raise
    except (OSError, RuntimeError) as error:  # h5py reports a failed write as either
        match = _ERRNO.search(str(error))
        if match is None and isinstance(error, RuntimeError):
            raise
        number = None if match is None else int(match[1])
        why = refusal(error if isinstance(error, OSError) else OSError(str(error)), number)
        raise RigtoolError(f"{path}: cannot be written: {why}") from error


def reserve(handle: int, size: int) -> None:
    """Make sure that a file can grow to `size` bytes; raises OSError where it cannot."""
    if not hasattr(os, "posix_fallocate"):
        return
    try:
        os.posix_fallocate(handle, 0, size)
    except OSError as error:
        if error.errno not in (errno.EINVAL, errno.EOPNOTSUPP, errno.ENOSYS):
            raise


def open_file(path: PathName, mode: str, **options: Any) -> h5py.File:
    """Open an HDF5 file, locked against writers; without a lock where the file system has none."""
    try:
        return h5py.File(path, mode, locking="best-effort", **options)
    except OSError as error:
        if error.errno not in (errno.ENOLCK, errno.EOPNOTSUPP):
            raise
    return h5py.File(path, mode, locking=False, **options)


def flush(file: h5py.File) -> None:
    """Hand everything to the system, and give back what was reserved and not needed."""
    file.flush()
    os.ftruncate(file.id.get_vfd_handle(), file.id.get_filesize())


def require_unlocked(path: Path, *, remove: bool = False) -> None:
    """Raise `UsageError` where another run is writing a file; `remove` it otherwise.

    Systems without such locks do not tell.
    """
    with contextlib.suppress(FileNotFoundError), path.open("r+b") as old:
        if not lock(old.fileno()):
            raise written_by_another(path)
        if remove:
            path.unlink()


def take_free_name(own: Path, name: Path) -> None:
    """Give a file another name in one step; raises `UsageError` where somebody was faster."""
    try:
        os.link(own, name)
    except FileExistsError:
        raise written_by_another(name) from None
    except OSError:  # a file system without hard links
        if name.exists():
            raise written_by_another(name) from None
        os.rename(own, name)


def written_by_another(path: Path) -> UsageError:
    """Return the error of a file that another run of rigtool has."""
    return UsageError(f"{path}: is being written by another run now: give the output another name")


def marked(path: Path) -> BinaryIO:
    """Open a file for reading and mark it as in use, until it is closed."""
    stream = path.open("rb")
    lock(stream.fileno(), shared=True)
    return stream


def lock(handle: int, *, shared: bool = False) -> bool:
    """Mark an open file as being written, until it is closed; return whether nobody else writes.

    A `shared` mark is for a file that is open for reading, and HDF5 may open it for reading, too.

    The lock belongs to the open file, not to the process: HDF5 opens it more than once. Linux calls
    it an open file description lock, fcntl(2); systems without it have none.
    """
    try:
        import fcntl

        kind = fcntl.F_RDLCK if shared else fcntl.F_WRLCK
        request = struct.pack("hhqqi", kind, os.SEEK_SET, 0, 0, 0)
        fcntl.fcntl(handle, fcntl.F_OFD_SETLK, request)
    except (ImportError, AttributeError):
        return True
    except OSError as error:
        return error.errno not in (errno.EACCES, errno.EAGAIN)
    return True


def sync_path(path: Path) -> None:
    """Wait until a file's data, or the names in a folder, are on the disk."""
    if path.is_dir() and os.name != "posix":
        return  # which cannot do that
    handle = os.open(path, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)
