"""KERN and Sauter instruments that speak KCP: `SI` asks for the reading at once, `S S 100.00 g`.

S is stable, D still moving (counted, and used: a step of current moves it, and the time of settling
is left out afterwards), + and - above and below its range, I not possible now. A scale shows the
mass, converted into force by standard gravity. Source: manuals of CKE, KIB, FS.
"""

from __future__ import annotations

import math
import re

from rigtool.rigs.serial.instruments import readings
from rigtool.rigs.serial.line import DamagedReply, Line

BAUD_RATE = 9600

ERRORS = ("ES", "EL", "ET")  # unknown command, wrong parameter, damaged on its way
_FLAGS = {"+": readings.OVERLOAD, "-": readings.UNDERRANGE}
_REPLY = re.compile(r"S ([SD]) +([+-]? *\d+\.?\d*) +([A-Za-z]+)", re.ASCII)
_IDENTITY = re.compile(r'I4 A "([^"]*)"')


def parse(line: bytes, channel: str, form: readings.Form) -> readings.Reading:
    """Return the reading in a line; raises `DamagedReply`, or `HardwareError` for one of no use."""
    text = readings.as_text(line)
    if text in ERRORS:
        raise DamagedReply(f"the instrument answers {text}: the question came to it damaged")
    if text.startswith("S ") and (flag := _FLAGS.get(text[2:])):
        return readings.Reading(math.nan, flag)
    found = _REPLY.fullmatch(text)
    if found is None:
        raise DamagedReply(f"{text!r} is not a reading")
    state, digits, unit = found.groups()
    digits = digits.replace(" ", "")
    value = readings.number(digits)
    form.require(digits, unit)
    flag = readings.UNSTABLE if state == "D" else ""
    return readings.Reading(readings.to_si(value, unit, channel), flag)


class Kern(readings.Polled):
    """Asks for one reading after the other, no faster than the instrument answers."""

    pause = 0.1

    def connect(self) -> str:
        """Return the kind of instrument with its number; `HardwareError` where none answers."""
        identity = _describe(self.ask(b"I4\r\n", readings.as_text))
        self._form.learn(self.read)
        return identity

    def read(self) -> readings.Reading:
        """Return the next reading; raises `HardwareError` where the instrument is lost."""
        return self.ask(b"SI\r\n", lambda line: parse(line, self._channel, self._form))


make_reader = Kern


def _describe(reply: str) -> str:
    found = _IDENTITY.fullmatch(reply)
    return f"KERN instrument {found.group(1)}" if found else "KERN instrument"


def probe(line: Line) -> str | None:
    """Return the identity of the instrument that speaks KCP, None for another device."""

    def accept(reply: bytes) -> str | None:
        text = reply.decode("latin-1").strip()
        return _describe(text) if _IDENTITY.fullmatch(text) else None

    # The first end of line ends the rest of an earlier question in the instrument.
    return line.ask(b"\r\nI4\r\n", accept)
