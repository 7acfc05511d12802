"""An instrument on a line of its own, read continuously in a thread of its own."""

from __future__ import annotations

import math
import threading
import time
from bisect import bisect_left, bisect_right
from collections.abc import Callable
from typing import Any, Self

import numpy as np

from rigtool.errors import HardwareError
from rigtool.numerics.arrays import Array, Mask
from rigtool.recipe.serial import MeasuringInstrument
from rigtool.rigs.serial.instruments.readings import UNSTABLE, Reader, Reading
from rigtool.rigs.serial.line import DamagedReply, Line, LineCounts, LineTimeout
from rigtool.rigs.serial.transport.spy import RecordEnd
from rigtool.signals import CHANNELS

HOLDING_TIME = {"force": 0.5, "deflection": 0.5, "temperature": 10.0}
"""Longest time for which a reading holds, s."""

SLOW_CHANNELS = ("temperature",)
"""Channels whose readings count only after the next reading: a late value is better than a damaged
one."""

READING_WAIT = 0.5
"""Longest wait for the readings that follow a moment and show whether one is a spike, s.

Results depend on the times of the readings, not on those of the queries: a record plays back as
it was.
"""

MAX_SILENCE = 5.0
"""Time without a valid reading after which an instrument that sends by itself is lost, s."""

FIRST_READING_TIME = 20.0
"""Time in which the first readings must have come, s: multimeters take up to 3 s for one."""

FIRST_READINGS = 3
"""Readings that must have come at first: the last but one can then be checked for a spike."""

SPIKE_RATIO = 20.0
"""Times the usual difference of two readings by which one may lie beyond both its neighbours."""

USUAL_DIFFERENCES = 200
"""Differences of readings from which the usual one is taken."""

MIN_DIFFERENCES = 10
"""Differences that are needed for that."""

STILL_READINGS = 30
"""Readings of which fewer than `MIN_DIFFERENCES` differ, which means that readings hardly
change."""


class LineGauge:
    """Reads through `make_reader(line, channel)` from `with` to its end; see `Gauge`.

    `beside` returns the line of the drive, whose clock and spy file its own line shares.
    """

    def __init__(
        self,
        channel: str,
        settings: MeasuringInstrument,
        make_reader: Callable[[Line, str], Reader],
        *,
        baud_rate: int,
        beside: Callable[[], Line | None] = lambda: None,
    ) -> None:
        self._channel, self._settings = channel, settings
        self._make_reader, self._baud_rate = make_reader, settings.baud_rate or baud_rate
        self._beside = beside
        self._line: Line | None = None
        self._thread: threading.Thread | None = None
        self._stop = threading.Event()
        self._arrived = threading.Condition()
        self._times: list[float] = []
        self._values: list[float] = []
        self._flagged: list[str] = []
        self._heard = -math.inf  # as late as the thread knows of, s
        self._error, self._lost = "", math.inf  # why and when reading ended early
        self._finished = False
        self._judged = -math.inf  # readings until then were checked for spikes, s
        self._reason = ""
        self._flags: dict[str, int] = {}
        self._identity = ""
        self._count = self._discarded = self._missing = 0
        self._spikes = 0

    # -- connecting and leaving

    def __enter__(self) -> Self:
        """Connect and read until the first value is there; raises `HardwareError`."""
        assert self._settings.port is not None
        self._stop.clear()
        try:
            self._line = Line(
                self._settings.port,
                self._baud_rate,
                driver=self._settings.driver,
                beside=self._beside(),
                role=self._channel,
                frame=self._settings.frame,
            )
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
        """End reading and close the port; a record is read to its end."""
        if self._line is None or not self._line.replays:
            self._stop.set()
        if self._thread is not None:
            self._thread.join()
            self._thread = None
        if self._line is not None:
            self._line.close()

    def _await_first(self) -> None:
        with self._arrived:
            self._arrived.wait_for(
                lambda: len(self._times) >= FIRST_READINGS or self._finished, FIRST_READING_TIME
            )
            come = len(self._times)
        if come < FIRST_READINGS:
            raise HardwareError(
                self._error
                or f"{self._name}: {come} readings within {FIRST_READING_TIME:g} s, "
                f"{FIRST_READINGS} are needed to find a damaged one: look at its rate"
            )

    @property
    def name(self) -> str:
        """Return the instrument's identity and port."""
        return f"{self._identity} on {self._settings.port}"

    @property
    def _name(self) -> str:
        return f"serial.{self._channel} ({self._settings.driver} on {self._settings.port})"

    # -- the rig's interface

    def begin(self, moment: float) -> None:
        """Discard readings from long before a recording begins at `moment`, s.

        Raises `HardwareError` where the instrument is lost by then.
        """
        with self._arrived:
            self._wait_for(lambda: self._heard >= moment, 0.0)
            if self._error and self._lost <= moment:
                raise HardwareError(self._error)
            old = max(
                0,
                bisect_left(self._times, moment - HOLDING_TIME[self._channel]) - USUAL_DIFFERENCES,
            )
            del self._times[:old], self._values[:old], self._flagged[:old]
            self._reason = ""

    def at(self, moments: Array) -> Array:
        """Return the last reading (n,) at each of the moments (n,) of the line's clock, s.

        NaN where they are old, or where the instrument had no value; see `problem`.
        """
        if len(moments) == 0:
            return np.empty(0)
        near, last = HOLDING_TIME[self._channel], float(moments[-1])
        with self._arrived:
            waited = last + READING_WAIT
            self._wait_for(lambda: self._covers(last) or self._heard >= waited, waited)
            first = bisect_left(self._times, float(moments[0]) - near)
            some = slice(max(0, first - USUAL_DIFFERENCES), self._end(last))
            times, values = np.array(self._times[some]), np.array(self._values[some])
            flag = self._flagged[some.stop - 1] if some.stop else ""
            covered = self._covers(last)
            lost = not covered and self._lost <= waited
        alone = spikes(values, self._reader.resolution, self._reader.finest)
        self._spikes += int(np.count_nonzero(alone & (times > self._judged)))
        if len(times) > 1:
            self._judged = max(self._judged, times[-2])
        if len(times) and not covered and (lost or self._channel in SLOW_CHANNELS):
            alone[-1] = True  # it may be one: no reading has followed yet
        found = latest(times[~alone], values[~alone], moments, near)
        lacking = int(np.count_nonzero(np.isnan(found)))
        self._missing += lacking
        if lost:
            self._reason = self._error
        elif lacking:
            why = f"it last sent: {flag}" if flag else "silence, or damaged lines"
            self._reason = (
                f"{self._name}: {lacking} samples have no reading near them: {why}; look at the "
                "instrument, its range, cable and battery"
            )
        return self._settings.scale * found + self._settings.offset

    def _wait_for(self, known: Callable[[], bool], moment: float) -> None:
        """Wait until a reading comes, at most until a moment of the line's clock."""
        assert self._line is not None
        if self._line.replays:  # the clock of a record ends by itself
            self._arrived.wait_for(lambda: known() or self._finished)
        else:
            left = moment - (time.monotonic() - self._line.opened)
            self._arrived.wait_for(
                lambda: known() or self._finished, min(max(0.0, left), READING_WAIT)
            )

    def _covers(self, moment: float) -> bool:
        """Return whether two readings follow soon: the second shows if the first is a spike."""
        return self._end(moment) - bisect_left(self._times, moment) >= 2

    def _end(self, moment: float) -> int:
        """Return how many readings are used: up to the second that follows, unless it is late."""
        follow = bisect_left(self._times, moment) + 2
        return min(follow, bisect_right(self._times, moment + READING_WAIT))

    def problem(self) -> str | None:
        """Return why the run cannot go on: readings are missing or the line is lost, or None."""
        return self._reason or None

    def report(self) -> dict[str, Any]:
        """Return facts about the instrument that are stored with a run."""
        counts = LineCounts() if self._line is None else self._line.counts
        return {
            "driver": self._settings.driver,
            "identity": self._identity,
            "unit": CHANNELS[self._channel][0],
            "scale": self._settings.scale,
            "offset": self._settings.offset,
            "readings": self._count,
            "missing_samples": self._missing,
            "discarded_lines": self._discarded,
            "spikes": self._spikes,
            "flags": dict(sorted(self._flags.items())),
            "retries": counts.retries,
            "timeouts": counts.timeouts,
            "damaged": counts.damaged,
        }

    # -- the thread

    def _run(self) -> None:
        assert self._line is not None
        try:
            self._read_on(self._line)
        except RecordEnd:
            pass
        except HardwareError as error:
            self._give_up(str(error))
        except Exception as error:  # a mistake here must stop the rig as well
            self._give_up(f"{type(error).__name__}: {error}")
        with self._arrived:
            self._finished = True
            self._arrived.notify_all()

    def _read_on(self, line: Line) -> None:
        valid = line.now()
        while not (self._stop.is_set() or line.over):
            try:
                reading = self._reader.read()
            except (LineTimeout, DamagedReply) as error:  # of one that sends by itself
                self._discarded += isinstance(error, DamagedReply)
                with self._arrived:
                    self._heard = line.now()
                if self._heard - valid > MAX_SILENCE:
                    raise HardwareError(
                        f"no valid reading for {MAX_SILENCE:g} s: {error}"
                    ) from None
                continue
            valid = self._take(reading, line)
            line.pause(self._reader.pause)

    def _take(self, reading: Reading, line: Line) -> float:
        """Keep a reading with the time of its arrival, and return that, s."""
        with self._arrived:
            self._heard = line.now()
            self._count += 1
            if reading.flag:
                self._flags[reading.flag] = self._flags.get(reading.flag, 0) + 1
            self._times.append(self._heard)
            self._values.append(reading.value)
            self._flagged.append("" if reading.flag == UNSTABLE else reading.flag)
            self._arrived.notify_all()
            return self._heard

    def _give_up(self, why: str) -> None:
        assert self._line is not None
        with self._arrived:
            if not self._stop.is_set():
                self._error, self._lost = f"{self._name}: {why}", self._line.now()


def latest(times: Array, values: Array, moments: Array, near: float) -> Array:
    """Return at moments (n,) the last value of readings (m,) until then; times in s.

    NaN where it is older than `near`, or NaN itself. Interpolation would let the end of a
    step contain the next one; this value is only late, which the settling time covers.
    """
    found = np.full(len(moments), np.nan)
    last = np.searchsorted(times, moments, side="right") - 1
    known = np.flatnonzero(last >= 0)
    known = known[moments[known] - times[last[known]] <= near]
    found[known] = values[last[known]]
    return found


def spikes(values: Array, resolution: float = 0.0, finest: float = 0.0) -> Mask:
    """Return (n,) which single readings are far beyond both neighbours: a damaged digit.

    Far is `SPIKE_RATIO` times the usual difference of neighbours, at least the `resolution`; where
    they hardly ever change it is `SPIKE_RATIO` times the `finest` step that they can show. A step
    is no spike, nor the turning point of a triangle.
    """
    alone = np.zeros(len(values), dtype=bool)
    if len(values) < 3:
        return alone
    steps = np.diff(values)
    usual = max(_usual(steps), resolution)
    if usual == 0 and len(steps) >= STILL_READINGS:
        usual = finest
    if usual > 0:
        before, after = steps[:-1], -steps[1:]
        beyond = np.minimum(np.abs(before), np.abs(after))
        alone[1:-1] = (before * after > 0) & (beyond > SPIKE_RATIO * usual)
    return alone


def _usual(steps: Array) -> float:
    size = np.abs(steps[np.isfinite(steps)][-USUAL_DIFFERENCES:])
    size = size[size > 0]
    return float(np.median(size)) if size.size >= MIN_DIFFERENCES else 0.0
