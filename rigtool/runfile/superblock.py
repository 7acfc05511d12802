"""Access to a file's superblock that HDF5 does not offer: opening unclosed files, clearing times.

HDF5 sets a flag in the superblock while a file is being written, and refuses to open a file with
that flag. Reading as a follower of the writer (SWMR) does not suit remains that may be damaged:
HDF5 then repeats each read with a wrong checksum, with pauses that double each time. Therefore HDF5
is given a superblock without the flag, with the true end of the file (as its tool h5clear would
write it) and a new checksum.

The superblock of version 3 (HDF5 File Format Specification 3.0, II.A): 8 bytes of signature,
version, two sizes, the consistency flags in byte 11, four addresses of 8 bytes (the second is that
of its extension, the end of the file the third), and the checksum in the last 4 of 48 bytes. The
extension is an object header of version 2 (IV.A.1.b): signature, version, flags, four times of 4
bytes, the size of its messages in 1 byte, the messages and their checksum.
"""

from __future__ import annotations

import io
from pathlib import Path
from typing import Any

import h5py

from rigtool.errors import RunFileError
from rigtool.inputs import open_input

SUPERBLOCK_SIZE = 48
VERSION, ADDRESS_SIZE, FLAGS, EXTENSION, END, CHECKSUM = 8, 9, 11, 20, 28, 44
TIMES, MESSAGES = slice(6, 22), 23

_MASK = 0xFFFFFFFF


class _Unclosed(io.FileIO):
    """A file with other bytes at its start, as h5py reads it: by `readinto`."""

    def __init__(self, path: Path, start: bytes) -> None:
        super().__init__(path)
        self._start = start

    def __del__(self) -> None:
        self.close()  # h5py leaves it open

    def __repr__(self) -> str:
        """Return the path, which h5py takes as the name of the file."""
        return str(self.name)

    def readinto(self, buffer: Any) -> int:
        """Read as a file does, with the other bytes at the start."""
        shown = self._start[self.tell() :][: len(buffer)]
        size = super().readinto(buffer)
        buffer[: len(shown)] = shown
        return size


def open_unclosed(path: Path) -> h5py.File:
    """Open an HDF5 file that was not closed, for reading.

    Raises `RunFileError` for a file that no writer of run files leaves behind.
    """
    with open_input(path, RunFileError) as stream:
        start = bytearray(stream.read(SUPERBLOCK_SIZE))
    if len(start) < SUPERBLOCK_SIZE or start[VERSION] != 3 or start[ADDRESS_SIZE] != 8:
        raise RunFileError(f"{path}: has no superblock as a run file has it: nothing to recover")
    if metadata_checksum(bytes(start[:CHECKSUM])) != int.from_bytes(start[CHECKSUM:], "little"):
        raise RunFileError(f"{path}: its superblock is damaged: nothing to recover")
    start[FLAGS] = 0
    # The stored end of the file is the one at its creation; the file has grown since.
    start[END : END + 8] = path.stat().st_size.to_bytes(8, "little")
    start[CHECKSUM:] = metadata_checksum(bytes(start[:CHECKSUM])).to_bytes(4, "little")
    shown = _Unclosed(path, bytes(start))
    try:
        return h5py.File(shown, "r")
    except Exception as error:
        raise RunFileError(
            f"{path}: does not open: its run was killed before the first sample, or it is damaged: "
            "nothing to recover"
        ) from error


def clear_times(path: Path) -> None:
    """Set the times in the extension of a closed file's superblock to 0: equal runs, equal bytes.

    HDF5 can leave out the times of every object but this one, which states how space is managed.
    """
    with path.open("r+b") as stream:
        start = stream.read(SUPERBLOCK_SIZE)
        address = int.from_bytes(start[EXTENSION : EXTENSION + 8], "little")
        stream.seek(address)
        header = bytearray(stream.read(MESSAGES))
        assert header[:6] == b"OHDR\x02\x20", "a file in pages has an extension with times"
        header[TIMES] = bytes(16)
        header += stream.read(header[MESSAGES - 1])
        header += metadata_checksum(bytes(header)).to_bytes(4, "little")
        stream.seek(address)
        stream.write(header)


def metadata_checksum(data: bytes) -> int:
    """Return HDF5's checksum of metadata: Jenkins' lookup3, initial value 0.

    (B. Jenkins, lookup3.c, May 2006, hashlittle, public domain.)
    """
    a = b = c = (0xDEADBEEF + len(data)) & _MASK
    whole = max(len(data) - 1, 0) // 12 * 12
    for start in range(0, whole, 12):
        x, y, z = _words(data[start : start + 12])
        a, b, c = _mix((a + x) & _MASK, (b + y) & _MASK, (c + z) & _MASK)
    if not data:
        return c
    x, y, z = _words(data[whole:].ljust(12, b"\0"))
    a, b, c = (a + x) & _MASK, (b + y) & _MASK, (c + z) & _MASK
    for turn in (14, 11, 25, 16, 4, 14, 24):
        c = ((c ^ b) - _turned(b, turn)) & _MASK
        a, b, c = b, c, a
    return b


def _mix(a: int, b: int, c: int) -> tuple[int, int, int]:
    for turn in (4, 6, 8, 16, 19, 4):
        a = ((a - c) & _MASK) ^ _turned(c, turn)
        c = (c + b) & _MASK
        a, b, c = b, c, a
    return a, b, c


def _turned(value: int, by: int) -> int:
    return (value << by | value >> (32 - by)) & _MASK


def _words(data: bytes) -> tuple[int, int, int]:
    x, y, z = (int.from_bytes(data[i : i + 4], "little") for i in (0, 4, 8))
    return x, y, z
