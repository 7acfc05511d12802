"""identify-plant: frequency response of the plant in closed loop, and its inertia [7.2.3, 7.2.4.2].

A multisine is added to the controller's torque while the shaft moves at constant speed. The
response from the torque set point of the amplifier to the shaft's angle is that of the plant with
the amplifier; the fit takes inertia and viscous friction from it [Fig. 35, 39].
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from rigtool.errors import InsufficientDataError, RecipeError
from rigtool.experiments.controller_torque import naming, require_unlimited, usual_current
from rigtool.experiments.outcome import Outcome
from rigtool.experiments.plant.angle_torque import without_angle_torque
from rigtool.experiments.plant.curvature import excited_speed, slope_rise
from rigtool.experiments.plant.fit import fit_plant
from rigtool.experiments.plant.frequency_response import (
    MIN_EXPERIMENTS,
    Experiment,
    frequency_response,
)
from rigtool.experiments.plant.procedure_excitation import (
    Excitation,
    excitations,
    excited_lines,
    period_samples,
    tasks,
)
from rigtool.experiments.plant.results import IdentifiedPlant, plant_outcome
from rigtool.experiments.procedure import Procedure, channels, record
from rigtool.experiments.torque_per_ampere import torque_per_ampere_at, warmed
from rigtool.numerics.arrays import Array
from rigtool.numerics.checks import rising_steps
from rigtool.numerics.plateaus import runs_of
from rigtool.quantity import Quantity
from rigtool.recipe import Recipe
from rigtool.rigs import Rig
from rigtool.runfile import Recording, RecordingSpec, Run, RunWriter

MOTION_PART = 0.5
"""Part of the limit of current that turning alone may take."""

MANY_PARTS = 50
"""Of a recording, most of them of one direction, in which the loop's answer is seen."""

LARGEST_ANSWER = 3.0
"""How many times as far as the excitation, rms, a stable loop swings against it at most."""

EDGE_STEPS = 2
"""Steps of the set point at the ends of a stretch of constant speed that may differ from it."""


def recordings(recipe: Recipe) -> tuple[RecordingSpec, ...]:
    """One recording for each speed and set of phases; both directions are in it."""
    recorded = channels(
        "time", "current_setpoint", "signal_current", "position_setpoint", "encoder", "temperature"
    )
    period = period_samples(recipe) * recipe.rig.sample_time
    return tuple(
        RecordingSpec(
            _name(excitation),
            recorded,
            {"speed": (excitation.speed, "rad/s"), "period": (period, "s")},
        )
        for excitation in excitations(recipe)
    )


def _name(excitation: Excitation) -> str:
    return f"multisine_{excitation.number:03d}"


def measure(rig: Rig, recipe: Recipe, recorder: RunWriter, *, kt: Run | None = None) -> None:
    """Excite the shaft at each speed, in both directions, with each set of phases.

    Raises `RecipeError` where these are too few for an uncertainty.
    """
    excited = excitations(recipe)
    if 2 * len(excited) < MIN_EXPERIMENTS:
        raise RecipeError(
            f"one speed in both directions with one set of phases makes {2 * len(excited)} "
            f"experiments, {MIN_EXPERIMENTS} are needed for an uncertainty: raise "
            "identify_plant.realisations, or add a speed"
        )
    for excitation in excited:
        for task in tasks(recipe, excitation):
            record(rig, task, recorder, _name(excitation))


def analyse(runs: Sequence[Run], recipe: Recipe, *, kt: Run | None = None) -> Outcome:
    """Return the frequency response, its fit, and the margins with the recipe's controller.

    Raises `RunFileError` for runs without its recordings.
    """
    found = [recording for run in runs for recording in run.recordings_of("multisine")]
    lines, sample_time = excited_lines(recipe), recipe.rig.sample_time
    experiments: list[Experiment] = []
    constants: list[Quantity | None] = []
    speeds: list[Array] = []
    swing = 0.0
    for recording in found:
        constant = _torque_constant(recording, kt)
        scale = recipe.rig.torque_constant if constant is None else constant.value
        for experiment in _experiments(recording, recipe, scale):
            speed = excited_speed(experiment, lines, sample_time)
            swing = max(swing, float(np.abs(speed).max()) / recording.condition("speed"))
            experiments.append(experiment)
            speeds.append(speed)
        constants.append(constant)
    count = recipe.rig.count_angle
    response = frequency_response(experiments, lines, sample_time, count)
    free = recipe.rig.attachment == "pulley"
    fit = fit_plant(response, sample_time, recipe.rig.nominal_inertia, tendon=not free)
    if free:
        experiments = without_angle_torque(experiments, lines, fit)
        response = frequency_response(experiments, lines, sample_time, count)
        fit = fit_plant(response, sample_time, recipe.rig.nominal_inertia)
    rise = slope_rise(experiments, speeds, lines, fit)
    return plant_outcome(IdentifiedPlant(response, fit, constants[0], swing, rise), recipe)


def _torque_constant(recording: Recording, kt: Run | None) -> Quantity | None:
    """Return the torque for each ampere at the winding's temperature in a recording; None without
    --kt."""
    if kt is None:
        return None
    constant = torque_per_ampere_at(kt, float(recording.read("temperature").mean()))
    current = recording.read("current_setpoint").astype(np.float64)
    return warmed(constant, kt, float(np.mean(current**2)))


def _require_unlimited(asked: Array, signal: Array, recipe: Recipe) -> None:
    """Raise `InsufficientDataError` where a set point of current (n,), A, is at the limit.

    `signal` (n,) is the excitation in it, A. Against that the loop swings about as far at most.
    """
    motion = usual_current(asked)
    if motion > MOTION_PART * recipe.rig.current_limit:
        remedy = (
            f"turning alone takes {motion:.3g} A; lower identify_plant.speeds or the load on the "
            "shaft"
        )
    else:
        remedy = "lower identify_plant.current_share or swing"
    swing = float(np.mean([part.std() for part in np.array_split(asked - signal, MANY_PARTS)]))
    usual = 0.0 if swing > LARGEST_ANSWER * float(np.std(signal)) else math.inf
    require_unlimited(float(np.abs(asked).max(initial=0.0)), recipe, remedy, usual)


def _experiments(recording: Recording, recipe: Recipe, torque_constant: float) -> list[Experiment]:
    """Cut whole periods in steady state out of a recording: one experiment a direction."""
    asked, setpoint = recording.read("current_setpoint"), recording.read("position_setpoint")
    with naming(recording):
        rising_steps(recording.read("time"))
        _require_unlimited(asked, recording.read("signal_current"), recipe)
    angle = recording.read("encoder") * recipe.rig.count_angle
    signals = (
        torque_constant * recording.read("signal_current"),
        torque_constant * asked,
        angle - setpoint,
        angle,
    )
    period = round(recording.condition("period") / recipe.rig.sample_time)
    settle = round(recipe.identify_plant.settle_time / recipe.rig.sample_time)
    step = recording.condition("speed") * recipe.rig.sample_time
    experiments = []
    for sign in (1, -1):
        starts = _period_starts(np.diff(setpoint), sign * step, settle, period)
        if not starts:
            raise InsufficientDataError(
                f"recording {recording.name}: no whole period of {period} samples at "
                f"{sign * recording.condition('speed'):.4g} rad/s: lower "
                "identify_plant.settle_time, or record again"
            )
        index = np.asarray(starts)[:, None] + np.arange(period)
        experiments.append(Experiment(*(signal[index] for signal in signals)))
    return experiments


def _period_starts(steps: Array, step: float, settle: int, period: int) -> list[int]:
    """Return the starts of whole periods in each stretch of constant steps, after `settle` samples.

    They lie in its middle as far as `settle` allows: strokes of both directions then cover the same
    angles, over which friction that differs along the stroke acts as springs of opposite sign.
    A step that the corner of the motion falls into is not constant: what `settle` leaves out may be
    shorter by these two.
    """
    constant = np.abs(steps - step) < 1e-4 * abs(step)
    starts: list[int] = []
    for first, stop in runs_of(constant):
        count = (stop - first - settle + EDGE_STEPS) // period
        free = stop - first - count * period
        last = stop - max(0, min(free // 2, free - settle))
        starts += [last - k * period for k in range(count, 0, -1)]
    return starts


PROCEDURE = Procedure(
    "identify-plant",
    recordings,
    measure,
    analyse,
    # The response from current to angle is that of a current which is held for each sample.
    rig_needs=lambda recipe: ("held_current",),
)
