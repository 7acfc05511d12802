"""Mecmesin force gauges AFG and CFG+: `?` asks for the reading, `U` for the unit, `M` for the mode.

An AFG that knows no `U` is set to N (`b`). The sign of a push is not documented: readings keep the
sign that the gauge sends. Source: manual of the CFG+; which lacks the form of its readings.
"""

from __future__ import annotations

import math
import re

from rigtool.errors import HardwareError
from rigtool.rigs.serial.instruments import readings
from rigtool.rigs.serial.line import DamagedReply, Line

BAUD_RATE = 9600

UNITS = ("mN", "N", "kN", "gf", "kgf", "ozf", "lbf")
MODES = ("Normal", "MaxC", "MaxT")
UNIT_REPEATS = 3
"""Times that an AFG is sent its unit: it does not acknowledge it."""

_REPLY = re.compile(r"([+-]? ?\d+\.?\d*) ?([A-Za-z]*)", re.ASCII)


def parse(line: bytes, unit: str, channel: str, form: readings.Form) -> readings.Reading:
    """Return the reading in a line, in `unit` where it names none.

    Raises `DamagedReply`, or `HardwareError` where its unit is not that of the channel.
    """
    text = readings.as_text(line)
    if flag := readings.flag_of(text):
        return readings.Reading(math.nan, flag)
    found = _REPLY.fullmatch(text)
    if found is None or found.group(2) not in ("", unit):
        raise DamagedReply(f"{text!r} is not a reading in {unit}")
    digits = found.group(1).replace(" ", "")
    value = readings.number(digits)
    form.require(digits, unit)
    return readings.Reading(readings.to_si(value, unit, channel))


class Mecmesin(readings.Polled):
    """Asks for one reading after the other."""

    _unit = "N"

    def connect(self) -> str:
        """Return the kind of gauge; raises `HardwareError` where it shows peaks, not the force."""
        unit = self.agreed(b"U")
        if unit in UNITS:
            self._unit = unit
        else:
            for _ in range(UNIT_REPEATS):
                self._line.write(b"b")
                self._line.settle()
        mode = self.agreed(b"M")
        if mode in MODES[1:]:
            raise HardwareError(
                f"the gauge is in mode {mode}, and would send peaks: press MAX until it shows the "
                "force itself"
            )
        self._form.learn(self.read)
        return f"Mecmesin force gauge, in {self._unit}"

    def read(self) -> readings.Reading:
        """Return the next reading; raises `HardwareError` where none comes."""

        def take(line: bytes) -> readings.Reading:
            return parse(line, self._unit, self._channel, self._form)

        return self.ask(b"?", take)


make_reader = Mecmesin


def probe(line: Line) -> str | None:
    """Return the identity of a Mecmesin gauge that knows its unit, None for another device."""
    unit = line.exchange(b"U", lambda: readings.as_text(readings.next_line(line, line.timeout)))
    return f"Mecmesin force gauge, in {unit}" if unit in UNITS else None
