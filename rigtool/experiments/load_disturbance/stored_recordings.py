"""Recordings of a hanging load, cut and brought to torque: what implementation D learns and
reads."""

from __future__ import annotations

import math

import numpy as np

from rigtool.errors import InsufficientDataError
from rigtool.experiments.load_disturbance.cycles import Drive, LoadedCycles, loaded_cycles
from rigtool.experiments.loop_tracking import require_tracking
from rigtool.experiments.torque_per_ampere import torque_per_ampere_at
from rigtool.recipe import Recipe
from rigtool.runfile import Recording, Run

CHANNELS = (
    "time",
    "current_setpoint",
    "feedforward_current",
    "table_current",
    "position_setpoint",
    "encoder",
    "temperature",
)
"""What is recorded of a hanging load."""


def drive_of(recipe: Recipe) -> Drive:
    """Return what the bench knows of the drive, with the bandwidth of the reading."""
    rig = recipe.rig
    return Drive(
        angle_ratio=rig.angle_ratio,
        torque_factor=rig.torque_factor,
        inertia=rig.nominal_inertia,
        arm=rig.load_arm,
        bandwidth_hz=recipe.measure_force.lowpass_hz,
    )


def cycles_of(recording: Recording, recipe: Recipe, kt: Run, speed: float) -> LoadedCycles:
    """Cut a recording into cycles; the one that runs in is left out.

    `speed` rad/s is that of the motor. The motor constant is that at the motor's own temperature in
    this recording. Raises `InsufficientDataError` where the loop did not hold the rotor, or where
    there are too few cycles.
    """
    signals = {name: recording.read(name) for name in CHANNELS if name != "table_current"}
    table = recording.read("table_current")
    rotor = signals["encoder"] * (2 * math.pi / recipe.rig.encoder_counts)
    asked = signals["current_setpoint"]
    constant = torque_per_ampere_at(kt, float(np.mean(signals["temperature"]))).value
    try:
        require_tracking(
            recipe,
            largest_current=float(np.abs(asked).max()),
            largest_controller=float(np.abs(asked - signals["feedforward_current"] - table).max()),
            distance=float(np.abs(signals["position_setpoint"] - rotor).max()),
        )
        return loaded_cycles(
            signals["time"],
            signals["position_setpoint"],
            rotor,
            asked,
            drive=drive_of(recipe),
            speed=speed,
            torque_constant=constant,
            moves=round(recording.condition("cycles")) - 1,
        )
    except InsufficientDataError as error:
        raise InsufficientDataError(f"recording {recording.name}: {error}") from None
