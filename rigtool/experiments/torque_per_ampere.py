"""Torque for each ampere of current set point: the one conversion that all commands use.

torque = torque_constant_mean * amplifier_gain * current set point [7.1.1]
"""

from __future__ import annotations

import math

from rigtool.experiments.torque_constant.temperature_fit import REFERENCE_DEGC
from rigtool.quantity import Quantity
from rigtool.runfile import Run


def torque_per_ampere(kt: Run) -> Quantity:
    """Return the torque for each ampere of set point, N m/A, from a run of calibrate-kt.

    The torque constant holds for the measured current, which is `amplifier_gain` times the set
    point. Raises `RunFileError` where `kt` is no calibration.
    """
    kt.require_command("calibrate-kt")
    mean, gain = kt.result("torque_constant_mean"), kt.result("amplifier_gain")
    relative_u = math.hypot((mean.u or 0.0) / mean.value, (gain.u or 0.0) / gain.value)
    value = mean.value * gain.value
    return Quantity(value, mean.unit, value * relative_u, mean.dof)


def torque_per_ampere_at(kt: Run, temperature_degc: float) -> Quantity:
    """Return `torque_per_ampere` at a motor temperature, or its mean without a known slope."""
    names = ("torque_constant", "torque_constant_temperature_coefficient", "amplifier_gain")
    mean = torque_per_ampere(kt)
    if not all(name in kt.results for name in names):
        return mean
    constant, slope, gain = (kt.result(name) for name in names)
    warmer = temperature_degc - REFERENCE_DEGC
    factor = 1 + slope.value * warmer
    parts = (
        (constant.u or 0.0) / constant.value,
        (slope.u or 0.0) * warmer / factor,
        (gain.u or 0.0) / gain.value,
    )
    value = constant.value * factor * gain.value
    return Quantity(value, constant.unit, value * math.hypot(*parts), constant.dof)
