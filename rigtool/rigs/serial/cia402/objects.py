"""Objects of CANopen and CiA 402: places and types of values, and the errors of a drive.

Sources: CiA 301 and CiA 402 (IEC 61800-7-201) as drives and programs of others use them.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass
from typing import Protocol

from rigtool.errors import HardwareError
from rigtool.rigs.serial.line import Line, RequestRefused

DOES_NOT_EXIST = frozenset({0x06020000, 0x06090011})

ERRORS = {
    0x05030000: "toggle bit",
    0x06010000: "not in this state of the object",
    0x06010002: "read-only",
    0x06020000: "no such object",
    0x06090011: "no such sub-index",
    0x06040041: "cannot be mapped to a PDO",
    0x06040042: "too long for a PDO",
    0x06070010: "another length",
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
VENDOR = Entry(0x1018, 1, "I", "vendor")
PRODUCT = Entry(0x1018, 2, "I", "product code")
SERIAL = Entry(0x1018, 4, "I", "serial number")
ERROR_CODE = Entry(0x603F, 0, "H", "error code")
CONTROL = Entry(0x6040, 0, "H", "control word")
STATUS = Entry(0x6041, 0, "H", "status word")
MODE = Entry(0x6060, 0, "b", "mode of operation")
POSITION = Entry(0x6064, 0, "i", "position")
LOWEST = Entry(0x607D, 1, "i", "lowest position")
HIGHEST = Entry(0x607D, 2, "i", "highest position")
MAX_PROFILE_SPEED = Entry(0x607F, 0, "I", "highest speed of profiles")
TORQUE_DEMAND = Entry(0x6074, 0, "h", "demanded torque")
TORQUE_CURRENT = Entry(0x6078, 0, "h", "current")
RATED_CURRENT = Entry(0x6075, 0, "I", "rated current")
RATED_TORQUE = Entry(0x6076, 0, "I", "rated torque")
MAX_MOTOR_SPEED = Entry(0x6080, 0, "I", "highest speed of the motor")
SPEED_UNIT = Entry(0x60A9, 0, "I", "unit of speed")
TARGET_TORQUE = Entry(0x6071, 0, "h", "target torque")
TORQUE_OFFSET = Entry(0x60B2, 0, "h", "torque offset")
TARGET_SPEED = Entry(0x60FF, 0, "i", "target speed")
TARGET_POSITION = Entry(0x607A, 0, "i", "target position")
MAX_CURRENT = Entry(0x6073, 0, "H", "limit of current")
MAX_TORQUE = Entry(0x6072, 0, "H", "limit of torque")
MODE_SHOWN = Entry(0x6061, 0, "b", "mode that is active")
SUPPORTED_MODES = Entry(0x6502, 0, "I", "modes that there are")
FEED = Entry(0x6092, 1, "I", "units of position a feed")
FEED_TURNS = Entry(0x6092, 2, "I", "turns of the shaft a feed")
INCREMENTS = Entry(0x608F, 1, "I", "increments of the encoder")
INCREMENTS_TURNS = Entry(0x608F, 2, "I", "turns of the motor for them")
CONSUMER_HEARTBEAT = Entry(0x1016, 1, "I", "heartbeat that it watches")
WHEN_SILENT = Entry(0x6007, 0, "h", "reaction to silence")


class Objects(Protocol):
    """The objects of a node; raises `RequestRefused` where it answers with an error."""

    line: Line

    def read(self, entry: Entry, retries: int | None = None) -> int:
        """Return a value."""

    def write(self, entry: Entry, value: int) -> None:
        """Set a value; repeating it does no harm."""


def find(objects: Objects, entry: Entry) -> int | None:
    """Return a value, None where this drive has no such object."""
    try:
        return objects.read(entry)
    except RequestRefused as refused:
        if refused.code in DOES_NOT_EXIST:
            return None
        raise


def refusal(port: str, code: int, entry: Entry, what: str) -> RequestRefused:
    """Return the error for an object that a drive does not let be `what`."""
    return RequestRefused(
        f"{port}: the drive refuses that its {entry.name} ({entry.index:04X}:{entry.sub:02X}) be "
        f"{what}: error {code:#010x} ({ERRORS.get(code, 'see its manual')})",
        code,
    )
