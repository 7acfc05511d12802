"""`measure-force`: known loads on the output, force read from current [chapter 8].

Torque at the output = torque_factor * torque constant * (set point - feed-forward - table), read at
one angle of each rising stroke. First without load, then with each force; with the instrument also
a load lifted and lowered (friction that grows with load) and a high one (stiffness).
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from rigtool.errors import InsufficientDataError, RunFileError, UsageError
from rigtool.experiments.force.cycles import find_cycles, kept_factor, lowpass_at, readings
from rigtool.experiments.force.imported import analyse_imported
from rigtool.experiments.force.results import ZERO_AGAIN, Reading, loads_outcome
from rigtool.experiments.force.results_instrument import instrument_outcome
from rigtool.experiments.force.results_method import (
    lacking_torque,
    require_slow_strokes,
    resolution_u,
    unsteady_torque,
)
from rigtool.experiments.learning.stored_table import feedforward_from, require_same_rig
from rigtool.experiments.loop_tracking import require_tracking
from rigtool.experiments.outcome import Outcome
from rigtool.experiments.procedure import Procedure, channels, record
from rigtool.experiments.torque_per_ampere import torque_per_ampere
from rigtool.numerics.checks import require_rising, rising_steps
from rigtool.numerics.decimation import Decimator
from rigtool.quantity import Quantity
from rigtool.recipe import Recipe
from rigtool.rigs import Load, Rig, Task
from rigtool.rigs.motion import Triangle
from rigtool.runfile import Recording, RecordingSpec, Run, RunWriter

Array = NDArray[np.float64]

SIGNALS = (
    "time",
    "current_setpoint",
    "encoder",
    "position_setpoint",
    "feedforward_current",
    "table_current",
)
"""What the analysis reads."""

RATE_SAMPLES = 8192
"""Samples that the sampling frequency is taken from."""

HYSTERESIS, SHIFT = "hysteresis", "shift"


# -- measuring


def recordings(recipe: Recipe) -> tuple[RecordingSpec, ...]:
    """List the cycles without load, with each force, and for the instrument two more loads."""
    settings = recipe.measure_force
    plan = [
        (f"load_{number:03d}", force, settings.cycles)
        for number, force in enumerate((0.0, *settings.forces))
    ]
    if settings.correction == "full":
        plan.append((ZERO_AGAIN, 0.0, settings.cycles))
    if recipe.rig.attachment == "instrument":
        plan += [
            (HYSTERESIS, settings.hysteresis_force, settings.extra_cycles),
            (SHIFT, settings.shift_force, settings.extra_cycles),
        ]
    recorded = channels(
        "time",
        "current_setpoint",
        "feedforward_current",
        "table_current",
        "position_setpoint",
        "encoder",
        "temperature",
    )
    return tuple(
        RecordingSpec(name, recorded, {"force": (force, "N"), "cycles": (float(cycles), "1")})
        for name, force, cycles in plan
    )


def measure(rig: Rig, recipe: Recipe, recorder: RunWriter, *, kt: Run, tables: Run) -> None:
    """Lift and lower each load with the learned table switched on."""
    _require_inputs(recipe, kt, tables)
    settings = recipe.measure_force
    require_slow_strokes(recipe, strokes(recipe, 1))
    feedforward = feedforward_from(tables, recipe.rig.nominal_inertia)
    for spec in recordings(recipe):
        motion = strokes(recipe, int(spec.conditions["cycles"][0]))
        load = Load(force=spec.conditions["force"][0])
        task = Task(motion, feedforward, load, record_every=settings.record_every)
        record(rig, task, recorder, spec.name)


def strokes(recipe: Recipe, cycles: int) -> Triangle:
    """Return the motion that lifts and lowers a load."""
    settings, ratio = recipe.measure_force, recipe.rig.angle_ratio
    return Triangle(
        low=0.0,
        high=math.radians(settings.angle) * ratio,
        speed=2 * math.pi * settings.speed_rev_per_s * ratio,
        turn_angle=math.radians(settings.turn_angle) * ratio,
        cycles=cycles,
    )


# -- analysing


def analyse(runs: Sequence[Run], recipe: Recipe, *, kt: Run, tables: Run) -> Outcome:
    """Read the force of each load from the stored currents, with its uncertainty.

    Raises `UsageError` for several runs, `RunFileError` for one without loads or inputs of another
    rig, `InsufficientDataError` where the signals do not carry a reading.
    """
    if len(runs) > 1:
        raise UsageError(f"{len(runs)} run files: measure-force takes one, with all its loads")
    run = runs[0]
    _require_inputs(recipe, kt, tables)
    require_slow_strokes(recipe, strokes(recipe, 1))
    constant = _constant_at_one_angle(kt)
    recorded = run.recordings_named("load_")
    if not recorded or recorded[0].condition("force") != 0:
        raise RunFileError(
            f"{run.path}: has no recording load_000 without load: give the run file in which "
            "measure-force recorded its signals"
        )
    forces = [recording.condition("force") for recording in recorded]
    lacking, remarks = lacking_torque(run, recipe, constant.value, forces)
    loads = [_read(recording, recipe, constant.value, lacking) for recording in recorded]
    sampled_u = math.hypot(lacking, resolution_u(recorded[0], recipe, constant.value))
    outcome = _corrected(run, loads, recipe, constant, sampled_u, kt=kt, tables=tables)
    extra, failed = {}, []
    for name in (HYSTERESIS, SHIFT):
        if name in run.recordings and run.recordings[name].size:
            try:
                extra[name] = _read(run.recordings[name], recipe, constant.value, lacking)
            except InsufficientDataError as error:  # costs its own results only
                failed.append(f"no result: {error}")
    more = instrument_outcome(extra, recipe, constant)
    return Outcome(
        {**outcome.results, **more.results},
        {**outcome.tables, **more.tables},
        (*_input_notes(kt, tables), *remarks, *outcome.notes, *failed, *more.notes),
    )


def _corrected(
    run: Run,
    loads: list[Reading],
    recipe: Recipe,
    constant: Quantity,
    sampled_u: float,
    *,
    kt: Run,
    tables: Run,
) -> Outcome:
    """Return Table 8 or 9, with the disturbance of the load taken off as the recipe says."""
    correction, table_u = recipe.measure_force.correction, _table_u(tables, recipe)
    thesis = loads_outcome(loads, recipe, constant, table_u)
    if correction == "none":
        return thesis
    from rigtool.experiments.force import results_corrected as corrected_force

    if correction == "full":
        return corrected_force.full_outcome(run, thesis, recipe, kt, tables, sampled_u)
    corrected, friction_u = corrected_force.without_load_friction(loads, recipe, tables)
    outcome = loads_outcome(corrected, recipe, constant, table_u)
    return corrected_force.load_outcome(outcome, friction_u, thesis)


def _read(recording: Recording, recipe: Recipe, torque_constant: float, lacking: float) -> Reading:
    """Filter a recording, cut it into cycles and read the torque of each."""
    settings, rig = recipe.measure_force, recipe.rig
    try:
        (position, controller, table, fed), rate = _filtered(recording, recipe)
        cycles = find_cycles(position)
        angle = position * (2 * math.pi / rig.encoder_counts) / rig.angle_ratio
        torque = rig.torque_factor * (torque_constant * controller)
        beside = (
            lacking,
            unsteady_torque(
                angle,
                torque,
                rig.torque_factor * (torque_constant * fed),
                rate=rate,
                cycles=cycles,
                recipe=recipe,
            ),
            resolution_u(recording, recipe, torque_constant),
        )
        return Reading(
            name=recording.name,
            force=recording.condition("force"),
            asked_cycles=round(recording.condition("cycles")),
            position=position,
            torque=torque,
            feedforward=torque_constant * table,
            cycles=cycles,
            values=readings(angle, torque, cycles, math.radians(settings.measure_angle)),
            method_u=math.hypot(*beside),
        )
    except InsufficientDataError as error:
        raise InsufficientDataError(f"recording {recording.name}: {error}") from None


def _filtered(recording: Recording, recipe: Recipe) -> tuple[Array, float]:
    """Return encoder, current of controller, table, model, low-passed and thinned, (4, m), and Hz.

    Goes through the recording once, block by block.
    """
    cutoff, per_count = recipe.measure_force.lowpass_hz, 2 * math.pi / recipe.rig.encoder_counts
    rate, last, samples = _rate(recording), np.zeros(0), 0
    collected = Decimator(factor := kept_factor(rate, cutoff), 4)
    largest = farthest = controlled = 0.0
    for time, asked, encoder, setpoint, feedforward, table in recording.blocks(*SIGNALS):
        rising_steps(np.concatenate([last, time]), samples - last.size)
        last, samples = time[-1:], samples + time.size
        largest = max(largest, _largest(asked))
        setpoint -= encoder * per_count
        farthest = max(farthest, _largest(setpoint))
        asked -= feedforward
        asked -= table
        controlled = max(controlled, _largest(asked))
        collected.add(encoder, asked, table, feedforward)
    require_tracking(
        recipe, largest_current=largest, largest_controller=controlled, distance=farthest
    )
    signals = collected.finish()
    for signal in signals:  # one by one: the filter holds several copies of what it works on
        signal[:] = lowpass_at(rate / factor, signal, cutoff)
    return signals, rate / factor


def _rate(recording: Recording) -> float:
    """Return the usual sampling frequency at the start of a recording, Hz."""
    return 1 / require_rising(recording.read("time", 0, min(recording.size, RATE_SAMPLES)))


def _largest(values: Array) -> float:
    return float(max(values.max(), -values.min()))


def _require_inputs(recipe: Recipe, kt: Run, tables: Run) -> None:
    """Raise `RunFileError` unless calibration and tables belong to the recipe's rig.

    With a correction also unless the tables hold it, `InsufficientDataError` at another speed. A
    calibration that does not say its rig is taken on trust: it is one number, of any source.
    """
    kt.require_command("calibrate-kt")
    if kt.rig not in (None, recipe.rig.name):
        raise RunFileError(
            f"{kt.path}: is the calibration of rig {kt.rig}, the recipe is that of "
            f"{recipe.rig.name}: calibrate this one"
        )
    require_same_rig(tables, recipe)
    if recipe.measure_force.correction != "none":
        from rigtool.experiments.force.results_corrected import corrects

        corrects(tables, recipe)


def _constant_at_one_angle(kt: Run) -> Quantity:
    """Return the torque constant with the uncertainty that it has at a single rotor angle.

    The calibration states the mean over a turn; where torque is read the amplifier's ripple makes
    it differ by `torque_constant_ripple` (relative, one standard deviation).
    """
    from GTC import dof, uncertainty, ureal

    mean, ripple = torque_per_ampere(kt), kt.results.get("torque_constant_ripple")
    constant = ureal(mean.value, mean.u or 0.0, mean.dof or math.inf)
    if ripple is not None:
        constant = constant * ureal(1.0, ripple.value, ripple.dof or math.inf)
    degrees = float(dof(constant))
    return Quantity(
        mean.value,
        mean.unit,
        float(uncertainty(constant)),
        degrees if math.isfinite(degrees) else None,
    )


def _input_notes(kt: Run, tables: Run) -> tuple[str, ...]:
    """Say where the tables were learned with another motor constant than the one used here."""
    calibrations = [
        used["content_sha256"]
        for used in tables.provenance["inputs"]
        if used["command"] == kt.command
    ]
    if not calibrations or kt.content_sha256 in calibrations:
        return ()
    return (
        f"the tables were learned with another calibration than {kt.path.name}: currents are "
        "compensated as learned, but torques are stated with this one",
    )


def _table_u(tables: Run, recipe: Recipe) -> float:
    """Return the standard uncertainty of the learned table where torque is read, N m.

    At the rising row whose speed is closest to that of the measurement.
    """
    settings, ratio = recipe.measure_force, recipe.rig.angle_ratio
    lookup = tables.table("lookup")
    speed = 2 * math.pi * settings.speed_rev_per_s * ratio
    row = int(np.argmin(np.abs(lookup["speed"] - speed)))
    angle = math.radians(settings.measure_angle) * ratio
    return float(np.interp(angle, lookup["position"], lookup["u"][row]))


PROCEDURE = Procedure(
    "measure-force",
    recordings,
    measure,
    analyse,
    needed=("kt",),
    analyse_imported=analyse_imported,
    record_every=lambda recipe: recipe.measure_force.record_every,
)
