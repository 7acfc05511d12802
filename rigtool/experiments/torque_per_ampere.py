"""From current set point to torque: the one conversion of all commands, and its one policy.

    torque = k(T) g i,   k(T) = k_20 (1 + b (T - 20 degC))

i is the current set point, g the gain of the amplifier, k the torque constant of the motor [7.1.1].

The thesis takes one constant, the mean over 20 to 35 degC, for all that it measures [7.1.1]:
`torque_per_ampere`, in every command except those below. Its standard uncertainty includes the
change of k over that range, since the motor may have any temperature within it: a rectangular
distribution (GUM 4.3.7). Where recordings show a temperature at which k is further from the mean,
the distribution reaches to there, and a note states it. A table of `ilc-learn` is fed forward as
current by the same constant, so that the constant cancels: uncertainties of learned tables are
those of their scatter. A run of `ilc-learn` states the constant, and whatever feeds its table
forward takes that one, also under a later calibration.

`identify-plant`, `fft-ripple` and `measure-force` with a correction have smaller uncertainties than
the change of k. They take k at the recorded temperature of the motor: `torque_per_ampere_at`, with
the uncertainty of the calibration alone.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from rigtool.errors import RunFileError
from rigtool.experiments.imported import is_linear, rig_property
from rigtool.numerics.arrays import TINY, Array
from rigtool.quantity import (
    CURRENT_READING,
    REFERENCE_DEGC,
    THERMOMETER,
    Quantity,
    combined,
    error_line,
    inherited,
    input_line,
    without,
)
from rigtool.runfile import Recording, Run
from rigtool.runfile.schema import CHUNK, LARGEST_NUMBER

CONSTANT = "feedforward_constant"
"""Result that states the torque per ampere of set point that the current of a table was made
with."""

END_SAMPLES = 1024
"""Samples at either end of a recording that show its temperatures, which change slowly."""

FAR_FROM_ZERO = 8.0
"""Standard uncertainties from zero beyond which no part of a normal distribution is beyond it."""


def torque_per_ampere(
    kt: Run, recordings: Sequence[Recording] = (), *, of_measured_current: bool = False
) -> Quantity:
    """Return the torque for each ampere of set point, N m/A, from a run of calibrate-kt.

    Its uncertainty holds for the temperatures of `recordings`, where they show any.

    The torque constant holds for the current as measured; the amplifier delivers `amplifier_gain`
    of its set point, which does not count `of_measured_current`. Raises `RunFileError` where `kt`
    is no calibration.
    """
    away = _furthest(kt, recordings)[1]
    return _torque_per_ampere(kt, away, of_measured_current=of_measured_current)


def _torque_per_ampere(kt: Run, away: float, *, of_measured_current: bool = False) -> Quantity:
    """Do as `torque_per_ampere` where recordings show the constant `away` from its mean."""
    mean = without(_constant(kt, "torque_constant_mean"), CURRENT_READING)
    gain = Quantity(1.0, "1", 0.0) if of_measured_current else _gain(kt)
    away = max(_known_error(kt), abs(away))
    value = mean.value * gain.value
    lines = [
        input_line("torque constant", mean, gain.value),
        input_line("gain of the amplifier", gain, mean.value),
        error_line("temperature of the motor", value * away / math.sqrt(3), mean.unit),
    ]
    return combined(value, mean.unit, lines)


def torque_per_ampere_at(kt: Run, temperature_degc: float) -> Quantity:
    """Return the torque for each ampere of set point, N m/A, at a temperature of the motor.

    A calibration without slope gives `torque_per_ampere`. Raises `RunFileError` as that does.
    """
    names = ("torque_constant", "torque_constant_temperature_coefficient", "amplifier_gain")
    mean = torque_per_ampere(kt)
    if not all(name in kt.results for name in names):
        return mean
    constant, slope, gain = _constant(kt, names[0]), kt.result(names[1], "1/K"), _gain(kt)
    for cancels in (CURRENT_READING, THERMOMETER):
        constant = without(constant, cancels)
    warmer = temperature_degc - REFERENCE_DEGC
    factor = 1 + slope.value * warmer
    lines = [
        input_line("torque constant at 20 degC", constant, factor * gain.value),
        input_line("temperature coefficient", slope, constant.value * warmer * gain.value),
        input_line("gain of the amplifier", gain, constant.value * factor),
    ]
    return combined(constant.value * factor * gain.value, constant.unit, lines)


def warmed(constant: Quantity, kt: Run, square: float, least: float = 0.0) -> Quantity:
    """Return a torque for each ampere while currents of the mean `square`, A2, heat the winding.

    The winding is warmer than the housing. How much of `winding_heat_loss` is reached is not known:
    anything between the part `least` and the whole, a rectangular distribution (GUM 4.3.7). No
    magnet gains by heat: of a loss that noise may have made negative, the positive part counts. One
    without a standard uncertainty is as uncertain as it is large.
    """
    if "winding_heat_loss" not in kt.results:
        return constant
    loss = kt.result("winding_heat_loss", "1/A2")
    lost, own = (loss.value,) * 2 if loss.u is None else _positive(loss.value, loss.u)
    reached, half = square * (1 + least) / 2, square * (1 - least) / 2
    u = constant.value * math.hypot(lost * half / math.sqrt(3), reached * own)
    left = 1 - lost * reached
    heat = error_line("heat of the winding", u, constant.unit)
    lines = [*inherited(constant, left, "torque constant"), heat]
    return combined(constant.value * left, constant.unit, lines)


def _positive(value: float, u: float) -> tuple[float, float]:
    """Return mean and standard deviation of the positive part of a normal distribution (N. L.
    Johnson et al., Continuous Univariate Distributions, 2nd ed., 1994, section 13.10.1)."""
    if value >= FAR_FROM_ZERO * u:
        return value, u
    ratio = max(value / max(u, TINY), -FAR_FROM_ZERO)
    below = math.exp(-(ratio**2) / 2) / math.sqrt(2 * math.pi)
    hazard = below / (math.erfc(-ratio / math.sqrt(2)) / 2)
    return u * (ratio + hazard), u * math.sqrt(1 - ratio * hazard - hazard**2)


def _constant(kt: Run, name: str, unit: str = "N m/A") -> Quantity:
    """Return a result that other numbers are divided by; `RunFileError` where it is zero."""
    found = kt.result(name, unit)
    if not abs(found.value) >= 1 / LARGEST_NUMBER:
        raise RunFileError(
            f"{kt.path}: {name} is {found.value:g} {unit}, which no torque can be read with: "
            "calibrate again"
        )
    return found


def _gain(kt: Run) -> Quantity:
    """Return the gain of the amplifier; an error of the reading is in the constant, too, inversely.

    Both divide the same measured current, so that it cancels in their product.
    """
    if "amplifier_gain" not in kt.results:  # imported: a drive's current follows its set point
        return Quantity(1.0, "1", 0.0)
    return without(_constant(kt, "amplifier_gain", "1"), CURRENT_READING)


def constant_result(per_ampere: float) -> dict[str, Quantity]:
    """Return the torque per ampere, N m/A, that currents were made with, under its name."""
    reason = "a scale by definition: torque over it is the current that was learned"
    return {CONSTANT: Quantity(per_ampere, "N m/A", reason=reason)}


def learned_constant(run: Run) -> float | None:
    """Return the torque per ampere, N m/A, that the current of a table was made with; None where
    the run does not state it."""
    return run.result(CONSTANT, "N m/A").value if CONSTANT in run.results else None


def with_constant(quantity: Quantity, constant: Quantity) -> Quantity:
    """Return a quantity that is proportional to a torque constant, with the constant's part of u.

    A quantity without uncertainty stays as it is.
    """
    if quantity.u is None:
        return quantity
    own = error_line("scatter", quantity.u, quantity.unit, quantity.dof)
    scale = inherited(constant, quantity.value / constant.value, "torque constant")
    return combined(quantity.value, quantity.unit, [own, *scale])


def _known_error(kt: Run) -> float:
    """Return the largest relative error of the mean constant over its range of temperatures."""
    name = "torque_constant_constant_error"
    return kt.result(name, "1").value if name in kt.results else 0.0


def mean_temperature(recordings: Sequence[Recording]) -> float:
    """Return the motor's mean temperature at the ends of recordings, degC; NaN where none is
    known."""
    ends = [end.mean() for recording in recordings for end in _at_ends(recording) if end.size]
    return float(np.mean(ends)) if ends else math.nan


def _at_ends(recording: Recording) -> tuple[Array, Array]:
    """Return the known temperatures among the first and among the last samples, degC."""
    if not recording.has("temperature"):
        return np.empty(0), np.empty(0)
    late = max(0, recording.size - END_SAMPLES)

    def read(start: int, stop: int | None) -> Array:
        blocks = recording.blocks("temperature", start=start, stop=stop, finite=False)
        return np.concatenate([np.empty(0), *(degc for (degc,) in blocks)])

    if recording.size <= CHUNK:  # that chunk is read once
        whole = read(0, None)
        first, last = whole[:END_SAMPLES], whole[late:]
    else:
        first, last = read(0, END_SAMPLES), read(late, None)
    first, last = (end[np.isfinite(end)] for end in (first, last))  # NaN without a thermometer
    return first, last if late else first


def _furthest(kt: Run, recordings: Sequence[Recording]) -> tuple[float, float]:
    """Return the recorded temperature, degC, at which k is furthest from its mean, and how far,
    relative; NaN and 0 where nothing shows it."""
    kt.require_command("calibrate-kt")
    names = ("torque_constant", "torque_constant_temperature_coefficient")
    ends = [end for recording in recordings for end in _at_ends(recording)]
    degc = np.concatenate([*ends, np.empty(0)], dtype=np.float64)
    if not degc.size or not all(name in kt.results for name in names):
        return math.nan, 0.0
    constant, slope = _constant(kt, names[0]).value, kt.result(names[1], "1/K").value
    there = constant * (1 + slope * (degc - REFERENCE_DEGC))
    away = there / _constant(kt, "torque_constant_mean").value - 1
    worst = int(np.abs(away).argmax())
    return float(degc[worst]), float(away[worst])


def mean_constant(kt: Run, recordings: Sequence[Recording] = ()) -> tuple[Quantity, str]:
    """Return `torque_per_ampere`, and a note on it and the parts of its uncertainty."""
    degc, away = _furthest(kt, recordings)
    constant = _torque_per_ampere(kt, away)
    if abs(away) > _known_error(kt):
        slope = kt.result("torque_constant_temperature_coefficient", "1/K").value
        remedy = "cool" if away * slope > 0 else "warm up"
        return constant, (
            f"torque by the mean torque constant, {constant.value * 1e3:.4g} mN m/A, but the motor "
            f"had {degc:.3g} degC, where the constant is {100 * abs(away):.2f} % "
            f"{'below' if away < 0 else 'above'} it: torques are read too "
            f"{'high' if away < 0 else 'low'} by that; the standard uncertainty, "
            f"{100 * (constant.u or 0.0) / constant.value:.2f} %, includes it; widen "
            f"calibrate_kt.reference_range_degc, or let the motor {remedy}"
        )
    return constant, (
        f"torque by the mean torque constant, {constant.value * 1e3:.4g} mN m/A; its standard "
        f"uncertainty, {100 * (constant.u or 0.0) / constant.value:.2f} %, includes its change "
        "over the temperatures of the calibration"
    )


# -- imported runs


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
    constant = rig_property(recording, "torque_constant")
    if constant is None or is_linear(recording):
        return Effort(current, "A", "current", 0.0, "current as in the file")
    u = rig_property(recording, "torque_constant_u")
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
