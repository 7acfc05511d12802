"""CAN frames as lines of text, in the notation of slcan adapters.

    t6018401041600000000\r      letter, identifier, length, data; upper case: identifier of 29 bit

`t` carries data, `r` asks for it (remote frame), `b` and `d` are CAN FD with and without a faster
data phase. The notation is that of LAWICEL's CAN232, with the letters of the CANable 2 for CAN FD.
"""

from __future__ import annotations

from typing import NamedTuple

END = b"\r"

SIZES = (0, 1, 2, 3, 4, 5, 6, 7, 8, 12, 16, 20, 24, 32, 48, 64)
"""Lengths that a CAN FD frame can have, by its code of one digit."""


class CanFrame(NamedTuple):
    """A frame on the bus; `fd` is one of CAN FD."""

    identifier: int
    data: bytes = b""
    extended: bool = False
    remote: bool = False
    fd: bool = False


def encode(frame: CanFrame) -> bytes:
    """Return the line of a frame, its end included; the data have one of `SIZES`."""
    letter = "r" if frame.remote else "b" if frame.fd else "t"
    head = f"{letter.upper()}{frame.identifier:08X}" if frame.extended else ""
    head = head or f"{letter}{frame.identifier:03X}"
    return f"{head}{SIZES.index(len(frame.data)):X}{frame.data.hex().upper()}".encode() + END


def decode(line: bytes) -> CanFrame:
    """Return the frame in a line; raises `ValueError` for anything else."""
    text = line.removesuffix(END).decode("latin-1")
    kind, extended = text[:1].lower(), text[:1].isupper()
    digits = 8 if extended else 3
    if kind not in tuple("trbd"):
        raise ValueError(f"{line[:60]!r}: is no CAN frame")
    identifier, code = int(text[1 : 1 + digits], 16), int(text[1 + digits : 2 + digits], 16)
    data = bytes.fromhex(text[2 + digits :])
    if kind != "r" and len(data) != SIZES[code]:
        raise ValueError(f"{line[:60]!r}: is a CAN frame that is cut")
    return CanFrame(identifier, data, extended, kind == "r", kind in "bd")
