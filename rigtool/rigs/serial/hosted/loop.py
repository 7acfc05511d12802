"""One motion on a drive that gets its set points from the host, tick by tick."""

from __future__ import annotations

import contextlib
import math
import threading
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from rigtool.control.position_loop import RunningController, controller_sections
from rigtool.errors import HardwareError
from rigtool.numerics.arrays import Array
from rigtool.recipe import Recipe
from rigtool.rigs.base import Block, Task
from rigtool.rigs.motion import Observe, OpenLoop
from rigtool.rigs.serial import safety
from rigtool.rigs.serial.drive import Drive, Mode, Sample, SetPoint
from rigtool.rigs.serial.hosted.between import Between
from rigtool.rigs.serial.hosted.ticks import Clock
from rigtool.rigs.serial.line import Line

BLOCK_TIME = 0.25
"""Approximate length of a block of signals, s."""

MAX_CORRECTION = 0.3
"""Part of an error of position that is corrected in a period at most."""

ADDED = ("feedforward_current", "table_current", "signal_current")
"""Currents that the host adds to a set point."""

COLUMNS = (
    *("time", "position_setpoint", "encoder", "current_setpoint", "current"),
    *(*ADDED, "temperature"),
)
"""Channels of a block."""


@dataclass(frozen=True)
class Followed:
    """What a loop works with: a drive on its line, and how it is followed.

    `torque_constant` is in N m/A; `between` takes in readings between two set points.
    """

    drive: Drive
    line: Line
    recipe: Recipe
    torque_constant: float
    mode: Mode
    between: Between


class MotionTicks:
    """One motion, tick by tick; with `halts` the drive is switched off at its end."""

    def __init__(self, followed: Followed, task: Task, halts: bool) -> None:
        self._followed, self._task, self._halts = followed, task, halts
        self._drive, self._line, self._recipe = followed.drive, followed.line, followed.recipe
        settings = self._recipe.line
        self._limits = settings.limits
        self._open_loop = isinstance(task.motion, OpenLoop)
        counts = self._recipe.rig.encoder_counts
        self._watch = safety.Watch(self._limits, counts, closed=not self._open_loop)
        self._clock = Clock(
            self._line,
            self._recipe.rig.sample_time,
            settings.watchdog,
            skips=task.feedforward.signal is None,
        )
        self._rows: list[dict[str, float]] = []
        self._gain = min(settings.position_gain, MAX_CORRECTION / self._recipe.rig.sample_time)
        self._controller: RunningController | None = None
        if followed.mode == "current" and not self._open_loop:
            sections = controller_sections(**self._recipe.rig.loop_design)
            self._controller = RunningController(sections)
        self._start = self._origin = 0.0
        self.ticks = self.late = self.skipped = 0
        self.longest_gap = self.elapsed = 0.0

    def run(self, put: Callable[[Block], None], stop: threading.Event) -> None:
        """Run to the end, or until stopped; on any error the drive is halted first."""
        self._put = put
        try:
            self._ticking(stop)
            if self._halts:
                self._drive.halt()
        except BaseException:
            with contextlib.suppress(HardwareError):  # leaving the rig tries again and reports
                self._drive.halt()
            raise
        finally:
            self._hand_on()

    def _ticking(self, stop: threading.Event) -> None:
        task = self._task
        dt = self._recipe.rig.sample_time
        last = self._drive.read()
        begin = self._origin = last.position
        motion = task.motion
        if task.start is not None:
            self._origin = task.start
        self._drive.enable("current" if self._open_loop else self._followed.mode)
        block = max(1, round(BLOCK_TIME / dt / task.record_every)) * task.record_every
        self._start = start = self._line.now()
        probe: Sample | None = None
        tick, last_tick = 0, round(motion.duration / dt) - 1
        while tick <= last_tick:
            if stop.is_set():
                self._drive.halt()
                return
            now, lateness, skipped = self._clock.wait(start, tick)
            skipped = min(skipped, last_tick - tick)  # the last set point is always sent
            self.skipped += skipped
            tick += skipped
            setpoint, added = self._setpoint(now - start, last)
            sample = self._drive.step(setpoint)
            self._clock.exchanged(now)
            if probe is not None:
                self._compare(last, probe, sample)
            self._note(sample, added, lateness > dt, sample.time - max(last.time, start))
            last, probe = sample, None
            if len(self._rows) == block:
                self._hand_on()
            travelled = abs(last.position - begin)
            if task.stop_angle is not None and self._open_loop and travelled > task.stop_angle:
                return
            if not self._open_loop and self._controller is None:
                probe = self._probe(tick)
            tick += 1

    def _probe(self, tick: int) -> Sample | None:
        """Read between two set points, now and then, where there is time."""
        next_tick = self._start + (tick + 1) * self._recipe.rig.sample_time
        moment = self._followed.between.moment(tick, self._line.now(), next_tick)
        if moment is None:
            return None
        self._line.sleep_until(moment)
        begun = self._line.now()
        probe = self._drive.read()
        self._clock.exchanged(begun)
        return probe

    def _compare(self, before: Sample, probe: Sample, after: Sample) -> None:
        """Take in a reading between two samples where the motion goes on at a constant speed."""
        _, speeds, accelerations = self._motion_at(before.time, after.time)
        if speeds[0] != 0.0 and not accelerations.any():
            self._followed.between.compare(float(speeds[0]), before, probe, after)

    def _motion_at(self, *moments: float) -> tuple[Array, Array, Array]:
        """Return position on the drive's zero, speed and acceleration at times of the line."""
        motion = self._task.motion
        assert not isinstance(motion, OpenLoop | Observe)
        end = motion.duration
        time = [min(max(moment - self._start, 0.0), end) for moment in moments]
        position, speed, acceleration = motion.setpoint(np.array(time))
        return position + self._origin, speed, acceleration

    def _setpoint(self, elapsed: float, last: Sample) -> tuple[SetPoint, Sequence[float]]:
        """Return the set point to send, and the currents in it, one for each of `ADDED`."""
        motion, feedforward = self._task.motion, self._task.feedforward
        if isinstance(motion, OpenLoop):
            time = np.array([min(elapsed, motion.duration)])
            return SetPoint(current=float(motion.current(time)[0])), (0.0, 0.0, 0.0)
        constant = self._followed.torque_constant
        position, speed, acceleration = self._motion_at(self._start + elapsed)
        model = float(feedforward.model_torque(speed, acceleration)[0]) / constant
        table = signal = 0.0
        if feedforward.table is not None:
            table = float(feedforward.table.evaluate(position, speed)[0]) / constant
        if feedforward.signal is not None:
            step = int(elapsed / self._recipe.rig.sample_time) % len(feedforward.signal)
            signal = float(feedforward.signal[step]) / constant
        rate, added = float(speed[0]), model + table + signal
        if self._controller is not None:
            error = self._wanted(last.time) - last.position
            added += self._controller.torque(error) / constant
            limit = min(self._recipe.rig.current_limit, self._limits.current)
            added = min(max(added, -limit), limit)
        if self._followed.mode == "velocity":
            limit = self._limits.speed
            # The set point at the time of the last sample: a sample that is older
            # than the set point would show a distance that grows with speed and delay.
            rate += self._gain * (self._wanted(last.time) - last.position)
            rate = min(max(rate, -limit), limit)
        sent = SetPoint(float(position[0]), rate, added)
        return sent, (model, table, signal)

    def _wanted(self, moment: float) -> float:
        """Return the set point of position at a time of the line, rad."""
        return float(self._motion_at(moment)[0][0])

    def _note(self, sample: Sample, added: Sequence[float], late: bool, gap: float) -> None:
        counts = self._recipe.rig.encoder_counts / (2 * math.pi)
        row = {
            "time": sample.time,
            # at the time of the sample: the set point that was sent is a little older
            "position_setpoint": sample.position if self._open_loop else self._wanted(sample.time),
            "encoder": sample.position * counts,
            "current_setpoint": sample.current_setpoint,
            "current": sample.current,
            "temperature": sample.temperature,
        }
        self._rows.append(row | dict(zip(ADDED, added, strict=True)))
        self.ticks += 1
        self.late += late
        self.longest_gap = max(self.longest_gap, gap)
        self.elapsed = sample.time - self._start
        if problem := self._watch.problem({name: np.array([v]) for name, v in row.items()}):
            raise HardwareError(problem)

    def _hand_on(self) -> None:
        """Put the samples, averaged over `record_every`, as a block."""
        every = self._task.record_every
        rows = len(self._rows) // every
        if rows:
            samples = {name: [row[name] for row in self._rows[: rows * every]] for name in COLUMNS}
            self._put({n: np.reshape(v, (rows, every)).mean(axis=1) for n, v in samples.items()})
        self._rows.clear()
