"""From current set point to torque: the one conversion of all commands, and its one policy.

    torque = k(T) g i,   k(T) = k_20 (1 + b (T - 20 degC))

i is the current set point, g the gain of the amplifier, k the torque constant of the motor [7.1.1].

The thesis takes one constant, the mean over 20 to 35 degC, for all that it measures [7.1.1]:
`torque_per_ampere`, of every command but those below. Its standard uncertainty includes the change
of k over that range, since the motor may have any temperature within it: a rectangular distribution
(GUM 4.3.7). Where recordings show a temperature at which k is further from the mean, the
distribution reaches to there, and a note states it. A table of `ilc-learn` is fed forward as
current by the same constant, so that the constant cancels: uncertainties of learned tables are
those of their scatter.

`identify-plant`, `fft-ripple` and `measure-force --correction full` resolve less than the change of
k. They take k at the recorded temperature of the motor: `torque_per_ampere_at`, with the
uncertainty of the calibration alone.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from rigtool.numerics.arrays import Array
from rigtool.quantity import REFERENCE_DEGC, Quantity
from rigtool.runfile import Recording, Run

ENDS = 1024
"""Samples at either end of a recording that show its temperatures, which change slowly."""


def torque_per_ampere(
    kt: Run, recordings: Sequence[Recording] = (), *, of_measured_current: bool = False
) -> Quantity:
    """Return the torque for each ampere of set point, N m/A, from a run of calibrate-kt.

    Its uncertainty holds for the temperatures of `recordings`, where they show any.

    The torque constant holds for the current as measured; the amplifier delivers `amplifier_gain`
    of its set point, which does not count `of_measured_current`. Raises `RunFileError` where `kt`
    is no calibration.
    """
    kt.require_command("calibrate-kt")
    mean = kt.result("torque_constant_mean")
    # An imported calibration has no gain: a drive's current follows its set point.
    gain = kt.results.get("amplifier_gain")
    if of_measured_current or gain is None:
        gain = Quantity(1.0, "1", 0.0)
    error = max(_known_error(kt), abs(_furthest(kt, recordings)[1]))
    own = (mean.u or 0.0) / mean.value
    relative_u = math.hypot(own, (gain.u or 0.0) / gain.value, error / math.sqrt(3))
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


def _known_error(kt: Run) -> float:
    """Return the largest relative error of the mean constant over its range of temperatures."""
    error = kt.results.get("torque_constant_constant_error")
    return 0.0 if error is None else error.value


def temperature_at_ends(recording: Recording) -> tuple[float, float]:
    """Return the motor's temperature at the start and at the end, degC; NaN where none is known."""
    first, last = (float(end.mean()) if end.size else math.nan for end in _at_ends(recording))
    return first, last


def _at_ends(recording: Recording) -> tuple[Array, Array]:
    """Return the known temperatures among the first and among the last samples, degC."""
    if not recording.has("temperature"):
        return np.empty(0), np.empty(0)
    first, last = (
        recording.read_stored("temperature", start, stop).astype(np.float64)
        for start, stop in ((0, ENDS), (max(0, recording.size - ENDS), recording.size))
    )
    return first[np.isfinite(first)], last[np.isfinite(last)]  # NaN where no thermometer is there


def _furthest(kt: Run, recordings: Sequence[Recording]) -> tuple[float, float]:
    """Return the recorded temperature, degC, at which k is furthest from its mean, and how far,
    relative; NaN and 0 where nothing shows it."""
    names = ("torque_constant", "torque_constant_temperature_coefficient")
    ends = [end for recording in recordings for end in _at_ends(recording)]
    degc = np.concatenate([*ends, np.empty(0)], dtype=np.float64)
    if not degc.size or not all(name in kt.results for name in names):
        return math.nan, 0.0
    constant, slope = (kt.result(name).value for name in names)
    there = constant * (1 + slope * (degc - REFERENCE_DEGC))
    away = there / kt.result("torque_constant_mean").value - 1
    worst = int(np.abs(away).argmax())
    return float(degc[worst]), float(away[worst])


def mean_constant_note(kt: Run, recordings: Sequence[Recording] = ()) -> str:
    """State the constant behind the torques, and the parts of its uncertainty."""
    constant = torque_per_ampere(kt, recordings)
    degc, away = _furthest(kt, recordings)
    if abs(away) > _known_error(kt):
        return (
            f"torque by the mean torque constant, {constant.value * 1e3:.4g} mN m/A, but the motor "
            f"had {degc:.3g} degC, where the constant is {abs(away):.2%} "
            f"{'below' if away < 0 else 'above'} it: torques are read too "
            f"{'high' if away < 0 else 'low'} by that; the standard uncertainty, "
            f"{(constant.u or 0.0) / constant.value:.2%}, includes it; widen "
            "calibrate_kt.reference_range_degc, or let the motor cool"
        )
    return (
        f"torque by the mean torque constant, {constant.value * 1e3:.4g} mN m/A; its standard "
        f"uncertainty, {(constant.u or 0.0) / constant.value:.2%}, includes its change over the "
        "temperatures of the calibration"
    )
