"""The common part of rigs on a serial line: limits, permission, operator, instruments, exit."""

from __future__ import annotations

import contextlib
import json
import math
import queue
import threading
from abc import ABC, abstractmethod
from collections.abc import Callable, Collection, Generator, Iterator, Mapping
from dataclasses import asdict, replace
from typing import Any, Self

import numpy as np

from rigtool.errors import HardwareError
from rigtool.interrupts import held
from rigtool.numerics.arrays import Array
from rigtool.quantity import STANDARD_GRAVITY
from rigtool.recipe import Recipe
from rigtool.rigs.base import NEED_DESCRIPTIONS, Block, Load, Rig, Task
from rigtool.rigs.motion import Observe, OpenLoop
from rigtool.rigs.operator import Operator
from rigtool.rigs.serial import safety
from rigtool.rigs.serial.instruments import Gauge, OperatorGauge, open_gauge
from rigtool.rigs.serial.line import Line

NO_OPERATOR = "nobody is at the terminal: run the command in a terminal"

COMING_BACK = 10.0
"""Time in which a port must be back after its device was switched off and on, s."""


class SerialRig(Rig, ABC):
    """A rig behind a `Line`; a context manager: any exit stops, switches off and restores it.

    Subclasses fill in `_connect`, `_execute`, `_halt`, `_restore`, `_position` and `_reason`.
    """

    physical = True

    def __init__(
        self, recipe: Recipe, torque_constant: float, use: str, operator: Operator
    ) -> None:
        self._recipe, self._settings = recipe, recipe.line
        self._limits = recipe.line.limits
        self._torque_constant = torque_constant
        self._use, self._operator = use, operator
        self._line: Line | None = None
        self._identity = ""
        self._permitted = False
        self._running: Generator[Block, None, None] | None = None
        self._load = Load()
        self._clamp_angle = math.nan
        self._gauges: dict[str, Gauge] = {
            name: open_gauge(name, settings, operator, lambda: self._line)
            for name, settings in recipe.line.instruments.items()
        }
        self._unused: list[str] = []
        self.notes: list[str] = []

    # -- for subclasses

    @abstractmethod
    def _open_line(self) -> Line:
        """Open the line with the driver's own settings."""

    @abstractmethod
    def _connect(self) -> str:
        """Identify, set limits and watchdog; return the identity. Nothing moves."""

    @abstractmethod
    def _execute(self, task: Task) -> Generator[Block, None, None]:
        """Run a checked and permitted task; on an exception, leave the rest to `_halt`."""

    @abstractmethod
    def _halt(self) -> None:
        """Stop and switch off, in any state."""

    @abstractmethod
    def _restore(self) -> None:
        """Restore changed settings."""

    @abstractmethod
    def _position(self) -> float:
        """Return the angle of the shaft, rad."""

    @abstractmethod
    def _reason(self, need: str) -> str | None:
        """Return why the device does not offer a need or channel, None where it does."""

    def _last_resort(self) -> str:
        """Return what stops a drive that is out of reach, for the operator."""
        return f"Its watchdog stops it after {self._settings.watchdog:g} s of silence"

    def _set_load(self, load: Load) -> None:
        """Apply a load, by the operator unless the rig can."""
        before, self._load = self._load, load
        # An arm that was just clamped needs no request.
        if load in (before, replace(before, clamped=True)):
            return
        self._halt()
        self._operator.done(describe_load(load, self._recipe.rig.attachment))

    @property
    def line(self) -> Line:
        """The open line."""
        assert self._line is not None, "use the rig as a context manager"
        return self._line

    # -- connecting and leaving

    def __enter__(self) -> Self:
        """Connect, identify, set limits and watchdog; nothing moves."""
        self._line = self._open_line()
        try:
            for gauge in self._gauges.values():
                gauge.__enter__()
            self._identity = self._connect()
        except BaseException as error:
            self.__exit__(type(error), error, error.__traceback__)
            raise
        return self

    def __exit__(self, kind: object, error: BaseException | None, trace: object) -> None:
        """Stop, switch off, restore, release. A failure here is reported, and hides no error."""
        problems = []
        with held():
            if self._running is not None:
                self._running.close()
            for what, act in (("stop", self._halt), ("restore its settings", self._restore)):
                try:
                    act()
                except Exception as failure:  # whatever it is, what follows has to be done
                    problems.append(f"the drive could not be made to {what}: {failure}")
                    break  # the line is lost: further requests would only wait
            for gauge in self._gauges.values():
                gauge.__exit__(None, None, None)
            if self._line is not None:
                self._line.close()
        if problems and self._line is not None and self._line.replays and error is not None:
            return  # a record has no drive that might still run
        if problems:
            text = (
                f"{'; '.join(problems)}. {self._last_resort()}: see that it stands still before "
                "you touch it"
            )
            if error is None:
                raise HardwareError(text)
            error.add_note(text)

    # -- abilities

    def lacks(self, need: str) -> str | None:
        """Return why a need or channel is not offered; None where it is."""
        if need == "observe":
            return "on a rig on a line only rigtool itself may move the motor"
        if need == "force" and isinstance(self._gauges.get(need), OperatorGauge):
            return (
                "an operator reads once a motion, and the force changes with every step of "
                "current: a gauge on a line is needed"
            )
        alone = not self._operator.present
        if alone and isinstance(self._gauges.get(need), OperatorGauge):
            return f"an operator reads it, and {NO_OPERATOR}"
        if need in self._gauges or need == "rotor_angle":
            return None
        reason = self._reason(need)
        if reason is not None and need in ("load", "clamp", "soak", "power_cycle"):
            if not self._settings.operator:
                return (
                    f"{reason}, and serial.operator is false: nobody can {NEED_DESCRIPTIONS[need]}"
                )
            return f"{reason}, and {NO_OPERATOR}" if alone else None
        return reason

    def use_only(self, channels: Collection[str]) -> None:
        """Do not use instruments that fill none of these channels; called before `with`.

        A thermometer is used in any case: the limit of temperature depends on it.
        """
        self._unused = [name for name in self._gauges if name not in {*channels, "temperature"}]
        for name in self._unused:
            del self._gauges[name]

    def permit(self, plan: str) -> None:
        """Show the plan and ask the operator for consent."""
        notes = [
            *(f"{name} is read: {gauge.name}" for name, gauge in self._gauges.items()),
            *(f"serial.{name} is not used: its channel is not recorded" for name in self._unused),
            *self.notes,
        ]
        if self.lacks("temperature"):
            notes.append("the temperature of the motor is not measured: its limit is not watched")
        plan = "\n".join([f"{self._identity} on {self.line.port}", plan, *notes])
        self._operator.permit(plan, "the rig would move", "Move now?")
        self._permitted = True

    @property
    def position(self) -> float:
        """Angle of the shaft, rad; raises `HardwareError` where the drive does not know it."""
        position = self._position()
        if not math.isfinite(position):
            raise HardwareError(
                f"{self.line.port}: the drive reports the position {position}: calibrate or home "
                "it first"
            )
        return position

    def report(self) -> str:
        """Return facts about the line and the instruments that are stored with a run, as JSON."""
        facts: dict[str, Any] = {
            "driver": self._settings.driver,
            "port": self._settings.port,
            "identity": self._identity,
            "missing_samples": 0,
            **asdict(self.line.counts),
            **self._facts(),
        }
        if self._gauges:
            facts["instruments"] = {name: gauge.report() for name, gauge in self._gauges.items()}
        return json.dumps(facts, sort_keys=True)

    def _facts(self) -> Mapping[str, Any]:
        """Return the facts that a subclass adds to the report."""
        return {}

    # -- motions

    def perform(self, task: Task) -> Generator[Block, None, None]:
        """Run a task and yield its signals in blocks; moves to the motion's start first.

        Raises `HardwareError` where the motion is beyond a limit, or something goes wrong.
        """
        if isinstance(task.motion, Observe):
            raise HardwareError(f"{self.line.port}: {self.lacks('observe')}: it cannot be observed")
        self._require_permission(task)
        self._set_load(task.load)
        on_lines = any(not isinstance(gauge, OperatorGauge) for gauge in self._gauges.values())
        moment = self.line.now() if on_lines else math.nan
        for gauge in self._gauges.values():
            gauge.begin(moment)
        yield from self._perform(task)

    def _perform(self, task: Task) -> Iterator[Block]:
        closed = not isinstance(task.motion, OpenLoop)
        watch = safety.Watch(self._limits, self._recipe.rig.encoder_counts, closed=closed)
        self._running = blocks = self._execute(task)
        complete = False
        try:
            for block in blocks:
                self._add_instruments(block, task.load)
                found = [watch.problem(block), *(g.problem() for g in self._gauges.values())]
                if problem := next(filter(None, found), None):
                    self._break_off()
                    yield block
                    raise HardwareError(problem)
                yield block
            complete = True
        finally:
            if not complete:
                self._break_off()

    def move_by(self, angle: float) -> None:
        """Turn the shaft by an angle, rad, and come to rest; nothing is recorded."""
        task = Task(safety.slow_move(angle, self._limits), load=self._load)
        self._require_permission(task)
        for _ in self._perform(task):
            pass

    def _require_permission(self, task: Task) -> None:
        rig = self._recipe.rig
        safety.require_duration(task, self._limits)
        found = safety.extremes(task, self.position, rig.sample_time, self._torque_constant)
        safety.require_within_limits(found, self._limits, f"{type(task.motion).__name__}")
        if not self._permitted:
            self.permit(f"{type(task.motion).__name__}: {found}")

    def _break_off(self) -> None:
        """End a motion before its end; `__exit__` tries again, and reports errors.

        The thread that uses the line releases it first.
        """
        with held(), contextlib.suppress(Exception):
            if self._running is not None:
                self._running.close()
            self._halt()

    def _add_instruments(self, block: Block, load: Load) -> None:
        for name, gauge in self._gauges.items():
            block[name] = gauge.at(self._host_time(block["time"]))
        if load.clamped and "rotor_angle" not in block:
            block["rotor_angle"] = np.full(len(block["time"]), self._clamp_angle)

    def _host_time(self, time: Array) -> Array:
        """Return the time of the line's clock at these times of the bench clock, s."""
        return time

    # -- the operator

    def clamp(self, angle: float) -> None:
        """Clamp the arm with the shaft at this angle, rad."""
        degrees = math.degrees(angle)
        here = math.degrees(self._position())
        self._operator.done(
            f"Clamp the arm on the force gauge with the shaft at {degrees:.1f} deg (now "
            f"{here:.1f} deg)"
        )
        self._clamp_angle = self._position()

    def soak(self, temperature_degc: float) -> None:
        """Wait until the motor has this temperature throughout, degC."""
        self._operator.done(
            f"Bring the motor to {temperature_degc:g} degC and wait until it has it throughout"
        )

    def power_cycle(self) -> None:
        """Switch the amplifier off and on: it calibrates itself again."""
        self._halt()
        self._operator.done("Switch the amplifier off and on again")
        self.line.reopen(COMING_BACK)
        self.line.settle()
        self._identity = self._connect()


def in_thread(work: Callable[[Callable[[Block], None], threading.Event], None]) -> Iterator[Block]:
    """Yield the blocks that `work(put, stop)` puts, from a thread of its own.

    The use of a block thus never disturbs the line. `work` returns soon once `stop` is set:
    that happens where the caller gives up. Its errors are raised here, after its last block.
    """
    blocks: queue.Queue[Block | BaseException | None] = queue.Queue()
    stop = threading.Event()

    def run() -> None:
        try:
            work(blocks.put, stop)
            blocks.put(None)
        except BaseException as error:
            blocks.put(error)

    thread = threading.Thread(target=run, name="line", daemon=True)
    thread.start()
    try:
        while (item := blocks.get()) is not None:
            if isinstance(item, BaseException):
                raise item
            yield item
    finally:
        stop.set()
        with held():
            thread.join()


def describe_load(load: Load, attachment: str) -> str:
    """Return the request to the operator for a load."""
    parts = []
    if load.force:
        where = "the grasper" if attachment == "instrument" else "the cord on the pulley"
        parts.append(
            f"hang {load.force:g} N ({load.force / STANDARD_GRAVITY * 1e3:.1f} g) on {where}"
        )
    if load.torque:
        parts.append(f"load the shaft with {load.torque * 1e3:g} mN m (weight on a cord)")
    if load.radial_force:
        parts.append(f"pull the shaft sideways with {load.radial_force:g} N")
    if not parts:
        parts.append("remove all loads")
    where = "clamped on" if load.clamped else "away from"
    parts.append(f"see that the arm is {where} the force gauge")
    text = ", ".join(parts)
    return text[0].upper() + text[1:]
