"""Frames of the host-target link: COBS over kind, sequence, payload and a CRC, then a zero byte.

COBS: S. Cheshire and M. Baker, IEEE/ACM Trans. Networking 7(2) 159-172, 1999. CRC-16/XMODEM,
polynomial 0x1021, start 0. See docs/target-link.md.
"""

from __future__ import annotations

import binascii
import struct
from typing import NamedTuple

import numpy as np

from rigtool.rigs.serial.line import DamagedReply

HEAD = struct.Struct("<BH")
CRC = struct.Struct(">H")
END = b"\0"

OVERHEAD = HEAD.size + CRC.size
"""Bytes of a frame besides its payload, before COBS."""


class Frame(NamedTuple):
    """Contents of a frame."""

    kind: int
    sequence: int
    payload: bytes


def encode(frame: Frame) -> bytes:
    """Return a frame as it goes over the line, its end included."""
    data = HEAD.pack(frame.kind, frame.sequence) + frame.payload
    return cobs_encode(data + CRC.pack(binascii.crc_hqx(data, 0))) + END


def decode(data: bytes) -> Frame:
    """Return the contents of a frame, given without its end; raises `DamagedReply`."""
    plain = cobs_decode(data)
    if len(plain) < OVERHEAD:
        raise DamagedReply(f"a frame of {len(plain)} bytes is too short: bytes were lost")
    body, check = plain[: -CRC.size], plain[-CRC.size :]
    if CRC.pack(binascii.crc_hqx(body, 0)) != check:
        raise DamagedReply(f"a frame of {len(plain)} bytes has a wrong CRC")
    kind, sequence = HEAD.unpack_from(body)
    return Frame(kind, sequence, body[HEAD.size :])


def cobs_encode(data: bytes) -> bytes:
    """Return data without zero bytes: each is replaced by the distance to the next."""
    out = np.frombuffer(END + data, np.uint8).copy()
    zeros = np.flatnonzero(out == 0)
    distances = np.diff(zeros, append=len(out))
    if distances.max() < 255:
        out[zeros] = distances
        return out.tobytes()
    # Somewhere 254 bytes or more without a zero: they need codes of their own.
    blocks = bytearray()
    for part in data.split(END):
        while len(part) >= 254:
            blocks.append(255)
            blocks += part[:254]
            part = part[254:]
        blocks.append(len(part) + 1)
        blocks += part
    return bytes(blocks)


def cobs_decode(data: bytes) -> bytes:
    """Decode COBS; raises `DamagedReply` for bytes that `cobs_encode` never returns."""
    codes = []
    position, size = 0, len(data)
    while position < size:
        code = data[position]
        if code == 0:
            break
        codes.append(position)
        position += code
    if position != size:
        raise DamagedReply("a frame is cut: its COBS blocks do not fit")
    plain = np.frombuffer(data, np.uint8).copy()
    follows_full = [at for at in codes if at >= 255 and data[at - 255] == 255]
    plain[codes] = 0
    if follows_full:
        before = set(codes)
        plain = np.delete(plain, [at for at in follows_full if at - 255 in before])
    return plain[1:].tobytes()


class Splitter:
    """Cuts received bytes into frames; counts damaged ones in `damaged`."""

    def __init__(self) -> None:
        self._rest = b""
        self.damaged = 0

    def feed(self, data: bytes, longest: int = 1 << 17) -> list[Frame]:
        """Return the frames that are complete with these bytes."""
        *whole, self._rest = (self._rest + data).split(END)
        if len(self._rest) > longest:
            self._rest = b""
            self.damaged += 1
        frames = []
        for item in whole:
            if not item:
                continue  # two ends in a row: nothing between them
            try:
                frames.append(decode(item))
            except DamagedReply:
                self.damaged += 1
        return frames
