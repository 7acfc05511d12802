"""Devices that send a number a line by themselves: loggers of load cells (HX711), Pt100 (MAX31865).

A unit may follow the number; without one it is that of the channel. Words like nan, OL or
fault are counted, and are no value. The first line is left out: it may have begun earlier.
"""

from __future__ import annotations

import math
import re
import time

from rigtool.rigs.serial.instruments import readings
from rigtool.rigs.serial.line import DamagedReply, Line, LineTimeout

BAUD_RATE = 115200
NUMBER_TIMEOUT = 0.5
GREETING_TIME = 10.0
"""Time in which a board that restarts when its port is opened must send numbers, s."""

LISTENING_TIME = 0.6
"""Time in which a logger is expected to send something, s."""

_LINE = re.compile(r"(\S+?)(?:\s*([A-Za-z°]+))?", re.ASCII)


def parse(line: bytes, channel: str, form: readings.Form) -> readings.Reading:
    """Return the reading in a line.

    Raises `DamagedReply`, or `HardwareError` for a unit of something else.
    """
    text = readings.as_text(line)
    if flag := readings.flag_of(text):
        return readings.Reading(math.nan, flag)
    found = _LINE.fullmatch(text)
    if found is None:
        raise DamagedReply(f"{text!r} is not a number")
    value, unit = readings.number(found.group(1)), found.group(2) or ""
    form.require_unit(found.group(1), unit)  # loggers leave zeros out
    return readings.Reading(readings.to_si(value, unit or readings.BARE_UNITS[channel], channel))


class NumberLines(readings.Reader):
    """Listens."""

    streams = True

    def connect(self) -> str:
        """Wait for the first whole number; raises `HardwareError` where none comes."""
        readings.next_line(self._line, GREETING_TIME)
        deadline = time.monotonic() + GREETING_TIME
        while True:
            try:
                self._form.learn(self.read)
                return "sends numbers"
            except (LineTimeout, DamagedReply):
                if time.monotonic() > deadline:
                    raise

    def read(self) -> readings.Reading:
        """Return the next reading; raises `LineTimeout` or `DamagedReply` where it is none."""
        return parse(readings.next_line(self._line, NUMBER_TIMEOUT), self._channel, self._form)


make_reader = NumberLines


def probe(line: Line) -> str | None:
    """Return the text that comes without a request, None where it is no number."""
    readings.next_line(line, LISTENING_TIME)
    text = readings.next_line(line, LISTENING_TIME)
    found = _LINE.fullmatch(readings.as_text(text))
    if found is None:
        return None
    readings.number(found.group(1))
    return f"sends numbers by itself, e.g. {readings.as_text(text)}"
