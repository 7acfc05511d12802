"""SCPI multimeters and thermometers (`READ?`); Hart 1502A and others (`FETC?`, `t: 25.587 C`).

Temperature comes in the unit that the instrument reports (`UNIT:TEMP?`), in the one behind the
number, or else in degC. Force and deflection come as volts or ohms: the recipe's scale and offset
convert them into N and m. Values of 9.9e37 and beyond are overload (IEEE 488.2, SCPI). Sources:
manuals of Fluke 1521, 1522 and 1529, Keysight B2961A.
"""

from __future__ import annotations

import math
import re

from rigtool.errors import HardwareError
from rigtool.rigs.serial.instruments import readings
from rigtool.rigs.serial.line import DamagedReply, Line
from rigtool.rigs.serial.transport.opening import VISA_PREFIX

BAUD_RATE = 9600

READING_TIMEOUT = 3.0
"""Longest time that a reading takes, s: multimeters integrate over many periods of the mains."""

ANSWER_TIMEOUT = 0.5
"""Longest time that any other answer takes, s."""

OVERRANGE = 9.9e37
NOT_A_NUMBER = 9.91e37
_REPLY = re.compile(
    r"(?:t: *)?(\S+?)(?: +([A-Za-z]+)|(?P<status>[NOUZR])(?P<unit>[AV][AD]C|OHM))?(?:,.*)?",
    re.ASCII,
)
STATUS = {"O": readings.OVERLOAD, "U": readings.UNDERRANGE, "Z": readings.NO_VALUE}
"""Letters before a unit that flag a reading: overflow, underflow, zero check [Keithley 6517]."""

REMOTE = "34401"
"""A multimeter that measures over RS232 only once it is set to remote [Agilent 34401A]."""


def parse(line: bytes, channel: str, unit: str, form: readings.Form) -> readings.Reading:
    """Return the reading in a line; `unit` is that of a temperature without one.

    Raises `DamagedReply`, or `HardwareError` for a unit of something else.
    """
    text = readings.as_text(line)
    if flag := readings.flag_of(text):
        return readings.Reading(math.nan, flag)
    found = _REPLY.fullmatch(text)
    if found is None:
        raise DamagedReply(f"{text!r} is not a reading")
    if flag := STATUS.get(found["status"] or ""):
        return readings.Reading(math.nan, flag)
    value, said = readings.number(found.group(1)), found.group(2) or found["unit"]
    form.require_unit(found.group(1), said or "")
    if abs(value) >= OVERRANGE:
        beyond = readings.UNDERRANGE if value < 0 else readings.OVERLOAD
        return readings.Reading(
            math.nan, readings.NO_VALUE if abs(value) == NOT_A_NUMBER else beyond
        )
    if channel != "temperature":
        return readings.Reading(value)
    return readings.Reading(readings.to_si(value, said or unit, channel))


class Scpi(readings.Polled):
    """Asks for one reading after the other."""

    timeout = READING_TIMEOUT
    _request = b"READ?\n"
    _unit = "C"

    @property
    def _bare_unit(self) -> str:
        return self._unit if self._channel == "temperature" else super()._bare_unit

    def connect(self) -> str:
        """Return the identity of the instrument, or the request that it answers.

        Raises `HardwareError` where nothing does, or it measures no temperature.
        """
        self.timeout = ANSWER_TIMEOUT
        identity = self.agreed(b"*IDN?\n")
        if REMOTE in (identity or "") and not self._line.port.startswith(VISA_PREFIX):
            self._line.write(b"SYST:REM\n")
        if self._channel == "temperature" and identity:
            self._require_temperature()
        self.timeout = READING_TIMEOUT
        # `READ?` starts a measurement; an instrument with `FETC?` only measures by itself.
        known = (b"READ?\n", b"FETC?\n") if identity else (b"FETC?\n", b"READ?\n")
        self._request = known[0 if self.ask_if_known(known[0], retries=0) else 1]
        self._form.learn(self.read)
        return identity or f"answers {self._request.decode().strip()}"

    def _require_temperature(self) -> None:
        function = (self.agreed(b"FUNC?\n") or "").strip('"').upper()
        if re.fullmatch("(VOLT|CURR|RES|FRES|FREQ|PER|CONT|DIOD|CAP)[A-Z:]*", function):
            raise HardwareError(
                f"the instrument measures {function}, not temperature: set it to temperature"
            )
        unit = (self.agreed(b"UNIT:TEMP?\n") or "").strip('"')
        if unit.lower() in readings.TEMPERATURES:
            self._unit = unit

    def read(self) -> readings.Reading:
        """Return the next reading; raises `HardwareError` where none comes."""
        return self.ask(
            self._request, lambda line: parse(line, self._channel, self._unit, self._form)
        )


make_reader = Scpi


def probe(line: Line) -> str | None:
    """Return the identity of the instrument, None where it does not know the question."""

    def accept(reply: bytes) -> str | None:
        text = readings.as_text(reply)
        return text if text.count(",") >= 2 else None

    # The first end of line ends the rest of an earlier question in the instrument.
    return line.ask(b"\n*IDN?\n", accept)
