"""The clock of a loop that the host runs: waits for its ticks, and knows why they come late."""

from __future__ import annotations

from rigtool.errors import HardwareError
from rigtool.rigs.serial.line import Line


class Clock:
    """Waits for ticks of a `period`, late by `patience` at most; both in s."""

    def __init__(self, line: Line, period: float, patience: float) -> None:
        self._line, self._period, self._patience = line, period, patience
        self._free = self._busy = 0.0
        self._asleep = self._exchanging = 0.0
        self._retries = line.counts.retries

    def wait(self, start: float, tick: int) -> tuple[float, float]:
        """Wait for a tick counted from `start`; return the time, and how late that is, s.

        Raises `HardwareError` where that is longer than the drive would wait.
        """
        moment = start + tick * self._period
        self._line.sleep_until(moment)
        now = self._line.now()
        lateness = now - moment
        if lateness <= self._period:
            self._asleep = self._exchanging = 0.0
            self._retries = self._line.counts.retries
        else:
            self._exchanging += max(0.0, self._busy - self._period)
            self._asleep += now - max(moment, self._free)
        self._busy = 0.0
        if lateness > self._patience:
            raise HardwareError(self._problem(lateness, tick))
        return now, lateness

    def exchanged(self, begun: float) -> None:
        """Note that the drive has answered the question of this time."""
        self._free = self._line.now()
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
