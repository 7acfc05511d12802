"""Recordings of a hanging load, cut into cycles and converted to torque.

Both `ilc-learn --implementation D` and `measure-force --correction full` read loads from them.
"""

from __future__ import annotations

import numpy as np

from rigtool.experiments.controller_torque import CHANNELS as LOOP_CHANNELS
from rigtool.experiments.controller_torque import LoopSignals, naming
from rigtool.experiments.load_disturbance.cycles import LoadedCycles, Transmission, loaded_cycles
from rigtool.experiments.torque_per_ampere import torque_per_ampere_at
from rigtool.recipe import Recipe
from rigtool.runfile import Recording, Run

CHANNELS = (*LOOP_CHANNELS, "temperature")
"""What is recorded of a hanging load."""


def transmission_of(recipe: Recipe) -> Transmission:
    """Return how the motor drives the output, with the bandwidth of the reading."""
    rig = recipe.rig
    return Transmission(
        angle_ratio=rig.angle_ratio,
        torque_factor=rig.torque_factor,
        inertia=rig.nominal_inertia,
        arm=rig.load_arm,
        bandwidth_hz=recipe.measure_force.lowpass_hz,
    )


def cycles_of(
    recording: Recording, signals: LoopSignals, recipe: Recipe, kt: Run, speed: float
) -> LoadedCycles:
    """Cut the signals of a recording into cycles; the first one, a run-in, is left out.

    `speed` rad/s is that of the motor. The torque constant is that at the motor's temperature in
    this recording. Raises `InsufficientDataError` for too few cycles.
    """
    temperature = float(np.mean(recording.read("temperature")))
    with naming(recording):
        return loaded_cycles(
            signals.time,
            signals.setpoint,
            signals.rotor,
            signals.total,
            transmission=transmission_of(recipe),
            speed=speed,
            torque_constant=torque_per_ampere_at(kt, temperature).value,
            moves=round(recording.condition("cycles")) - 1,
        )
