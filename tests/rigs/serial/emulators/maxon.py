"""maxon drives: an EPOS4 between DLE and CRC, an EPOS2 and a DES 70/10 in lock-step.

With the faults of the real ones: no watchdog, whole rpm, answers that do not say to which question
they belong, and a frame that goes on until it is complete or given up. They are slaves that answer
one request at a time: what comes before the answer has left is lost. An EPOS4 answers a frame with
a wrong CRC with an error (maxon, EPOS4 Communication Guide rel8759, 2.2.1, 2.2.2, 2.2.7).
"""

from __future__ import annotations

import math
import struct
import time

from rigtool.rigs.serial.emulators.motor import EmulatedMotor
from rigtool.rigs.serial.emulators.server import Emulator
from rigtool.rigs.serial.maxon.frames import (
    ANSWER,
    DLE,
    FAILED,
    FRAME_TIMEOUT,
    OKAY,
    START,
    crc,
    dle_frame,
    lock_step_frame,
)

RPM = 2 * math.pi / 60
COUNTS = 4000
"""Quad counts a turn of the encoder."""

NO_OBJECT, WRONG_STATE = 0x06020000, 0x08000022
UNKNOWN_COMMAND, CRC_ERROR = 0x05040001, 0x05040004

NOT_AWAITED = "lost what came before the answer"
"""Line of the log of a device whose host did not wait."""

BITS = {
    **dict.fromkeys((0x1000, 0x1018, 0x3001, 0x6076, 0x60A9, 0x6080, 0x3010), 32),
    **dict.fromkeys((0x2210, 0x607D, 0x607F, 0x6064, 0x606C, 0x30D1, 0x60FF, 0x206B), 32),
    0x6060: 8,
}
"""Width of an object's value; 16 for all others."""


class Device(Emulator):
    """A motor behind a drive: `mode` None where the power stage is off; `log` what happened."""

    def __init__(self) -> None:
        self.motor = EmulatedMotor()
        self.log: list[str] = []
        self.reset()

    def reset(self) -> None:
        """Restart: off, at position zero, with the settings that are stored."""
        self.mode: str | None = None
        self.speed = self.current = 0.0
        self.refusals = 0
        self.motor.position = self.motor.speed = 0.0
        self.power_up()

    def power_up(self) -> None:
        """Load what is stored."""
        raise NotImplementedError

    def refuse(self, count: int) -> None:
        """Refuse the next requests."""
        self.refusals = count

    def refused(self) -> bool:
        """Say whether this request is to be refused."""
        self.refusals = max(0, self.refusals - 1) if (refused := self.refusals > 0) else 0
        return refused

    def idle(self) -> bytes:
        """Turn the motor."""
        self.turn()
        return b""

    def turn(self) -> None:
        """Turn the motor until now."""
        self.motor.advance(self.mode, 0.0, self.speed, self.current)

    def switch(self, mode: str | None) -> None:
        """Switch the power stage on in a mode, or off."""
        self.turn()
        if mode != self.mode:
            self.log.append("off" if mode is None else f"on: {mode}")
        self.mode = mode

    @property
    def counts(self) -> int:
        """Position in quad counts."""
        return math.floor(self.motor.position / (2 * math.pi) * COUNTS)


class LockStep(Device):
    """A device in lock-step; `frame_timeout` [s] after which it gives up a frame."""

    frame_timeout = FRAME_TIMEOUT
    lengths: dict[int, int]
    """Bytes of data of each op code that is known."""

    def reset(self) -> None:
        """Restart: in the middle of nothing."""
        self.phase, self.frame, self.reply = "idle", b"", b""
        self.then = time.monotonic()
        super().reset()

    def receive(self, data: bytes) -> bytes:
        """Take bytes one by one, as they come in lock-step."""
        if self.phase != "idle" and time.monotonic() - self.then > self.frame_timeout:
            self.phase = "idle"
            self.log.append("frame given up")
        self.then = time.monotonic()
        for place, value in enumerate(data):
            if answer := self.byte(bytes([value])):
                if data[place + 1 :]:
                    self.log.append(NOT_AWAITED)
                return answer
        return b""

    def byte(self, byte: bytes) -> bytes:
        """Take one byte and return what is answered at once."""
        if self.phase == "idle":
            if byte[0] not in self.lengths or self.refused():
                return FAILED
            self.phase, self.frame = "frame", byte
            return OKAY
        if self.phase == "frame":
            self.frame += byte
            if len(self.frame) < 2 or len(self.frame) < 2 + 2 * (self.frame[1] + 1) + 2:
                return b""
            return self.complete()
        if self.phase == "ready":
            self.phase = "acknowledge" if byte == OKAY else "idle"
            return self.reply if byte == OKAY else b""
        self.phase = "idle"
        return b""

    def complete(self) -> bytes:
        """Check a whole frame, carry it out, and begin the answer."""
        self.phase = "idle"
        data, check = self.frame[2:-2], self.frame[-2:]
        opcode = self.frame[0]
        if check != crc(self.frame[:2], data) or len(data) != self.lengths[opcode]:
            return FAILED
        answer = self.command(opcode, data)
        if answer is None:
            return OKAY
        self.phase, self.reply = "ready", lock_step_frame(ANSWER, answer)
        return OKAY + bytes([ANSWER])

    def command(self, opcode: int, data: bytes) -> bytes | None:
        """Carry a command out; return the data of its answer, None where it has none."""
        raise NotImplementedError


class Epos(Device):
    """Objects and states of an EPOS; subclasses frame them."""

    modes: dict[int, str]
    stored: dict[tuple[int, int], int]
    """Settings after power is switched on."""

    def power_up(self) -> None:
        """Load what is stored."""
        self.objects = {
            (0x1000, 0): 0x00020192,
            (0x1018, 2): 0x63500000,
            (0x1018, 4): 0x1234,
            (0x603F, 0): 0,
            (0x6040, 0): 0,
            (0x6060, 0): 1,
            (0x607D, 1): -(2**31),
            (0x607D, 2): 2**31 - 1,
            **self.stored,
        }
        self.status = 0x0240
        self.apply()

    def fault(self, code: int) -> None:
        """Report a fault: the power stage is off."""
        self.objects[0x603F, 0] = code
        self.status = 0x0208
        self.switch(None)

    def carry_out(self, node: int, index: int, sub: int, value: int | None) -> bytes:
        """Read an object, or write it; return the data of the answer."""
        if node != 1:
            return struct.pack("<I", 0x0F00FFB9) + (b"" if value is not None else bytes(4))
        if value is None:
            return self.read(index, sub)
        if index != 0x6040 and self.refused():
            return struct.pack("<I", WRONG_STATE)
        if (index, sub) not in self.objects:
            return struct.pack("<I", NO_OBJECT)
        self.turn()
        bits = BITS.get(index, 16)
        value &= 2**bits - 1
        signed = index in (0x6060, 0x6071, 0x60B2, 0x2030, 0x60FF, 0x206B, 0x607D)
        if signed and value >= 2 ** (bits - 1):
            value -= 2**bits
        self.objects[index, sub] = value
        if index == 0x6040:
            self.control(value)
        self.apply()
        return bytes(4)

    def read(self, index: int, sub: int) -> bytes:
        """Return the answer to a read: error and value, whose unused bytes are zero."""
        self.turn()
        value = self.measured().get((index, sub), self.objects.get((index, sub)))
        if value is None:
            return struct.pack("<II", NO_OBJECT, 0)
        return struct.pack("<II", 0, value & (2 ** BITS.get(index, 16) - 1))

    def measured(self) -> dict[tuple[int, int], int]:
        """Return objects that are measured."""
        return {
            (0x6041, 0): self.status,
            (0x6064, 0): self.counts,
            (0x606C, 0): round(self.motor.speed / RPM),
        }

    def control(self, word: int) -> None:
        """Change the state as the control word asks."""
        if self.status & 0x08:
            return
        if word & 0x0F == 0x07 and self.status & 0x6F == 0x21:
            self.status = 0x0233
        elif word & 0x0F == 0x0F and self.status & 0x6F == 0x23:
            self.status = 0x0237
            self.switch(self.modes.get(self.objects[0x6060, 0]))
        elif word & 0x07 == 0x06:
            self.status = 0x0231
            self.switch(None)
        elif not word & 0x02:
            self.status = 0x0240
            self.switch(None)

    def apply(self) -> None:
        """Let set points and limits act."""
        raise NotImplementedError


class Epos4Emulator(Epos):
    """An EPOS4 with the node 1; `stored` may be changed before it is switched on."""

    modes = {9: "velocity", 10: "current"}  # noqa: RUF012

    def __init__(self, **stored: int) -> None:
        self.stored = {
            (0x3001, 1): 3210,
            (0x3001, 2): 15000,
            (0x3001, 5): 45000,
            (0x3010, 1): COUNTS // 4,
            (0x6076, 0): 144450,
            (0x6071, 0): 0,
            (0x6080, 0): 10000,
            (0x60A9, 0): 0x00B44700,
            (0x60B2, 0): 0,
            (0x60FF, 0): 0,
        }
        self.stored.update({(int(name[1:5], 16), int(name[6:])): n for name, n in stored.items()})
        super().__init__()

    def reset(self) -> None:
        """Restart: in the middle of nothing."""
        self.buffer, self.then = b"", time.monotonic()
        super().reset()

    def apply(self) -> None:
        """Let set points and limits act."""
        get = self.objects
        per_mille = get[0x6076, 0] / get[0x3001, 5] * 1e-3
        unit = RPM * 10.0 ** struct.unpack("<b", bytes([get[0x60A9, 0] >> 24]))[0]
        top = get[0x6080, 0] * unit
        self.speed = min(max(get[0x60FF, 0] * unit, -top), top)
        torque = get[0x60B2, 0] + (get[0x6071, 0] if get[0x6060, 0] == 10 else 0)
        self.current = torque * per_mille
        self.motor.current_limit = get[0x3001, 2] * 1e-3

    def measured(self) -> dict[tuple[int, int], int]:
        """Return objects that are measured."""
        return {
            **super().measured(),
            (0x30D1, 2): round(self.motor.current * 1e3),
            (0x30D0, 0): round(self.motor.current_setpoint * 1e3),
        }

    def receive(self, data: bytes) -> bytes:
        """Take bytes; the first whole frame is answered, the rest of what came is lost."""
        if time.monotonic() - self.then > FRAME_TIMEOUT:
            self.buffer = b""
        self.then = time.monotonic()
        self.buffer += data
        frame = self.next_frame()
        if frame is None:
            return b""
        if self.buffer:
            self.log.append(NOT_AWAITED)
        self.buffer = b""
        body, check = frame[:-2], frame[-2:]
        if check != crc(body[1::-1], body[2:]):
            return dle_frame(ANSWER, struct.pack("<I", CRC_ERROR))
        return self.answer(body[0], body[2:])

    def next_frame(self) -> bytes | None:
        """Take a whole frame from what has come: op code, length, data, CRC."""
        while (start := self.buffer.find(START)) >= 0:
            body, position, whole = bytearray(), start + 2, False
            while position < len(self.buffer) and not whole:
                byte = self.buffer[position]
                follows = self.buffer[position + 1 : position + 2]
                if byte == DLE and not follows:
                    return None
                if byte == DLE and follows[0] != DLE:
                    break  # another frame starts here
                body.append(byte)
                position += 2 if byte == DLE else 1
                whole = len(body) >= 2 and len(body) == 2 + 2 * body[1] + 2
            if whole:
                self.buffer = self.buffer[position:]
                return bytes(body)
            if position >= len(self.buffer):
                return None
            self.buffer = self.buffer[position:]
        return None

    def answer(self, opcode: int, data: bytes) -> bytes:
        """Return the frame that answers a command."""
        if opcode == 0x60 and len(data) == 4:
            node, index, sub = struct.unpack("<BHB", data)
            return dle_frame(ANSWER, self.carry_out(node, index, sub, None))
        if opcode == 0x68 and len(data) == 8:
            node, index, sub, value = struct.unpack("<BHBI", data)
            return dle_frame(ANSWER, self.carry_out(node, index, sub, value))
        return dle_frame(ANSWER, struct.pack("<I", UNKNOWN_COMMAND))


class Epos2Emulator(LockStep, Epos):
    """An EPOS2 with the node 1."""

    modes = {-2: "velocity", -3: "current"}  # noqa: RUF012
    lengths = {0x10: 4, 0x11: 8}  # noqa: RUF012

    def __init__(self) -> None:
        self.stored = {
            (0x2005, 0): 500,
            (0x2030, 0): 0,
            (0x206B, 0): 0,
            (0x2210, 1): COUNTS // 4,
            (0x607F, 0): 25000,
            (0x6410, 2): 10000,
            (0x6410, 4): 25000,
        }
        super().__init__()

    def apply(self) -> None:
        """Let set points and limits act."""
        get = self.objects
        top = get[0x607F, 0]
        self.speed = min(max(get[0x206B, 0], -top), top) * RPM
        self.current = get[0x2030, 0] * 1e-3 if get[0x6060, 0] == -3 else 0.0
        self.motor.current_limit = get[0x6410, 2] * 1e-3
        self.frame_timeout = get[0x2005, 0] * 1e-3

    def measured(self) -> dict[tuple[int, int], int]:
        """Return objects that are measured."""
        return {
            **super().measured(),
            (0x6078, 0): round(self.motor.current * 1e3),
            (0x2031, 0): round(self.motor.current_setpoint * 1e3),
        }

    def command(self, opcode: int, data: bytes) -> bytes:
        """Read or write an object."""
        index, sub, node = struct.unpack("<HBB", data[:4])
        value = None if opcode == 0x10 else int.from_bytes(data[4:], "little")
        return self.carry_out(node, index, sub, value)


class DesEmulator(LockStep):
    """A DES 70/10: rotor position within a turn, settings in RAM until it restarts."""

    lengths = {0x05: 2, 0x14: 4, 0x15: 6, 0x21: 2, 0x22: 2}  # noqa: RUF012

    def power_up(self) -> None:
        """Load what is stored."""
        self.parameters = {1: 0x0001, 14: 20000, 15: 10000, 17: 25000, 20: COUNTS // 4, 44: 25000}
        self.error = False
        self.apply()

    def command(self, opcode: int, data: bytes) -> bytes | None:
        """Carry a command out."""
        self.turn()
        words = struct.unpack(f"<{len(data) // 2}h", data)
        if opcode == 0x14:
            value = self.measured().get(words[0], self.parameters.get(words[0], 0))
            return struct.pack("<H", value & 0xFFFF)
        if opcode == 0x15:
            self.parameters[words[0]] = words[2] & 0xFFFF
        elif opcode == 0x05:
            regulator = "current" if self.parameters[1] & 4 else "velocity"
            self.switch(regulator if words[0] else None)
        elif opcode == 0x21:
            top = self.parameters[17]
            self.speed = min(max(words[0], -top), top) * RPM
        else:
            self.current = words[0] * 1e-3
        self.apply()
        return None

    def apply(self) -> None:
        """Let the limit of current act, where software sets it."""
        self.motor.current_limit = self.parameters[14] * 1e-3

    def turn(self) -> None:
        """Turn the motor until now; set points that are not for this mode do nothing."""
        current = self.current if self.mode == "current" else 0.0
        self.motor.advance(self.mode, 0.0, self.speed, current)

    def measured(self) -> dict[int, int]:
        """Return status variables."""
        return {
            128: (1 << 10 | 1 << 14) * (self.mode is not None) | (1 << 9) * self.error,
            130: round(self.motor.current * 1e3),
            131: round(self.motor.current_setpoint * 1e3),
            132: self.counts % COUNTS,
            134: round(self.motor.speed / RPM),
        }
