"""What a host uploads to a target before a motion: objects, each in a slot of its own."""

from __future__ import annotations

import zlib

from rigtool.recipe.serial import Limits
from rigtool.rigs.base import Feedforward, Load, Task
from rigtool.rigs.serial.target import link
from rigtool.rigs.serial.target.link import Refusal, Slot


class Refused(Exception):
    """The request is answered with a refusal."""

    def __init__(self, text: str, code: Refusal = Refusal.NOT_NOW) -> None:
        super().__init__(text)
        self.code = code


class Uploads:
    """The objects by slot; each is kept once it is whole and checked.

    `Refused` is raised for what does not fit.
    """

    def __init__(self, most_bytes: int) -> None:
        self._most_bytes = most_bytes
        self._growing: dict[Slot, bytearray] = {}
        self._objects: dict[Slot, bytes] = {}

    def begin(self, payload: bytes) -> bytes:
        """Make room for an object."""
        slot, size = link.BEGIN.unpack(payload)
        if size > self._most_bytes:
            raise Refused(f"no memory for an object of {size} bytes", Refusal.BAD_VALUE)
        self._growing[Slot(slot)] = bytearray(size)
        return b""

    def chunk(self, payload: bytes) -> bytes:
        """Take a part of an object."""
        slot, offset = link.CHUNK.unpack_from(payload)
        data, whole = payload[link.CHUNK.size :], self._growing.get(Slot(slot))
        if whole is None or offset + len(data) > len(whole):
            raise Refused(f"CHUNK at {offset} of slot {slot} does not fit the size of BEGIN")
        whole[offset : offset + len(data)] = data
        return b""

    def whole(self, payload: bytes) -> tuple[Slot, bytes]:
        """Return the object of a COMMIT."""
        number, size, crc = link.COMMIT.unpack(payload)
        slot = Slot(number)
        data = bytes(self._growing.get(slot, b""))
        if len(data) != size or zlib.crc32(data) != crc:
            raise Refused(f"slot {number}: its CRC-32 is not that of COMMIT", Refusal.BAD_CRC)
        return slot, data

    def keep(self, slot: Slot, data: bytes) -> None:
        """Keep an object, in place of the one before."""
        self._objects[slot] = data
        self._growing.pop(slot, None)

    def limits(self) -> Limits:
        """Return the limits of motions."""
        if Slot.LIMITS not in self._objects:
            raise Refused("upload slot LIMITS first")
        return link.unpack_limits(self._objects[Slot.LIMITS])[0]

    def require_motion(self) -> None:
        """Refuse to arm where an object is missing that each motion needs."""
        needed = (Slot.RIG, Slot.LIMITS, Slot.CONTROLLER, Slot.MOTION)
        if missing := [slot.name for slot in needed if slot not in self._objects]:
            raise Refused(f"ARM before {', '.join(missing)} were uploaded")

    def sample_time(self) -> float:
        """Return the period of the loop, s."""
        return link.RigSetup.unpack(self._objects[Slot.RIG]).sample_time

    def task(self, every: int, stop_angle: float | None, *, touched: bool) -> Task:
        """Return the motion with its feed-forward and load."""
        objects = self._objects
        nothing = link.floats(0.0, 0.0, 0.0)
        friction = link.read_floats(objects.get(Slot.FEEDFORWARD, nothing)).tolist()
        inertia, coulomb, viscous = friction
        signal = link.read_floats(objects.get(Slot.SIGNAL, b""))
        added = Feedforward(
            inertia,
            coulomb,
            viscous,
            link.unpack_table(objects.get(Slot.TABLE, b"")),
            signal if signal.size else None,
        )
        load = link.unpack_load(objects[Slot.LOAD]) if Slot.LOAD in objects else Load()
        motion = link.unpack_motion(objects[Slot.MOTION])
        return Task(motion, added, load, every, stop_angle, touched)
