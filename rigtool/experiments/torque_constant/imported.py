"""`calibrate-kt` on imported runs: current against a torque or force sensor, stepped or ramped.

The analysis of a rig of rigtool knows the staircases, arm and rotor angles. Other rigs step or ramp
their current in ways of their own, and some turn meanwhile; imported runs have another fit,
`current_levels`.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from rigtool.errors import InsufficientDataError, RunFileError
from rigtool.experiments.imported import place, rig_property, rotary_recordings
from rigtool.experiments.outcome import Outcome
from rigtool.experiments.torque_constant.current_levels import (
    Course,
    CurrentFit,
    find_points,
    fit_constant,
)
from rigtool.numerics.arrays import Array
from rigtool.quantity import Quantity
from rigtool.runfile import Column, Recording, Run, Table


def analyse_imported(runs: Sequence[Run]) -> Outcome:
    """Return the torque constant from plateaus or ramps of current.

    Raises `UsageError` for a linear axis, `RunFileError` where a run has no current or no sensor,
    `InsufficientDataError` where the runs do not carry a constant.
    """
    recordings = rotary_recordings(runs, "where current makes force")
    points = []
    for recording in recordings:
        torque, _ = _sensor(recording)
        course = Course(
            recording.read("time"),
            recording.read(_current(recording)),
            torque,
            recording.read("temperature") if recording.has("temperature") else None,
            recording.read("speed") if recording.has("speed") else None,
        )
        try:
            points.append(find_points(course))
        except InsufficientDataError as error:
            raise InsufficientDataError(f"{place(recording)}: {error}") from None
    fit = fit_constant(points)
    sensor_u = rig_property(recordings[0], "reference_relative_u")
    return Outcome(
        _results(fit, sensor_u or 0.0, points[0].temperature),
        {"calibration_points": _table(fit)},
        _notes(fit, recordings[0], sensor_u),
    )


def _current(recording: Recording) -> str:
    if recording.has("current"):
        return "current"
    if recording.has("current_setpoint"):
        return "current_setpoint"
    raise RunFileError(f"{recording.name}: holds no current: map `current` or `current_setpoint`")


def _sensor(recording: Recording) -> tuple[Array, str]:
    """Return the torque (n,) of a sensor, N m, and what it comes from."""
    for name in ("reference_torque", "torque"):
        if recording.has(name):
            return recording.read(name), name
    length = rig_property(recording, "arm_length")
    if recording.has("force") and length is not None:
        return recording.read("force") * length, "force, times arm_length"
    raise RunFileError(
        f"{recording.name}: holds no torque of a sensor: map `reference_torque` or `torque`, or "
        "`force` with arm_length in [rig]"
    )


def _results(fit: CurrentFit, sensor_u: float, degc: Array | None) -> dict[str, Quantity]:
    def quantity(value: float, u: float) -> Quantity:
        # Welch-Satterthwaite (GUM G.4.1): what is common to all currents has many degrees.
        total = math.hypot(u, value * fit.curvature_u, value * sensor_u)
        return Quantity(value, "N m/A", total, fit.dof * (total / u) ** 4)

    results = {"torque_constant_mean": quantity(fit.constant, fit.constant_u)}
    if fit.reference is not None and fit.coefficient is not None and degc is not None:
        results["torque_constant"] = quantity(*fit.reference)
        change, u = fit.coefficient
        results["torque_constant_temperature_coefficient"] = Quantity(change, "1/K", u, fit.dof)
        half = float(degc.max() - degc.min()) / 2
        results["torque_constant_constant_error"] = Quantity(
            abs(change) * half, "1", u * half, fit.dof
        )
    if fit.hysteresis is not None:
        results["hysteresis_torque"] = Quantity(
            fit.hysteresis[0], "N m", fit.hysteresis[1], fit.dof
        )
    return results


def _table(fit: CurrentFit) -> Table:
    return Table(
        ("point",),
        {
            "point": Column(
                np.arange(len(fit.current)), "1", "plateau, or part of a ramp, in time"
            ),
            "current": Column(fit.current, "A", "mean"),
            "torque": Column(fit.measured, "N m", "mean, without the sensor's zero"),
            "model": Column(fit.model, "N m", "the same of the fitted model"),
        },
        "torque",
        "Torque against current",
    )


def _notes(fit: CurrentFit, recording: Recording, sensor_u: float | None) -> tuple[str, ...]:
    _, sensor = _sensor(recording)
    kind = "plateaus" if fit.plateaus else "parts of ramps"
    notes = [
        f"from {len(fit.current)} {kind} of {_current(recording)} against {sensor}; standard "
        f"uncertainty: fit {fit.constant_u / fit.constant:.2%}, one constant for all currents up "
        f"to {abs(fit.current).max():.3g} A {fit.curvature_u:.2%}"
    ]
    if sensor == "torque":
        notes.append("a drive that computes torque from current shows its own constant here")
    if sensor_u is None:
        notes.append(
            "the uncertainty of the sensor's calibration is unknown and not part of u: state "
            "reference_relative_u in [rig]"
        )
    if fit.one_way:
        notes.append(
            "the current goes one way: friction of the shaft is not separated from the slope, its "
            "usual size is part of u; step the current up and down"
        )
    if fit.coefficient is None:
        notes.append(
            "no change of temperature shows a coefficient: the constant holds at the temperature "
            "of the recording"
        )
    else:
        notes.append(
            "the coefficient combines the recording with the range of magnets, -0.2 to 0 %/K; the "
            f"mean holds at {fit.temperature:.3g} degC as recorded, the winding may be warmer"
        )
    return tuple(notes)
