"""`calibrate-kt` on imported runs: current against a torque or force sensor, stepped or ramped.

Two staircases or more, up and down, on a shaft at rest are analysed as the bench's own:
`temperature_fit.calibrate`. They separate friction, heat in the winding and torque constant by
themselves. A single staircase, one way, ramps and turning shafts do not, and have the fit of
`current_levels`, where usual sizes take the place of what the data do not show. On drawn motors
with one staircase each, the bench's fit is off by 0.9 % rms and refuses 3 of 20, the other by 0.5
%; with four to twenty-four it is off by 0.01 to 0.05 %, the other by 0.1 %. With two or three it is
off by up to 2.7 times as much as the other, but its intervals hold, also those of the coefficient.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from rigtool.errors import InsufficientDataError, RunFileError
from rigtool.experiments.imported import moves, place, position_of, rig_property, rotary_recordings
from rigtool.experiments.outcome import Outcome
from rigtool.experiments.torque_constant.current_levels import CurrentFit, fit_constant
from rigtool.experiments.torque_constant.current_points import Course, find_points
from rigtool.experiments.torque_constant.results import outcome_of
from rigtool.experiments.torque_constant.staircases.measured_levels import (
    common_levels,
    find_levels,
    stepped,
)
from rigtool.experiments.torque_constant.staircases.plateaus import (
    Plateaus,
    plateaus_of_set_point,
    pool,
)
from rigtool.experiments.torque_constant.temperature_fit import calibrate
from rigtool.numerics.arrays import Array
from rigtool.quantity import REFERENCE_DEGC, Quantity, combined, error_line
from rigtool.recipe.commands import CalibrateKt
from rigtool.runfile import Column, Recording, Run, Table

ROTOR_ANGLE = "rotor_angle"
"""Signal, or condition, that holds the angle at which the shaft is held, rad."""

MAX_TWIST = 0.5
"""Largest angle by which a shaft at rest gives way, rad."""

REVERSED_CURRENT = 0.02
"""Largest current against the others, relative to them: staircases have one sign."""

FEWEST_STAIRCASES = 2
"""Staircases from which the bench's analysis separates heat and friction from the constant."""


def analyse_imported(runs: Sequence[Run]) -> Outcome:
    """Return the torque constant from staircases, other plateaus, or ramps of current.

    Raises `UsageError` for a linear axis, `RunFileError` where a run has no current or no sensor,
    `InsufficientDataError` where the runs do not carry a constant.
    """
    recordings = rotary_recordings(runs, "where current makes force")
    courses = [_course(recording) for recording in recordings]
    notes = _common_notes(recordings[0])
    asked = all(recording.has("current_setpoint") for recording in recordings)
    for by_setpoint in [True, False][not asked :]:
        try:
            outcome = _as_at_the_bench(recordings, courses, by_setpoint=by_setpoint)
        except InsufficientDataError as error:
            which = " by their set point" if by_setpoint else ""
            notes = (*notes, f"not analysed as staircases of a bench are{which}: {error}")
        else:
            return replace(outcome, notes=(*outcome.notes, *notes))
    outcome = _by_usual_sizes(recordings, courses)
    return replace(outcome, notes=(*outcome.notes, *notes))


def _course(recording: Recording) -> Course:
    sensed, arm, _ = _sensor(recording)
    speed = recording.read("speed") if recording.has("speed") else None
    if speed is not None and _at_rest(recording):
        speed = np.zeros(len(speed))
    return Course(
        recording.read("time"),
        recording.read(_current(recording)),
        sensed * arm,
        recording.read("temperature") if recording.has("temperature") else None,
        speed,
    )


def _at_rest(recording: Recording) -> bool:
    """Return whether the shaft hardly moves, as far as the recording shows its motion."""
    return not moves(recording) or float(np.ptp(position_of(recording))) < MAX_TWIST


def _common_notes(recording: Recording) -> tuple[str, ...]:
    notes, (_, _, sensor) = [], _sensor(recording)
    if sensor == "torque":
        notes.append("a drive that computes torque from current shows its own constant here")
    if rig_property(recording, "reference_relative_u") is None:
        notes.append(
            "the uncertainty of the sensor's calibration is unknown and not part of u: state "
            "reference_relative_u in [rig]"
        )
    return tuple(notes)


# -- staircases, as at the bench


def _as_at_the_bench(
    recordings: Sequence[Recording], courses: Sequence[Course], *, by_setpoint: bool
) -> Outcome:
    """Analyse staircases as the bench's own; `InsufficientDataError` where they are none."""
    for recording, course in zip(recordings, courses, strict=True):
        if not _at_rest(recording):
            raise InsufficientDataError(f"{place(recording)}: the shaft turns")
        low, high = sorted(np.abs([course.current.min(), course.current.max()]).tolist())
        if low > REVERSED_CURRENT * high and course.current.min() < 0 < course.current.max():
            raise InsufficientDataError(f"{place(recording)}: the current has both signs")
    if any(course.temperature is None for course in courses):
        courses = [replace(course, temperature=None) for course in courses]
    each = zip(recordings, courses, strict=True)
    plateaus = pool([_plateaus(*one, by_setpoint=by_setpoint) for one in each])
    if not by_setpoint:
        plateaus = replace(plateaus, current_setpoint=common_levels(plateaus.current_setpoint))
    if (count := int(plateaus.staircase.max()) + 1) < FEWEST_STAIRCASES:
        raise InsufficientDataError(
            f"{count} staircase does not show heat and friction, {FEWEST_STAIRCASES} or more do"
        )
    reference_range = CalibrateKt().reference_range_degc
    found = calibrate(
        plateaus,
        arm_length=1.0,
        arm_length_u=0.0,
        gauge_relative_u=rig_property(recordings[0], "reference_relative_u") or 0.0,
        reference_range_degc=reference_range,
    )
    return outcome_of(
        found,
        nominal=rig_property(recordings[0], "torque_constant"),
        current_reading_relative_u=0.0,
        reference_range_degc=reference_range,
        setpoint_known=by_setpoint,
        temperature_known=courses[0].temperature is not None,
    )


def _plateaus(recording: Recording, course: Course, *, by_setpoint: bool) -> Plateaus:
    if by_setpoint:
        setpoint = recording.read("current_setpoint")
    else:
        levels = find_levels(course.current, course.torque)
        if not levels.plateaus:
            raise InsufficientDataError(f"{place(recording)}: the current has no plateaus")
        setpoint = stepped(course.current, levels.plateaus)
    angle = recording.read(ROTOR_ANGLE) if recording.has(ROTOR_ANGLE) else None
    if angle is None and (held := rig_property(recording, ROTOR_ANGLE)) is not None:
        angle = np.full(len(setpoint), held)
    degc, (sensed, arm, _), settings = course.temperature, _sensor(recording), CalibrateKt()
    sign = 1.0 if course.current.max() > -course.current.min() else -1.0
    return plateaus_of_set_point(
        time=course.time,
        current_setpoint=sign * setpoint,
        current=sign * course.current,
        force=sign * sensed,
        temperature=np.full(len(setpoint), REFERENCE_DEGC) if degc is None else degc,
        rotor_angle=angle,
        arm_length=arm,
        settle_time=settings.settle_time
        * _median_duration(course.time, setpoint)
        / settings.step_time,
    )


def _median_duration(time: Array, setpoint: Array) -> float:
    """Return the median time, s, for which a set point stays."""
    changes = np.flatnonzero(np.diff(setpoint)) + 1
    samples = np.diff(np.concatenate([[0], changes, [len(setpoint)]]))
    return float(np.median(samples) * np.median(np.diff(time)))


# -- other courses


def _by_usual_sizes(recordings: Sequence[Recording], courses: Sequence[Course]) -> Outcome:
    points = []
    for recording, course in zip(recordings, courses, strict=True):
        try:
            points.append(find_points(course))
        except InsufficientDataError as error:
            raise InsufficientDataError(f"{place(recording)}: {error}") from None
    fit = fit_constant(points)
    sensor_u = rig_property(recordings[0], "reference_relative_u")
    return Outcome(
        _results(fit, sensor_u or 0.0, points[0].temperature),
        {"calibration_points": _table(fit)},
        _notes(fit, recordings[0]),
    )


def _current(recording: Recording) -> str:
    if recording.has("current"):
        return "current"
    if recording.has("current_setpoint"):
        return "current_setpoint"
    raise RunFileError(f"{place(recording)}: holds no current: map `current` or `current_setpoint`")


def _sensor(recording: Recording) -> tuple[Array, float, str]:
    """Return the readings (n,) of a sensor, its arm, whose product is the torque, N m, and what
    they are."""
    for name in ("reference_torque", "torque"):
        if recording.has(name):
            return recording.read(name), 1.0, name
    length = rig_property(recording, "arm_length")
    if recording.has("force") and length is not None:
        return recording.read("force"), length, "force, times arm_length"
    raise RunFileError(
        f"{place(recording)}: holds no torque of a sensor: map `reference_torque` or `torque`, or "
        "`force` with arm_length in [rig]"
    )


def _results(fit: CurrentFit, sensor_u: float, degc: Array | None) -> dict[str, Quantity]:
    def quantity(value: float, u: float) -> Quantity:
        lines = [
            error_line("scatter and what the data do not show", u, "N m/A", fit.dof),
            error_line("curvature of a staircase", value * fit.curvature_u, "N m/A"),
            error_line("calibration of the sensor", value * sensor_u, "N m/A"),
        ]
        return combined(value, "N m/A", lines)

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


def _notes(fit: CurrentFit, recording: Recording) -> tuple[str, ...]:
    _, _, sensor = _sensor(recording)
    kind = "plateaus" if fit.plateaus else "parts of ramps"
    notes = [
        f"from {len(fit.current)} {kind} of {_current(recording)} against {sensor}; standard "
        f"uncertainty: fit {100 * fit.constant_u / fit.constant:.2f} %, one constant for all "
        f"currents up to {abs(fit.current).max():.3g} A {100 * fit.curvature_u:.2f} %"
    ]
    if fit.one_way:
        notes.append(
            "the current goes one way: friction of the shaft is not separated from the slope, its "
            "usual size is part of u; step the current up and down"
        )
    if not fit.turning:
        notes.append(
            "measured at one angle of the shaft: ripple of the constant around the turn, often 1 "
            "%, is not part of u; repeat the staircase at 8 angles"
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
