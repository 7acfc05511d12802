"""Devices that send a number a line by themselves: loggers of load cells (HX711), Pt100 (MAX31865).

A unit may follow the number; without one it is that of the channel. Words like nan, OL or
fault are counted, and are no value. The first line is left out: it may have begun earlier.
"""

from __future__ import annotations

import math
import re
import time

from rigtool.rigs.serial.instruments.readings import (
    Form,
    Reading,
    as_text,
    flag_of,
    next_line,
    number,
    to_si,
)
from rigtool.rigs.serial.line import DamagedReply, Line, LineTimeout

BAUD_RATE = 115200
NUMBER_TIMEOUT = 0.5
GREETING_TIME = 10.0
"""Time in which a board that restarts when its port is opened must send numbers, s."""

LISTENING_TIME = 0.6
"""Time in which a logger is expected to send something, s."""

_LINE = re.compile(r"(\S+?)(?:\s*([A-Za-z°]+))?", re.ASCII)
_SI = {"force": "N", "temperature": "C", "deflection": "m"}


def parse(line: bytes, channel: str, form: Form) -> Reading:
    """Return the reading in a line.

    Raises `DamagedReply`, or `HardwareError` for a unit of something else.
    """
    text = as_text(line)
    if flag := flag_of(text):
        return Reading(math.nan, flag)
    found = _LINE.fullmatch(text)
    if found is None:
        raise DamagedReply(f"{text!r} is not a number")
    value, unit = number(found.group(1)), found.group(2) or ""
    form.require_unit(found.group(1), unit)  # loggers leave zeros out
    return Reading(to_si(value, unit or _SI[channel], channel))


class NumberLines:
    """Listens."""

    streams = True
    pause = 0.0
    resolution = 0.0

    def __init__(self, line: Line, channel: str) -> None:
        self._line, self._channel = line, channel
        self._form = Form()

    @property
    def finest(self) -> float:
        """A step of the last decimal in the unit of the channel, by the first readings."""
        return self._form.finest(self._channel, _SI[self._channel])

    def connect(self) -> str:
        """Wait for the first whole number; raises `HardwareError` where none comes."""
        next_line(self._line, GREETING_TIME)
        deadline = time.monotonic() + GREETING_TIME
        while True:
            try:
                self._form.learn(self.read)
                return "sends numbers"
            except (LineTimeout, DamagedReply):
                if time.monotonic() > deadline:
                    raise

    def read(self) -> Reading:
        """Return the next reading; raises `LineTimeout` or `DamagedReply` where it is none."""
        return parse(next_line(self._line, NUMBER_TIMEOUT), self._channel, self._form)


make_reader = NumberLines


def probe(line: Line) -> str | None:
    """Return the text that comes without a request, None where it is no number."""
    next_line(line, LISTENING_TIME)
    text = next_line(line, LISTENING_TIME)
    found = _LINE.fullmatch(as_text(text))
    if found is None:
        return None
    number(found.group(1))
    return f"sends numbers by itself, e.g. {as_text(text)}"
