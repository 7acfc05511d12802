"""The clock of a loop that the host runs: waits for its ticks, and states why they come late."""

from __future__ import annotations

from rigtool.errors import HardwareError
from rigtool.rigs.serial.line import Line

FORGIVEN_PART = 0.25
"""Part of a period by which each tick that comes in time makes up for ticks that were skipped: a
loop goes on for ever where a fifth of its ticks are skipped, and ends where it is much more."""


LATE_PART = 0.8
"""Part of the patience by which a loop is late when it skips ticks."""

SKIPPED_RATIO = 2.0
"""Multiple of the patience: skipped ticks that add up to more, and are not made up for, are too
many."""


class Clock:
    """Waits for ticks of a `period`; no silence may exceed `patience`; both in s.

    A tick that comes late is made up for. With `skips`, a loop that falls behind goes on at the
    tick that is due; a motion whose signal has a sample for each tick cannot.
    """

    def __init__(self, line: Line, period: float, patience: float, *, skips: bool) -> None:
        self._line, self._period, self._patience = line, period, patience
        self._skips, self._owed = skips, 0.0
        self._free = self._busy = self._asked = 0.0
        self._asleep = self._exchanging = 0.0
        self._retries = line.counts.retries

    def wait(self, start: float, tick: int) -> tuple[float, float, int]:
        """Wait for a tick counted from `start`; return the time, how late it is, s, and `skipped`.

        Raises `HardwareError` where the drive was asked nothing for longer than it would wait, or
        where too many ticks are skipped.
        """
        moment = start + tick * self._period
        self._line.sleep_until(moment)
        now = self._line.now()
        lateness = now - moment
        behind = self._skips and lateness > max(self._period, LATE_PART * self._patience)
        skipped = int(lateness / self._period) if behind else 0
        in_time = lateness <= self._period
        less = FORGIVEN_PART * self._period if in_time else 0.0
        self._owed = max(0.0, self._owed + skipped * self._period - less)
        if in_time and self._owed == 0.0:
            self._asleep = self._exchanging = 0.0
            self._retries = self._line.counts.retries
        elif not in_time:
            self._exchanging += max(0.0, self._busy - self._period)
            self._asleep += now - max(moment, self._free)
        self._busy = 0.0
        silent = now - max(start, self._asked) if self._skips else lateness
        if silent > self._patience or self._owed > SKIPPED_RATIO * self._patience:
            raise HardwareError(self._problem(max(lateness, self._owed), tick))
        return now, lateness - skipped * self._period, skipped

    def exchanged(self, begun: float) -> None:
        """Note that the drive has answered the question of this time."""
        self._asked, self._free = begun, self._line.now()
        self._busy += self._free - begun

    def _problem(self, lateness: float, tick: int) -> str:
        text = (
            f"{self._line.port}: the loop is {lateness * 1e3:.0f} ms late after {tick} samples, "
            f"more than serial.watchdog allows ({self._patience:g} s): "
        )
        if self._asleep > self._exchanging:
            return text + (
                f"for {self._asleep * 1e3:.0f} ms of it this computer did not let rigtool run: end "
                "other programs, keep it from saving power, or set serial.watchdog longer"
            )
        repeated = self._line.counts.retries - self._retries
        return text + (
            f"exchanges with the drive took {self._exchanging * 1e3:.0f} ms more than the period "
            f"of {self._period:g} s, {repeated} were repeated: set rig.sample_time longer; where "
            "they are repeated, see to the cable"
        )
