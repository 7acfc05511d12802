"""Objects of an EPOS: where values are, of what kind, and how they are read and written.

EPOS4 objects: [maxon, EPOS4 Firmware Specification] as others use them; EPOS2 objects from
implementations of others only. Neither was tried on hardware: see docs/bench-maxon.md.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass

from rigtool.errors import HardwareError
from rigtool.rigs.serial.line import RequestRefused
from rigtool.rigs.serial.maxon.frames import Frames

DOES_NOT_EXIST = frozenset({0x06020000, 0x06090011})

ERRORS = {
    0x05030000: "toggle bit",
    0x06010002: "read-only",
    0x06020000: "no such object",
    0x06090011: "no such sub-index",
    0x06090030: "value out of range",
    0x06090031: "value too high",
    0x06090032: "value too low",
    0x08000020: "cannot be stored",
    0x08000022: "not in this state of the drive",
    0x0F00FFB9: "wrong node: see serial.node",
    0x0F00FFC0: "the device is in NMT state stopped",
}


@dataclass(frozen=True)
class Entry:
    """An object: `kind` is a format of `struct` for its value, of at most four bytes."""

    index: int
    sub: int
    kind: str
    name: str

    @property
    def size(self) -> int:
        """Bytes of the value."""
        return struct.calcsize("<" + self.kind)

    def pack(self, value: int) -> bytes:
        """Return four bytes with a value; raises `HardwareError` where it does not fit."""
        try:
            return struct.pack("<" + self.kind, value).ljust(4, b"\0")
        except struct.error:
            raise HardwareError(
                f"{self.name} cannot be {value}: object {self.index:04X}:{self.sub:02X} has "
                f"{8 * self.size} bit"
            ) from None

    def unpack(self, data: bytes) -> int:
        """Return the value in four bytes, of which only the lower ones count."""
        return int(struct.unpack("<" + self.kind, data[: self.size])[0])


DEVICE_TYPE = Entry(0x1000, 0, "I", "device type")
PRODUCT = Entry(0x1018, 2, "I", "product code")
SERIAL = Entry(0x1018, 4, "I", "serial number")
ERROR_CODE = Entry(0x603F, 0, "H", "error code")
CONTROL = Entry(0x6040, 0, "H", "control word")
STATUS = Entry(0x6041, 0, "H", "status word")
MODE = Entry(0x6060, 0, "b", "mode of operation")
POSITION = Entry(0x6064, 0, "i", "position")
SPEED = Entry(0x606C, 0, "i", "speed")
LOWEST = Entry(0x607D, 1, "i", "lowest position")
HIGHEST = Entry(0x607D, 2, "i", "highest position")
MAX_PROFILE_SPEED = Entry(0x607F, 0, "I", "highest speed of profiles")

# EPOS4
NOMINAL_CURRENT = Entry(0x3001, 1, "I", "nominal current")
CURRENT_LIMIT_4 = Entry(0x3001, 2, "I", "limit of current")
TORQUE_CONSTANT = Entry(0x3001, 5, "I", "torque constant")
RATED_TORQUE = Entry(0x6076, 0, "I", "rated torque")
MAX_MOTOR_SPEED = Entry(0x6080, 0, "I", "highest speed of the motor")
SPEED_UNIT = Entry(0x60A9, 0, "I", "unit of speed")
TARGET_TORQUE = Entry(0x6071, 0, "h", "target torque")
TORQUE_OFFSET = Entry(0x60B2, 0, "h", "torque offset")
TARGET_SPEED_4 = Entry(0x60FF, 0, "i", "target speed")
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


class Objects:
    """The objects of one node. Raises `RequestRefused` where the drive answers with an error."""

    def __init__(self, frames: Frames, access: Access, node: int) -> None:
        self.frames = frames
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

    def find(self, entry: Entry) -> int | None:
        """Return a value, None where this drive has no such object."""
        try:
            return self.read(entry)
        except RequestRefused as refused:
            if refused.code in DOES_NOT_EXIST:
                return None
            raise

    def _check(self, answer: bytes, entry: Entry, what: str) -> None:
        code = int.from_bytes(answer[:4], "little")
        if code:
            raise RequestRefused(
                f"{self.frames.line.port}: the drive refuses that its {entry.name} "
                f"({entry.index:04X}:{entry.sub:02X}) be {what}: error {code:#010x} "
                f"({ERRORS.get(code, 'see its manual')})",
                code,
            )
