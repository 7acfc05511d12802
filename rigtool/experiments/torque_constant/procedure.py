"""calibrate-kt: staircases of current against a force gauge, at several temperatures [7.1.1]."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from rigtool.errors import RecipeError
from rigtool.experiments.outcome import Outcome
from rigtool.experiments.procedure import Procedure, channels, record
from rigtool.experiments.torque_constant.clampings import clamping_angles
from rigtool.experiments.torque_constant.imported import analyse_imported
from rigtool.experiments.torque_constant.results import outcome_of
from rigtool.experiments.torque_constant.staircases.plateaus import (
    Plateaus,
    plateaus_of_set_point,
    pool,
)
from rigtool.experiments.torque_constant.temperature_fit import calibrate
from rigtool.recipe import Recipe
from rigtool.recipe.commands import CalibrateKt
from rigtool.rigs import Load, Rig, Task
from rigtool.rigs.motion import CurrentSteps
from rigtool.runfile import RecordingSpec, Run, RunWriter

STAIRCASE = "staircase"


def recordings(recipe: Recipe) -> tuple[RecordingSpec, ...]:
    """One recording of all staircases in sequence; the bench clock runs on."""
    names = ("time", "rotor_angle", "encoder", "current_setpoint", "current", "force")
    every = recipe.calibrate_kt.record_every
    return (RecordingSpec(STAIRCASE, channels(*names, "temperature"), record_every=every),)


def measure(rig: Rig, recipe: Recipe, recorder: RunWriter) -> None:
    """Run the staircases at each temperature and rotor angle.

    Raises `RecipeError` for currents above the rig's limit.
    """
    settings = recipe.calibrate_kt
    if settings.current_max > recipe.rig.current_limit:
        raise RecipeError(
            f"calibrate_kt.current_max is {settings.current_max:g} A, rig.current_limit "
            f"{recipe.rig.current_limit:g} A: lower the first"
        )
    task = Task(
        CurrentSteps(staircase(settings), settings.step_time),
        load=Load(clamped=True),
        record_every=settings.record_every,
    )
    angles = clamping_angles(settings.temperatures_degc, settings.rotor_positions)
    for number, temperature in enumerate(settings.temperatures_degc):
        for angle in angles[number].tolist():
            rig.soak(temperature)
            rig.clamp(angle)
            record(rig, task, recorder, STAIRCASE)


def staircase(settings: CalibrateKt) -> tuple[float, ...]:
    """Return the levels of current at one clamping: zero, up to the top and down, repeated; A."""
    up = np.linspace(0.0, settings.current_max, settings.steps + 1)
    turn = np.concatenate([up[1:], up[-2::-1]])
    return (0.0, *np.tile(turn, settings.staircases).tolist())


def analyse(runs: Sequence[Run], recipe: Recipe) -> Outcome:
    """Return the torque constant against temperature from the staircases of all runs."""
    plateaus = pool([_plateaus(run, recipe) for run in runs])
    arm, settings = recipe.rig.arm, recipe.calibrate_kt
    found = calibrate(
        plateaus,
        arm_length=arm.length,
        arm_length_u=arm.length_u,
        gauge_relative_u=arm.gauge_relative_u,
        gauge_linearity=arm.gauge_linearity,
        thermometer_u=recipe.rig.thermometer_u,
        current_reading_relative_u=recipe.rig.current_reading_relative_u,
        reference_range_degc=settings.reference_range_degc,
    )
    return outcome_of(
        found,
        nominal=recipe.rig.torque_constant,
        current_reading_relative_u=recipe.rig.current_reading_relative_u,
        reference_range_degc=settings.reference_range_degc,
    )


def _plateaus(run: Run, recipe: Recipe) -> Plateaus:
    recording = run.recording(STAIRCASE)
    count = recipe.rig.count_angle
    return plateaus_of_set_point(
        time=recording.read("time"),
        current_setpoint=recording.read("current_setpoint"),
        current=recording.read("current"),
        force=recording.read("force"),
        temperature=recording.read("temperature"),
        rotor_angle=recording.read("rotor_angle") if recording.has("rotor_angle") else None,
        position=recording.read("encoder") * count if recording.has("encoder") else None,
        count=count,
        arm_length=recipe.rig.arm.length,
        settle_time=recipe.calibrate_kt.settle_time,
        gauge_resolution=recipe.rig.arm.gauge_resolution,
    )


PROCEDURE = Procedure(
    "calibrate-kt",
    recordings,
    measure,
    analyse,
    bare_motor=True,
    analyse_imported=analyse_imported,
    analysis_settings=(
        "calibrate_kt.settle_time",
        "calibrate_kt.reference_range_degc",
        "rig.arm.length_u",
        "rig.arm.gauge_relative_u",
        "rig.arm.gauge_linearity",
        "rig.thermometer_u",
        "rig.current_reading_relative_u",
    ),
)
