"""Frames of a moteus drive: lines of the fdcanusb, and the registers in a CAN-FD frame.

A frame is a row of subframes: write registers `00 04 08 0c`, read them `10 14 18 1c`, replies
`20 24 28 2c` (int8, int16, int32, float), each with a count and the first register; `30 31` are
errors; `40 41 42` carry text of the diagnostic channel (mjbots/moteus docs/protocol/can.md).
"""

from __future__ import annotations

import struct
from collections.abc import Mapping, Sequence

from rigtool.rigs.serial.transport.can_frames import SIZES

INT8, INT16, INT32, FLOAT = range(4)
FORMATS = ("b", "h", "i", "f")

NOP = 0x50
TEXT_TO_DRIVE, TEXT_FROM_DRIVE, ASK_TEXT = 0x40, 0x41, 0x42
CHANNEL = 1
LONGEST_TEXT = 61
"""Bytes of text that fit into a frame."""

CRC_POLYNOMIAL = 0x97


class BadFrame(ValueError):
    """Bytes that are no frame."""


class RegisterError(ValueError):
    """The drive refuses a register."""


# -- lines


def _crc_table() -> tuple[int, ...]:
    table = []
    for byte in range(256):
        crc = byte
        for _ in range(8):
            crc = (crc << 1) ^ (CRC_POLYNOMIAL if crc & 0x80 else 0)
            crc &= 0xFF
        table.append(crc)
    return tuple(table)


_CRC = _crc_table()


def crc8(data: bytes) -> int:
    """Return the CRC-8 of a line, polynomial 0x97, most significant bit first, from 0."""
    crc = 0
    for byte in data:
        crc = _CRC[crc ^ byte]
    return crc


def sealed(line: bytes) -> bytes:
    """Return a line with its checksum ` *XX`, which covers the space before it, too."""
    return line + b" *%02X" % crc8(line + b" ")


def unsealed(line: bytes) -> bytes:
    """Return a line without its checksum; raises `BadFrame` where there is none or a wrong one."""
    body, mark, digits = line.rpartition(b" *")
    if not mark or len(digits) != 2 or sealed(body) != line:
        raise BadFrame(f"{line[:60]!r}: wrong checksum")
    return body


def has_seal(line: bytes) -> bool:
    """Return whether a line ends with a checksum, right or wrong."""
    return line[-4:-2] == b" *"


def padded(frame: bytes) -> bytes:
    """Fill a frame up to a length that CAN-FD has, with subframes that do nothing."""
    size = next(size for size in SIZES if size >= len(frame))
    return frame + bytes([NOP]) * (size - len(frame))


def send_line(identifier: int, frame: bytes) -> bytes:
    """Return the line that sends a frame, without its end."""
    return b"can send %04x %s" % (identifier, padded(frame).hex().encode())


def received(line: bytes) -> tuple[int, bytes]:
    """Return identifier and frame of a line `rcv ...`; raises `BadFrame`."""
    words = line.split(b" ")
    try:
        if len(words) < 3 or words[0] != b"rcv":
            raise ValueError
        return int(words[1], 16), bytes.fromhex(words[2].decode("ascii"))
    except ValueError:
        raise BadFrame(f"{line[:60]!r}: is no frame") from None


# -- subframes


def varuint(value: int) -> bytes:
    """Return a number in groups of 7 bits, the lowest first, the last one without bit 7."""
    out = bytearray()
    while value > 0x7F:
        out.append(value & 0x7F | 0x80)
        value >>= 7
    return bytes([*out, value])


def _head(kind: int, resolution: int, count: int, first: int) -> bytes:
    code = kind | resolution << 2
    if count < 4:
        return bytes([code | count]) + varuint(first)
    return bytes([code]) + varuint(count) + varuint(first)


def write(first: int, values: Sequence[float], resolution: int = FLOAT) -> bytes:
    """Return the subframe that writes registers from `first` on."""
    return _head(0x00, resolution, len(values), first) + struct.pack(
        f"<{len(values)}{FORMATS[resolution]}", *values
    )


def read(first: int, count: int = 1, resolution: int = FLOAT) -> bytes:
    """Return the subframe that asks for registers from `first` on."""
    return _head(0x10, resolution, count, first)


def text_to_drive(text: bytes) -> bytes:
    """Return the subframe that carries text to the drive."""
    return bytes([TEXT_TO_DRIVE, CHANNEL, len(text)]) + text


def ask_text() -> bytes:
    """Return the subframe that asks for text of the drive."""
    return bytes([ASK_TEXT, CHANNEL, LONGEST_TEXT])


def text_from_drive(frame: bytes) -> bytes:
    """Return the text of a reply; raises `BadFrame`."""
    if len(frame) < 3 or frame[:2] != bytes([TEXT_FROM_DRIVE, CHANNEL]):
        raise BadFrame(f"{frame[:20].hex()}: is no text")
    if len(frame) < 3 + frame[2]:
        raise BadFrame(f"{frame[:20].hex()}: text of {frame[2]} bytes is cut")
    return frame[3 : 3 + frame[2]]


class Subframes:
    """Takes a frame apart."""

    def __init__(self, frame: bytes) -> None:
        self._frame, self._at = frame, 0

    @property
    def left(self) -> bool:
        """Whether anything is left."""
        return self._at < len(self._frame)

    def byte(self) -> int:
        """Return the next byte."""
        return self.bytes(1)[0]

    def bytes(self, count: int) -> bytes:
        """Return the next bytes; raises `BadFrame` where the frame is cut."""
        found = self._frame[self._at : self._at + count]
        if len(found) < count:
            raise BadFrame(f"{self._frame.hex()}: is cut")
        self._at += count
        return found

    def varuint(self) -> int:
        """Return the next number; raises `BadFrame` where it is too long."""
        value = shift = 0
        while True:
            byte = self.byte()
            value |= (byte & 0x7F) << shift
            shift += 7
            if byte < 0x80:
                return value
            if shift > 28:
                raise BadFrame(f"{self._frame.hex()}: holds a number of more than 32 bits")

    def registers(self, code: int) -> tuple[int, int, int]:
        """Return (resolution, count, first register) of a subframe of this code."""
        count = code & 3 or self.varuint()
        return code >> 2 & 3, count, self.varuint()

    def values(self, resolution: int, count: int) -> tuple[float, ...]:
        """Return the next values."""
        form = f"<{count}{FORMATS[resolution]}"
        return struct.unpack(form, self.bytes(struct.calcsize(form)))


def registers_of(frame: bytes) -> Mapping[int, float]:
    """Return the registers of a reply by number.

    Raises `BadFrame` for other bytes, `RegisterError` where the drive refuses one.
    """
    found: dict[int, float] = {}
    parts = Subframes(frame)
    while parts.left:
        code = parts.byte()
        if code == NOP:
            continue
        if code in (0x30, 0x31):
            register, number = parts.varuint(), parts.varuint()
            done = "write" if code == 0x30 else "read"
            raise RegisterError(f"{done} of register 0x{register:03x}: error {number}")
        if code & 0xF0 != 0x20:
            raise BadFrame(f"{frame.hex()}: is no reply")
        resolution, count, first = parts.registers(code)
        for number, value in enumerate(parts.values(resolution, count)):
            found[first + number] = value
    return found
