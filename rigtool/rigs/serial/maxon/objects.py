"""Objects of an EPOS that CiA 402 does not have, and how all are read on a serial line.

EPOS4 objects: [maxon, EPOS4 Firmware Specification] as others use them; EPOS2 objects from
implementations of others only. Neither was tried on hardware: see docs/bench-maxon.md.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass

from rigtool.rigs.serial.cia402.objects import Entry, refusal
from rigtool.rigs.serial.maxon.frames import Frames

# EPOS4
NOMINAL_CURRENT = Entry(0x3001, 1, "I", "nominal current")
CURRENT_LIMIT_4 = Entry(0x3001, 2, "I", "limit of current")
TORQUE_CONSTANT = Entry(0x3001, 5, "I", "torque constant")
CURRENT_4 = Entry(0x30D1, 2, "i", "current")
# of 16 or of 32 bit, sources disagree: mA fit into the lower half
CURRENT_DEMAND_4 = Entry(0x30D0, 0, "h", "demanded current")
ENCODER_4 = Entry(0x3010, 1, "I", "pulses of encoder 1 a turn")

# EPOS2
FRAME_TIMEOUT_2 = Entry(0x2005, 0, "H", "timeout of frames")
CURRENT_TARGET_2 = Entry(0x2030, 0, "h", "set point of current")
CURRENT_DEMAND_2 = Entry(0x2031, 0, "h", "demanded current")
SPEED_TARGET_2 = Entry(0x206B, 0, "i", "set point of speed")
CURRENT_2 = Entry(0x6078, 0, "h", "current")
CURRENT_LIMIT_2 = Entry(0x6410, 2, "H", "limit of current")
CURRENT_MODE_SPEED_2 = Entry(0x6410, 4, "I", "highest speed in current mode")
ENCODER_2 = Entry(0x2210, 1, "I", "pulses of the encoder a turn")


@dataclass(frozen=True)
class Access:
    """Op codes by which a family reads and writes objects, and where the node stands."""

    read: int
    write: int
    node_first: bool

    def address(self, node: int, entry: Entry) -> bytes:
        """Return the four bytes that name an object."""
        place = struct.pack("<HB", entry.index, entry.sub)
        return bytes([node]) + place if self.node_first else place + bytes([node])


EPOS4_ACCESS = Access(read=0x60, write=0x68, node_first=True)
EPOS2_ACCESS = Access(read=0x10, write=0x11, node_first=False)


class EposObjects:
    """The objects of one node on a serial line; see `Objects`."""

    def __init__(self, frames: Frames, access: Access, node: int) -> None:
        self.frames, self.line = frames, frames.line
        self._access = access
        self._node = node

    def read(self, entry: Entry, retries: int | None = None) -> int:
        """Return a value."""
        address = self._access.address(self._node, entry)
        answer = self.frames.command(self._access.read, address, 8, retries)
        self._check(answer, entry, "read")
        return entry.unpack(answer[4:])

    def write(self, entry: Entry, value: int) -> None:
        """Set a value; repeating it does no harm."""
        data = self._access.address(self._node, entry) + entry.pack(value)
        self._check(self.frames.command(self._access.write, data, 4), entry, f"set to {value}")

    def _check(self, answer: bytes, entry: Entry, what: str) -> None:
        code = int.from_bytes(answer[:4], "little")
        if code:
            raise refusal(self.line.port, code, entry, what)
