"""`measure-force --record` and `--observe`: the torque on the output over time, in any motion.

Nothing is known of what acts there. The filter of `force_over_time` reads it from current and
encoder, with the model of motor and instrument that `ilc-learn --implementation D` learned.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from rigtool.errors import InsufficientDataError, RecipeError, RunFileError, UsageError
from rigtool.experiments.force.procedure_motion import moved, require_learned
from rigtool.experiments.force.results_over_time import Reading, force_outcome
from rigtool.experiments.force_over_time.estimate import Filter, smoothed
from rigtool.experiments.force_over_time.force_model import ForceModel
from rigtool.experiments.force_over_time.motion_states import (
    Reach,
    State,
    mean_speed,
    moving_states,
)
from rigtool.experiments.force_over_time.plant import HOUSING, SPEED
from rigtool.experiments.force_over_time.steps import Grid, unbroken
from rigtool.experiments.force_over_time.stored import model_from
from rigtool.experiments.learning.stored_table import feedforward_from, require_rig
from rigtool.experiments.outcome import Outcome
from rigtool.experiments.procedure import Procedure, channels, record
from rigtool.experiments.torque_per_ampere import torque_per_ampere_at
from rigtool.numerics.checks import require_rising
from rigtool.recipe import Recipe
from rigtool.rigs import Rig, Task
from rigtool.rigs.motion import Observe
from rigtool.runfile import Recording, RecordingSpec, Run, RunWriter

NEEDED = ("time", "encoder", "current_setpoint", "temperature")
"""Channels that the torque is read from; `current_setpoint` is all of the motor's current."""

OF_THE_LOOP = ("position_setpoint", "feedforward_current", "table_current")
"""Channels that are recorded besides where rigtool moves the rig."""

REFERENCE = "reference_torque"

SHORTEST = 2.0
"""Stretch without gaps that is analysed, s: the filter has to settle."""

SETTLING = 0.1
"""After a current at its limit, s, until the torque has a value again."""

AT_THE_LIMIT = 0.999


# -- measuring


def over_time(seconds: float, *, observed: bool) -> Procedure:
    """Return the procedure that records for `seconds` s, moving the rig, or observing it."""
    return Procedure(
        "measure-force",
        partial(_recordings, seconds=seconds, observed=observed),
        partial(_measure, seconds=seconds, observed=observed),
        analyse_over_time,
        needed=("kt",),
    )


def _recordings(recipe: Recipe, *, seconds: float, observed: bool) -> tuple[RecordingSpec, ...]:
    own = recipe.measure_force.motion
    if seconds > own.time_max:
        raise RecipeError(
            f"{seconds:g} s is longer than measure_force.motion.time_max = {own.time_max:g} s: "
            "record for less, or raise it"
        )
    names = NEEDED if observed else (*NEEDED, *OF_THE_LOOP)
    if recipe.rig.source == "virtual":
        names = (*names, REFERENCE)
    name = "observed" if observed else own.kind
    return (RecordingSpec(f"{name}_000", channels(*names), {}, own.record_every),)


def _measure(
    rig: Rig,
    recipe: Recipe,
    recorder: RunWriter,
    *,
    kt: Run,
    tables: Run,
    seconds: float,
    observed: bool,
) -> None:
    _require_inputs(recipe, kt, tables)
    model_from(tables, recipe)
    (spec,) = _recordings(recipe, seconds=seconds, observed=observed)
    task = Task(Observe(seconds), record_every=spec.record_every, touched=True)
    if not observed:
        start, motion = moved(recipe, seconds)
        require_learned(start, motion, reach_of(tables, kt, recipe), rig.position)
        if start is not None and motion.start is None:
            rig.move_by(start - rig.position)
        feedforward = feedforward_from(tables, recipe.rig.nominal_inertia)
        task = replace(task, motion=motion, feedforward=feedforward)
    record(rig, task, recorder, spec.name)


# -- analysing


def analyse_over_time(runs: Sequence[Run], recipe: Recipe, *, kt: Run, tables: Run) -> Outcome:
    """Read the torque over time from every recording that has the channels.

    Raises `UsageError` for several runs, `RunFileError` for tables without the model and runs
    without the channels, `InsufficientDataError` where no recording is long enough.
    """
    if len(runs) > 1:
        raise UsageError(f"{len(runs)} run files: measure-force takes one")
    _require_inputs(recipe, kt, tables)
    run, model = runs[0], model_from(tables, recipe)
    recorded = [r for r in run.recordings.values() if all(r.has(name) for name in NEEDED)]
    if not recorded:
        raise RunFileError(
            f"{run.path}: has no recording with the channels {', '.join(NEEDED)}: record one with "
            "--record or --observe"
        )
    reach = reach_of(tables, kt, recipe)
    read = [read_recording(r, recipe, kt, model, reach) for r in recorded if r.size]
    readings = [reading for reading in read if reading is not None]
    if not readings:
        raise InsufficientDataError(
            f"{run.path}: no recording has {SHORTEST:g} s without a gap: record for longer"
        )
    return force_outcome(readings, recipe, reach)


def reach_of(tables: Run, kt: Run, recipe: Recipe) -> Reach:
    """Return how far the model in these tables was learned.

    Angles and torques are those of the known loads, speeds those of all learned strokes,
    temperatures those of the calibration.
    """
    learned = tables.recipe
    assert learned is not None  # `require_rig`
    own, rig = learned.ilc_learn, recipe.rig
    calibrated = None if kt.recipe is None else kt.recipe.calibrate_kt.temperatures_degc
    return Reach(
        (0.0, math.radians(learned.measure_force.angle) * rig.angle_ratio),
        2 * math.pi * rig.angle_ratio * max(*own.speeds_rev_per_s, *own.loads.speeds_rev_per_s),
        max(own.loads.forces) * rig.load_arm,
        (-math.inf, math.inf) if calibrated is None else (min(calibrated), max(calibrated)),
    )


def read_recording(
    recording: Recording, recipe: Recipe, kt: Run, model: ForceModel, reach: Reach
) -> Reading | None:
    """Return the torque over a recording; None where no stretch of it is long enough."""
    time, encoder, current, temperature = (recording.read(name) for name in NEEDED)
    if len(time) < 2:
        return None
    reference = recording.read(REFERENCE) if recording.has(REFERENCE) else None
    rig, interval = recipe.rig, require_rising(time)
    grid = Grid.of(interval)
    constant = torque_per_ampere_at(kt, float(temperature.mean())).value
    count = 2 * math.pi / rig.encoder_counts
    limited = np.abs(current) >= AT_THE_LIMIT * rig.current_limit
    good = np.ones(len(time), dtype=np.bool_)
    step_time = grid.step_samples * grid.sample_time
    plant, uncertainty = model.plant(grid.sample_time), model.uncertainty
    parts = []
    for stretch in unbroken(time, good, interval):
        if (stretch.stop - stretch.start) * interval < SHORTEST:
            continue
        signals = grid.signals(encoder[stretch], current[stretch], count, model.drive, constant)
        causal = Filter(plant, uncertainty, grid.step_samples).add(signals)
        torque, deviation = smoothed(plant, uncertainty, grid.step_samples, signals)
        low = signals.low[grid.step_samples :: grid.step_samples][: len(torque)]
        states = moving_states(
            low, causal.states[:, SPEED], causal.states[:, HOUSING], torque, count, step_time
        )
        warm = grid.steps(temperature[stretch])
        outside = reach.left_by(low, mean_speed(low, step_time), torque, warm)
        saturated = grid.steps(limited[stretch].astype(np.float64)) > 0
        lasting = np.ones(2 * round(SETTLING / step_time) + 1)
        outside |= np.convolve(saturated, lasting, mode="same") > 0.5
        states[outside] = State.OUTSIDE
        began = time[stretch.start] - interval / 2
        parts.append(
            Reading(
                recording.name,
                step_time,
                began + step_time * (1 + np.arange(len(torque))),
                torque,
                deviation,
                causal.torque,
                causal.deviation,
                states,
                None if reference is None else grid.steps(reference[stretch]),
                int(limited[stretch].sum()),
            )
        )
    return Reading.joined(parts) if parts else None


def _require_inputs(recipe: Recipe, kt: Run, tables: Run) -> None:
    kt.require_command("calibrate-kt")
    if kt.rig not in (None, recipe.rig.name):
        raise RunFileError(
            f"{kt.path}: is the calibration of rig {kt.rig}, the recipe is that of "
            f"{recipe.rig.name}: calibrate this one"
        )
    require_rig(tables, recipe)
