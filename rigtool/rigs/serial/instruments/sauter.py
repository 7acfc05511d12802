"""Sauter FH and FL force gauges: `9` is answered by 7 characters without an end, `0011.70`.

The first is the direction, 1 pull, 0 push; here a push is positive. The unit is not sent: the
gauge must be set to N. Source: FH interface description, manuals of FH and FL.
"""

from __future__ import annotations

import re

from rigtool.rigs.serial.instruments.readings import Polled, Reading
from rigtool.rigs.serial.line import DamagedReply, Line, LineTimeout

BAUD_RATE = 9600
LENGTH = 7
_REPLY = re.compile(rb"([01])((?=\d*\.\d*$)[\d.]{6})")


def parse(reply: bytes) -> float:
    """Return the force, N, push positive; raises `DamagedReply`."""
    found = _REPLY.fullmatch(reply)
    if found is None:
        raise DamagedReply(f"{reply[:40]!r} is not a reading")
    direction, digits = found.groups()
    size = float(digits)
    return -size if direction == b"1" else size


class Sauter(Polled):
    """Asks for one reading after the other."""

    def connect(self) -> str:
        """Return the kind of gauge; raises `HardwareError` where none answers."""
        self._form.learn(self.read)
        return "Sauter force gauge, in N"

    def read(self) -> Reading:
        """Return the next reading; raises `HardwareError` where none comes."""
        self._line.settle(0.0)
        return Reading(self._line.exchange(b"9", self._receive))

    def _receive(self) -> float:
        reply = self._line.read_exactly(LENGTH, self.timeout)
        if more := self._line.read_some(0.0):
            raise DamagedReply(f"{reply + more[:40]!r} is longer than {LENGTH} characters")
        value = parse(reply)
        # Without an end, a lost or doubled character shows in the place of the point alone.
        self._form.require(reply.decode("ascii"), "N")
        return value


make_reader = Sauter


def probe(line: Line) -> str | None:
    """Return the identity of the Sauter gauge that answers, None for another device."""
    line.write(b"9")
    try:
        reply = line.read_exactly(LENGTH)
        more = line.read_some(0.02)
        parse(reply)
    except (LineTimeout, DamagedReply):
        return None
    return None if more else f"Sauter force gauge, answers {reply.decode('ascii')}"
