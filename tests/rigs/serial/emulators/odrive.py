"""An ODrive with one motor: its ASCII protocol, its watchdog, and its known faults.

Faults: commands without a word of reply, wrong checksums ignored in silence, replies cut to 64
bytes and values to 9 characters, a watchdog that also runs out at rest and does not start when it
is turned on, firmware 0.6 that drops a reply while another is being sent.
"""

from __future__ import annotations

import re
import time
from collections.abc import Sequence

import numpy as np

from rigtool.rigs.serial.emulators.motor import EmulatedMotor
from rigtool.rigs.serial.emulators.server import Emulator
from rigtool.rigs.serial.odrive.text import DIALECT_05, DIALECT_06, xor_checksum

TURN = 2 * np.pi
LINE = 256
REPLY = 64
VALUE = 9

IDLE, CLOSED_LOOP = 1, 8
MODES = {1: "current", 2: "velocity", 3: "position"}

Value = float | int | bool


class ODriveEmulator(Emulator):
    """Axis 0 of an ODrive; `words` has it say true and false instead of 1 and 0.

    `properties` are what it is set to now; `saved` comes back with `reset`. `log` names what
    happened, for tests.
    """

    def __init__(
        self,
        firmware: tuple[int, int, int] = (0, 5, 6),
        *,
        words: bool = False,
        thermistor: bool = False,
        direction: int = 1,
    ) -> None:
        self.firmware, self._words = firmware, words
        self.dialect = DIALECT_05 if firmware < (0, 6, 0) else DIALECT_06
        self.motor = EmulatedMotor()
        self.saved: dict[str, Value] = {
            self.dialect.current_limit: 30.0,
            self.dialect.torque_constant: 0.045,
            self.dialect.motor_type: 0,
            self.dialect.direction[0]: direction,
            "controller.config.pos_gain": 20.0,
            "controller.config.vel_limit": 50.0,
            "controller.config.vel_limit_tolerance": 1.2,
            "controller.config.enable_vel_limit": True,
            "controller.config.enable_overspeed_error": True,
            "controller.config.control_mode": 3,
            "controller.config.input_mode": 3,
            "controller.config.circular_setpoints": False,
            "config.enable_watchdog": False,
            "config.watchdog_timeout": 0.0,
            "controller.input_pos": 0.0,
            "controller.input_vel": 0.0,
            "controller.input_torque": 0.0,
            "requested_state": 0,
            f"{self.dialect.thermistor[0]}.config.enabled": thermistor,
            f"{self.dialect.thermistor[0]}.config.temp_limit_lower": 100.0,
            f"{self.dialect.thermistor[0]}.config.temp_limit_upper": 120.0,
            f"{self.dialect.thermistor[0]}.temperature": 31.25,
            **dict.fromkeys(self.dialect.errors, 0),
        }
        self.log: list[str] = []
        self.calibrated = True
        self.reset()

    def reset(self) -> None:
        """Restart: saved settings, idle, and an encoder that counts from here."""
        self.properties = dict(self.saved)
        self.state = IDLE
        self._buffer = b""
        self._refusals = 0
        self._zero = self.motor.position
        self._left = 0.0  # of the watchdog, s
        self._then = time.monotonic()
        self._sending = False
        self.log.append("reset")

    def refuse(self, count: int) -> None:
        """Answer the next requests as a firmware does that cannot do them."""
        self._refusals = count

    def trip(self, error: int) -> None:
        """Have a fault: the motor is let go."""
        self.properties[self.dialect.errors[0]] = int(self[self.dialect.errors[0]]) | error
        self.state = IDLE

    def __getitem__(self, name: str) -> float:
        return float(self.properties[name])

    # -- time

    def idle(self) -> bytes:
        """Turn the motor, run the watchdog down, take up a state that was asked for."""
        now = time.monotonic()
        span, self._then = now - self._then, now
        if self.properties["config.enable_watchdog"]:
            self._left -= span
            if self._left <= 0 and not self._expired:
                self.log.append("watchdog")
                self.trip(self.dialect.watchdog_error)
        self._change_state()
        self._turn()
        limit = self["controller.config.vel_limit"] * self["controller.config.vel_limit_tolerance"]
        if self.state == CLOSED_LOOP and abs(self.motor.speed) > limit * TURN:
            self.log.append("overspeed")
            self.trip(0x200 if self.dialect is DIALECT_05 else 0x8000)
        return b""

    @property
    def _expired(self) -> bool:
        return bool(int(self[self.dialect.errors[0]]) & self.dialect.watchdog_error)

    def _change_state(self) -> None:
        wanted = int(self["requested_state"])
        self.properties["requested_state"] = 0
        if wanted == IDLE:
            self.log.append("idle")
            self.state = IDLE
        elif wanted == CLOSED_LOOP and not self.calibrated:
            self.trip(0x1 if self.dialect is DIALECT_05 else 0x10)
        elif wanted == CLOSED_LOOP and not self[self.dialect.errors[0]]:
            if self["controller.config.control_mode"] == 3:
                self.properties["controller.input_pos"] = self._position
            self.log.append("closed loop")
            self.state = CLOSED_LOOP

    def _turn(self) -> None:
        mode = MODES.get(int(self["controller.config.control_mode"]))
        self.motor.current_limit = self[self.dialect.current_limit]
        self.motor.gain_position = self["controller.config.pos_gain"]
        limit = self["controller.config.vel_limit"]
        self.motor.advance(
            mode if self.state == CLOSED_LOOP else None,
            self["controller.input_pos"] * TURN + self._zero,
            min(max(self["controller.input_vel"], -limit), limit) * TURN,
            self["controller.input_torque"] / max(self[self.dialect.torque_constant], 1e-9),
        )

    @property
    def _position(self) -> float:
        return (self.motor.position - self._zero) / TURN

    # -- lines

    def receive(self, data: bytes) -> bytes:
        """Take bytes, and answer each whole line."""
        self._sending = False
        self._buffer += data
        *lines, self._buffer = re.split(rb"[\r\n!]", self._buffer)
        if len(self._buffer) >= LINE:
            self._buffer = b""
        out = b""
        for line in lines:
            self.idle()
            reply = self._process(line)
            if reply and self._sending and self.firmware >= (0, 6, 0):
                continue  # the one before is still on its way
            self._sending = self._sending or bool(reply)
            out += reply
        return out

    def _process(self, line: bytes) -> bytes:
        body, star, check = line.partition(b";")[0].partition(b"*")
        sealed = bool(star and check)
        if sealed:
            digits = re.match(rb"\s*(\d+)", check)
            if not digits or int(digits[1]) != xor_checksum(body):
                return b""
        text = body.decode("latin-1")
        if self._refusals:
            self._refusals -= 1
            return self._say("not implemented", sealed)
        return b"".join(self._say(reply, sealed) for reply in self._answer(text))

    def _say(self, text: str, sealed: bool) -> bytes:
        data = text.encode("latin-1")[:REPLY]
        data += b"*%d\r\n" % xor_checksum(data) if sealed else b"\r\n"
        return data[:REPLY]

    def _answer(self, text: str) -> Sequence[str]:
        words = text.split()
        match text[:1]:
            case "p" | "q" | "v" | "c" | "t" | "f" | "u":
                return self._of_axis(text[0], words[1:])
            case "i":
                version = ".".join(map(str, self.firmware))
                return ("Hardware version: 3.6-56", f"Firmware version: {version}", SERIAL)
            case "s":
                self._system(text[1:2])
                return ()
            case "r" if len(words) > 1:
                return (self._read(words[1]),)
            case "w" if len(words) > 1:
                return self._write(words[1], words[2] if len(words) > 2 else "0")
            case "r" | "w":
                return ("invalid command format",)
        return ("unknown command",)

    def _of_axis(self, command: str, words: Sequence[str]) -> Sequence[str]:
        try:
            axis, *numbers = int(words[0]), *(float(np.float32(word)) for word in words[1:])
        except (ValueError, IndexError):
            return ("invalid command format",)
        if axis != 0:
            return (f"invalid motor {axis}",)
        if command == "f":
            self._turn()
            return (f"{np.float32(self._position):f} {np.float32(self.motor.speed / TURN):f}",)
        if command != "u" and not numbers:
            return ("invalid command format",)
        self._left = self["config.watchdog_timeout"]
        inputs = {
            "p": ("pos", "vel", "torque"),
            "q": ("pos",),
            "t": ("pos",),
            "v": ("vel", "torque"),
            "c": ("torque",),
        }
        if command in inputs:
            mode = {"v": 2, "c": 1}.get(command, 3)
            self.properties["controller.config.control_mode"] = mode
            for name, value in zip(inputs[command], numbers, strict=False):
                self.properties[f"controller.input_{name}"] = value
        return ()

    def _system(self, which: str) -> None:
        if which == "c":
            for name in self.dialect.errors:
                self.properties[name] = 0
        elif which == "s":
            self.saved = {**self.properties, **dict.fromkeys(self.dialect.errors, 0)}
        elif which == "r":
            self.reset()

    # -- properties

    def _read(self, name: str) -> str:
        axis, _, rest = name.partition(".")
        if axis == "axis0" and rest == "current_state":
            return str(self.state)
        sign = self[self.dialect.direction[0]]
        if axis == "axis0" and rest in (self.dialect.current, self.dialect.current_setpoint):
            self._turn()
            motor = self.motor
            current = motor.current if rest == self.dialect.current else motor.current_setpoint
            return self._format(sign * current)
        if axis != "axis0" or rest not in self.properties:
            return "invalid property"
        return self._format(self.properties[rest])

    def _format(self, value: Value) -> str:
        if isinstance(value, bool) and self._words:
            return "true" if value else "false"
        if isinstance(value, int):
            return str(int(value))[:VALUE]
        return f"{np.float32(value):f}"[:VALUE]

    def _write(self, name: str, text: str) -> Sequence[str]:
        axis, _, rest = name.partition(".")
        if axis != "axis0" or rest not in self.properties:
            return ("invalid property",)
        try:
            value = float(np.float32({"true": "1", "false": "0"}.get(text, text)))
        except ValueError:
            return ("not implemented",)
        self.properties[rest] = type(self.properties[rest])(value)
        if rest != "requested_state":
            self.log.append(f"{rest} {text}")
        return ()


SERIAL = "Serial number: 2060358F524B"
