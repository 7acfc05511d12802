"""Errors that a user can meet, each with the exit code of the command line.

Every message gives the value that was found, the limit that it violates, and a remedy.
"""

from __future__ import annotations

import errno
import os
from collections.abc import Iterable, Iterator
from contextlib import contextmanager


def did_you_mean(name: str, known: Iterable[str], otherwise: str = "") -> str:
    """Return the question for the known name nearest to a misspelt one, or another remedy."""
    import difflib  # only here: the time of `rigtool --help` counts

    close = difflib.get_close_matches(name, list(known), 1, cutoff=0.75)
    return f"did you mean {close[0]}?" if close else otherwise


_FULL = "the disk is full, or a quota is reached: free some space, or write elsewhere"
_REMEDIES = {
    errno.ENOENT: "give another name",
    errno.ENAMETOOLONG: "choose a shorter name or folder",
    errno.ELOOP: "its links lead in a circle: give the file itself",
    errno.ENOTDIR: "a part of the path is a file: correct the path",
    errno.EISDIR: "give the name of a file",
    errno.EACCES: "check the permissions of the file and its folder",
    errno.EPERM: "check the permissions of the file and its folder",
    errno.EROFS: "write elsewhere",
    errno.ENXIO: "nothing answers there: give a file on a disk",
    errno.EIO: "the disk or the connection to it fails: take a copy from elsewhere",
    errno.ESTALE: "the server has replaced it: run the command again",
    errno.EMFILE: "close other files, or raise the limit (`ulimit -n`)",
    errno.ENFILE: "close other programs",
    errno.ENOMEM: "close other programs, or raise the limit (`ulimit -v`)",
    errno.EAGAIN: "close other programs, or raise the limit (`ulimit -u`)",
    errno.ENOSPC: _FULL,
    errno.EDQUOT: _FULL,
    errno.EFBIG: f"{_FULL}; or raise the limit (`ulimit -f`)",
    errno.EPIPE: "its reader is gone",
}
"""What helps where the system refuses something about a file, by the number of the error."""


def refusal(error: OSError, code: int | None = None) -> str:
    """Return what the system refused and what helps; `code` is the number where HDF5 has it."""
    code = code or error.errno
    if not code:
        return f"{error}: check the file and its disk"
    remedy = _REMEDIES.get(code, "check the file and its folder")
    return f"{os.strerror(code)}: {remedy}"


class RigtoolError(Exception):
    """Base of all errors that rigtool raises on purpose (exit code 1, failed while running)."""

    exit_code = 1


class UsageError(RigtoolError):
    """The command line asks for something that cannot be done as asked (exit code 2)."""

    exit_code = 2


class RecipeError(RigtoolError, ValueError):
    """A recipe cannot be read or does not describe a rig (exit code 3)."""

    exit_code = 3


class RunFileError(RigtoolError, ValueError):
    """A run file cannot be read, is damaged, or is of another kind than needed (exit code 3)."""

    exit_code = 3


NO_RESULT_REMEDY = (
    "some signals are zero, constant, or in another unit; look at them by `rigtool plot`"
)


class InsufficientDataError(RigtoolError, ValueError):
    """The data do not support the requested result (exit code 4)."""

    exit_code = 4


@contextmanager
def naming(where: object) -> Iterator[None]:
    """Name in each `InsufficientDataError` that is raised within this context what it is of."""
    try:
        yield
    except InsufficientDataError as error:
        raise InsufficientDataError(f"{where}: {error}") from None


class HardwareError(RigtoolError, OSError):
    """A rig or an instrument beside it fails (exit code 5)."""

    exit_code = 5
