"""From current set point to torque: the one conversion of all commands, and its one policy.

    torque = k(T) g i,   k(T) = k_20 (1 + b (T - 20 degC))

i is the current set point, g the gain of the amplifier, k the torque constant of the motor [7.1.1].

The thesis takes one constant, the mean over 20 to 35 degC, for all that it measures [7.1.1]:
`torque_per_ampere`, of every command but those below. Its standard uncertainty includes the change
of k over that range, since the motor may have any temperature within it: a rectangular distribution
(GUM 4.3.7). A table of `ilc-learn` is fed forward as current by the same constant, so that the
constant cancels: uncertainties of learned tables are those of their scatter.

`identify-plant` and `measure-force --correction full` resolve less than the change of k. They take
k at the recorded temperature of the motor: `torque_per_ampere_at`, with the uncertainty of the
calibration alone.
"""

from __future__ import annotations

import math
from dataclasses import replace

from rigtool.experiments.torque_constant.temperature_fit import REFERENCE_DEGC
from rigtool.quantity import Quantity
from rigtool.runfile import Run


def torque_per_ampere(kt: Run, *, of_measured_current: bool = False) -> Quantity:
    """Return the torque for each ampere of set point, N m/A, from a run of calibrate-kt.

    The torque constant holds for the current as measured; the amplifier delivers `amplifier_gain`
    of its set point, which does not count `of_measured_current`. Raises `RunFileError` where `kt`
    is no calibration.
    """
    kt.require_command("calibrate-kt")
    mean = kt.result("torque_constant_mean")
    gain = Quantity(1.0, "1", 0.0) if of_measured_current else kt.result("amplifier_gain")
    error = kt.results.get("torque_constant_constant_error")
    own = (mean.u or 0.0) / mean.value
    relative_u = math.hypot(
        own, (gain.u or 0.0) / gain.value, 0.0 if error is None else error.value / math.sqrt(3)
    )
    # Welch-Satterthwaite (GUM G.4.1): only the mean has finite degrees of freedom.
    dof = mean.dof * (relative_u / own) ** 4 if mean.dof is not None and own else None
    value = mean.value * gain.value
    return Quantity(value, mean.unit, value * relative_u, dof)


def torque_per_ampere_at(kt: Run, temperature_degc: float) -> Quantity:
    """Return the torque for each ampere of set point, N m/A, at a temperature of the motor.

    A calibration without slope gives `torque_per_ampere`. Raises `RunFileError` as that does.
    """
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


def with_constant(quantity: Quantity, constant: Quantity) -> Quantity:
    """Return a quantity that is proportional to a torque constant, with the constant's part of u.

    A quantity without uncertainty stays as it is.
    """
    if quantity.u is None:
        return quantity
    u = math.hypot(quantity.u, quantity.value * (constant.u or 0.0) / constant.value)
    dof = quantity.dof
    if dof is not None and quantity.u:
        dof *= (u / quantity.u) ** 4  # Welch-Satterthwaite, those of the constant being many
    return replace(quantity, u=u, dof=dof)


def mean_constant_note(constant: Quantity) -> str:
    """State the constant behind the torques, and the parts of its uncertainty."""
    return (
        f"torque by the mean torque constant, {constant.value * 1e3:.4g} mN m/A; its standard "
        f"uncertainty, {(constant.u or 0.0) / constant.value:.2%}, includes its change over the "
        "temperatures of the calibration"
    )
