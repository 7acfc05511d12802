"""Texts from instruments: numbers, units, and words in place of a number.

A line that differs from the protocol raises `DamagedReply`; it never becomes a number.
"""

from __future__ import annotations

import contextlib
import math
import re
import time
from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeVar

from rigtool.errors import HardwareError
from rigtool.recipe.units import spelled
from rigtool.rigs.serial.line import QUIET_TIME, DamagedReply, Line, LineTimeout

T = TypeVar("T")

QUANTITIES = {"force": spelled("N"), "deflection": spelled("m")}
"""SI values of the units of a channel; capitals differ from maker to maker (lbF, kgF), and scales
show the mass that weighs as much."""

TEMPERATURES = {
    "c": (1.0, 0.0),
    "cel": (1.0, 0.0),
    "degc": (1.0, 0.0),
    "°c": (1.0, 0.0),
    "k": (1.0, -273.15),
    "f": (5 / 9, -160 / 9),
    "far": (5 / 9, -160 / 9),
    "degf": (5 / 9, -160 / 9),
    "°f": (5 / 9, -160 / 9),
}
"""Factor and offset to degC."""

BARE_UNITS = {"force": "N", "temperature": "C", "deflection": "m"}
"""Units of readings that name none, where the instrument does not state another."""

NUMBER = re.compile(r"[+-]?[0-9]{1,12}(\.[0-9]{0,12})?([eE][+-]?[0-9]{1,3})?")
MAX_LINE = 80
"""Characters in a line of an instrument, at most."""

OVERLOAD = "overload"
UNDERRANGE = "below its range"
UNSTABLE = "unstable"
NO_VALUE = "no value"

_WORDS = {
    "ol": OVERLOAD,
    "+ol": OVERLOAD,
    "over": OVERLOAD,
    "overload": OVERLOAD,
    "ovl": OVERLOAD,
    "-ol": UNDERRANGE,
    "under": UNDERRANGE,
    "nan": NO_VALUE,
    "inf": NO_VALUE,
    "-inf": NO_VALUE,
    "+inf": NO_VALUE,
    "ovf": NO_VALUE,
    "err": NO_VALUE,
    "error": NO_VALUE,
    "fault": NO_VALUE,
    "xxxx": NO_VALUE,  # Mecmesin: load cell not calibrated, or faulty
}


@dataclass(frozen=True)
class Reading:
    """A value in the unit of the channel; `flag` names its fault.

    Among flagged readings only an unstable one has a value.
    """

    value: float
    flag: str = ""


class Reader(ABC):
    """Reads one kind of instrument on an open line.

    `streams`: the instrument sends by itself; `pause`: time between two requests, s.
    """

    streams = False
    pause = 0.0

    def __init__(self, line: Line, channel: str) -> None:
        self._line, self._channel, self._form = line, channel, Form()

    @property
    def resolution(self) -> float:
        """A step of the last decimal in the unit of the channel, 0 where decimals vary."""
        return self._form.resolution(self._channel)

    @property
    def finest(self) -> float:
        """The same where decimals vary, by the first readings; else 0."""
        return self._form.finest(self._channel, self._bare_unit)

    @property
    def _bare_unit(self) -> str:
        """Unit of readings without one."""
        return BARE_UNITS[self._channel]

    @abstractmethod
    def connect(self) -> str:
        """Return the identity in a line. Raises `HardwareError` for wrong settings."""

    @abstractmethod
    def read(self) -> Reading:
        """Return the next reading. Raises `HardwareError` where it is refused or does not come."""


def to_si(value: float, unit: str, channel: str) -> float:
    """Return a value in N, degC or m; raises `HardwareError` for a unit of something else."""
    key = unit.lower()
    if channel == "temperature" and key in TEMPERATURES:
        factor, added = TEMPERATURES[key]
        return factor * value + added
    known = QUANTITIES.get(channel, {})
    if key not in known:
        raise HardwareError(
            f"the instrument reads in {unit!r}, which is no unit of {channel}: set another one at "
            "the instrument"
        )
    return value * known[key]


def number(text: str) -> float:
    """Return a decimal number. Raises `DamagedReply` for anything else."""
    if not NUMBER.fullmatch(text):
        raise DamagedReply(f"{text[:40]!r} is not a number")
    return float(text)


def flag_of(text: str) -> str | None:
    """Return the flag of a word in place of a number, None for any other word."""
    return _WORDS.get(text.strip().lower())


def as_text(line: bytes) -> str:
    """Return a line as text; raises `DamagedReply` for bytes that are no text, or too many."""
    text = line.strip(b" \r\n").decode("latin-1")
    if not text.isprintable() or len(text) > MAX_LINE:
        raise DamagedReply(f"{line[:40]!r} is not a reading")
    return text


def next_line(line: Line, timeout: float) -> bytes:
    """Return the next line, without its CR, LF or both; never an empty one.

    Raises `LineTimeout` where it does not come within `timeout`, s, and `DamagedReply` where it is
    too long.
    """
    deadline = time.monotonic() + timeout
    got = b""
    while True:
        data = line.read_some(max(0.0, deadline - time.monotonic()))
        if not data:
            raise LineTimeout(f"{line.port}: no whole line within {timeout:g} s, only {got[:40]!r}")
        got = (got + data).lstrip(b"\r\n")
        ends = [place for end in (b"\r", b"\n") if (place := got.find(end)) >= 0]
        if ends:
            line.give_back(got[min(ends) + 1 :])
            return got[: min(ends)]
        if len(got) > 4 * MAX_LINE:
            raise DamagedReply(f"{line.port}: {len(got)} bytes without an end of line")


AGREEING_PAIRS = 4
"""Pairs of answers to one question of which two must be the same."""


class Polled(Reader):
    """An instrument that is asked for each reading and answers with a line."""

    timeout = 0.3

    def ask(self, request: bytes, take: Callable[[bytes], T]) -> T:
        """Return the result of `take` for the line that answers; see `Line.exchange` for errors."""
        attempts = 0

        def receive() -> T:
            nonlocal attempts
            attempts += 1
            answer = next_line(self._line, self.timeout)
            with contextlib.suppress(LineTimeout):
                while attempts > 1:  # a late answer to the question before may have come first
                    answer = next_line(self._line, QUIET_TIME)
            return take(answer)

        self._line.settle(0.0)  # the rest of an older answer
        return self._line.exchange(request, receive)

    def agreed(self, request: bytes) -> str | None:
        """Return the answer that came twice in a row, None after silence.

        For settings that affect all readings, e.g. the unit: a damaged answer may look like
        another one. Raises `HardwareError` where no two agree.
        """
        answers = [self.ask_if_known(request)]
        for _ in range(AGREEING_PAIRS):
            answers.append(self.ask_if_known(request))
            if answers[-1] == answers[-2]:
                return answers[-1]
        raise HardwareError(
            f"{request!r} is answered differently each time, last {answers[-1]!r}: check the cable"
        )

    def ask_if_known(self, request: bytes, retries: int = 1) -> str | None:
        """Return the answer to a question that not every model knows, None where it is silent."""
        self._line.settle(0.0)
        try:
            reply = self._line.exchange(
                request, lambda: as_text(next_line(self._line, self.timeout)), retries=retries
            )
        except HardwareError:
            self._line.settle()
            return None
        return reply


LEARNING_PAIRS = 5
"""Pairs of readings in which two must have the same form."""


class Form:
    """Holds readings to the form of the first: an instrument does not change its decimals.

    Protocols without a checksum show a lost digit in no other way.
    """

    def __init__(self) -> None:
        self._form: tuple[int, str] | None = None
        self._finest = math.inf
        self._learning = False

    def learn(self, read: Callable[[], Reading]) -> None:
        """Read until two readings in a row have one form; `HardwareError` where none have."""
        reading = None
        self._learning = True
        for _ in range(LEARNING_PAIRS):
            self._form = None
            reading = read()
            first, self._form = self._form, None
            reading = read()
            if first is not None and first == self._form and not math.isnan(reading.value):
                self._learning = False
                return
        problem = f"sends {reading.flag!r}" if reading and reading.flag else "changes its decimals"
        raise HardwareError(f"the instrument {problem}: it must read before a run can begin")

    def resolution(self, channel: str) -> float:
        """Return a step of the last decimal in the unit of the channel, 0 where decimals vary."""
        if self._form is None or self._form[0] < 0:
            return 0.0
        decimals, unit = self._form
        return abs(to_si(10.0**-decimals, unit, channel) - to_si(0.0, unit, channel))

    def finest(self, channel: str, unit: str) -> float:
        """Return the step of the last decimal, where decimals vary, by the first readings.

        `unit` is that of readings without one.
        """
        if self._form is None or not math.isfinite(self._finest):
            return 0.0
        unit = self._form[1] or unit
        return abs(to_si(self._finest, unit, channel) - to_si(0.0, unit, channel))

    def require_unit(self, digits: str, unit: str) -> None:
        """Raise `DamagedReply` where the unit differs from that before; decimals may vary."""
        self.require("", unit)
        if self._learning:
            mantissa, _, exponent = digits.lower().partition("e")
            step = 10.0 ** (int(exponent or 0) - len(mantissa.partition(".")[2]))
            self._finest = min(self._finest, step)

    def require(self, digits: str, unit: str) -> None:
        """Raise `DamagedReply` where decimals or unit differ from those before."""
        form = (len(digits.partition(".")[2]) if "." in digits else -1, unit.lower())
        if self._form is None:
            self._form = form
        if form != self._form:
            raise DamagedReply(f"{digits} {unit}: other decimals or unit than the readings before")
