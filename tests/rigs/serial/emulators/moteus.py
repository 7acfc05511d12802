"""A moteus drive, at an fdcanusb or at its own UART, byte for byte.

The texts of the fdcanusb are those of its firmware, `fw/can_manager.cc`.

Its known ways: a UART demands checksums once it was sent one; the watchdog is that of position mode
only; settings are printed with six decimals; what is set is lost with the power unless written;
after power-on it is enabled only after a short calibration.
"""

from __future__ import annotations

import math
import re
import time

from rigtool.rigs.serial.emulators.motor import EmulatedMotor
from rigtool.rigs.serial.emulators.server import Emulator
from rigtool.rigs.serial.moteus import frames

TURN = 2 * math.pi
ENABLING = 0.01
CODES = 1024
TABLE = "motor.cogging_dq_comp."
FIRMWARE = 0x010305

INTEGERS = {
    "motor.poles": 14,
    "motor_position.commutation_source": 0,
    "motor_position.output.source": 0,
    "motor_position.output.sign": 1,
    "servo.voltage_mode_control": 0,
    "servo.fixed_voltage_mode": 0,
    "servo.enable_motor_temperature": 1,
    "servo.timeout_mode": 12,
}
FLOATS = {
    "motor.rotation_current_cutoff_A": 10000.0,
    "motor.cogging_dq_scale": 0.0,
    "motor_position.rotor_to_output_ratio": 1.0,
    "servo.max_current_A": 100.0,
    "servo.max_velocity": 500.0,
    "servo.default_timeout_s": 0.1,
    "servo.default_velocity_limit": math.nan,
    "servo.default_accel_limit": 50.0,
    "servo.motor_fault_temperature": math.nan,
    "servopos.position_min": math.nan,
    "servopos.position_max": math.nan,
}
VELOCITY_DERATE = 2.0
"""Speeds beyond servo.max_velocity over which torque ends, turns a second."""
NO_COMMAND = {0x20: 0.0, 0x21: 0.0, 0x22: 0.0, 0x23: 1.0, 0x24: 1.0, 0x25: math.nan, 0x27: 0.0}


SCALES = {
    (0x001, 0x020): (0.01, 1e-4, 1e-5),
    (0x002, 0x021): (0.1, 2.5e-4, 1e-5),
    (0x003, 0x022, 0x025, 0x034): (0.5, 0.01, 1e-3),
    (0x004,): (1.0, 0.1, 1e-3),
    (0x00A, 0x00E): (1.0, 0.1, 1e-3),
    (0x00D,): (0.5, 0.1, 1e-3),
    (0x023, 0x024, 0x02B): (1 / 127, 1 / 32767, 1 / 2147483647),
    (0x027,): (0.01, 1e-3, 1e-6),
    (0x050,): (0.01, 1e-4, 1e-5),
}
"""A step of a register as int8, int16 and int32, docs/reference of mjbots; others are whole."""

NOT_A_NUMBER = (-(2**7), -(2**15), -(2**31))
"""The smallest integer stands for NaN."""


def step_of(register, resolution):
    """Return the step of a register in one of the formats, 1 for a float."""
    if resolution == frames.FLOAT:
        return 1.0
    return next((steps[resolution] for all_, steps in SCALES.items() if register in all_), 1.0)


def reply(first, values, resolution=frames.FLOAT):
    """Return the subframe that a drive answers with: that of writing, with another code."""
    written = frames.write(first, values, resolution)
    return bytes([written[0] | 0x20]) + written[1:]


class MoteusEmulator(Emulator):
    """A drive of address `node`; `uart` without an fdcanusb between.

    `encoder` is what the commutation encoder shows where the position is 0, in turns, and `sign`
    whether it counts the same way; `home` is the register that says what position 0 means.
    """

    def __init__(
        self,
        *,
        node: int = 1,
        uart: bool = True,
        encoder: float = 0.0,
        sign: int = 1,
        home: int = 1,
        **settings: float,
    ) -> None:
        self.node, self.uart = node, uart
        self.encoder, self.sign, self.home = encoder, sign, home
        self.motor = EmulatedMotor()
        self.on_bus = True
        self.temperature = 25.0
        self.log: list[str] = []
        self.loses_writes = False
        self.stored: dict[str, float] = {**INTEGERS, **FLOATS}
        self.stored |= {f"{TABLE}{i}": 0 for i in range(CODES)}
        self.stored["motor_position.output.sign"] = sign
        self.stored["motor.Kv"] = 1.5 / math.sqrt(3) * 60 / TURN / self.motor.torque_constant
        self.stored |= {name.replace("__", "."): value for name, value in settings.items()}
        self.reset()

    def reset(self) -> None:
        """Start anew with what is stored."""
        self.config = dict(self.stored)
        self.buffer = b""
        self.text_in, self.text_out = b"", b""
        self.mode, self.fault = 0, 0
        self.command = dict(NO_COMMAND)
        self.since = self.enabled = self.fed = time.monotonic()
        self.checksums = False
        self.refusals = 0

    def refuse(self, count: int) -> None:
        """Answer the next requests with errors."""
        self.refusals = count

    # -- lines

    def receive(self, data: bytes) -> bytes:
        """Answer whole lines."""
        self.buffer += data
        *lines, self.buffer = self.buffer.replace(b"\r", b"\n").split(b"\n")
        return b"".join(self._end(out) for line in lines if line for out in self._line(line))

    def _end(self, line: bytes) -> bytes:
        return (frames.sealed(line) if self.checksums else line) + b"\r\n"

    def _line(self, line: bytes) -> list[bytes]:
        if self.uart:
            if frames.has_seal(line):
                try:
                    line = frames.unsealed(line)
                except frames.BadFrame:
                    return [b"ERR checksum"]
                self.checksums = True
            elif self.checksums:
                return [b"ERR checksum"]
        words = line.split()
        if words[:2] != [b"can", b"send"]:
            return [b"ERR unknown subcommand" if words[:1] == [b"can"] else b"ERR unknown command"]
        if not self.uart and (refused := self._refused(words[2:])):
            return [refused]
        try:
            identifier, frame = int(words[2], 16), bytes.fromhex(words[3].decode("ascii"))
        except (ValueError, IndexError):
            return [b"ERR malformed data"]
        if identifier & 0x7F != self.node:
            return [b"OK"]
        try:
            answer = self._frame(frame)
        except (frames.BadFrame, ValueError):
            answer = b""
        if not identifier & 0x8000 or not answer:
            return [b"OK"]
        back = self.node << 8 | identifier >> 8 & 0x7F
        if self.uart:
            return [b"OK", b"rcv %08x %s" % (back, answer.hex().encode())]
        data = frames.padded(answer).hex().upper().encode()
        return [b"OK", b"rcv %X %s %c B F r f-1" % (back, data, b"eE"[back > 0x7FF])]

    def _refused(self, words: list[bytes]) -> bytes:
        """Return how an fdcanusb refuses a frame, in its firmware's words and order, if it does."""
        if not self.on_bus:
            return b"ERR not in BusOn state"
        if len(words) < 2:
            return b"ERR insufficient options"
        identifier, data, flags = words[0], words[1], b" ".join(words[2:])
        if set(flags) - set(b"BbFfRr "):  # a checksum is no flag
            return b"ERR unknown flag"
        if not re.fullmatch(rb"0*[0-9a-fA-F]{1,8}", identifier) or int(identifier, 16) >> 29:
            return b"ERR bad id"
        if len(data) % 2:
            return b"ERR data invalid length"
        return b"" if re.fullmatch(rb"[0-9a-fA-F]*", data) else b"ERR invalid data"

    # -- frames

    def _frame(self, frame: bytes) -> bytes:
        parts, out = frames.Subframes(frame), b""
        self.turn()
        commanded: dict[int, float] = {}
        while parts.left:
            code = parts.byte()
            if code == frames.NOP:
                continue
            if code == frames.TEXT_TO_DRIVE:
                parts.byte()
                self._text(parts.bytes(parts.byte()))
            elif code == frames.ASK_TEXT:
                parts.byte()
                size = parts.byte()
                text, self.text_out = self.text_out[:size], self.text_out[size:]
                out += bytes([frames.TEXT_FROM_DRIVE, frames.CHANNEL, len(text)]) + text
            elif code < 0x20:
                resolution, count, first = parts.registers(code)
                if code >= 0x10:
                    out += self._read(first, count, resolution)
                else:
                    values = parts.values(resolution, count)
                    for register, value in enumerate(values, start=first):
                        whole = resolution != frames.FLOAT
                        missing = whole and value == NOT_A_NUMBER[resolution]
                        step = step_of(register, resolution)
                        commanded[register] = math.nan if missing else value * step
            else:
                raise frames.BadFrame(f"subframe {code:02x}")
        if self.refusals and frame[0] != frames.ASK_TEXT and out:
            self.refusals -= 1
            return bytes([0x31]) + frames.varuint(0) + b"\x01"
        if 0 in commanded:
            self._obey(int(commanded.pop(0)), commanded)
        return out

    def _obey(self, mode: int, values: dict[int, float]) -> None:
        now = time.monotonic()
        if mode == 0:
            self.log.append("stop")
            self.mode, self.fault = 0, 0
        elif mode == 10 and self.mode not in (1, 11):
            held = self._target(now)[0]
            self.command = {**NO_COMMAND, **values}
            if math.isnan(self.command[0x20]):
                self.command[0x20] = held
            self.since = self.fed = now
            if self.mode == 0:
                self.mode, self.enabled = 3, now
                self.command[0x20] = self._position()

    def _read(self, first: int, count: int, resolution: int) -> bytes:
        values = [self._register(first + i) for i in range(count)]
        if None in values:  # the firmware refuses a register that it does not have
            return bytes([0x31]) + frames.varuint(first + values.index(None)) + b"\x01"
        if resolution != frames.FLOAT:
            largest = -NOT_A_NUMBER[resolution] - 1
            values = [
                max(-largest, min(largest, round(value / step_of(first + i, resolution))))
                for i, value in enumerate(values)
            ]
        return reply(first, values, resolution)

    def _register(self, number: int) -> float | None:
        m, ratio = self.motor, self.config["motor_position.rotor_to_output_ratio"]
        constant = m.torque_constant / ratio
        registers: dict[int, float] = {
            0x000: self.mode,
            0x001: self._position(),
            0x002: m.speed / TURN * ratio,
            0x003: m.current * constant,
            0x004: m.current,
            0x00A: self.temperature if self.config["servo.enable_motor_temperature"] else 0.0,
            0x00C: self.home,
            0x00D: 24.0,  # V, of the supply
            0x00E: 40.0,  # degC, of the board
            0x00F: self.fault,
            0x034: (m.current_setpoint - self._added()) * constant if self.mode == 10 else 0.0,
            0x050: self.encoder_position(),
            0x100: 0x0220,
            0x101: FIRMWARE,
            0x120: 0x5A17,
            0x121: 0x0042,
            0x122: 0x3000,
        }
        return registers.get(number)

    # -- text

    def _text(self, data: bytes) -> None:
        self.text_in += data
        *lines, self.text_in = self.text_in.split(b"\n")
        for line in lines:
            if line.strip():
                self.text_out += self._answer(line.decode("latin-1").split()).encode() + b"\r\n"

    def _answer(self, words: list[str]) -> str:
        if self.refusals:
            self.refusals -= 1
            return "ERR error setting"
        match words:
            case ["conf", "get", name] if name in self.config:
                value = self.config[name]
                whole = name in INTEGERS or name.startswith(TABLE)
                return f"{int(value)}" if whole else f"{value:.6f}"
            case ["conf", "set", name, value] if name in self.config:
                try:
                    self.config[name] = float(value)
                except ValueError:
                    return "ERR error setting"
                self.log.append(f"{name} {value}")
            case ["conf", "write"]:
                self.log.append("write")
                if not self.loses_writes:
                    self.stored = dict(self.config)
            case ["conf", "load"]:
                self.config = dict(self.stored)
            case ["tel", "stop"] | ["d", "stop"]:
                pass
            case ["conf", *_]:
                return "ERR unknown group"
            case _:
                return "ERR unknown command"
        return "OK"

    # -- motion

    def idle(self) -> bytes:
        """Turn, and look at the watchdog."""
        self.turn()
        return b""

    def turn(self) -> None:
        """Let the motor turn until now."""
        now = time.monotonic()
        if 2 <= self.mode <= 4 and now - self.enabled > ENABLING:
            self._start()
        timeout = self.command[0x27] or self.config["servo.default_timeout_s"]
        if self.mode == 10 and now - self.fed > timeout:  # not so where it is NaN
            self.mode = 11
            self.log.append("watchdog")
        if self.mode == 10 and self.temperature > self.config["servo.motor_fault_temperature"]:
            self.mode, self.fault = 1, 38
        position, speed = self._target(now)
        constant, added = self._torque_constant(), self._added()
        largest = self.command[0x25] / constant
        current = self.command[0x22] / constant
        most = self.config["servo.max_current_A"]
        self.motor.current_limit = most if math.isnan(largest) else min(most, largest)
        ratio = self.config["motor_position.rotor_to_output_ratio"]
        # beyond its highest speed the firmware lets go, over a range of speeds
        beyond = abs(self.motor.speed) / TURN * ratio - self.config["servo.max_velocity"]
        self.motor.current_limit *= min(max(1 - beyond / VELOCITY_DERATE, 0.0), 1.0)
        mode: str | None = None
        if self.mode == 10:
            mode = "position" if self.command[0x23] else "current"
        self.motor.advance(
            mode, position * TURN / ratio, speed * TURN / ratio, current + added, moving=True
        )

    def _start(self) -> None:
        low, high = self.config["servopos.position_min"], self.config["servopos.position_max"]
        self.mode = 10
        if self._position() < low or self._position() > high:
            self.mode, self.fault = 1, 39
        self.since = self.fed = time.monotonic()

    def _target(self, now: float) -> tuple[float, float]:
        speed = self.command[0x21]
        target = self.command[0x20] + speed * (now - self.since)
        # beyond its bounds the firmware clamps the set point, and stays in position mode
        for name, inner in (("servopos.position_min", max), ("servopos.position_max", min)):
            if not math.isnan(bound := self.config[name]) and inner(target, bound) != target:
                target, speed = bound, 0.0
        return target, speed

    def _torque_constant(self) -> float:
        """Return what the firmware has: it does not know that a motor turns against its current."""
        return abs(self.motor.torque_constant) / self.config["motor_position.rotor_to_output_ratio"]

    def _position(self) -> float:
        ratio = self.config["motor_position.rotor_to_output_ratio"]
        return self.motor.position / TURN * ratio

    def encoder_position(self) -> float:
        """Return what the commutation encoder shows, in turns from 0 to 1."""
        return (self.sign * self.motor.position / TURN + self.encoder) % 1.0

    def compensation(self, shaft: float) -> float:
        """Return the current of the stored table where the shaft is at an angle, rad; A."""
        place = (self.sign * shaft / TURN + self.encoder) % 1.0 * CODES
        left = min(CODES - 1, int(place))
        codes = [self.config[f"{TABLE}{i % CODES}"] for i in (left, left + 1)]
        value = codes[0] + (codes[1] - codes[0]) * (place - left)
        return float(value * self.config["motor.cogging_dq_scale"])

    def _added(self) -> float:
        return self.compensation(self.motor.position) if self.mode == 10 else 0.0
