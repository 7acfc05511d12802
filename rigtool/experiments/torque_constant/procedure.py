"""calibrate-kt: staircases of current against a force gauge, at several temperatures [7.1.1]."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from rigtool.errors import RecipeError
from rigtool.experiments.outcome import Outcome
from rigtool.experiments.procedure import Procedure, channels, record
from rigtool.experiments.torque_constant.imported import analyse_imported
from rigtool.experiments.torque_constant.staircase import Plateaus, plateaus_of_set_point
from rigtool.experiments.torque_constant.staircase_fit import SAME_TEMPERATURE
from rigtool.experiments.torque_constant.temperature_fit import (
    Calibration,
    calibrate,
)
from rigtool.numerics.arrays import Array
from rigtool.quantity import CURRENT_READING, Component, Quantity, combined, error_line
from rigtool.recipe import Recipe
from rigtool.recipe.commands import CalibrateKt
from rigtool.rigs import Load, Rig, Task
from rigtool.rigs.motion import CurrentSteps
from rigtool.runfile import Column, RecordingSpec, Run, RunWriter, Table, dof_column

STAIRCASE = "staircase"

FAR_OFF = 3.0
"""Ratio of measured constant and data sheet that no motor explains: magnets differ by a tenth."""


def recordings(recipe: Recipe) -> tuple[RecordingSpec, ...]:
    """One recording of all staircases in sequence; the bench clock runs on."""
    names = ("time", "rotor_angle", "current_setpoint", "current", "force", "temperature")
    every = recipe.calibrate_kt.record_every
    return (RecordingSpec(STAIRCASE, channels(*names), record_every=every),)


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
    angles = clamping_angles(settings)
    for number, temperature in enumerate(settings.temperatures_degc):
        for angle in angles[number].tolist():
            rig.soak(temperature)
            rig.clamp(angle)
            record(rig, task, recorder, STAIRCASE)


def clamping_angles(settings: CalibrateKt) -> Array:
    """Return the angles of the arm at each temperature, (temperatures, positions) rad.

    Each temperature has angles at equal distance. The lowest has those of the highest, the second
    that of the second highest and so on, so that no order of the amplifier's ripple can pass for a
    change with temperature; the others lie between them, to resolve more orders.
    """
    temperatures, positions = len(settings.temperatures_degc), settings.rotor_positions
    place = np.argsort(np.argsort(settings.temperatures_degc, kind="stable"))
    place = np.minimum(place, temperatures - 1 - place)
    shift = place[:, None] / ((temperatures + 1) // 2)
    angles: Array = 2 * np.pi * (np.arange(positions) + shift) / positions
    return angles


def staircase(settings: CalibrateKt) -> tuple[float, ...]:
    """Return the levels of current at one clamping: zero, up to the top and down, repeated; A."""
    up = np.linspace(0.0, settings.current_max, settings.steps + 1)
    turn = np.concatenate([up[1:], up[-2::-1]])
    return (0.0, *np.tile(turn, settings.staircases).tolist())


def analyse(runs: Sequence[Run], recipe: Recipe) -> Outcome:
    """Return the torque constant against temperature from the staircases of all runs."""
    plateaus = _pool([_plateaus(run, recipe) for run in runs])
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
    return Outcome(_results(found, recipe), _tables(found), _notes(found, recipe))


def _plateaus(run: Run, recipe: Recipe) -> Plateaus:
    recording = run.recording(STAIRCASE)
    return plateaus_of_set_point(
        time=recording.read("time"),
        current_setpoint=recording.read("current_setpoint"),
        current=recording.read("current"),
        force=recording.read("force"),
        temperature=recording.read("temperature"),
        rotor_angle=recording.read("rotor_angle") if recording.has("rotor_angle") else None,
        arm_length=recipe.rig.arm.length,
        settle_time=recipe.calibrate_kt.settle_time,
        gauge_resolution=recipe.rig.arm.gauge_resolution,
    )


def _pool(parts: Sequence[Plateaus]) -> Plateaus:
    """Return the plateaus of several runs as one series in time."""
    placed = [parts[0]]
    for part in parts[1:]:
        before = placed[-1]
        later = before.end[-1] - part.begin[0] + 3600.0
        moved = {
            "begin": part.begin + later,
            "end": part.end + later,
            "staircase": part.staircase + before.staircase[-1] + 1,
        }
        placed.append(replace(part, **moved))
    names = vars(parts[0])
    return Plateaus(**{name: np.concatenate([vars(p)[name] for p in placed]) for name in names})


def _results(found: Calibration, recipe: Recipe) -> dict[str, Quantity]:
    linearity, slopes = found.linearity, found.slopes
    gain = Component(
        CURRENT_READING, 1.0, "1", recipe.rig.current_reading_relative_u, None, linearity.gain
    )
    scatter = error_line("lack of fit and scatter", linearity.gain_u, "1", linearity.dof)
    if slopes.hysteresis_dof > 0:
        hysteresis = Quantity(slopes.hysteresis, "N m", slopes.hysteresis_u, slopes.hysteresis_dof)
    else:
        reason = "one staircase: no scatter"
        hysteresis = Quantity(slopes.hysteresis, "N m", reason=reason)
    results = {
        "torque_constant": found.torque_constant,
        "torque_constant_temperature_coefficient": found.coefficient,
        "torque_constant_mean": found.mean,
        "torque_constant_constant_error": found.constant_error,
        "torque_constant_ripple": found.ripple,
        "amplifier_gain": combined(linearity.gain, "1", [scatter, gain]),
        "amplifier_offset": Quantity(linearity.offset, "A", linearity.offset_u, linearity.dof),
        "amplifier_linearity": Quantity(
            linearity.deviation, "A", linearity.deviation_u, linearity.deviation_dof
        ),
        "hysteresis_torque": hysteresis,
        "winding_heat_loss": Quantity(
            slopes.steady_heating, "1/A2", slopes.steady_heating_u, slopes.heating_dof
        ),
    }
    return {name: quantity for name, quantity in results.items() if quantity is not None}


def _tables(found: Calibration) -> dict[str, Table]:
    linearity, slopes = found.linearity, found.slopes
    return {
        "torque_constant": Table(
            ("temperature",),
            {
                "temperature": Column(found.temperature, "degC", "of the winding"),
                "torque_constant": Column(found.value, "N m/A", "without the amplifier's ripple"),
                "u": Column(found.u, "N m/A", "standard uncertainty"),
                "dof": dof_column(found.dof),
            },
            signal="torque_constant",
            description="Torque constant against temperature",
        ),
        "linearity": Table(
            ("current_setpoint",),
            {
                "current_setpoint": Column(linearity.current_setpoint, "A"),
                "current": Column(linearity.current, "A", "measured, mean of all plateaus"),
                "deviation": Column(linearity.deviations, "A", "from the straight line"),
            },
            signal="deviation",
            description="DC linearity of the amplifier",
        ),
        "hysteresis": Table(
            ("current",),
            {
                "current": Column(slopes.level, "A"),
                "rising": Column(slopes.rising, "N m", "torque minus the straight line"),
                "falling": Column(slopes.falling, "N m", "torque minus the straight line"),
            },
            signal="rising",
            description="Friction of the shaft in the staircases, mean of all",
        ),
    }


def _notes(found: Calibration, recipe: Recipe) -> tuple[str, ...]:
    notes, settings = [], recipe.calibrate_kt
    ratio = found.mean.value / recipe.rig.torque_constant
    if not 1 / FAR_OFF < ratio < FAR_OFF:
        notes.append(
            f"the measured constant is {ratio:.3g} times the data sheet's, rig.torque_constant = "
            f"{recipe.rig.torque_constant:g} N m/A: see to the units of force, arm and current"
        )
    parts = sorted(found.components.items(), key=lambda item: -item[1])
    budget = ", ".join(f"{name} {u * 100:.2g} %" for name, u in parts if u > 0)
    notes.append(f"standard uncertainty of torque_constant_mean: {budget}")
    slopes = found.slopes
    notes.append(
        f"heat in the winding lowered the torque constant by {slopes.heating * 100:.2g} % within "
        f"the staircases (time constant {slopes.time_constant:.2g} s); corrected"
    )
    if found.coefficient is None:
        notes.append(
            f"all staircases are within {SAME_TEMPERATURE:g} K of {found.temperature[0]:.4g} degC: "
            "no temperature coefficient and no value at 20 degC; torque_constant_mean holds there "
            "only. Measure at a second temperature"
        )
    else:
        notes.extend(_extrapolation(found, settings.reference_range_degc))
    if found.rotor_angles < 3:
        known = f"{found.rotor_angles} rotor angles" if found.rotor_angles else "unknown angles"
        notes.append(
            f"measured at {known}: the amplifier's ripple does not average out, and its part of "
            "the uncertainty is missing; clamp the arm at 8 angles around the turn"
        )
    return tuple(notes)


def _extrapolation(found: Calibration, range_degc: tuple[float, float]) -> list[str]:
    low, high = float(found.temperature.min()), float(found.temperature.max())
    outside = [t for t in (20.0, *range_degc) if not low - 2 <= t <= high + 2]
    if not outside:
        return []
    listed = ", ".join(f"{t:g}" for t in dict.fromkeys(outside))
    return [f"extrapolated to {listed} degC from {low:.3g} to {high:.3g} degC along the line"]


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
