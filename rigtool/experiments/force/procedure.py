"""`measure-force`: known loads on the output, force read from current [chapter 8].

Torque at the output = torque_factor * torque constant * (set point - feed-forward - table), read at
one angle of each rising stroke. First without load, then with each force; with the instrument also
a load lifted and lowered (friction that grows with load) and a high one (stiffness).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from operator import attrgetter

import numpy as np

from rigtool.errors import InsufficientDataError, RunFileError, UsageError
from rigtool.experiments.controller_torque import require_stable_loop
from rigtool.experiments.force.cycles import steady_statistics
from rigtool.experiments.force.imported import analyse_imported
from rigtool.experiments.force.procedure_readings import read_load
from rigtool.experiments.force.results import (
    ONE_ANGLE,
    ZERO_AGAIN,
    LoadReadings,
    load_rows,
    loads_outcome,
)
from rigtool.experiments.force.results_instrument import instrument_outcome
from rigtool.experiments.force.results_method import (
    lacking_torque,
    require_slow_strokes,
    resolution_u,
)
from rigtool.experiments.force_model.procedure_learning import LOADED_CHANNELS, stroke_record
from rigtool.experiments.force_sensor.procedure_over_time import (
    analyse_over_time,
    require_calibration,
)
from rigtool.experiments.learning.stored_table import (
    feedforward_from,
    of_another_calibration,
    require_same_rig,
)
from rigtool.experiments.outcome import Outcome
from rigtool.experiments.procedure import Procedure, channels, only_run, record
from rigtool.experiments.torque_per_ampere import (
    learned_constant,
    mean_constant,
    mean_temperature,
    torque_per_ampere_at,
    warmed,
)
from rigtool.quantity import Component, Quantity, combined, inherited
from rigtool.recipe import Recipe
from rigtool.rigs import Load, Rig, Task
from rigtool.rigs.motion import Triangle
from rigtool.runfile import RecordingSpec, Run, RunWriter

HYSTERESIS, SHIFT = "hysteresis", "shift"

KNOWN_LOAD_SETTINGS = (
    "measure_force.correction",
    "measure_force.measure_angle",
    "measure_force.lowpass_hz",
    "measure_force.zero",
    "rig.weights_relative_u",
    "rig.pulley_radius_u",
    "rig.instrument.grasper_length_u",
    "rig.instrument.angle_ratio_relative_u",
)
OVER_TIME_SETTINGS = ("measure_force.motion.bandwidth_hz",)
"""Settings by which stored signals are read, with known loads and without."""


HIDDEN_DOF = 4.5
"""Degrees of freedom of the ripple of so few angles that it states no uncertainty: it is known to a
third of its size or so (GUM G.4.2)."""

HEATED = 0.5
"""Least part of the winding's heat that loads reach, whose recordings follow each other for longer
than the time of `winding_heat_loss`."""

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
    recorded = channels(*LOADED_CHANNELS)
    return tuple(
        RecordingSpec(
            name,
            recorded,
            {"force": (force, "N"), "cycles": (float(cycles), "1")},
            settings.record_every,
        )
        for name, force, cycles in plan
    )


def measure(rig: Rig, recipe: Recipe, recorder: RunWriter, *, kt: Run, tables: Run) -> None:
    """Lift and lower each load with the learned table switched on."""
    _require_inputs(recipe, kt, tables)
    require_slow_strokes(recipe, strokes(recipe, 1))
    require_stable_loop(recipe)
    feedforward = feedforward_from(tables, recipe.rig.nominal_inertia)
    for spec in recordings(recipe):
        motion = strokes(recipe, int(spec.conditions["cycles"][0]))
        load = Load(force=spec.conditions["force"][0])
        task = Task(motion, feedforward, load, record_every=spec.record_every)
        record(rig, task, recorder, spec.name)


def strokes(recipe: Recipe, cycles: int) -> Triangle:
    """Return the motion that lifts and lowers a load."""
    settings, ratio = recipe.measure_force, recipe.rig.angle_ratio
    speed = recipe.rig.motor_speed(settings.speed_rev_per_s)
    return Triangle.of_output(settings.angle, settings.turn_angle, ratio, speed, cycles)


# -- analysing


def analyse(runs: Sequence[Run], recipe: Recipe, *, kt: Run, tables: Run) -> Outcome:
    """Read the force of each load from the stored currents, with its uncertainty.

    A run without known loads gives the torque over time. Raises `UsageError` for several runs, and
    for settings of the other one of both readings, `RunFileError` for inputs of another rig,
    `InsufficientDataError` where the signals do not carry a reading.
    """
    run = only_run(runs, "measure-force", "loads")
    recorded = run.recordings_named("load_")
    if not recorded:
        _require_as_stored(run, recipe, KNOWN_LOAD_SETTINGS, "has no known loads")
        return analyse_over_time(runs, recipe, kt=kt, tables=tables)
    _require_as_stored(run, recipe, OVER_TIME_SETTINGS, "has known loads")
    _require_inputs(recipe, kt, tables)
    require_slow_strokes(recipe, strokes(recipe, 1))
    per_ampere, note = mean_constant(kt, recorded)
    constant = _constant_at_one_angle(per_ampere, kt)
    if recorded[0].condition("force") != 0:
        raise RunFileError(
            f"{run.path}: has no recording load_000 without load: give the run file in which "
            "measure-force recorded its signals"
        )
    forces = [recording.condition("force") for recording in recorded]
    lacking, remarks = lacking_torque(run, recipe, constant.value, forces)
    whole = kt if recipe.measure_force.correction == "full" else None
    loads = [read_load(r, recipe, constant.value, lacking, whole) for r in recorded]
    outcome = _corrected(run, loads, recipe, constant, lacking, kt=kt, tables=tables)
    extra, failed = {}, []
    for name in (HYSTERESIS, SHIFT):
        if name in run.recordings and run.recordings[name].size:
            try:
                extra[name] = read_load(run.recordings[name], recipe, constant.value, lacking)
            except InsufficientDataError as error:  # costs its own results only
                failed.append(f"no result: {error}")
    more = instrument_outcome(extra, recipe, constant)
    return Outcome(
        {**outcome.results, **more.results},
        {**outcome.tables, **more.tables},
        (*_input_notes(kt, tables), *remarks, *outcome.notes, note, *failed, *more.notes),
    )


def _corrected(
    run: Run,
    loads: list[LoadReadings],
    recipe: Recipe,
    constant: Quantity,
    lacking: float,
    *,
    kt: Run,
    tables: Run,
) -> Outcome:
    """Return Table 8 or 9, with the disturbance of the load taken off as the recipe asks."""
    correction, table_u = recipe.measure_force.correction, _table_u(tables, recipe)
    ripple = _ripple_part(kt)
    rows = load_rows(loads, recipe, constant, ripple, table_u)
    if correction == "none":
        return loads_outcome(loads, rows, recipe)
    from rigtool.experiments.force.results_corrected import (
        full_outcome,
        load_outcome,
        temperature_drift,
        without_load_friction,
    )

    if correction == "load":
        own, own_loads, remarks = _at_motor(run, loads, recipe, constant, kt)
        corrected, added_u = without_load_friction(own_loads, recipe, tables, own)
        steady = steady_statistics([load.values for load in corrected])
        found = load_rows(corrected, recipe, own, ripple, table_u, steady)
        base = loads_outcome(corrected, found, recipe)
        base = replace(base, notes=(*remarks, *base.notes))
        return load_outcome(base, found, added_u, rows)
    first, again = run.recordings_named("load_")[0], run.recordings_named(ZERO_AGAIN)
    return full_outcome(
        loads_outcome(loads, rows, recipe),
        loads,
        [stroke_record(recording, recipe, kt) for recording in again],
        rows,
        recipe,
        tables,
        temperature_drift([first, *again], kt, tables),
        math.hypot(lacking, resolution_u(first, recipe, constant.value)),
    )


def _at_motor(
    run: Run, loads: list[LoadReadings], recipe: Recipe, mean: Quantity, kt: Run
) -> tuple[Quantity, list[LoadReadings], tuple[str, ...]]:
    """Return the torque constant at one rotor angle while the heaviest load warms the winding, each
    load read by that of its own winding, with a remark; as they are where the motor's temperature
    is unknown."""
    degc = mean_temperature(run.recordings_named("load_"))
    if math.isnan(degc):
        return mean, loads, ()
    at_housing = torque_per_ampere_at(kt, degc)
    factor = recipe.rig.torque_factor * mean.value
    currents = [load.torque / factor + load.feedforward / mean.value for load in loads]
    squares = [float(current @ current) / current.size for current in currents]
    winding = [warmed(at_housing, kt, square, HEATED) for square in squares]
    read = [load.scaled(own.value / mean.value) for load, own in zip(loads, winding, strict=True)]
    least = min(winding, key=lambda own: own.value)
    return (
        _constant_at_one_angle(least, kt),
        read,
        (
            f"loads with the correction are read by the torque constant at the motor's {degc:.3g} "
            f"degC, {at_housing.value * 1e3:.4g} mN m/A, less up to "
            f"{100 * (1 - least.value / at_housing.value):.2g} % as currents warm the winding",
        ),
    )


def _require_inputs(recipe: Recipe, kt: Run, tables: Run) -> None:
    """Raise `RunFileError` unless calibration and tables belong to the recipe's rig.

    With a correction also unless the tables hold it, `InsufficientDataError` at another speed. A
    calibration that does not state its rig is accepted: it is one number, of any source.
    """
    require_calibration(kt, recipe)
    require_same_rig(tables, recipe)
    if recipe.measure_force.correction != "none":
        from rigtool.experiments.force.results_corrected import corrects

        corrects(tables, recipe)


def _require_as_stored(run: Run, recipe: Recipe, keys: Sequence[str], which: str) -> None:
    """Raise `UsageError` where a setting was given that changes nothing in the run's reading."""
    stored = run.recipe or recipe
    for key in keys:
        value = attrgetter(key)
        if value(stored) != value(recipe):
            raise UsageError(
                f"{key} = {value(recipe)} changes nothing in how {run.path} is read, which "
                f"{which}: leave it out"
            )


def _constant_at_one_angle(mean: Quantity, kt: Run) -> Quantity:
    """Return the mean torque constant with the uncertainty that it has at a single rotor angle.

    The calibration states the mean over a turn; where torque is read the amplifier's ripple makes
    it differ by `torque_constant_ripple` (relative, one standard deviation).
    """
    lines = inherited(mean, 1.0, "torque constant")
    if "torque_constant_ripple" in kt.results:
        ripple = kt.result("torque_constant_ripple", "1")
        dof = HIDDEN_DOF if ripple.u is None else ripple.dof
        lines.append(Component(ONE_ANGLE, 1.0, "1", ripple.value, dof, mean.value))
    return combined(mean.value, mean.unit, lines)


def _ripple_part(kt: Run) -> Callable[[float], float]:
    """Return the part of `torque_constant_ripple` that acts at a current, A: a part of the ripple
    grows with the current, with phases that have nothing to do with the rest's."""
    names = ("torque_constant_ripple_small_current", "torque_constant_ripple")
    if not all(name in kt.results for name in names) or "hysteresis" not in kt.tables:
        return lambda current: 1.0
    first, whole = (kt.result(name, "1").value for name in names)
    if not whole > 0:
        return lambda current: 1.0
    top = float(np.abs(kt.table("hysteresis", "current", current="A")["current"]).max())
    least = (first / whole) ** 2

    def part(current: float) -> float:
        square = least + (1 - least) * (current / top) ** 2
        return math.sqrt(max(square, min(least, 1.0)))

    return part


def _input_notes(kt: Run, tables: Run) -> tuple[str, ...]:
    """Report tables that were learned with another torque constant than the one used here."""
    if not of_another_calibration(tables, kt):
        return ()
    currents = (
        "turned into current with this one, so that currents are not those that were learned: "
        "learn again"
        if learned_constant(tables) is None
        else "turned into the currents that were learned; torques are stated with this one"
    )
    return (
        f"the tables were learned with another calibration than {kt.path.name}: they are "
        f"{currents}",
    )


def _table_u(tables: Run, recipe: Recipe) -> float:
    """Return the standard uncertainty of the learned table where torque is read, N m.

    At the rising row whose speed is closest to that of the measurement.
    """
    settings = recipe.measure_force
    lookup = tables.table("lookup", "speed", "position", u="N m")
    speed = recipe.rig.motor_speed(settings.speed_rev_per_s)
    row = int(np.argmin(np.abs(lookup["speed"] - speed)))
    angle = math.radians(settings.measure_angle) * recipe.rig.angle_ratio
    return float(np.interp(angle, lookup["position"], lookup["u"][row]))


PROCEDURE = Procedure(
    "measure-force",
    recordings,
    measure,
    analyse,
    needed=("kt",),
    accepts=("ilc-learn", "identify-plant", "stribeck", "fft-ripple"),
    analyse_imported=analyse_imported,
    analysis_settings=(*KNOWN_LOAD_SETTINGS, *OVER_TIME_SETTINGS),
)
