"""Files that are read: no device or folder, and errors of the system as messages."""

from __future__ import annotations

import os
import stat
from collections.abc import Iterator
from contextlib import contextmanager
from io import BufferedReader

from rigtool.errors import RigtoolError, refusal

PathName = str | os.PathLike[str]
"""Type of a file's name, as text or as a path."""


@contextmanager
def reading(path: PathName, kind: type[RigtoolError]) -> Iterator[None]:
    """Turn what the system refuses about an input into an error of a `kind`, with a remedy."""
    try:
        yield
    except RigtoolError:
        raise
    except OSError as error:
        raise kind(f"{path}: cannot be read: {refusal(error)}") from error
    except ValueError as error:
        if "null byte" not in str(error):
            raise
        raise kind(f"{path!r}: holds a NUL, as no file's name does: correct it") from None


def is_recipe(path: PathName) -> bool:
    """Return whether a source is a recipe: by its name, or as a pipe, which no run file can be."""
    try:
        return os.fspath(path).endswith(".toml") or stat.S_ISFIFO(os.stat(path).st_mode)
    except (OSError, ValueError):
        return False


@contextmanager
def open_input(
    path: PathName, kind: type[RigtoolError], *, pipe: bool = False
) -> Iterator[BufferedReader]:
    """Open a file for reading; raises an error of a `kind` where the system refuses.

    A device is not opened: that may block, and moves the lines of a serial port. A `pipe` is for
    readers that read once, from its beginning.
    """
    with reading(path, kind):
        mode = os.stat(path).st_mode
        if not (stat.S_ISREG(mode) or (pipe and stat.S_ISFIFO(mode))):
            what = "a folder" if stat.S_ISDIR(mode) else "a device or a pipe"
            raise kind(f"{path}: is {what}, no file: give a file that was written to a disk")
        with open(path, "rb") as stream:
            yield stream
