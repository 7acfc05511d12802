"""A rig whose loop is closed in a drive, and whose set points the host sends one by one.

The host's loop has the period `rig.sample_time`; a thread of its own owns the line while a motion
runs, so that writing files does not disturb it. A tick that comes late is made up for, and each
sample carries the time at which it was taken; how evenly is in the run's record of the line.
"""

from __future__ import annotations

import contextlib
import math
import threading
from collections.abc import Callable, Generator, Iterator, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rigtool.errors import HardwareError, RecipeError
from rigtool.recipe import Recipe
from rigtool.rigs.base import NEEDS, Block, Task
from rigtool.rigs.bench import Bench
from rigtool.rigs.motion import Move, OpenLoop
from rigtool.rigs.serial import safety
from rigtool.rigs.serial.drive import Drive, Mode, Sample, SetPoint
from rigtool.rigs.serial.line import Line
from rigtool.rigs.serial.rig import SETTLE_TIME, SerialRig, in_thread

Array = NDArray[np.float64]

BLOCK_TIME = 0.25
"""Signals are handed on in blocks of about this length, s."""

RATE_READINGS = 40
"""Readings at standstill by which the rate of a line is found."""

COLUMNS = (
    "time",
    "position_setpoint",
    "encoder",
    "current_setpoint",
    "current",
    "feedforward_current",
    "table_current",
    "signal_current",
    "temperature",
)


class HostedRig(SerialRig):
    """A rig behind a `Drive`; `make_drive(line, recipe)` is the driver's `make_drive`."""

    def __init__(
        self,
        recipe: Recipe,
        torque_constant: float,
        use: str,
        bench: Bench,
        *,
        make_drive: Callable[[Line, Recipe], Drive],
        baud_rate: int,
    ) -> None:
        super().__init__(recipe, torque_constant, use, bench)
        self._make_drive = make_drive
        self._baud_rate = self._settings.baud_rate or baud_rate
        self._drive: Drive | None = None
        self._configured = False
        self._ticks = self._late = 0
        self._longest_gap = self._driven = 0.0

    @property
    def drive(self) -> Drive:
        """The connected drive."""
        assert self._drive is not None, "use the rig as a context manager"
        return self._drive

    def _open_line(self) -> Line:
        return Line(
            self._settings.port,
            self._baud_rate,
            timeout=self._settings.watchdog / 5,
            spy=self._bench.spy,
            driver=self._settings.driver,
        )

    def _connect(self) -> str:
        if self._drive is None:  # after a power cycle it still knows what to restore
            self._drive = self._make_drive(self.line, self._recipe)
        identity = self._drive.connect()
        self._configured = True
        for gap in self._drive.configure(self._limits, self._settings.watchdog):
            note = f"the drive {gap}: the host alone watches it"
            if note not in self.notes:
                self.notes.append(note)
        self._require_rate()
        return identity

    def _require_rate(self) -> None:
        """Refuse a loop that the line cannot keep up with."""
        start = self.line.now()
        for _ in range(RATE_READINGS):
            self.drive.read()
        period = (self.line.now() - start) / RATE_READINGS
        wanted = self._recipe.rig.sample_time
        if period > wanted:
            raise RecipeError(
                f"rig.sample_time is {wanted:g} s, and a reading on {self.line.port} takes "
                f"{period * 1e3:.2f} ms: set it to {1.5 * period:.1g} s or more, or use a faster "
                "line"
            )

    def _halt(self) -> None:
        if self._drive is not None and self._configured:
            self._drive.halt()

    def _restore(self) -> None:
        if self._drive is not None and self._configured:
            self._drive.restore()
            self._configured = False

    def _last_resort(self) -> str:
        if self._drive is None or self._drive.abilities.watchdog:
            return super()._last_resort()
        return "It has no watchdog and may go on: switch its supply off"

    def _position(self) -> float:
        return self.drive.read().position

    def _reason(self, need: str) -> str | None:
        able = self.drive.abilities
        name = self._settings.driver
        if need in ("load", "clamp", "soak", "power_cycle"):
            return f"{name} cannot do this by itself"
        if need == "closed_loop" and not able.modes & {"position", "velocity"}:
            return f"this {name} follows neither positions nor speeds"
        if need == "open_loop" and "current" not in able.modes:
            return f"this {name} takes no set point of current"
        if need in ("feedforward", "table", "signal") and not able.feedforward:
            return f"this {name} takes no torque feed-forward beside its set point"
        if need in ("current", "current_setpoint", "temperature") and need not in able.channels:
            more = ": add [serial.temperature]" if need == "temperature" else ""
            return f"this {name} does not tell its {need}{more}"
        if need in ("force", "deflection"):
            return f"a {name} does not measure it: add [serial.{need}]"
        return None if need in (*NEEDS, *COLUMNS) else f"a {name} does not record it"

    def _facts(self) -> Mapping[str, Any]:
        rate = self._ticks / self._driven if self._driven > 0 else 0.0
        return {
            "samples": self._ticks,
            "rate_hz": round(rate, 3),
            "late_samples": self._late,
            "longest_gap_s": round(self._longest_gap, 6),
        }

    # -- motions

    def _execute(self, task: Task) -> Generator[Block, None, None]:
        motion = task.motion
        if not isinstance(motion, OpenLoop) and motion.start is not None:
            angle = motion.start - self._position()
            speed = safety.speed_of_moves(self._limits)
            approach = Move(angle, SETTLE_TIME + abs(angle) / speed)
            for _ in self._run(Task(approach, load=task.load)):
                pass
        yield from self._run(task)
        self.drive.halt()

    def _run(self, task: Task) -> Iterator[Block]:
        """Drive a task in a thread of its own, and hand on what it measures."""
        loop = _Loop(self, task)
        try:
            yield from in_thread(loop.run)
        finally:
            self._ticks += loop.ticks
            self._late += loop.late
            self._longest_gap = max(self._longest_gap, loop.longest_gap)
            self._driven += loop.elapsed

    @property
    def mode(self) -> Mode:
        """How motions are followed: by position, or by speed with the host's correction."""
        return "position" if "position" in self.drive.abilities.modes else "velocity"


class _Loop:
    """One motion, tick by tick."""

    def __init__(self, rig: HostedRig, task: Task) -> None:
        self._rig, self._task = rig, task
        self._drive, self._line = rig.drive, rig.line
        self._recipe = rig._recipe
        self._watch = safety.Watch(rig._limits, self._recipe.rig.encoder_counts)
        self._rows: list[tuple[float, ...]] = []
        self.ticks = self.late = 0
        self.longest_gap = self.elapsed = 0.0

    def run(self, put: Callable[[Block], None], stop: threading.Event) -> None:
        """Run to the end, or until stopped; whatever is wrong, the drive is halted first."""
        self._put = put
        try:
            self._ticking(stop)
        except BaseException:
            with contextlib.suppress(HardwareError):  # leaving the rig tries again, and tells
                self._drive.halt()
            raise
        finally:
            self._hand_on()

    def _ticking(self, stop: threading.Event) -> None:
        task, line, rig = self._task, self._line, self._rig
        dt = self._recipe.rig.sample_time
        open_loop = isinstance(task.motion, OpenLoop)
        origin = rig._position()
        begin = origin
        motion = task.motion
        if not isinstance(motion, OpenLoop) and motion.start is not None:
            origin = motion.start
        self._drive.enable("current" if open_loop else rig.mode)
        block = max(1, round(BLOCK_TIME / dt / task.record_every)) * task.record_every
        start = line.now()
        last, here = start, begin
        for tick in range(round(motion.duration / dt)):
            if stop.is_set():
                self._drive.halt()
                return
            line.sleep_until(start + tick * dt)
            now = line.now()
            lateness = now - start - tick * dt
            if lateness > rig._settings.watchdog:
                raise HardwareError(
                    f"{line.port}: the loop is {lateness * 1e3:.0f} ms late after {tick} samples: "
                    f"this line does not keep a period of {dt:g} s; set rig.sample_time longer"
                )
            setpoint, parts = self._setpoint(now - start, origin, here)
            sample = self._drive.step(setpoint)
            here = sample.position
            # What was sent is a little older than the sample: record the set point of its time.
            wanted = self._wanted(sample.time - start, origin, here)
            self._note(sample, (wanted, *parts), lateness > dt, sample.time - last)
            last = sample.time
            self.elapsed = sample.time - start
            if len(self._rows) == block:
                self._hand_on()
            if task.stop_angle is not None and open_loop and abs(here - begin) > task.stop_angle:
                return

    def _setpoint(
        self, elapsed: float, origin: float, here: float
    ) -> tuple[SetPoint, tuple[float, float, float]]:
        """Return what to send, and (feed-forward, table, signal current) to record."""
        motion, feedforward = self._task.motion, self._task.feedforward
        time = np.array([min(elapsed, motion.duration)])
        if isinstance(motion, OpenLoop):
            return SetPoint(current=float(motion.current(time)[0])), (0.0, 0.0, 0.0)
        constant = self._rig._torque_constant
        position, speed, acceleration = motion.setpoint(time)
        position = position + origin
        model = float(safety.model_torque(feedforward, speed, acceleration)[0]) / constant
        table = signal = 0.0
        if feedforward.table is not None:
            table = float(feedforward.table.evaluate(position, speed)[0]) / constant
        if feedforward.signal is not None:
            step = int(elapsed / self._recipe.rig.sample_time) % len(feedforward.signal)
            signal = float(feedforward.signal[step]) / constant
        wanted, rate = float(position[0]), float(speed[0])
        if self._rig.mode == "velocity":
            limit = self._rig._limits.speed
            rate += self._rig._settings.position_gain * (wanted - here)
            rate = min(max(rate, -limit), limit)
        return SetPoint(wanted, rate, model + table + signal), (model, table, signal)

    def _wanted(self, elapsed: float, origin: float, here: float) -> float:
        """Return the set point of position at a time of the motion, rad."""
        motion = self._task.motion
        if isinstance(motion, OpenLoop):
            return here
        position, _, _ = motion.setpoint(np.array([min(elapsed, motion.duration)]))
        return float(position[0]) + origin

    def _note(
        self, sample: Sample, parts: tuple[float, float, float, float], late: bool, gap: float
    ) -> None:
        counts = self._recipe.rig.encoder_counts / (2 * math.pi)
        encoder = sample.position * counts
        setpoint, model, table, signal = parts
        self._rows.append(
            (
                sample.time,
                setpoint,
                encoder,
                sample.current_setpoint,
                sample.current,
                model,
                table,
                signal,
                sample.temperature,
            )
        )
        self.ticks += 1
        self.late += late
        self.longest_gap = max(self.longest_gap, gap)
        problem = self._watch.problem(
            {
                "time": np.array([sample.time]),
                "encoder": np.array([encoder]),
                "current": np.array([sample.current]),
                "temperature": np.array([sample.temperature]),
            }
        )
        if problem:
            raise HardwareError(problem)

    def _hand_on(self) -> None:
        """Put what was measured, averaged over `record_every`, as a block."""
        every = self._task.record_every
        rows = len(self._rows) // every
        if rows:
            table = np.array(self._rows[: rows * every]).reshape(rows, every, len(COLUMNS))
            means = table.mean(axis=1)
            self._put({name: means[:, n].copy() for n, name in enumerate(COLUMNS)})
        self._rows.clear()
