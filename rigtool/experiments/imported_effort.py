"""Torque, force or current of the motor in imported runs."""

from __future__ import annotations

from dataclasses import dataclass

from rigtool.experiments.imported import is_linear, known
from rigtool.experiments.torque_per_ampere import torque_per_ampere
from rigtool.numerics.arrays import Array
from rigtool.runfile import Recording, Run


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
