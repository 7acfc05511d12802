"""Names of signals that have one meaning and one unit, whoever records them."""

from __future__ import annotations

import re

CHANNELS: dict[str, tuple[str, str, str]] = {
    "time": ("s", "f8", "bench clock"),
    "position_setpoint": ("rad", "f8", "set point of the motor shaft"),
    "encoder": ("count", "f8", "motor encoder, quad counts; a mean where samples are averaged"),
    "current_setpoint": ("A", "f4", "asked of the amplifier: controller + feed-forward + table"),
    "current": ("A", "f4", "as the amplifier measures it"),
    "feedforward_current": ("A", "f4", "part from acceleration and friction model"),
    "table_current": ("A", "f4", "part from the learned table"),
    "signal_current": ("A", "f4", "part that repeats with time: excitation, or a learned torque"),
    "temperature": ("degC", "f4", "of the motor's cooling body"),
    "force": ("N", "f4", "force gauge at the end of the arm"),
    "rotor_angle": ("rad", "f4", "angle of the shaft in the arm's clamp"),
    "deflection": ("m", "f8", "of the motor on its leaf springs, by a micrometer"),
    "reference_torque": ("N m", "f8", "true external torque on the output; for comparison only"),
}
"""Unit, type in the file and meaning of each channel that a rig may offer."""

SIGNALS: dict[str, tuple[str, str, str]] = {
    "time": ("s", "s", "clock of the recording"),
    "encoder": ("count", "count", "motor encoder, quad counts"),
    "position": ("rad", "m", "measured position of the motor"),
    "position_setpoint": ("rad", "m", "set point of the motor's position"),
    "speed": ("rad/s", "m/s", "measured speed of the motor"),
    "speed_setpoint": ("rad/s", "m/s", "set point of the motor's speed"),
    "current": ("A", "A", "motor current as measured"),
    "current_setpoint": ("A", "A", "set point of the motor current"),
    "torque": ("N m", "N m", "motor torque, as the drive or a sensor reports it"),
    "relative_torque": ("1", "1", "relative to the rated torque, as the drive reports it"),
    "force": ("N", "N", "force along the axis, as the drive or a sensor reports it"),
    "output_position": ("rad", "m", "behind the motor's gearbox"),
    "output_position_setpoint": ("rad", "m", "set point behind the motor's gearbox"),
    "output_torque": ("N m", "N m", "behind the motor's gearbox, as a sensor reports it"),
    "reference_position": ("rad", "m", "angle or position at the load"),
    "reference_torque": ("N m", "N m", "reference for comparison, from a sensor at the load"),
    "reference_current": ("A", "A", "set point of the motor that makes the load"),
    "temperature": ("degC", "degC", "of the motor"),
    "rotor_angle": ("rad", "m", "at which the shaft is held while torque is measured"),
}
"""Names with a fixed meaning in imports: unit on a rotary and on a linear axis, and description."""


def units_of(name: str) -> tuple[str, ...]:
    """Return the units that a signal, or a condition, of this name may have; none where all may.

    A linear axis has m for rad.
    """
    rotary, linear, _ = SIGNALS.get(name, (None, None, None))
    units = (rotary, linear, CHANNELS[name][0] if name in CHANNELS else None)
    return tuple(dict.fromkeys(unit for unit in units if unit is not None))


def is_name(name: str) -> bool:
    """Return whether a name can stand for a recording, signal, table, column or result."""
    return re.fullmatch(r"[A-Za-z_][A-Za-z0-9_]{0,99}", name) is not None
