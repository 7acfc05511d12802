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

import math
from collections.abc import Generator, Iterator, Mapping
from typing import Any

from rigtool.control.position_loop import stable_one_sample_late
from rigtool.errors import RecipeError
from rigtool.recipe import Recipe
from rigtool.rigs.base import NEED_DESCRIPTIONS, Block, Task
from rigtool.rigs.operator import Operator
from rigtool.rigs.serial import safety
from rigtool.rigs.serial.drive import Drive, Mode
from rigtool.rigs.serial.drivers import Driver
from rigtool.rigs.serial.hosted.between import MIN_ROOM, Between, usual_time
from rigtool.rigs.serial.hosted.loop import COLUMNS, Followed, MotionTicks
from rigtool.rigs.serial.line import Line
from rigtool.rigs.serial.rig import SerialRig, in_thread
from rigtool.rigs.serial.transport.opening import CAN_PREFIX, REPLAY_PREFIX

RATE_READINGS = 40
"""Readings at standstill from which the rate of a line is found."""

STOPPING_READINGS = 3
"""Readings that pass, at most, from the sample that shows a runaway to the drive's being off."""

PERIOD_RATIO = 1.5
"""Recommended period, as a multiple of the time of a reading."""


class HostedRig(SerialRig):
    """A rig behind the `Drive` that a driver makes; the host runs the loop."""

    def __init__(
        self, recipe: Recipe, torque_constant: float, use: str, operator: Operator, driver: Driver
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
        if not port.startswith(REPLAY_PREFIX) and port.startswith(CAN_PREFIX) != self._driver.can:
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
            self._add_note(f"the drive {gap}: the host alone watches it")
        self._require_rate()
        self._state_runaway()
        return identity

    def _state_runaway(self) -> None:
        """Note the speed of the shaft of a runaway loop before host or drive notices."""
        rig, limits = self._recipe.rig, self._limits
        torque = self._torque_constant * limits.current
        acceleration = torque / rig.inertia.total(rig.attachment)
        fastest = safety.runaway(limits, rig.encoder_counts, rig.sample_time, acceleration)
        fastest += acceleration * STOPPING_READINGS * self._between.reading
        own = self.drive.abilities.lets_go
        who = "the drive lets go" if own < fastest else "the host notices it"
        reached = min(own, fastest)
        self._add_note(
            f"where a loop runs away (a wrong sign, a lost encoder) with {limits.current:g} A, "
            f"{who} at up to {reached:.3g} rad/s, {reached / limits.speed:.2g} times the limit of "
            "speed: lower serial.limits.current where that is too fast"
        )

    def _add_note(self, note: str) -> None:
        if note not in self.notes:  # it may stand there from before a power cycle
            self.notes.append(note)

    def _require_rate(self) -> None:
        """Refuse a period that is too short for the line."""
        usual = usual_time(self.drive.read, self.line, RATE_READINGS)
        wanted, needed = self._recipe.rig.sample_time, usual
        why = "a reading"
        if self.steps_in_position:
            needed = (1 + MIN_ROOM) * usual
            why = "two readings and a half, to see the effect of its steps of position on current,"
        if needed > wanted:
            longer = _rounded_up(PERIOD_RATIO * needed)
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
        if need == "held_current" and self.mode != "current":
            return f"the loop of this {name} changes its current between two samples, unseen"
        if need in ("current", "current_setpoint", "temperature") and need not in able.channels:
            more = ": add [serial.temperature]" if need == "temperature" else ""
            return f"this {name} does not report its {need}{more}"
        if need in ("force", "deflection"):
            return f"{name} does not measure it: add [serial.{need}]"
        return None if need in (*NEED_DESCRIPTIONS, *COLUMNS) else f"{name} does not record it"

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
        followed = Followed(
            self.drive, self.line, self._recipe, self._torque_constant, self.mode, self._between
        )
        loop = MotionTicks(followed, task, halts)
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


def _rounded_up(period: float) -> float:
    """Return a period with one digit, not shorter, s."""
    digit = 10.0 ** math.floor(math.log10(period))
    return float(f"{math.ceil(period / digit) * digit:.1g}")
