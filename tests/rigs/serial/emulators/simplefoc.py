"""A SimpleFOC sketch with one motor: its Commander, as `Commander.cpp` of Arduino-FOC 2.4 has it.

Faults: 20 characters a line, longer ones are dropped without a word; four kinds of answers, and
none at all in verbosity 0; no checksum, no watchdog; a start that switches the motor on; the
monitor's lines between the answers; floats of 4 bytes, printed with `decimals`.
"""

import re
import time

import numpy as np

from rigtool.rigs.serial.emulators.motor import EmulatedMotor
from rigtool.rigs.serial.emulators.server import Emulator

LONGEST = 20
MOTIONS = ("torque", "vel", "angle", "vel open", "angle open", "angle nocascade", "custom")
TORQUES = ("volt", "dc curr", "foc curr", "est. curr")
NOTHING, USER_FRIENDLY, MACHINE = 0, 2, 3


LABELS = (("T", "target angle"), ("M", "motor"))


class SimpleFocEmulator(Emulator):
    """Commands T (a scalar) and M (the motor); `log` names what was switched.

    `watchdog` [s] is that of the sketch in docs/bench-simplefoc.md, None for one without it.
    """

    def __init__(self, *, torque=2, labels=LABELS, verbose=2, watchdog=0.25):
        self.motor = EmulatedMotor()
        self.torque_at_start, self.labels, self.verbose_at_start = torque, labels, verbose
        self.log = []
        self.watchdog = watchdog
        self.reset()

    def reset(self):
        self.buffer = ""
        self.verbose, self.decimals = self.verbose_at_start, 3
        self.torque, self.motion = self.torque_at_start, 1
        self.limits = {"C": 2.0, "U": 12.0, "V": 20.0}
        self.target, self.enabled = 0.0, 1  # initFOC leaves it switched on
        self.variables = "1100011"
        self.refusals = 0
        self.heard = time.monotonic()

    @property
    def mode(self):
        """How the motor is driven, None where it is off."""
        return ("current", "velocity", "position")[self.motion] if self.enabled else None

    def refuse(self, count):
        self.refusals = count

    def idle(self):
        self.turn()
        silent = self.watchdog is not None and time.monotonic() - self.heard > self.watchdog
        if silent and self.enabled:
            self.enabled = 0
            self.log.append("watchdog")
        return b""

    def turn(self):
        self.motor.current_limit = self.limits["C"]
        target = self.target
        self.motor.advance(self.mode, target, target, target if self.motion == 0 else 0.0)

    def receive(self, data):
        out = ""
        if data:
            self.heard = time.monotonic()
        for character in data.decode("latin-1"):
            self.buffer += character
            if character in "\r\n":
                self.turn()
                out += self.run(self.buffer)
                self.buffer = ""
            elif len(self.buffer) >= LONGEST:
                self.buffer = ""
        return out.encode("latin-1")

    # -- what Commander prints

    def word(self, value):
        if isinstance(value, float):
            return f"{np.float32(value):.{self.decimals}f}"
        return str(value)

    def say(self, machine, friendly, *values):
        """Return an answer with what each verbosity puts before the values."""
        if self.verbose == NOTHING:
            return ""
        before = {USER_FRIENDLY: friendly, MACHINE: machine}.get(self.verbose, "")
        return before + ";".join(self.word(value) for value in values) + "\r\n"

    def run(self, text):
        command, rest = text[0], text[1:].rstrip("\r\n")
        if command == "?":
            return "".join(self.say("?", "", f"{name}:{label}") for name, label in self.labels)
        if command == "@":
            self.verbose = int(number(rest)) if rest else self.verbose
            return self.say("@", "Verb:", "machine" if self.verbose == MACHINE else "on!")
        if command == "#":
            self.decimals = int(number(rest)) if rest else self.decimals
            return self.say("#", "Decimal:", self.decimals)
        if command == "T" and ("T", "target angle") in self.labels:
            self.target = number(rest) if rest else self.target
            return self.say("T", "", self.target)
        if command not in [name for name, _ in self.labels]:
            return ""
        if self.refusals:
            self.refusals -= 1
            return self.say(command, "", "err")
        return self.of_motor(command, rest)

    def of_motor(self, letter, text):
        if not text:
            return self.say(letter, "", self.target) if self.verbose == MACHINE else ""
        if text[0] in "0123456789+-":
            self.target = float(np.float32(number(text)))
            return self.say(letter, "Target: ", self.target)
        sub = text[1:2] if text[1:2].isupper() else ""
        value = text[1 + len(sub) :]
        return self.answer(letter + text[0] + sub, text[0], sub, value)

    def answer(self, machine, command, sub, value):
        match command, sub:
            case "C", "":
                if value and 0 <= number(value) < len(MOTIONS):
                    self.motion, self.target = int(number(value)), 0.0
                return self.say(machine, "Motion:", MOTIONS[self.motion])
            case "T", "":
                self.torque = int(number(value)) if value else self.torque
                return self.say(machine, "Torque: ", TORQUES[self.torque])
            case "E", "":
                if value:
                    self.enabled = int(bool(number(value)))
                    self.log.append("on" if self.enabled else "off")
                return self.say(machine, "Status: ", self.enabled)
            case "L", _ if sub in self.limits:
                self.limits[sub] = number(value) if value else self.limits[sub]
                return self.say(machine, "Limits| ", float(self.limits[sub]))
            case "M", "G" if value == "7":
                return self.say(machine, "Monitor | all: ", *self.state())
            case "M", "S":
                self.variables = value or self.variables
                return self.say(machine, "Monitor | ", self.variables)
            case "M", "C":
                self.variables = "0000000"
                return self.say(machine, "Monitor | ", "clear")
        return self.say(machine, "unknown cmd ", "err")

    def state(self):
        measured = self.motor.current if TORQUES[self.torque] != "volt" else 0.0
        return self.target, 0.5, 0.0, measured, 0.0, self.motor.speed, self.motor.position


def number(text):
    """Return what C's `atof` returns."""
    found = re.match(r"\s*[-+]?\d*\.?\d*", text)
    return float(found[0]) if found and found[0].strip("+-. ") else 0.0
