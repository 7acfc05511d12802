"""A rig whose loop is closed in a drive, and whose set points the host sends one by one.

The host's loop has the period `rig.sample_time`; a thread of its own owns the line while a motion
runs, so that writing files does not disturb it. A late tick is made up for; where the loop falls
too far behind, ticks are skipped and counted. Each sample carries the time at which it was taken;
the run's record of the line states how even these times are.

A drive whose set point of position stands still between two messages answers each with a step of
current. Such a drive follows speeds, which the host corrects by the error of position; where it
takes positions only, `between` measures the bias of the samples. A drive that takes currents only
is followed by the controller of [rig.controller], which the host runs; it adds feed-forward, table
and signal itself.
"""

from __future__ import annotations

import contextlib
import math
import threading
from collections.abc import Callable, Generator, Iterator, Mapping
from typing import Any

import numpy as np

from rigtool.control.position_loop import (
    RunningController,
    controller_sections,
    stable_one_sample_late,
)
from rigtool.errors import HardwareError, RecipeError
from rigtool.numerics.arrays import Array
from rigtool.recipe import Recipe
from rigtool.rigs.base import NEEDS, Block, Task
from rigtool.rigs.motion import Observe, OpenLoop
from rigtool.rigs.operator import Operator
from rigtool.rigs.serial import safety
from rigtool.rigs.serial.between import ROOM, Between, usual_time
from rigtool.rigs.serial.drive import Drive, Mode, Sample, SetPoint
from rigtool.rigs.serial.drivers import Driver
from rigtool.rigs.serial.line import CAN, REPLAY, Line
from rigtool.rigs.serial.rig import SerialRig, in_thread
from rigtool.rigs.serial.ticks import Clock

BLOCK_TIME = 0.25
"""Approximate length of a block of signals, s."""

RATE_READINGS = 40
"""Readings at standstill from which the rate of a line is found."""

STOPPING = 3
"""Readings that pass, at most, from the sample that shows a runaway to the drive's being off."""

CORRECTED = 0.3
"""Part of an error of position that is corrected in a period at most."""

LONGER = 1.5
"""Recommended period, as a multiple of the time of a reading."""

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
    """A rig behind the `Drive` that a driver makes; the host runs the loop."""

    def __init__(
        self,
        recipe: Recipe,
        torque_constant: float,
        use: str,
        operator: Operator,
        driver: Driver,
    ) -> None:
        super().__init__(recipe, torque_constant, use, operator)
        self._driver = driver
        self._drive: Drive | None = None
        self._configured = False
        self._ticks = self._late = self._skipped = 0
        self._between = Between()
        self._longest_gap = self._driven = 0.0

    @property
    def drive(self) -> Drive:
        """The connected drive."""
        assert self._drive is not None, "use the rig as a context manager"
        return self._drive

    def _open_line(self) -> Line:
        port = self._settings.port
        if not port.startswith(REPLAY) and port.startswith(CAN) != self._driver.can:
            needed = "a CAN bus: can:INTERFACE:CHANNEL" if self._driver.can else "a serial port"
            raise RecipeError(
                f"serial.port is {port!r}, and {self._settings.driver} is on {needed}"
            )
        return Line(
            self._settings.port,
            self._settings.baud_rate or self._driver.baud_rates[0],
            timeout=self._settings.watchdog / 5,
            spy=self._operator.spy,
            driver=self._settings.driver,
        )

    def _connect(self) -> str:
        if self._drive is None:  # after a power cycle it still knows the values to restore
            assert self._driver.make_drive is not None, "a driver makes a drive or a rig"
            self._drive = self._driver.make_drive(self.line, self._recipe)
        identity = self._drive.connect()
        design = self._recipe.rig.loop_design
        if self.mode == "current" and not stable_one_sample_late(**design):
            raise RecipeError(
                f"the loop of [rig.controller], {design['crossover_hz']:g} Hz of crossover, is not "
                f"stable where the host closes it every {design['sample_time']:g} s: lower "
                "crossover_hz, to a fiftieth of the rate for a good margin, and the other "
                "frequencies with it"
            )
        self._configured = True
        for gap in self._drive.configure(self._limits, self._settings.watchdog):
            note = f"the drive {gap}: the host alone watches it"
            if note not in self.notes:
                self.notes.append(note)
        self._require_rate()
        self._state_runaway()
        return identity

    def _state_runaway(self) -> None:
        """Note the speed of the shaft of a runaway loop before host or drive notices."""
        rig, limits = self._recipe.rig, self._limits
        torque = self._torque_constant * limits.current
        acceleration = torque / rig.inertia.total(rig.attachment)
        fastest = safety.runaway(limits, rig.encoder_counts, rig.sample_time, acceleration)
        fastest += acceleration * STOPPING * self._between.reading
        own = self.drive.abilities.lets_go
        who = "the drive lets go" if own < fastest else "the host notices it"
        reached = min(own, fastest)
        note = (
            f"where a loop runs away (a wrong sign, a lost encoder) with {limits.current:g} A, "
            f"{who} at up to {reached:.3g} rad/s, {reached / limits.speed:.2g} times the limit of "
            "speed: lower serial.limits.current where that is too fast"
        )
        if note not in self.notes:
            self.notes.append(note)

    def _require_rate(self) -> None:
        """Refuse a period that is too short for the line."""
        usual = usual_time(self.drive.read, self.line, RATE_READINGS)
        wanted, needed = self._recipe.rig.sample_time, usual
        why = "a reading"
        if self.steps_in_position:
            needed = (1 + ROOM) * usual
            why = "two readings and a half, to see the effect of its steps of position on current,"
        if needed > wanted:
            longer = _rounded_up(LONGER * needed)
            raise RecipeError(
                f"rig.sample_time is {wanted:g} s, and {why} on {self.line.port} takes "
                f"{needed * 1e3:.2f} ms (median of {RATE_READINGS}): set it to {longer:g} s or "
                "more, or use a faster line"
            )
        self._between.reading = usual

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
        return "It has no watchdog and may continue: switch its supply off"

    def _position(self) -> float:
        return self.drive.read().position

    def _reason(self, need: str) -> str | None:
        able = self.drive.abilities
        name = self._settings.driver
        if need in ("load", "clamp", "soak", "power_cycle"):
            return f"{name} cannot do this by itself"
        if need == "open_loop" and "current" not in able.modes:
            return f"this {name} takes no set point of current"
        added = able.feedforward or self.mode == "current"
        if need in ("feedforward", "table", "signal") and not added:
            return f"this {name} takes no torque feed-forward beside its set point"
        if need in ("current", "current_setpoint", "temperature") and need not in able.channels:
            more = ": add [serial.temperature]" if need == "temperature" else ""
            return f"this {name} does not report its {need}{more}"
        if need in ("force", "deflection"):
            return f"{name} does not measure it: add [serial.{need}]"
        return None if need in (*NEEDS, *COLUMNS) else f"{name} does not record it"

    def _facts(self) -> Mapping[str, Any]:
        rate = self._ticks / self._driven if self._driven > 0 else 0.0
        return {
            "samples": self._ticks,
            "rate_hz": round(rate, 3),
            "late_samples": self._late,
            "skipped_samples": self._skipped,
            "longest_gap_s": round(self._longest_gap, 6),
            "steps_in_position": self.steps_in_position,
            "between_set_points": list(self._between.found()),
        }

    # -- motions

    def _execute(self, task: Task) -> Generator[Block, None, None]:
        if task.start is not None:
            approach = safety.slow_move(task.start - self._position(), self._limits)
            for _ in self._run(Task(approach, load=task.load), halts=False):
                pass
        yield from self._run(task, halts=True)

    def _run(self, task: Task, *, halts: bool) -> Iterator[Block]:
        """Drive a task in a thread of its own, and hand on its samples.

        With `halts` the thread switches the drive off at the end: who takes the samples may be
        slower than the drive's watchdog.
        """
        loop = _Loop(self, task, halts)
        try:
            yield from in_thread(loop.run)
        finally:
            self._ticks += loop.ticks
            self._late += loop.late
            self._skipped += loop.skipped
            self._longest_gap = max(self._longest_gap, loop.longest_gap)
            self._driven += loop.elapsed

    @property
    def mode(self) -> Mode:
        """How motions are followed: by corrected speeds, unless the drive moves along.

        By the host's own controller where the drive takes nothing but currents.
        """
        able = self.drive.abilities
        if able.modes == {"current"}:
            return "current"
        if "velocity" in able.modes and not able.moves_along:
            return "velocity"
        return "position" if "position" in able.modes else "velocity"

    @property
    def steps_in_position(self) -> bool:
        """Whether the drive gets positions between which it stands still."""
        return self.mode == "position" and not self.drive.abilities.moves_along


class _Loop:
    """One motion, tick by tick."""

    def __init__(self, rig: HostedRig, task: Task, halts: bool) -> None:
        self._rig, self._task, self._halts = rig, task, halts
        self._drive, self._line = rig.drive, rig.line
        self._recipe = rig._recipe
        self._open_loop = isinstance(task.motion, OpenLoop)
        counts = self._recipe.rig.encoder_counts
        self._watch = safety.Watch(rig._limits, counts, closed=not self._open_loop)
        self._clock = Clock(
            rig.line,
            self._recipe.rig.sample_time,
            rig._settings.watchdog,
            skips=task.feedforward.signal is None,
        )
        self._rows: list[tuple[float, ...]] = []
        self._gain = min(rig._settings.position_gain, CORRECTED / self._recipe.rig.sample_time)
        self._controller: RunningController | None = None
        if rig.mode == "current" and not self._open_loop:
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
        self._drive.enable("current" if self._open_loop else self._rig.mode)
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
            setpoint, parts = self._setpoint(now - start, last)
            sample = self._drive.step(setpoint)
            self._clock.exchanged(now)
            if probe is not None:
                self._compare(last, probe, sample)
            self._note(sample, parts, lateness > dt, sample.time - max(last.time, start))
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
        moment = self._rig._between.moment(tick, self._line.now(), next_tick)
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
            self._rig._between.compare(float(speeds[0]), before, probe, after)

    def _motion_at(self, *moments: float) -> tuple[Array, Array, Array]:
        """Return position on the drive's zero, speed and acceleration at times of the line."""
        motion = self._task.motion
        assert not isinstance(motion, OpenLoop | Observe)
        time = np.clip(np.array(moments) - self._start, 0.0, motion.duration)
        position, speed, acceleration = motion.setpoint(time)
        return position + self._origin, speed, acceleration

    def _setpoint(
        self, elapsed: float, last: Sample
    ) -> tuple[SetPoint, tuple[float, float, float]]:
        """Return the set point to send, and (feed-forward, table, signal current) to record."""
        motion, feedforward = self._task.motion, self._task.feedforward
        if isinstance(motion, OpenLoop):
            time = np.array([min(elapsed, motion.duration)])
            return SetPoint(current=float(motion.current(time)[0])), (0.0, 0.0, 0.0)
        constant = self._rig._torque_constant
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
            error = float(self._motion_at(last.time)[0][0]) - last.position
            added += self._controller.torque(error) / constant
            limit = min(self._recipe.rig.current_limit, self._rig._limits.current)
            added = min(max(added, -limit), limit)
        if self._rig.mode == "velocity":
            limit = self._rig._limits.speed
            # The set point at the time of the last sample: a sample that is older
            # than the set point would show a distance that grows with speed and delay.
            rate += self._gain * (float(self._motion_at(last.time)[0][0]) - last.position)
            rate = min(max(rate, -limit), limit)
        sent = SetPoint(float(position[0]), rate, added)
        return sent, (model, table, signal)

    def _wanted(self, sample: Sample) -> float:
        """Return the set point of position at the time of a sample, rad.

        The set point is a little older than the sample.
        """
        if self._open_loop:
            return sample.position
        return float(self._motion_at(sample.time)[0][0])

    def _note(
        self, sample: Sample, parts: tuple[float, float, float], late: bool, gap: float
    ) -> None:
        counts = self._recipe.rig.encoder_counts / (2 * math.pi)
        encoder = sample.position * counts
        model, table, signal = parts
        wanted = self._wanted(sample)
        self._rows.append(
            (
                sample.time,
                wanted,
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
        self.elapsed = sample.time - self._start
        problem = self._watch.problem(
            {
                "time": np.array([sample.time]),
                "encoder": np.array([encoder]),
                "position_setpoint": np.array([wanted]),
                "current": np.array([sample.current]),
                "temperature": np.array([sample.temperature]),
            }
        )
        if problem:
            raise HardwareError(problem)

    def _hand_on(self) -> None:
        """Put the samples, averaged over `record_every`, as a block."""
        every = self._task.record_every
        rows = len(self._rows) // every
        if rows:
            table = np.array(self._rows[: rows * every]).reshape(rows, every, len(COLUMNS))
            means = table.mean(axis=1)
            self._put({name: means[:, n].copy() for n, name in enumerate(COLUMNS)})
        self._rows.clear()


def _rounded_up(period: float) -> float:
    """Return a period with one digit, not shorter, s."""
    digit = 10.0 ** math.floor(math.log10(period))
    return float(f"{math.ceil(period / digit) * digit:.1g}")
