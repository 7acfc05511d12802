"""A VESC with one motor: frames, telemetry, limits, and its timeout, as bldc 6 has them.

Faults: set points without a reply; frames with a wrong check dropped without a word; values rounded
to 10 mA, 1 ERPM and 0.1 degC; the mean current of the time since the last question; an angle of one
turn; a motor that stays released below its smallest current; a timeout that only set points feed,
looked at every 10 ms.
"""

import binascii
import math
import struct
import time

import numpy as np

from rigtool.rigs.serial.emulators.motor import EmulatedMotor
from rigtool.rigs.serial.emulators.server import Emulator

LOOK = 0.01
FIELDS = {1: "h", 5: "i", 7: "i", 15: "B", 16: "i", 21: "B"}
LIMITS = (1.0, 1.0, -1e5, 1e5, 0.005, 0.95, -15e5, 15e5, -60.0, 99.0)


class VescEmulator(Emulator):
    """`timeout` in s; `smallest` current in A; `log` names what happened."""

    def __init__(self, *, timeout=0.2, smallest=0.005, poles=14, old=False, thermistor=True):
        self.motor = EmulatedMotor()
        self.timeout, self.smallest, self.poles, self.old = timeout, smallest, poles, old
        self.thermistor = thermistor
        self.log = []
        self.claimed_poles = poles
        self.reset()

    def reset(self):
        self.buffer = b""
        self.limits = tuple(np.float32(value) for value in LIMITS)
        self.current, self.mode, self.fault = 0.0, None, 0
        self.fed, self.looked, self.timed_out = -math.inf, -math.inf, True
        self.sum = self.count = 0.0
        self.position_then = time.monotonic()

    def refuse(self, count):
        """Have a fault: the motor is released."""
        self.fault, self.mode = 2, None

    # -- time

    def idle(self):
        self.turn()
        now = time.monotonic()
        if now - self.looked >= LOOK:
            self.looked = now
            before, self.timed_out = self.timed_out, now - self.fed > self.timeout > 0
            if self.timed_out:
                self.mode, self.current = None, 0.0
                if not before:
                    self.log.append("timeout")
        return b""

    def turn(self):
        now = time.monotonic()
        span, self.position_then = now - self.position_then, now
        self.sum += span * (self.motor.current if self.mode else 0.0)
        self.count += span
        highest = float(self.limits[3]) / (self.poles / 2) * 2 * math.pi / 60
        left = (highest - abs(self.motor.speed)) / (0.2 * highest)
        self.motor.advance(self.mode, 0.0, 0.0, self.current * min(max(left, 0.0), 1.0))

    # -- frames

    def receive(self, data):
        self.buffer += data
        out = b""
        while (found := self.next_frame()) is not None:
            self.idle()
            out += self.process(found)
        return out

    def next_frame(self):
        """Return the next whole payload with the right check; drop bytes that begin none."""
        while self.buffer:
            start = self.buffer[0]
            head = 2 if start == 2 else 3
            if start in (2, 3):
                if len(self.buffer) < head:
                    return None
                size = int.from_bytes(self.buffer[1:head], "big")
                valid = 1 <= size <= 512 and (start == 2 or size >= 255)
                if valid and len(self.buffer) < head + size + 3:
                    return None
                payload, tail = (
                    self.buffer[head : head + size],
                    self.buffer[head + size : head + size + 3],
                )
                if valid and tail == checked(payload):
                    self.buffer = self.buffer[head + size + 3 :]
                    return payload
            self.buffer = self.buffer[1:]
        return None

    def process(self, payload):
        command, data = payload[0], payload[1:]
        if command == 0:
            name = b"" if self.old else bytes(range(12))
            return framed(bytes([0, 3 if self.old else 6, 5]) + b"60_MK6\0" + name)
        if command == 6 and len(data) == 4:
            self.set_current(struct.unpack(">i", data)[0] / 1e3)
        elif command == 50 and len(data) == 4:
            return self.values(struct.unpack(">I", data)[0])
        elif command == 91 and not self.old:
            return framed(struct.pack(">B10fBff", 91, *self.limits, self.claimed_poles, 1.0, 0.1))
        elif command == 48 and len(data) in (36, 44):
            self.limits = struct.unpack(">10f", data[4:])
            self.log.append(f"limits {self.limits[3]:.0f}")
            return framed(bytes([48])) if data[2] else b""
        return b""

    def set_current(self, current):
        self.fed = time.monotonic()
        if self.fault:
            return
        if (self.mode is not None) != (abs(current) >= self.smallest):
            self.log.append("released" if self.mode else "running")
        self.mode = "current" if abs(current) >= self.smallest else None
        self.current = current if self.mode else 0.0

    def values(self, mask):
        erpm = self.motor.speed * 60 / (2 * math.pi) * self.poles / 2
        degrees = math.degrees(self.motor.position) % 360.0
        mean = self.sum / self.count if self.count else 0.0
        self.sum = self.count = 0.0
        known = {
            1: 312 if self.thermistor else -2000,
            5: int(mean * 100),
            7: int(erpm),
            15: self.fault,
            16: int(np.float32(degrees) * 1e6) % 360000000,
            21: int(self.timed_out),
        }
        asked = [bit for bit in FIELDS if mask >> bit & 1]
        asked = [bit for bit in asked if bit != 21 or not self.old]
        layout = ">BI" + "".join(FIELDS[bit] for bit in asked)
        return framed(struct.pack(layout, 50, mask, *(known[bit] for bit in asked)))


def checked(payload):
    return binascii.crc_hqx(payload, 0).to_bytes(2, "big") + b"\3"


def framed(payload):
    return bytes([2, len(payload)]) + payload + checked(payload)
