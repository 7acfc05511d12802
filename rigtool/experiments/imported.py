"""Signals of imported runs, the effort of their motor, and properties of the rig: conditions.

A property that the mapping file did not state is absent.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from rigtool.errors import RunFileError, UsageError
from rigtool.experiments.torque_per_ampere import torque_per_ampere
from rigtool.numerics.arrays import Array
from rigtool.runfile import Recording, Run

RECORDING = "imported"
"""Name of the one recording of an imported run."""

RIG = {
    "encoder_counts",
    "torque_constant",
    "torque_constant_u",
    "rated_torque",
    "inertia",
    "arm_length",
    "reference_relative_u",
    "linear_axis",
}
"""Conditions that describe the rig, not one recording."""


def signals_of(runs: Sequence[Run]) -> list[Recording]:
    """Return the recording of each run; `RunFileError` for a run that holds only a map."""
    return [run.recording(RECORDING) for run in runs]


def known(recording: Recording, name: str) -> float | None:
    """Return a property of the rig, None where it is unknown."""
    return recording.condition(name) if name in recording.conditions else None


def is_linear(recording: Recording) -> bool:
    """Return whether the axis is linear: m and N."""
    return known(recording, "linear_axis") == 1.0


def position_of(recording: Recording) -> Array:
    """Return the position (n,), rad or m.

    The measured position is preferred to encoder counts, counts to the integral of speed, which
    starts at zero. Raises `RunFileError` where none of the three is recorded.
    """
    if recording.has("position"):
        return recording.read("position")
    counts = known(recording, "encoder_counts")
    if recording.has("encoder") and counts is not None:
        turn = 1.0 if is_linear(recording) else 2 * math.pi
        return recording.read("encoder") * (turn / counts)
    if recording.has("speed"):
        time, speed = recording.read("time"), recording.read("speed")
        steps = np.diff(time) * (speed[1:] + speed[:-1]) / 2
        return np.concatenate([[0.0], np.cumsum(steps)])
    raise RunFileError(
        f"{recording.name}: the position is unknown: there is no channel position or speed, nor "
        "encoder with encoder_counts; import it with one of them mapped"
    )


def require_one_rig(recordings: Sequence[Recording], runs: Sequence[Run]) -> None:
    """Raise `UsageError` where the known properties of the rig differ between runs."""
    first = {name: known(recordings[0], name) for name in RIG}
    for recording, run in zip(recordings, runs, strict=True):
        for name, value in first.items():
            if known(recording, name) != value:
                raise UsageError(
                    f"{run.path} has {name} {known(recording, name)}, {runs[0].path} has {value}: "
                    "give runs of one rig, imported with one mapping"
                )


@dataclass(frozen=True)
class Effort:
    """Torque, force or current of the motor: `values` (n,) in `unit`; `name` as in tables.

    `relative_u` is the relative standard uncertainty of the scale, None where it is unknown;
    `origin` states the channel and the factor that the values come from.
    """

    values: Array
    unit: str
    name: str
    relative_u: float | None
    origin: str


def effort_of(recording: Recording, kt: Run | None) -> Effort:
    """Return torque (force on a linear axis), or current where no torque constant is known.

    With `kt`, current times its torque constant; else the torque that the drive or a sensor
    reports, else current times the torque constant of the mapping, else torque relative to the
    rated one, else current alone. Raises `RunFileError` where there is none of them.
    """
    has_current = recording.has("current") or recording.has("current_setpoint")
    if kt is not None and has_current:
        scale = torque_per_ampere(kt, of_measured_current=recording.has("current"))
        current = recording.read(_current_name(recording)) * scale.value
        relative = None if scale.u is None else scale.u / scale.value
        return Effort(current, "N m", "torque", relative, "current times the constant of --kt")
    name, unit = ("force", "N") if is_linear(recording) else ("torque", "N m")
    if recording.has(name):
        return Effort(recording.read(name), unit, name, None, f"{name} as in the file")
    if recording.has("relative_torque") and not has_current:
        origin = "torque relative to the rated one, which the mapping does not state (rated_torque)"
        return Effort(recording.read("relative_torque"), "1", "relative_torque", 0.0, origin)
    current = recording.read(_current_name(recording))
    constant = known(recording, "torque_constant")
    if constant is None or is_linear(recording):
        return Effort(current, "A", "current", 0.0, "current as in the file")
    u = known(recording, "torque_constant_u")
    return Effort(
        current * constant,
        "N m",
        "torque",
        None if u is None else u / constant,
        "current times the torque constant of the mapping",
    )


def _current_name(recording: Recording) -> str:
    # The mapping may name either; the measured current is nearer to the torque.
    return "current" if recording.has("current") else "current_setpoint"
