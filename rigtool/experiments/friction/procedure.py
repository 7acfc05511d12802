"""stribeck: friction against speed, and breakaway around the turn [7.1.2, 7.2.1, 7.2.2].

Holds at constant speed give the friction; with it, the sweep is repeated with Coulomb and then with
viscous compensation too, and the torque-speed curve must go flat. Breakaway is measured by slow
ramps of current from many rotor angles, without and with a radial force on the shaft; with the
force, some speeds are held again.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass

from rigtool.errors import RecipeError
from rigtool.experiments.controller_torque import require_stable_loop
from rigtool.experiments.friction.imported import analyse_imported
from rigtool.experiments.friction.procedure_analysis import (
    BREAKAWAY,
    BREAKAWAY_LOADED,
    HOLD_RECORDING,
    HOLDS_LOADED,
    SWEEP_RECORDINGS,
    analyse,
    coulomb_and_viscous,
)
from rigtool.experiments.procedure import Procedure, channels, record
from rigtool.experiments.torque_per_ampere import torque_per_ampere
from rigtool.recipe import Recipe
from rigtool.recipe.commands import Stribeck
from rigtool.rigs import Feedforward, Load, Rig, Task
from rigtool.rigs.motion import CurrentRamp, SpeedProfile
from rigtool.runfile import RecordingSpec, Run, RunWriter

RUN_UP = 1.0
"""Time from standstill to the highest speed, s."""

SETTLE_TIME = 1.0
"""Added to each hold before the whole turns that are averaged, s."""

SLIDING_SPEED = 1.0
"""Lowest speed of holds under radial force, rad/s."""

LOADED_SPEEDS = 4
"""Largest number of speeds held under radial force."""

STOP_ANGLE_FACTOR = 4.5
"""A ramp ends when the shaft has moved by this multiple of the breakaway angle."""

APPROACH_ANGLE = 0.2
"""Each position is approached from at least this far in the ramp's direction, rad."""


def rig_needs(recipe: Recipe) -> tuple[str, ...]:
    """Return the abilities that compensation and breakaway need, once friction is known."""
    loaded = recipe.stribeck.radial_force > 0
    return ("feedforward", "open_loop", *(("load",) if loaded else ()))


def recordings(recipe: Recipe) -> tuple[RecordingSpec, ...]:
    """Holds, three sweeps, two series of ramps, and holds under radial force."""
    names = channels(
        "time",
        "position_setpoint",
        "encoder",
        "current_setpoint",
        "current",
        "feedforward_current",
        "temperature",
    )
    force, every = recipe.stribeck.radial_force, recipe.stribeck.record_every
    conditions = {BREAKAWAY: {"radial_force": (0.0, "N")}}
    conditions[BREAKAWAY_LOADED] = conditions[HOLDS_LOADED] = {"radial_force": (force, "N")}
    return tuple(
        RecordingSpec(name, names, conditions.get(name, {}), every)
        for name in (HOLD_RECORDING, *SWEEP_RECORDINGS, BREAKAWAY, BREAKAWAY_LOADED, HOLDS_LOADED)
    )


def measure(rig: Rig, recipe: Recipe, recorder: RunWriter, *, kt: Run) -> None:
    """Hold, sweep, compensate and sweep again, then break the shaft away around the turn.

    Raises `RecipeError` where the ramps would go beyond the limit of current.
    """
    require_stable_loop(recipe)
    settings = recipe.stribeck
    highest = recipe.rig.torque_constant * recipe.highest_current
    if settings.breakaway_limit > highest:
        raise RecipeError(
            f"stribeck.breakaway_limit is {settings.breakaway_limit:g} N m, the limit of current "
            f"leaves {highest:.4g} N m: lower the first"
        )
    every = settings.record_every
    for direction in (1.0, -1.0):
        task = Task(hold_profile(settings, direction), record_every=every)
        record(rig, task, recorder, HOLD_RECORDING)
    coulomb, viscous = coulomb_and_viscous(recorder.recording(HOLD_RECORDING), recipe, kt)
    compensations = (
        Feedforward(),
        Feedforward(coulomb=coulomb),
        Feedforward(coulomb=coulomb, viscous=viscous),
    )
    for name, feedforward in zip(SWEEP_RECORDINGS, compensations, strict=True):
        task = Task(sweep_profile(settings), feedforward=feedforward, record_every=every)
        record(rig, task, recorder, name)
    shaft = _Shaft()
    for name, force in ((BREAKAWAY, 0.0), (BREAKAWAY_LOADED, settings.radial_force)):
        if name == BREAKAWAY or force > 0:
            _ramps(rig, recipe, recorder, kt, name, force, shaft)
    if settings.radial_force > 0:
        load = Load(radial_force=settings.radial_force)
        task = Task(loaded_profile(settings), load=load, record_every=every)
        record(rig, task, recorder, HOLDS_LOADED)


@dataclass
class _Shaft:
    """Angle of the shaft from the start of the first ramp, rad; encoder count at that start."""

    angle: float = 0.0
    origin: float | None = None


def hold_profile(settings: Stribeck, direction: float) -> SpeedProfile:
    """Return a motion that holds each speed for whole turns, from the lowest to the highest."""
    holds = []
    for speed in sorted(settings.hold_speeds):
        turns = max(settings.hold_revolutions, math.ceil(settings.hold_time * speed / 2 / math.pi))
        holds.append((direction * speed, turns))
    return _profile(settings, holds)


def loaded_profile(settings: Stribeck) -> SpeedProfile:
    """Return a motion that holds a few speeds to and fro, so that hung weights move little.

    The lowest hold speeds at which a shaft slides, or the highest of all.
    """
    speeds = sorted(settings.hold_speeds)
    chosen = [speed for speed in speeds if speed >= SLIDING_SPEED][:LOADED_SPEEDS] or speeds[-1:]
    turns = settings.hold_revolutions
    return _profile(settings, [(sign * speed, turns) for speed in chosen for sign in (1, -1)])


def _profile(settings: Stribeck, holds: Iterable[tuple[float, int]]) -> SpeedProfile:
    """Return a motion that holds speeds, rad/s, for so many turns each, and comes to rest."""
    times, speeds = [0.0], [0.0]

    def go(speed: float, duration: float) -> None:
        times.append(times[-1] + abs(speed - speeds[-1]) * RUN_UP / settings.speed_max)
        speeds.append(speed)
        if duration > 0:
            times.append(times[-1] + duration)
            speeds.append(speed)

    for speed, turns in holds:
        go(speed, SETTLE_TIME + turns * 2 * math.pi / abs(speed))
    go(0.0, 0.0)
    return SpeedProfile(tuple(times), tuple(speeds))


def sweep_profile(settings: Stribeck) -> SpeedProfile:
    """Return a motion from standstill to full speed backwards, slowly to full speed, and a stop."""
    top, end = settings.speed_max, RUN_UP + settings.sweep_time
    return SpeedProfile((0.0, RUN_UP, end, end + RUN_UP), (0.0, -top, top, 0.0))


def _ramps(
    rig: Rig,
    recipe: Recipe,
    recorder: RunWriter,
    kt: Run,
    name: str,
    radial_force: float,
    shaft: _Shaft,
) -> None:
    """Ramp the current from each position in both directions."""
    settings = recipe.stribeck
    constant = torque_per_ampere(kt).value
    pitch = 2 * math.pi / settings.breakaway_positions
    for direction in (1.0, -1.0):
        task = Task(
            CurrentRamp(
                direction * settings.breakaway_rate / constant,
                direction * settings.breakaway_limit / constant,
            ),
            load=Load(radial_force=radial_force),
            record_every=settings.record_every,
            stop_angle=STOP_ANGLE_FACTOR * settings.breakaway_angle,
        )
        for number in range(settings.breakaway_positions):
            _go_to(rig, shaft, direction * number * pitch, direction)
            _record_ramp(rig, task, recorder, name, shaft, recipe.rig.encoder_counts)


def _go_to(rig: Rig, shaft: _Shaft, target: float, direction: float) -> None:
    """Turn the shaft to an angle within the turn, arriving in the ramp's direction."""
    target += 2 * math.pi * round((shaft.angle - target) / (2 * math.pi))
    if direction * (target - shaft.angle) < APPROACH_ANGLE:
        rig.move_by(target - direction * APPROACH_ANGLE - shaft.angle)
        shaft.angle = target - direction * APPROACH_ANGLE
    rig.move_by(target - shaft.angle)


def _record_ramp(
    rig: Rig, task: Task, recorder: RunWriter, name: str, shaft: _Shaft, counts: int
) -> None:
    """Record a ramp and update the angle of the shaft."""
    channel_names = recorder.channel_names(name)
    for block in rig.perform(task):
        recorder.append(name, {channel: block[channel] for channel in channel_names})
        encoder = block["encoder"]
        if len(encoder):
            if shaft.origin is None:
                shaft.origin = float(encoder[0])
            shaft.angle = (float(encoder[-1]) - shaft.origin) * 2 * math.pi / counts


PROCEDURE = Procedure(
    "stribeck",
    recordings,
    measure,
    analyse,
    needed=("kt",),
    bare_motor=True,
    analyse_imported=analyse_imported,
    rig_needs=rig_needs,
)
