"""`ilc-learn --implementation D`: the table of implementation C, and torque as a third input [9].

First C learns by position and speed. Then known loads are lifted and lowered at several speeds,
each speed beginning and ending without load. A short motion without load shows what strokes do not:
rest and reversals anywhere. From all of them one model of motor, friction and tendon is learned
(`experiments.force_model.model`). The disturbance of a load by speed, position and torque is a
table of it (`experiments.load_disturbance.sliding`). All go into one run file: the table of C is
fed forward while moving, the model converts the motor's torque into a load.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from rigtool.errors import InsufficientDataError, RecipeError, RunFileError
from rigtool.experiments.force_model import stored
from rigtool.experiments.force_model.procedure_learning import (
    LOADED_CHANNELS,
    LearnedForce,
    exploring,
    learn_force,
)
from rigtool.experiments.force_model.records import SLIDING_COUNT_RATE, Record
from rigtool.experiments.learning.implementations.c_limited_angle import LimitedAngle
from rigtool.experiments.learning.implementations.d_saturated import (
    FEWEST_LOADS,
    TooHeavy,
    left_out_notes,
    unsaturated,
)
from rigtool.experiments.learning.implementations.d_tendon import (
    inertia_notes,
    stroke_notes,
    tendon_results,
)
from rigtool.experiments.learning.implementations.signals import record_loop
from rigtool.experiments.learning.stored_table import feedforward, friction_results
from rigtool.experiments.load_disturbance.reading import LoadedPair, read_loads
from rigtool.experiments.load_disturbance.sliding import DisturbanceGrid, grid_of
from rigtool.experiments.load_disturbance.stored import grid_tables
from rigtool.experiments.outcome import Outcome
from rigtool.experiments.procedure import channels
from rigtool.experiments.torque_per_ampere import torque_per_ampere_at
from rigtool.numerics.arrays import Array
from rigtool.quantity import REFERENCE_DEGC, Quantity, scattered
from rigtool.recipe import Recipe
from rigtool.rigs import Load, Rig, Task
from rigtool.rigs.motion import Triangle
from rigtool.runfile import Column, Recording, RecordingSpec, Run, RunWriter, Table, dof_column

LOADED_PREFIX = "known"
"""First part of the names of recordings of known loads."""

EXPLORED, CHECKED = "explore", "check"
"""First part of the name of the recording that explores, and of those that check the model."""

ANGLE_STEP_DEG, POINTS_OF_LOAD = 5.0, 13
"""Of the tables of the disturbance."""


def _loaded(recipe: Recipe) -> list[RecordingSpec]:
    settings = recipe.ilc_learn.loads
    return [
        RecordingSpec(
            f"{LOADED_PREFIX}_{row:03d}_{number:03d}",
            channels(*LOADED_CHANNELS),
            {
                "speed": (recipe.rig.motor_speed(speed), "rad/s"),
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
        RecordingSpec(name, channels(*LOADED_CHANNELS), {"force": (force, "N")})
        for name, force in zip(names, forces, strict=True)
    ]


class KnownLoads(LimitedAngle):
    """Learning as implementation C does, and then from known loads."""

    @classmethod
    def recordings(cls, recipe: Recipe) -> tuple[RecordingSpec, ...]:
        """List the recordings of implementation C, the known loads by speed, the exploration."""
        return (*super().recordings(recipe), *_loaded(recipe), *_explored(recipe))

    def require(self, recipe: Recipe, friction: Run | None) -> None:
        """Raise `RecipeError` without the instrument."""
        if recipe.rig.attachment != "instrument":
            raise RecipeError(
                "implementation D learns the effects of an instrument on a load; rig.attachment is "
                f"{recipe.rig.attachment}: attach the instrument, or learn with implementation C"
            )

    @classmethod
    def measure(cls, rig: Rig, recipe: Recipe, recorder: RunWriter, **inputs: Any) -> None:
        """Learn the table, then lift and lower the known loads.

        Raises `InsufficientDataError` where the loop saturates without load, or so often that fewer
        than two loads are learned from.
        """
        super().measure(rig, recipe, recorder, **inputs)
        plain = feedforward(recipe.rig.nominal_inertia, friction_results(inputs.get("friction")))
        settings, ratio = recipe.measure_force, recipe.rig.angle_ratio
        too_heavy = TooHeavy()
        for spec in _loaded(recipe):
            speed, force, cycles = (spec.conditions[k][0] for k in ("speed", "force", "cycles"))
            if too_heavy(force, speed):
                continue
            motion = Triangle.of_output(
                settings.angle, settings.turn_angle, ratio, speed, int(cycles)
            )
            task = Task(motion, plain, Load(force=force), record_every=spec.record_every)
            with too_heavy.noticed(force, speed):
                record_loop(rig, recipe, task, recorder, spec.name)
        too_heavy.require_lifted()
        low = rig.position
        for number, spec in enumerate(_explored(recipe)):
            if number:
                rig.move_by(low - rig.position)
            force = spec.conditions["force"][0]
            task = Task(exploring(recipe, number), plain, Load(force=force))
            with too_heavy.noticed(force):
                record_loop(rig, recipe, task, recorder, spec.name)

    @classmethod
    def analyse(cls, runs: Sequence[Run], recipe: Recipe, **inputs: Any) -> Outcome:
        """Learn the table from its moves, and the disturbance from the known loads.

        Raises `InsufficientDataError` where the loads do not determine it.
        """
        table = super().analyse(runs, recipe, **inputs)
        run = runs[0]
        recorded = run.recordings_named(f"{LOADED_PREFIX}_")
        strokes = unsaturated(recorded, recipe, FEWEST_LOADS)
        learned = _learn_force(run, strokes, recipe, inputs["kt"])
        loads = _known_loads(run, strokes, recipe, learned.strokes)
        found = _loads_outcome(run, recipe, learned, loads)
        left_out = left_out_notes(recorded, strokes, learned.model.learned.shape, recipe)
        constant = torque_per_ampere_at(inputs["kt"], REFERENCE_DEGC)
        own = {stored.MODEL_PREFIX + stored.CONSTANT: constant}
        return Outcome(
            {**table.results, **found.results, **stored.model_results(learned.model), **own},
            {**table.tables, **found.tables, **stored.model_tables(learned.model)},
            (*table.notes, *left_out, *inertia_notes(learned.model.learned), *found.notes),
        )


def _learn_force(run: Run, strokes: Sequence[Recording], recipe: Recipe, kt: Run) -> LearnedForce:
    explored = run.recordings_named(f"{EXPLORED}_")
    forces = {r.condition("force") for r in strokes} - {0.0}
    if len(forces) < FEWEST_LOADS or not explored:
        raise RunFileError(
            f"{run.path}: holds {len(forces)} known loads and {len(explored)} recordings that "
            "explore rest and reversals, 2 loads and one exploration are needed: give the run file "
            "in which ilc-learn --implementation D recorded its signals, or learn again"
        )
    moves = [r for kind in ("learn", "low") for r in run.recordings_named(f"{kind}_")]
    switched, checks = (run.recordings_named(f"{kind}_") for kind in ("validate", CHECKED))
    healthy = unsaturated(checks, recipe)
    return learn_force(strokes, moves, switched, explored[0], healthy, recipe, kt)


@dataclass(frozen=True, eq=False)
class _KnownLoads:
    """Pairs of a load and the same motion without it, with motor `speed` rad/s and `moment` N m of
    each (n,), and the speeds of all strokes in the order of their recordings."""

    pairs: list[LoadedPair]
    speed: Array
    moment: Array


def _known_loads(
    run: Run, recorded: Sequence[Recording], recipe: Recipe, strokes: dict[str, Record]
) -> _KnownLoads:
    """Return each load beside the same motion without, where the rotor slides in both.

    Raises `InsufficientDataError` where it slides under no load.
    """
    by_speed: dict[float, list[Recording]] = {}
    for recording in recorded:
        by_speed.setdefault(recording.condition("speed"), []).append(recording)
    arm, found = recipe.rig.load_arm, []
    for speed, group in by_speed.items():
        unloaded = tuple(strokes[r.name] for r in group if r.condition("force") == 0)
        loaded = [r for r in group if r.condition("force") > 0]
        if loaded and not unloaded:
            raise RunFileError(
                f"{run.path}: nothing was recorded without load at {speed:.4g} rad/s: learn again"
            )
        for r in loaded:
            pair = LoadedPair(strokes[r.name], unloaded, arm)
            if all(record.used.any() for record in (pair.loaded, *unloaded)):
                found.append((pair, speed, r.condition("force") * arm))
    if not found:
        raise InsufficientDataError(
            f"{run.path}: under no known load does the rotor slide evenly, by "
            f"{SLIDING_COUNT_RATE:g} counts of the encoder a second or more: learn at higher "
            "ilc_learn.loads.speeds_rev_per_s"
        )
    pairs, speeds, moments = zip(*found, strict=True)
    return _KnownLoads(list(pairs), np.array(speeds), np.array(moments))


def _loads_outcome(run: Run, recipe: Recipe, learned: LearnedForce, loads: _KnownLoads) -> Outcome:
    settings, model = recipe.measure_force, learned.model.learned
    turn, largest = settings.turn_angle, float(loads.moment.max())
    speeds = np.unique(loads.speed)
    grid = grid_of(
        model,
        speeds.tolist(),
        np.radians(np.arange(turn, settings.angle - turn + ANGLE_STEP_DEG / 2, ANGLE_STEP_DEG)),
        largest * np.linspace(0, 1, POINTS_OF_LOAD) ** 2,  # closest where friction sets in
        float(np.mean([record.torque_constant for record in learned.strokes.values()])),
    )
    return Outcome(
        {
            **tendon_results(learned, loads.pairs, loads.speed, recipe.rig),
            "load_friction_coefficient": _friction_coefficient(grid, recipe),
            "learned_torque": Quantity(
                largest, "N m", reason="a bound of what was learned, not measured"
            ),
            "learned_temperature": Quantity(
                _temperature(run), "degC", reason="how well the sensor is calibrated is not known"
            ),
        },
        {**grid_tables(grid, recipe), "left_out": _left_out(learned, loads, recipe)},
        (*_notes(largest, speeds, recipe), *stroke_notes(learned, recipe)),
    )


def _temperature(run: Run) -> float:
    """Return the motor's mean temperature while the loads were lifted, degC."""
    recorded = run.recordings_named(f"{LOADED_PREFIX}_")
    return float(np.mean([np.mean(recording.read("temperature")) for recording in recorded]))


def _friction_coefficient(grid: DisturbanceGrid, recipe: Recipe) -> Quantity:
    """Return friction per load of the largest load at the slowest speed, at `measure_angle`."""
    angle = math.radians(recipe.measure_force.measure_angle)
    friction, u = (
        float(np.interp(angle, grid.angle, values[0, :, -1]))
        for values in (grid.friction, grid.friction_u)
    )
    load = float(grid.load[-1])
    return scattered(friction / load, "1", u / load, name="strokes under known loads")


def _left_out(learned: LearnedForce, loads: _KnownLoads, recipe: Recipe) -> Table:
    """Read each load with what was learned from the other loads, at all speeds."""
    settings, sliding = recipe.measure_force, learned.sliding
    moments, speeds = np.unique(loads.moment), np.unique(loads.speed)
    largest, angle = float(moments[-1]), math.radians(settings.measure_angle)
    error, u, dof = np.full((3, len(speeds), len(moments)), math.nan)
    for column, moment in enumerate(moments):
        less = sliding.learned_from([r.moment != moment for r in sliding.problem.records])
        for row, speed in enumerate(speeds):
            chosen = np.flatnonzero((loads.speed == speed) & (loads.moment == moment))
            for i in chosen.tolist():  # none where the load was too heavy
                (found,) = read_loads(less, [loads.pairs[i]], largest, angle, settings.lowpass_hz)
                if isinstance(found, InsufficientDataError):
                    continue
                error[row, column] = 100 * (found.moment / moment - 1)
                u[row, column] = 100 * (found.quantity.u or 0.0) / moment
                dof[row, column] = found.quantity.dof or math.inf
    return Table(
        ("speed", "load"),
        {
            "speed": Column(speeds, "rad/s", "of the motor shaft"),
            "load": Column(moments, "N m", "moment of the known load at 90 deg"),
            "error_percent": Column(error, "%", "of the load; NaN where it could not be read"),
            "u": Column(u, "%", "standard uncertainty that the reading states"),
            "dof": dof_column(dof),
        },
        "error_percent",
        "each known load read with a model learned from the other loads; the largest one is "
        "extrapolated",
    )


def _notes(largest: float, speeds: Array, recipe: Recipe) -> tuple[str, ...]:
    slow, fast = speeds[[0, -1]] / (2 * math.pi * recipe.rig.angle_ratio)
    return (
        f"loads were learned up to {largest * 1e3:.4g} mN m from {slow:.3g} to "
        f"{fast:.3g} rev/s: measure-force corrects those within this range and reports others",
    )
