"""Readings between two set points: how far the current varies within a period of the loop.

A drive that gets set points one by one is sampled when it gets one, always at the same phase of the
period. Where its loop answers each set point with a step of current, as it does to steps of
position, that sample differs from the mean of the period by an amount that grows with speed and
repeats: it looks like friction, and averaging does not remove it. Every few periods the current is
therefore read once more, at a phase that varies over the rest of the period, and compared with the
value interpolated between the samples before and after it. The mean difference is missing from the
samples. Where readings fill most of the period, only its rest is covered: the difference is then
overestimated or, for currents shorter than a reading, underestimated.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from itertools import pairwise

from rigtool.rigs.serial.drive import Sample
from rigtool.rigs.serial.line import Line

READING_PERIODS = 4
"""Periods from one reading in between to the next."""

GOLDEN_SECTION = (math.sqrt(5) - 1) / 2
"""Its multiples, modulo one, fill a period evenly, for any number of multiples."""

MIN_ROOM = 1.5
"""Readings that must fit into the rest of a period before another one is taken."""

MIN_READINGS = 8
"""Readings at a speed that are needed for a mean with its scatter."""


class Between:
    """Differences of current set point within a period, by speed; `reading` takes so long, s."""

    def __init__(self) -> None:
        self.reading = 0.0
        self._sums: dict[float, tuple[int, float, float]] = {}
        self._taken = 0

    def moment(self, tick: int, now: float, next_tick: float) -> float | None:
        """Return when to read after a tick, s; None where it is not due, or there is no time."""
        left = next_tick - now
        if tick % READING_PERIODS != READING_PERIODS - 1 or left < MIN_ROOM * self.reading:
            return None
        self._taken += 1
        return now + (left - self.reading) * (self._taken * GOLDEN_SECTION % 1.0)

    def compare(self, speed: float, before: Sample, between: Sample, after: Sample) -> None:
        """Take in a reading, at a constant speed of the set point, rad/s, that is not zero."""
        value = _current(between)
        part = (between.time - before.time) / (after.time - before.time)
        expected = _current(before) + part * (_current(after) - _current(before))
        difference = math.copysign(1.0, speed) * (value - expected)
        if math.isfinite(difference):
            key = float(f"{abs(speed):.3g}")
            n, total, squares = self._sums.get(key, (0, 0.0, 0.0))
            self._sums[key] = (n + 1, total + difference, squares + difference**2)

    def found(self) -> Iterator[dict[str, float]]:
        """Yield speed [rad/s], mean difference and its standard uncertainty [A], and their number.

        A positive difference is current that the samples lack in the direction of motion.
        """
        for speed, (n, total, squares) in sorted(self._sums.items()):
            if n >= MIN_READINGS:
                mean = total / n
                variance = max(0.0, squares / n - mean**2) * n / (n - 1)
                yield {
                    "speed": speed,
                    "lacking_current": mean,
                    "u": math.sqrt(variance / n),
                    "readings": n,
                }


def _current(sample: Sample) -> float:
    """Return the current set point; the measured current where the drive reports no set point."""
    asked = sample.current_setpoint
    return asked if math.isfinite(asked) else sample.current


def usual_time(read: Callable[[], object], line: Line, count: int) -> float:
    """Return the median time of `count` readings, s: single ones that were repeated do not matter.

    Median, so that neither a retry nor a moment in which the host was busy counts.
    """
    times = [line.now()]
    for _ in range(count):
        read()
        times.append(line.now())
    spans = sorted(b - a for a, b in pairwise(times))
    return (spans[(count - 1) // 2] + spans[count // 2]) / 2
