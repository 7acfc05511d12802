"""The motions that a command will make, listed by running its procedure on a rig that only records
requests.

Motions that depend on earlier measurements are not known beforehand: the list ends there, with a
note.
"""

from __future__ import annotations

import math
import re
from collections import Counter
from collections.abc import Generator, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from rigtool.control.position_loop import largest_deviation
from rigtool.errors import HardwareError, RecipeError
from rigtool.experiments.outcome import Outcome
from rigtool.experiments.procedure import Procedure
from rigtool.recipe import Recipe
from rigtool.recipe.serial import Serial
from rigtool.rigs import NEED_DESCRIPTIONS, Block, Load, Rig, Task, open_rig
from rigtool.rigs.motion import Observe, OpenLoop
from rigtool.rigs.serial import safety
from rigtool.rigs.serial.drivers import REPLAY_DRIVER, driver
from rigtool.rigs.serial.instruments import require_instrument
from rigtool.rigs.serial.rig import describe_load
from rigtool.runfile import RecordingSpec, Run

LISTED_MOTIONS = 12
"""Kinds of motion that are listed; the others are only counted."""


LONGEST_VIRTUAL_TIME = 24 * 3600.0
"""All motions of a command on the virtual rig, s: an hour of its clock takes seconds."""


class _NeedsData(Exception):
    """The motions from here on depend on measurements."""


@dataclass
class MotionPlan:
    """Motions in order, with the extremes of each; needed abilities of the rig, by name.

    `complete` is false where further motions depend on the results of these.
    """

    duration: float = 0.0
    motions: list[tuple[str, safety.Extremes]] = field(default_factory=list)
    bench_work: list[str] = field(default_factory=list)
    temperatures: list[float] = field(default_factory=list)
    needs: dict[str, None] = field(default_factory=dict)
    complete: bool = True

    def __str__(self) -> str:
        together = Counter(f"{name}: {found}" for name, found in self.motions)
        lines = [
            f"  {line}" if count == 1 else f"  {count} times {line}"
            for line, count in together.items()
        ]
        if (rest := len(lines) - LISTED_MOTIONS) > 0:
            lines[LISTED_MOTIONS:] = [f"  and {rest} kinds of motion more"]
        count, total = len(self.motions), self.duration
        head = f"{count} motion{'s' if count != 1 else ''} to record, {total:.0f} s in all"
        parts = [head, *lines]
        if self.bench_work or self.temperatures:
            parts += ["At the bench:", *(f"  {work}" for work in self._work())]
        if not self.complete:
            parts.append(
                "Further motions depend on the results of these; the limits hold for all motions"
            )
        return "\n".join(parts)

    def _work(self) -> list[str]:
        """Return what the operator does, each once: temperatures, then all else."""
        degc = ", ".join(f"{temperature:g}" for temperature in sorted(set(self.temperatures)))
        soaks = [f"bring the motor to {degc} degC"] if degc else []
        return [*soaks, *dict.fromkeys(self.bench_work)]

    def check(self, limits: Any) -> None:
        """Raise `RecipeError` for the first motion beyond the limits."""
        for name, found in self.motions:
            safety.require_within_limits(found, limits, name)


class _Rehearsal(Rig):
    """A rig that only lists the motions that it is asked for."""

    def __init__(
        self, recipe: Recipe, torque_constant: float, position: float, *, evaluated: bool
    ) -> None:
        self.plan = MotionPlan()
        self._recipe, self._rig = recipe, recipe.rig
        self._limits = recipe.line.limits if _on_line(recipe) else None
        name = recipe.line.driver if _on_line(recipe) else REPLAY_DRIVER
        self._host_closes = name != REPLAY_DRIVER and driver(name).host_closes
        self._torque_constant = torque_constant
        self._position = position
        self._evaluated = evaluated

    @property
    def position(self) -> float:
        """Angle of the shaft after the motions so far, rad; NaN where it is not known."""
        return self._position

    def perform(self, task: Task) -> Generator[Block, None, None]:
        """List a task; there are no signals."""
        self.plan.duration += task.motion.duration
        if self._limits is not None:
            safety.require_duration(task, self._limits)
        elif self.plan.duration > LONGEST_VIRTUAL_TIME:
            raise RecipeError(
                f"the motions would last longer than {LONGEST_VIRTUAL_TIME / 3600:.0f} h on the "
                "clock of the virtual rig: shorten them in the recipe"
            )
        self._require_carried(task.load)
        if not isinstance(task.motion, OpenLoop):
            self._require_held(task.load)
        if self._evaluated:
            found = safety.extremes(
                task, self._position, self._rig.sample_time, self._torque_constant
            )
            self._position = found.end
            name = re.sub(r"\B(?=[A-Z])", " ", type(task.motion).__name__).lower()
            self.plan.motions.append((name, found))
        for need in _needs(task):
            work = [describe_load(task.load, self._rig.attachment)] if need == "load" else []
            self._need(need, *work)
        nothing: tuple[Block, ...] = ()
        return (block for block in nothing)

    def _require_carried(self, load: Load) -> None:
        """Raise `RecipeError` for a load that takes more current than there is."""
        current, limit = self._torque(load) / self._torque_constant, self._recipe.highest_current
        if current > limit:
            raise RecipeError(
                f"a load of {_weight(load)} takes {current:.4g} A of the motor, and the current is "
                f"limited to {limit:g} A: lower the load in the recipe, where forces are in N and "
                "torques in N m"
            )

    def _require_held(self, load: Load) -> None:
        """Raise `RecipeError` for a load that pulls the shaft out of the loop of the host."""
        if self._limits is None or not self._host_closes or not (torque := self._torque(load)):
            return
        pulled = torque * largest_deviation(**self._rig.loop_design)
        if pulled > self._limits.following_error:
            raise RecipeError(
                f"a load of {_weight(load)} pulls the shaft up to {pulled:.3g} rad off its set "
                "point in the loop of [rig.controller], and serial.limits.following_error is "
                f"{self._limits.following_error:g} rad: lower the load in the recipe, or close the "
                "loop faster, with a shorter rig.sample_time and a higher crossover_hz"
            )

    def _torque(self, load: Load) -> float:
        """Return the magnitude of the torque of a load at the motor, N m."""
        return abs(load.force * self._rig.load_arm / self._rig.torque_factor + load.torque)

    def move_by(self, angle: float) -> None:
        """Follow a move between recordings."""
        self._need("closed_loop")
        if math.isfinite(self._position):
            self._position += angle

    def clamp(self, angle: float) -> None:
        """List the clamping of the arm."""
        self._need("clamp", "clamp the arm at several angles")

    def soak(self, temperature_degc: float) -> None:
        """List a temperature."""
        self._need("soak")
        self.plan.temperatures.append(temperature_degc)

    def power_cycle(self) -> None:
        """List a power cycle of the amplifier."""
        self._need("power_cycle", "switch the amplifier off and on")

    def _need(self, need: str, *work: str) -> None:
        self.plan.needs[need] = None
        self.plan.bench_work += work


def _weight(load: Load) -> str:
    return f"{load.force:g} N at the output" if load.force else f"{load.torque:g} N m"


class _Recorder:
    """Stands for the writer in a rehearsal; has no recording to return."""

    def __init__(self, specs: Sequence[RecordingSpec]) -> None:
        self._names = {spec.name: tuple(c.name for c in spec.channels) for spec in specs}

    def channel_names(self, recording: str) -> tuple[str, ...]:
        """Return the channels of a recording."""
        return self._names[recording]

    def recording(self, name: str) -> Any:
        """Raise: nothing was recorded."""
        raise _NeedsData

    def recorded(self) -> Any:
        """Raise: nothing was recorded."""
        raise _NeedsData


def rehearse(
    procedure: Procedure,
    recipe: Recipe,
    torque_constant: float,
    inputs: Mapping[str, Run],
    position: float = 0.0,
    *,
    evaluated: bool = True,
) -> MotionPlan:
    """Return the motions of a command; the shaft starts at `position`, rad.

    What they ask for at most is only `evaluated` on demand: that takes time. Raises `RecipeError`
    where the recipe asks for what no rig, or not this rig, can do.
    """
    specs = procedure.recordings(recipe)
    rig = _Rehearsal(recipe, torque_constant, position, evaluated=evaluated)
    try:
        procedure.measure(rig, recipe, _Recorder(specs), **inputs)
    except _NeedsData:
        rig.plan.complete = False
    for spec in specs:
        rig.plan.needs |= {channel.name: None for channel in spec.channels}
    rig.plan.needs |= dict.fromkeys(procedure.rig_needs(recipe))
    return rig.plan


def require_offered(rig: Rig, plan: MotionPlan, command: str) -> None:
    """Raise `HardwareError` with every reason why this rig cannot run a command."""
    reasons = [
        f"it needs to {NEED_DESCRIPTIONS[need]}: {reason}"
        if need in NEED_DESCRIPTIONS
        else f"it records {need}: {reason}"
        for need in plan.needs
        if (reason := rig.lacks(need)) is not None
    ]
    if reasons:
        raise HardwareError(f"{command} cannot run on this rig: {'; '.join(reasons)}")


def dry_run(
    procedure: Procedure, recipe: Recipe, torque_constant: float, inputs: Mapping[str, Run]
) -> Outcome:
    """Return the motions as notes, checked against the limits of a rig on a serial line."""
    if not _on_line(recipe):
        open_rig(recipe, torque_constant, procedure.command)
    plan = rehearse(procedure, recipe, torque_constant, inputs)
    notes = [str(plan)]
    if _on_line(recipe):
        limits, name = recipe.line.limits, recipe.line.driver
        plan.check(limits)
        found = None if name == REPLAY_DRIVER else driver(name)
        require_gauges(plan, recipe.line, procedure.command)
        low, high = limits.position
        notes.append(
            f"Within the limits {limits.current:g} A, {limits.speed:g} rad/s, {low:g} to {high:g} "
            f"rad (counted from the shaft's position at the start), {limits.duration:g} s a motion"
        )
        notes.append("Whether the drive offers all of this is checked when it is connected")
        if found is not None and not found.has_watchdog:
            notes.append(
                "This drive has no watchdog: where computer or cable fail it continues with its "
                "last set point. It runs only with serial.emergency_stop = true; try that stop "
                "first"
            )
    return Outcome(results={}, tables={}, notes=tuple(notes))


def require_gauges(plan: MotionPlan, settings: Serial, command: str) -> None:
    """Raise `RecipeError` for a gauge that no drive has and the recipe does not name, or that is
    unknown.
    """
    for channel, instrument in settings.instruments.items():
        require_instrument(channel, instrument)
    if settings.driver == REPLAY_DRIVER or driver(settings.driver).make_drive is None:
        return
    for need in ("force", "deflection"):
        if need in plan.needs and getattr(settings, need) is None:
            raise RecipeError(
                f"{command} cannot run on this rig: it records {need}, which {settings.driver} "
                f"does not measure: add [serial.{need}]"
            )


def _on_line(recipe: Recipe) -> bool:
    return recipe.rig.source == "serial"


def _needs(task: Task) -> Iterator[str]:
    if isinstance(task.motion, Observe):
        yield "observe"
    else:
        yield "open_loop" if isinstance(task.motion, OpenLoop) else "closed_loop"
    added, load = task.feedforward, task.load
    if added.inertia or added.coulomb or added.viscous:
        yield "feedforward"
    if added.table is not None:
        yield "table"
    if added.signal is not None:
        yield "signal"
    if load.force or load.torque or load.radial_force:
        yield "load"
    if load.clamped:
        yield "clamp"
