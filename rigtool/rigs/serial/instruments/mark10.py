"""Mark-10 force gauges, series 4, 5 and 7: `?C` asks for the reading, e.g. `-18.78 lbF`.

Compression is positive, tension negative, as here. Source: user's guides of series 4 and 5 (GCL2).
"""

from __future__ import annotations

import math
import re

from rigtool.errors import HardwareError
from rigtool.rigs.serial.instruments import readings
from rigtool.rigs.serial.line import DamagedReply, Line

BAUD_RATE = 115200

UNKNOWN = "*10"
ERRORS = {"*11": "not applicable", "*12": "invalid specifier", "*22": "value too large"}
_REPLY = re.compile(r"([+-]?\d+\.?\d*) ?([A-Za-z]*)", re.ASCII)


def parse(line: bytes, channel: str, form: readings.Form) -> readings.Reading:
    """Return the reading in a line; raises `DamagedReply`, or `HardwareError` for a refusal."""
    text = readings.as_text(line)
    if text == UNKNOWN:
        raise DamagedReply("the gauge does not know the question, which was damaged")
    if text in ERRORS:
        raise HardwareError(f"the gauge refuses: {text} ({ERRORS[text]})")
    if flag := readings.flag_of(text):
        return readings.Reading(math.nan, flag)
    found = _REPLY.fullmatch(text)
    if found is None:
        raise DamagedReply(f"{text!r} is not a reading")
    digits, unit = found.groups()
    value = readings.number(digits)
    form.require(digits, unit)
    if not unit:
        raise HardwareError(
            "the gauge sends no unit: switch it on under Serial/USB Settings, Data Format"
        )
    return readings.Reading(readings.to_si(value, unit, channel))


class Mark10(readings.Polled):
    """Asks for one reading after the other."""

    _request = b"?C\r"

    def connect(self) -> str:
        """Return the kind of gauge; raises `HardwareError` where there is none or it has no unit.

        Series 4 does not know `?C`: `?` is sent instead, and it must not be in a peak mode.
        """
        knows = any(self.ask(self._request, readings.as_text) != UNKNOWN for _ in range(2))
        if not knows:
            self._request = b"?\r"
        self._form.learn(self.read)
        return "Mark-10 force gauge" + ("" if knows else ", read from its display")

    def read(self) -> readings.Reading:
        """Return the next reading; raises `HardwareError` where the gauge refuses."""
        return self.ask(self._request, lambda line: parse(line, self._channel, self._form))


make_reader = Mark10


def probe(line: Line) -> str | None:
    """Return the identity of the Mark-10 gauge that answers, None for another device."""

    def take() -> str | None:
        # The first CR ends the rest of an earlier question in the gauge.
        while (text := readings.as_text(readings.next_line(line, line.timeout))) == UNKNOWN:
            pass
        found = _REPLY.fullmatch(text)
        return f"Mark-10 force gauge, answers {text}" if found and found.group(2) else None

    return line.exchange(b"\r?\r", take)
