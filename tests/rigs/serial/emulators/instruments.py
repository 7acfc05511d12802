"""Force gauges and thermometers: their protocols byte for byte, and what they say when in trouble.

Each shows what `quantity()` returns, in the unit it displays: a function of yours, e.g. of an
emulated motor's current. Signs are those of the device.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable

from rigtool.rigs.serial.emulators.server import Emulator

Quantity = Callable[[], float]


class Instrument(Emulator):
    """What they share: lines, a range, a number of decimals, `refuse`; fill in `answer`.

    `ends` are the characters that end a request; empty where each character is one.
    """

    ends = b"\n"

    def __init__(
        self,
        quantity: Quantity,
        *,
        unit: str = "N",
        decimals: int = 3,
        highest: float = math.inf,
    ) -> None:
        self.quantity, self.unit, self.decimals = quantity, unit, decimals
        self.highest = highest
        self.asked: list[bytes] = []
        self.reset()

    def reset(self) -> None:
        """Restart; a gauge keeps its settings."""
        self._buffer = b""
        self._refusals = 0

    def refuse(self, count: int) -> None:
        """Refuse the next requests."""
        self._refusals = count

    def receive(self, data: bytes) -> bytes:
        """Answer each whole request."""
        self._buffer += data
        replies = b""
        while self._buffer:
            place = min((self._buffer.find(bytes([end])) + 1 or 1 << 30) for end in self.ends)
            if place > len(self._buffer):
                break
            request, self._buffer = self._buffer[:place], self._buffer[place:]
            if not (request := request.strip(b"\r\n")):
                continue
            self.asked.append(request)
            if self._refusals:
                self._refusals -= 1
                replies += self.refusal()
            else:
                replies += self.answer(request)
        return replies

    def answer(self, request: bytes) -> bytes:
        """Return what is answered to a request without its end."""
        raise NotImplementedError

    def refusal(self) -> bytes:
        """Return what is said to a request that is refused; silence by default."""
        return b""

    def shown(self) -> str | None:
        """Return the number on the display, None where it is out of range."""
        value = self.quantity()
        return None if abs(value) > self.highest else f"{value:.{self.decimals}f}"


class Mark10Emulator(Instrument):
    """Mark-10; `real_time` false is a series 4, which knows `?` alone; `says_unit` a setting."""

    ends = b"\r"
    real_time = True
    says_unit = True

    def answer(self, request: bytes) -> bytes:
        """Know `?` and `?C`; anything else is illegal."""
        if request != b"?" and not (request == b"?C" and self.real_time):
            return b"*10\r\n"
        shown = self.shown()
        if shown is None:
            return b"OVER\r\n"
        return f"{shown} {self.unit}\r\n".encode() if self.says_unit else f"{shown}\r\n".encode()

    def refusal(self) -> bytes:
        """Return that it does not apply now."""
        return b"*11\r\n"


class SauterEmulator(Instrument):
    """Sauter FH: 7 characters without an end; pull is positive at the device."""

    ends = b""

    def receive(self, data: bytes) -> bytes:
        """Every character is a command; only `9` is answered."""
        replies = b""
        for character in data:
            self.asked.append(bytes([character]))
            if self._refusals:
                self._refusals -= 1
            elif character == ord("9"):
                value = self.quantity()
                size = f"{abs(value):0{6}.{self.decimals}f}"
                replies += (("1" if value >= 0 else "0") + size).encode()[:7]
        return replies


class MecmesinEmulator(Instrument):
    """Mecmesin CFG+; `informs` false is an AFG that knows neither `U` nor `M`."""

    ends = b""
    informs = True
    mode = "Normal"
    faulty = False

    def receive(self, data: bytes) -> bytes:
        """Every character is a command."""
        replies = b""
        for character in data:
            request = bytes([character])
            self.asked.append(request)
            if self._refusals:
                self._refusals -= 1
            else:
                replies += self.answer(request)
        return replies

    def answer(self, request: bytes) -> bytes:
        """Know `?`, `b`, and `U` and `M` where it informs."""
        if request == b"b":
            self.unit = "N"
        elif request == b"?":
            return b"xxxx\r\n" if self.faulty else f"{self.shown()}\r\n".encode()
        elif request in (b"U", b"M") and self.informs:
            return f"{self.unit if request == b'U' else self.mode}\r\n".encode()
        return b""


class KernEmulator(Instrument):
    """A KERN scale or gauge that speaks KCP; `moving` says that it is not at rest."""

    moving = False

    def answer(self, request: bytes) -> bytes:
        """Know `SI` and `I4`."""
        if request == b"I4":
            return b'I4 A "K123456"\r\n'
        if request != b"SI":
            return b"ES\r\n"
        shown = self.shown()
        if shown is None:
            return b"S +\r\n" if self.quantity() > 0 else b"S -\r\n"
        return f"S {'D' if self.moving else 'S'} {shown:>10} {self.unit}\r\n".encode()

    def refusal(self) -> bytes:
        """Return that it is busy."""
        return b"S I\r\n"


class ScpiEmulator(Instrument):
    """A multimeter, or with `hart` a thermometer of Hart Scientific, which says nothing else."""

    hart = False
    function = '"TEMP"'

    def answer(self, request: bytes) -> bytes:
        """Know what a thermometer needs."""
        shown = self.shown()
        if self.hart:
            return f"t: {shown} {self.unit}\r\n".encode() if request == b"FETC?" else b""
        if request == b"READ?":
            value = float(shown) if shown is not None else 9.9e37
            return f"{value:+.8E}\r\n".encode()
        answers = {
            b"*IDN?": "KEITHLEY INSTRUMENTS INC.,MODEL 2110,8004040,1.02",
            b"FUNC?": self.function,
            b"UNIT:TEMP?": self.unit,
        }
        return f"{answers[request]}\r\n".encode() if request in answers else b""


class NumberLinesEmulator(Instrument):
    """A logger that sends a number every `period` s; `greeting` is what it says at first."""

    period = 0.01
    greeting = b""
    word = ""
    """Said in place of numbers, e.g. nan."""

    def reset(self) -> None:
        """Restart: it greets anew."""
        super().reset()
        self._next = 0.0
        self._greeted = False

    def receive(self, data: bytes) -> bytes:
        """Not listen."""
        return b""

    def idle(self) -> bytes:
        """Send the next number in time."""
        now = time.monotonic()
        if now < self._next:
            return b""
        self._next = now + self.period
        if not self._greeted:
            self._greeted = True
            if self.greeting:
                return self.greeting
        unit = f" {self.unit}" if self.unit else ""
        return f"{self.word or self.shown()}{unit if not self.word else ''}\r\n".encode()
