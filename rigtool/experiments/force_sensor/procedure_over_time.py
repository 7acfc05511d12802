"""`measure-force --record` and `--observe`: the torque on the output over time, in any motion.

Nothing is known of what acts there. The filter of `force_filter` reads it from current and
encoder, with the model of motor and instrument that `ilc-learn --implementation D` learned.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from rigtool.errors import InsufficientDataError, RecipeError, RunFileError, UsageError
from rigtool.experiments.force_filter.motion_states import CREEP_SPEED_RATIO, Reach, State
from rigtool.experiments.force_model.force_model import ForceModel
from rigtool.experiments.force_model.records import slowest_taught
from rigtool.experiments.force_model.stored import model_from
from rigtool.experiments.force_sensor.encoder_zero import EncoderZero, encoder_zero
from rigtool.experiments.force_sensor.procedure_calibration import require_calibration, with_zero_of
from rigtool.experiments.force_sensor.procedure_instrument import (
    largest_friction,
    of_this_instrument,
)
from rigtool.experiments.force_sensor.procedure_motion import (
    path_from_start,
    require_learned,
    require_time,
)
from rigtool.experiments.force_sensor.procedure_reading import (
    NEEDED_CHANNELS,
    REFERENCE_CHANNEL,
    read_recording,
    require_interval,
)
from rigtool.experiments.force_sensor.results_recordings import Recorded, force_outcome
from rigtool.experiments.force_sensor.stretch import shortest_stretch
from rigtool.experiments.learning.stored_table import feedforward_from, require_rig
from rigtool.experiments.outcome import Outcome
from rigtool.experiments.procedure import Procedure, channels, record
from rigtool.recipe import Recipe
from rigtool.rigs import Rig, Task
from rigtool.rigs.motion import Observe
from rigtool.runfile import Recording, RecordingSpec, Run, RunWriter

OF_THE_LOOP = ("position_setpoint", "feedforward_current", "table_current")
"""Channels that are recorded besides where rigtool moves the rig."""


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
    if not 0 < seconds <= own.time_max:
        raise UsageError(
            f"{seconds:g} s cannot be recorded: at most measure_force.motion.time_max = "
            f"{own.time_max:g} s, and more than 0"
        )
    interval = own.record_every * recipe.rig.sample_time
    require_interval(interval, "measure_force.motion", RecipeError)
    names = NEEDED_CHANNELS if observed else (*NEEDED_CHANNELS, *OF_THE_LOOP)
    if recipe.rig.source == "virtual":
        names = (*names, REFERENCE_CHANNEL)
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
    _, reach = model_and_reach(tables, kt, recipe)
    (spec,) = _recordings(recipe, seconds=seconds, observed=observed)
    task = Task(Observe(seconds), record_every=spec.record_every, touched=True)
    least = shortest_stretch(recipe.measure_force.motion.corner_hz)
    if observed:
        require_time(least, seconds, seconds)
    else:
        start, motion = path_from_start(recipe, seconds)
        require_time(least, motion.duration, motion.duration)
        require_learned(start, motion, reach, rig.position)
        if start is not None and motion.start is None:
            rig.move_by(start - rig.position)
        feedforward = feedforward_from(tables, recipe.rig.nominal_inertia)
        task = replace(task, motion=motion, feedforward=feedforward)
    record(rig, task, recorder, spec.name)


# -- analysing


UNEVEN = 0.01
"""Share of gaps between samples from which on they are no gaps: the times are uneven."""


def analyse_over_time(runs: Sequence[Run], recipe: Recipe, *, kt: Run, tables: Run) -> Outcome:
    """Read the torque over time from every recording that has the channels.

    Raises `UsageError` for several runs, `RunFileError` for tables without the model and runs
    without the channels, `InsufficientDataError` where no recording is long enough, or no
    sample lies within what was learned.
    """
    if len(runs) > 1:
        raise UsageError(f"{len(runs)} run files: measure-force takes one")
    run = runs[0]
    recorded = [r for r in run.recordings.values() if all(r.has(name) for name in NEEDED_CHANNELS)]
    if not recorded:
        raise RunFileError(
            f"{run.path}: has no recording with the channels {', '.join(NEEDED_CHANNELS)}: record "
            "one with --record or --observe"
        )
    model, reach = model_and_reach(tables, kt, recipe)
    read = [read_recording(r, recipe, kt, model, reach) for r in recorded if r.size]
    if not any(r.parts for r in read):
        blocks = (
            (n, b) for n in NEEDED_CHANNELS for r in recorded for b in r.blocks(n, finite=False)
        )
        unknown = dict.fromkeys(name for name, block in blocks if np.isnan(block).any())
        corner_hz = recipe.measure_force.motion.corner_hz
        why = f" (NaN, or a value that none has, is in {', '.join(unknown)})" if unknown else ""
        remedy = "record for longer, without gaps"
        uneven = sum(r.breaks for r in read) / max(sum(r.size for r in recorded), 1)
        if not unknown and uneven > UNEVEN:
            why = (
                f": {100 * uneven:.2g} % of the times between samples are off by half of their mean"
            )
            remedy = "record at even times"
        raise InsufficientDataError(
            f"{run.path}: no recording has {shortest_stretch(corner_hz):.3g} s without a gap{why}, "
            f"which the filter needs at measure_force.motion.bandwidth_hz: {remedy}"
        )
    observed = not all(r.has("position_setpoint") for r in recorded)
    zero = _zero(read, recipe, model, reach, observed=observed)
    if zero is not None and zero.moved:
        again = [
            read_recording(r, recipe, kt, model, reach, zero.moved) for r in recorded if r.size
        ]
        # what is found again, or leaves nothing, was another thing
        if _zero(again, recipe, model, reach, observed=observed) is not None:
            zero = None
        else:
            read = again
    _require_values(read, recorded, reach)
    read, notes = of_this_instrument(read, model, tables, kt, observed=observed, zero=zero)
    notes += _other_tip(tables, recipe)
    outcome = force_outcome(read, recipe, reach, model.scales[0], model.limits)
    return replace(outcome, notes=(*outcome.notes, *notes))


def _zero(
    read: Sequence[Recorded], recipe: Recipe, model: ForceModel, reach: Reach, *, observed: bool
) -> EncoderZero | None:
    """Return the zero that the encoder has, where the recordings show that it is another one."""
    count, hand = recipe.rig.count_angle, largest_friction(model, observed)
    passes = [part.passes[1] for r in read for part in r.parts]
    return encoder_zero(passes, model, reach.angle, count, hand) if passes else None


def _other_tip(tables: Run, recipe: Recipe) -> list[str]:
    """Return a note where force is not that at the place where the known loads hung."""
    assert tables.recipe is not None  # `require_rig`
    there, here = tables.recipe.rig.load_arm, recipe.rig.load_arm
    if there == here:
        return []
    return [
        f"force is that at {here * 1e3:.4g} mm from the axis; the loads of {tables.path} hung at "
        f"{there * 1e3:.4g} mm: if that was wrong, all torques are off by its ratio; learn again"
    ]


def _require_values(read: Sequence[Recorded], recorded: Sequence[Recording], reach: Reach) -> None:
    """Raise `InsufficientDataError` unless some sample lies within what was learned."""
    if any(np.any(part.states != State.OUTSIDE) for r in read for part in r.parts):
        return
    limited = sum(part.limited for r in read for part in r.parts)
    if 2 * limited > sum(r.size for r in recorded):
        raise InsufficientDataError(
            f"{limited} samples have a current at its limit, rig.current_limit, or above: no "
            "torque has a value; move slower, or against less, and check the unit of the current"
        )
    every = [fault for r in read for part in r.parts for fault in part.faults]
    faults = [fault for fault in every if fault.no_value and fault.text]
    if faults:
        raise InsufficientDataError(faults[0].text)
    blocks = (degc for r in recorded for (degc,) in r.blocks("temperature", finite=False))
    ends = [(np.min(known), np.max(known)) for degc in blocks if (known := degc[degc == degc]).size]
    measured, (low, high) = (np.min(ends), np.max(ends)), reach.temperature_degc
    if measured[1] < low or measured[0] > high:
        raise InsufficientDataError(
            f"the motor was at {measured[0]:.3g} to {measured[1]:.3g} degC, its torque constant is "
            f"calibrated from {low:g} to {high:g} degC: no torque has a value; calibrate with "
            "calibrate_kt.temperatures_degc about these, and learn again, or measure within"
        )
    raise InsufficientDataError(
        f"no sample lies within what was learned, {reach.angle[0]:.4g} to {reach.angle[1]:.4g} rad "
        f"of the motor, up to {reach.speed:.4g} rad/s and {reach.torque * 1e3:.4g} mN m, with a "
        "current below its limit: no torque has a value; move within, or learn more"
    )


def model_and_reach(tables: Run, kt: Run, recipe: Recipe) -> tuple[ForceModel, Reach]:
    """Return the model in these tables, and how far it was learned; checks that all belongs
    together."""
    require_calibration(kt, recipe)
    tables.require_command("ilc-learn")
    model = with_zero_of(model_from(tables, recipe), kt)
    require_rig(tables, recipe)
    return model, reach_of(tables, kt)


def reach_of(tables: Run, kt: Run) -> Reach:
    """Return how far the model in these tables was learned.

    Angles and torques are those of the known loads, speeds those of all learned strokes,
    temperatures those of the calibration.
    """
    learned = tables.recipe
    assert learned is not None  # `require_rig`
    own, rig = learned.ilc_learn, learned.rig
    calibrated = None if kt.recipe is None else kt.recipe.calibrate_kt.temperatures_degc
    loaded = [rig.motor_speed(speed) for speed in own.loads.speeds_rev_per_s]
    return Reach(
        (0.0, math.radians(learned.measure_force.angle) * rig.angle_ratio),
        max(*loaded, *(rig.motor_speed(speed) for speed in own.speeds_rev_per_s)),
        max(own.loads.forces) * rig.load_arm,
        (-math.inf, math.inf) if calibrated is None else (min(calibrated), max(calibrated)),
        CREEP_SPEED_RATIO * slowest_taught(loaded, rig.count_angle),
    )
