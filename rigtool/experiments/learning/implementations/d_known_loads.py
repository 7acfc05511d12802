"""`ilc-learn --implementation D`: the table of implementation C, and torque as a third input [9].

First C learns by position and speed. Then known loads are lifted and lowered at several speeds,
each speed beginning and ending without load; from these the disturbance of a load is learned
(`experiments.load_disturbance.model`): friction that grows with load, stiffness of the tendon,
ripple by current. A short motion without load explores what strokes do not show: rest and reversals
anywhere. From all of them the model of motor and instrument is learned that reads torque over time
(`experiments.force_over_time.model`). All go into one run file: the table is fed forward while
moving, disturbance and model convert the motor's torque into a load.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from rigtool.errors import InsufficientDataError, RecipeError, RunFileError
from rigtool.experiments.controller_torque import loop_signals, naming
from rigtool.experiments.force_over_time import stored
from rigtool.experiments.force_over_time.procedure_learning import exploring, learn_force
from rigtool.experiments.learning.implementations.c_limited_angle import LimitedAngle
from rigtool.experiments.learning.stored_table import feedforward, friction_results
from rigtool.experiments.load_disturbance.cycles import LoadedCycles
from rigtool.experiments.load_disturbance.fit import fit_disturbance, refit_disturbance
from rigtool.experiments.load_disturbance.model import Disturbance, LoadedPair
from rigtool.experiments.load_disturbance.reading import read_load
from rigtool.experiments.load_disturbance.stored import (
    Grid,
    grid_of,
    grid_tables,
    model_tables,
    tendon_results,
)
from rigtool.experiments.load_disturbance.stored_recordings import CHANNELS, cycles_of
from rigtool.experiments.load_disturbance.tendon import Tendon
from rigtool.experiments.outcome import Outcome
from rigtool.experiments.procedure import channels, record
from rigtool.quantity import Quantity
from rigtool.recipe import Recipe
from rigtool.rigs import Load, Rig, Task
from rigtool.rigs.motion import Triangle
from rigtool.runfile import Column, Recording, RecordingSpec, Run, RunWriter, Table

LOADED = "known"
"""First part of the names of recordings of known loads."""

EXPLORED, CHECKED = "explore", "check"
"""First part of the name of the recording that explores, and of those that check the model."""


def _loaded(recipe: Recipe) -> list[RecordingSpec]:
    settings, ratio = recipe.ilc_learn.loads, recipe.rig.angle_ratio
    return [
        RecordingSpec(
            f"{LOADED}_{row:03d}_{number:03d}",
            channels(*CHANNELS),
            {
                "speed": (2 * math.pi * speed * ratio, "rad/s"),
                "force": (force, "N"),
                "cycles": (float(settings.cycles), "1"),
            },
            settings.record_every,
        )
        for row, speed in enumerate(settings.speeds_rev_per_s)
        for number, force in enumerate((0.0, *settings.forces, 0.0))
    ]


def _explored(recipe: Recipe) -> list[RecordingSpec]:
    """List the exploration, and the same with other free motion under three loads."""
    loads = sorted(recipe.ilc_learn.loads.forces)
    names = [f"{EXPLORED}_000", *(f"{CHECKED}_{number:03d}" for number in range(3))]
    forces = (0.0, 0.0, loads[len(loads) // 2], loads[-1])
    return [
        RecordingSpec(name, channels(*CHANNELS), {"force": (force, "N")})
        for name, force in zip(names, forces, strict=True)
    ]


class KnownLoads(LimitedAngle):
    """Learning as implementation C does, and then from known loads."""

    @classmethod
    def recordings(cls, recipe: Recipe) -> tuple[RecordingSpec, ...]:
        """List what implementation C records, the known loads at each speed, the exploration."""
        return (*super().recordings(recipe), *_loaded(recipe), *_explored(recipe))

    def require(self, recipe: Recipe, friction: Run | None) -> None:
        """Raise `RecipeError` without the instrument."""
        if recipe.rig.attachment != "instrument":
            raise RecipeError(
                "implementation D learns what an instrument does to a load; rig.attachment is "
                f"{recipe.rig.attachment}: attach the instrument, or learn with implementation C"
            )

    @classmethod
    def measure(cls, rig: Rig, recipe: Recipe, recorder: RunWriter, **inputs: Any) -> None:
        """Learn the table, then lift and lower the known loads."""
        super().measure(rig, recipe, recorder, **inputs)
        plain = feedforward(recipe.rig.nominal_inertia, friction_results(inputs.get("friction")))
        settings, ratio = recipe.measure_force, recipe.rig.angle_ratio
        for spec in _loaded(recipe):
            motion = Triangle(
                low=0.0,
                high=math.radians(settings.angle) * ratio,
                speed=spec.conditions["speed"][0],
                turn_angle=math.radians(settings.turn_angle) * ratio,
                cycles=int(spec.conditions["cycles"][0]),
            )
            load = Load(force=spec.conditions["force"][0])
            task = Task(motion, plain, load, record_every=spec.record_every)
            record(rig, task, recorder, spec.name)
        for number, spec in enumerate(_explored(recipe)):
            load = Load(force=spec.conditions["force"][0])
            record(rig, Task(exploring(recipe, number), plain, load), recorder, spec.name)

    @classmethod
    def analyse(cls, runs: Sequence[Run], recipe: Recipe, **inputs: Any) -> Outcome:
        """Learn the table from its moves, and the disturbance from the known loads.

        Raises `InsufficientDataError` where the loads do not carry it.
        """
        table = super().analyse(runs, recipe, **inputs)
        pairs, moments = _pairs(runs[0], recipe, inputs["kt"])
        disturbance = fit_disturbance(pairs, moments)
        loads = _loads_outcome(runs[0], recipe, disturbance, pairs, moments)
        force = _learn_force(runs[0], recipe, inputs["kt"], disturbance.tendon)
        return Outcome(
            {**table.results, **loads.results, **force.results},
            {**table.tables, **loads.tables, **force.tables},
            (*table.notes, *loads.notes, *force.notes),
        )


def _learn_force(run: Run, recipe: Recipe, kt: Run, tendon: Tendon) -> Outcome:
    explored = run.recordings_named(f"{EXPLORED}_")
    if not explored:
        note = "no recording explores rest and reversals: force over time needs tables learned anew"
        return Outcome({}, {}, (note,))
    moves = [r for kind in ("learn", "low") for r in run.recordings_named(f"{kind}_")]
    strokes = run.recordings_named(f"{LOADED}_")
    checks = run.recordings_named(f"{CHECKED}_")
    model = learn_force(strokes, moves, explored[0], checks, recipe, kt, tendon)
    return Outcome(stored.model_results(model), stored.model_tables(model))


def _loads_outcome(
    run: Run,
    recipe: Recipe,
    disturbance: Disturbance,
    pairs: list[LoadedPair],
    moments: list[float],
) -> Outcome:
    grid = grid_of(disturbance, pairs, recipe)
    return Outcome(
        {
            **_tendon_results(disturbance, pairs, moments),
            "load_friction_coefficient": _friction_coefficient(grid, recipe),
            "learned_torque": Quantity(
                disturbance.torque, "N m", reason="a bound of what was learned, not measured"
            ),
            "learned_temperature": Quantity(
                _temperature(run), "degC", reason="how well the sensor is calibrated is not known"
            ),
        },
        {
            **grid_tables(grid, recipe),
            **model_tables(disturbance),
            "left_out": _left_out(disturbance, pairs, moments, recipe),
        },
        _notes(disturbance, pairs, recipe),
    )


def _temperature(run: Run) -> float:
    """Return the motor's mean temperature while the loads were lifted, degC."""
    recorded = run.recordings_named(f"{LOADED}_")
    return float(np.mean([np.mean(recording.read("temperature")) for recording in recorded]))


def _pairs(run: Run, recipe: Recipe, kt: Run) -> tuple[list[LoadedPair], list[float]]:
    """Return each load beside the same motion without, and its moment, N m."""
    recorded = run.recordings_named(f"{LOADED}_")
    by_speed: dict[float, list[Recording]] = {}
    for recording in recorded:
        by_speed.setdefault(recording.condition("speed"), []).append(recording)
    pairs, moments = [], []
    margin = math.radians(recipe.measure_force.turn_angle)
    for speed, group in by_speed.items():
        cycles = {r.name: _cycles(r, recipe, kt, speed) for r in group}
        unloaded = [cycles[r.name] for r in group if r.condition("force") == 0]
        loaded = [r for r in group if r.condition("force") > 0]
        if loaded and not unloaded:
            raise RunFileError(
                f"{run.path}: nothing was recorded without load at {speed:.4g} rad/s: learn again"
            )
        pairs += [LoadedPair.of(cycles[r.name], unloaded, margin) for r in loaded]
        moments += [r.condition("force") * recipe.rig.load_arm for r in loaded]
    if len(set(moments)) < 2:
        raise RunFileError(
            f"{run.path}: holds {len(set(moments))} known loads, 2 are needed: give the run file "
            "in which ilc-learn --implementation D recorded its signals"
        )
    return pairs, moments


def _cycles(recording: Recording, recipe: Recipe, kt: Run, speed: float) -> LoadedCycles:
    with naming(recording):
        signals = loop_signals(recording, recipe)
    return cycles_of(recording, signals, recipe, kt, speed)


def _friction_coefficient(grid: Grid, recipe: Recipe) -> Quantity:
    """Return friction per load of the largest load at the slowest speed, at `measure_angle`."""
    speed, load = min(grid.friction), float(grid.load[-1])
    angle = math.radians(recipe.measure_force.measure_angle)
    friction, u = (
        float(np.interp(angle, grid.angle, values[speed][:, -1]))
        for values in (grid.friction, grid.friction_u)
    )
    return Quantity(friction / load, "1", u / load)


def _tendon_results(
    disturbance: Disturbance, pairs: list[LoadedPair], moments: list[float]
) -> dict[str, Quantity]:
    """Return the tendon's parameters, its stiffness also by the slowest and fastest speed alone.

    The slowest shows it by the shift of the peak, the fastest by how the load swings.
    """
    results, speeds = tendon_results(disturbance), disturbance.speeds
    if len(speeds) > 1:
        for name, speed in (("shift", speeds[0]), ("resonance", speeds[-1])):
            own = [i for i, each in enumerate(pairs) if each.loaded.speed == speed]
            alone = fit_disturbance([pairs[i] for i in own], [moments[i] for i in own])
            results[f"tendon_stiffness_{name}"] = tendon_results(alone)["tendon_stiffness"]
    return results


def _left_out(
    disturbance: Disturbance,
    pairs: list[LoadedPair],
    moments: list[float],
    recipe: Recipe,
) -> Table:
    """Read each load with what was learned from the other loads, at all speeds."""
    loads, speeds = sorted(set(moments)), disturbance.speeds
    angle = math.radians(recipe.measure_force.measure_angle)
    error, u = np.full((2, len(speeds), len(loads)), math.nan)
    for column, moment in enumerate(loads):
        others = [i for i, m in enumerate(moments) if m != moment]
        less = refit_disturbance(
            disturbance, [pairs[i] for i in others], [moments[i] for i in others]
        )
        for pair, there in zip(pairs, moments, strict=True):
            if there != moment:
                continue
            row = speeds.index(pair.loaded.speed)
            try:
                found = read_load(less, pair, angle)
            except InsufficientDataError:
                continue
            error[row, column] = 100 * (found.moment / moment - 1)
            u[row, column] = 100 * found.u / moment
    return Table(
        ("speed", "load"),
        {
            "speed": Column(np.array(speeds), "rad/s", "of the motor shaft"),
            "load": Column(np.array(loads), "N m", "moment of the known load at 90 deg"),
            "error_percent": Column(error, "%", "of the load; NaN where it could not be read"),
            "u": Column(u, "%", "standard uncertainty that the reading states"),
        },
        "error_percent",
        "each known load read with a disturbance learned from the other loads; the largest one is "
        "extrapolated",
    )


def _notes(disturbance: Disturbance, pairs: list[LoadedPair], recipe: Recipe) -> tuple[str, ...]:
    ratio = 2 * math.pi * recipe.rig.angle_ratio
    slow, fast = disturbance.speeds[0] / ratio, disturbance.speeds[-1] / ratio
    return (
        f"loads were learned up to {disturbance.torque * 1e3:.4g} mN m from {slow:.3g} to "
        f"{fast:.3g} rev/s: measure-force corrects those within this range and reports others",
    )
