"""An instrument on a line of its own, read all the time in a thread of its own."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from rigtool.errors import HardwareError
from rigtool.recipe.serial import Instrument
from rigtool.rigs.base import CHANNELS
from rigtool.rigs.serial.instruments.readings import UNSTABLE, Reader, Reading
from rigtool.rigs.serial.line import DamagedReply, Line, LineTimeout

Array = NDArray[np.float64]

NEAR = {"force": 0.5, "deflection": 0.5, "temperature": 10.0}
"""Longest time for which a reading holds, s."""

WAIT = 0.5
"""Longest wait for the readings that follow a moment and show whether one is a spike, s."""

SILENCE = 5.0
"""Time without a valid reading after which an instrument that sends by itself is lost, s."""

FIRST = 10.0
"""Time in which the first reading must have come, s."""

SPIKE = 20.0
"""Times the usual difference of two readings by which one may lie beyond both its neighbours."""

USUAL = 200
"""Differences of readings from which the usual one is taken."""

ENOUGH = 10
"""Differences that are needed for that."""


class LineGauge:
    """Reads through `make_reader(line, channel)` from `with` to its end; see `Gauge`."""

    def __init__(
        self,
        channel: str,
        settings: Instrument,
        make_reader: Callable[[Line, str], Reader],
        *,
        baud_rate: int,
    ) -> None:
        self._channel, self._settings = channel, settings
        self._make_reader, self._baud_rate = make_reader, settings.baud_rate or baud_rate
        self._line: Line | None = None
        self._thread: threading.Thread | None = None
        self._stop = threading.Event()
        self._arrived = threading.Condition()
        self._times: list[float] = []
        self._values: list[float] = []
        self._error = ""
        self._gap = ""
        self._flags: dict[str, int] = {}
        self._last_flag = ""
        self._identity = ""
        self._count = self._discarded = self._missing = 0
        self._spikes_before = self._spikes_now = 0

    # -- in and out

    def __enter__(self) -> Self:
        """Connect and read until the first value is there; raises `HardwareError`."""
        assert self._settings.port is not None
        self._stop.clear()
        self._line = Line(self._settings.port, self._baud_rate, driver=self._settings.driver)
        try:
            self._reader = self._make_reader(self._line, self._channel)
            if not self._reader.streams:
                self._line.settle()
            self._identity = self._reader.connect()
            self._thread = threading.Thread(target=self._run, name=self._channel, daemon=True)
            self._thread.start()
            self._await_first()
        except BaseException as error:
            self.__exit__()
            if isinstance(error, HardwareError) and not str(error).startswith(self._name):
                raise HardwareError(f"{self._name}: {error}") from None
            raise
        return self

    def __exit__(self, *details: object) -> None:
        """End reading and close the port."""
        self._stop.set()
        if self._thread is not None:
            self._thread.join()
            self._thread = None
        if self._line is not None:
            self._line.close()

    def _await_first(self) -> None:
        with self._arrived:
            self._arrived.wait_for(lambda: bool(self._times or self._error), FIRST)
        if self._error:
            raise HardwareError(self._error)
        if not self._times:
            raise HardwareError(f"{self._name}: no reading within {FIRST:g} s")

    @property
    def _name(self) -> str:
        return f"serial.{self._channel} ({self._settings.driver} on {self._settings.port})"

    # -- what a rig asks for

    def begin(self) -> None:
        """Forget what was read before this recording; raises `HardwareError` where it is lost."""
        if self._error:
            raise HardwareError(self._error)
        with self._arrived:
            old = time.monotonic() - NEAR[self._channel]
            keep = int(np.searchsorted(self._times, old))
            del self._times[:keep], self._values[:keep]
            self._gap = ""
        self._spikes_before += self._spikes_now
        self._spikes_now = 0

    def at(self, moments: Array) -> Array:
        """Return the last readings (n,) until moments (n,) of `time.monotonic()`.

        NaN where they are old, or where the instrument had no value; see `problem`.
        """
        if len(moments) == 0:
            return np.empty(0)
        with self._arrived:
            last = float(moments[-1])
            self._arrived.wait_for(lambda: bool(self._error) or self._covers(last), WAIT)
            times, values = np.array(self._times), np.array(self._values)
            flag = self._last_flag
        good = ~spikes(values, self._reader.resolution)
        self._spikes_now = int(np.count_nonzero(~good))
        found = latest(times[good], values[good], moments, NEAR[self._channel])
        lacking = int(np.count_nonzero(np.isnan(found)))
        if lacking:
            self._missing += lacking
            why = f"its last word was: {flag}" if flag else "silence, or damaged lines"
            self._gap = (
                f"{self._name}: {lacking} samples have no reading near them: {why}; look at the "
                "instrument, its range, cable and battery"
            )
        return self._settings.scale * found + self._settings.offset

    def _covers(self, moment: float) -> bool:
        """Say whether two readings follow: the second tells whether the first is a spike."""
        return len(self._times) > 1 and self._times[-2] >= moment

    def problem(self) -> str | None:
        """Return why the run cannot go on: readings are missing or the line is lost, or None."""
        return self._error or self._gap or None

    def report(self) -> dict[str, Any]:
        """Return what is to be kept about the instrument with a run."""
        counts = self._line.counts.as_dict() if self._line is not None else {}
        return {
            "driver": self._settings.driver,
            "identity": self._identity,
            "unit": CHANNELS[self._channel][0],
            "scale": self._settings.scale,
            "offset": self._settings.offset,
            "readings": self._count,
            "missing_samples": self._missing,
            "discarded_lines": self._discarded,
            "spikes": self._spikes_before + self._spikes_now,
            "flags": dict(sorted(self._flags.items())),
            "retries": counts.get("retries", 0),
            "timeouts": counts.get("timeouts", 0),
            "damaged": counts.get("damaged", 0),
        }

    # -- the thread

    def _run(self) -> None:
        heard = time.monotonic()
        while not self._stop.is_set():
            try:
                reading = self._reader.read()
            except (LineTimeout, DamagedReply) as error:  # of one that sends by itself
                self._discarded += isinstance(error, DamagedReply)
                if time.monotonic() - heard > SILENCE:
                    self._give_up(f"no valid reading for {SILENCE:g} s: {error}")
                    return
                continue
            except HardwareError as error:
                self._give_up(str(error))
                return
            except Exception as error:  # a mistake here must stop the rig as well
                self._give_up(f"{type(error).__name__}: {error}")
                return
            heard = time.monotonic()
            self._take(reading, heard)
            self._stop.wait(self._reader.pause)

    def _take(self, reading: Reading, moment: float) -> None:
        with self._arrived:
            self._count += 1
            if reading.flag:
                self._flags[reading.flag] = self._flags.get(reading.flag, 0) + 1
            self._last_flag = "" if reading.flag == UNSTABLE else reading.flag
            self._times.append(moment)
            self._values.append(reading.value)
            self._arrived.notify_all()

    def _give_up(self, why: str) -> None:
        with self._arrived:
            self._error = f"{self._name}: {why}" if not self._stop.is_set() else ""
            self._arrived.notify_all()


def latest(times: Array, values: Array, moments: Array, near: float) -> Array:
    """Return at moments (n,) the last value of readings (m,) until then; times in s.

    NaN where it is older than `near`, or NaN itself. A line between readings would let the end of a
    step know of the next one; this is only late, which the time of settling takes care of.
    """
    found = np.full(len(moments), np.nan)
    last = np.searchsorted(times, moments, side="right") - 1
    known = np.flatnonzero(last >= 0)
    known = known[moments[known] - times[last[known]] <= near]
    found[known] = values[last[known]]
    return found


def spikes(values: Array, resolution: float = 0.0) -> NDArray[np.bool_]:
    """Tell readings (n,) that lie alone, far beyond both neighbours: a damaged digit, not a force.

    Far is `SPIKE` times the usual difference of neighbours, at least the `resolution`. A step is no
    spike, nor the turning point of a triangle. Readings that hardly ever change, of unknown
    resolution, have none.
    """
    alone = np.zeros(len(values), dtype=bool)
    if len(values) < 3:
        return alone
    steps = np.diff(values)
    usual = max(_usual(steps), resolution)
    if usual > 0:
        before, after = steps[:-1], -steps[1:]
        beyond = np.minimum(np.abs(before), np.abs(after))
        alone[1:-1] = (before * after > 0) & (beyond > SPIKE * usual)
    return alone


def _usual(steps: Array) -> float:
    size = np.abs(steps[np.isfinite(steps)][-USUAL:])
    size = size[size > 0]
    return float(np.median(size)) if size.size >= ENOUGH else 0.0
