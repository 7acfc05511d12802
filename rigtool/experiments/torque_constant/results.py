"""Results, tables and notes of torque constants from staircases: the bench's, and imported ones."""

from __future__ import annotations

import numpy as np

from rigtool.experiments.outcome import Outcome
from rigtool.experiments.torque_constant.staircases.model import SAME_TEMPERATURE
from rigtool.experiments.torque_constant.temperature_fit import MODEL_OF_FRICTION, Calibration
from rigtool.quantity import (
    CURRENT_READING,
    ROUNDING_PART,
    Component,
    Quantity,
    combined,
    error_line,
)
from rigtool.runfile import Column, Table, dof_column

FAR_OFF = 3.0
"""Ratio of measured constant and data sheet that no motor explains: magnets differ by a tenth."""


def outcome_of(
    found: Calibration,
    *,
    nominal: float | None,
    current_reading_relative_u: float,
    reference_range_degc: tuple[float, float],
    setpoint_known: bool = True,
    temperature_known: bool = True,
) -> Outcome:
    """Return the outcome of a calibration; `nominal` N m/A is the data sheet's constant.

    What set point or temperature would show is left out where that was not recorded.
    """
    results, tables = _results(found, current_reading_relative_u), _tables(found)
    if not setpoint_known:
        results = {k: q for k, q in results.items() if not k.startswith("amplifier_")}
        del tables["linearity"]
    if not temperature_known:
        del tables["torque_constant"]
    notes = _notes(found, nominal, reference_range_degc, temperature_known=temperature_known)
    return Outcome(results, tables, notes)


def _results(found: Calibration, reading_relative_u: float) -> dict[str, Quantity]:
    linearity, slopes = found.linearity, found.slopes

    def current(value: float, unit: str, u: float, dof: float, name: str) -> Quantity:
        gain = Component(CURRENT_READING, 1.0, "1", reading_relative_u, None, value)
        return combined(value, unit, [error_line(name, u, unit, dof), gain])

    if slopes.hysteresis_dof > 0:
        arm = [
            Component(name, 1.0, "1", found.components.get(name, 0.0), None, slopes.hysteresis)
            for name in ("arm length", "gauge calibration")
        ]
        scatter = error_line("scatter", slopes.hysteresis_u, "N m", slopes.hysteresis_dof)
        hysteresis = combined(slopes.hysteresis, "N m", [scatter, *arm])
    else:
        reason = "one staircase: no scatter"
        hysteresis = Quantity(slopes.hysteresis, "N m", reason=reason)
    lack = "lack of fit and scatter"
    largest = float(np.max(np.abs(slopes.level)))
    # At the largest current, an error of the slope passes for a loss.
    model_u = found.components.get(MODEL_OF_FRICTION, 0.0) / largest**2
    heat = [*slopes.lasting_heating.budget, error_line(MODEL_OF_FRICTION, model_u, "1/A2")]
    loss = combined(slopes.lasting_heating.value, "1/A2", heat)
    results = {
        "torque_constant": found.torque_constant,
        "torque_constant_temperature_coefficient": found.coefficient,
        "torque_constant_mean": found.mean,
        "torque_constant_constant_error": found.constant_error,
        "torque_constant_ripple": found.ripple,
        "torque_constant_ripple_small_current": found.first_ripple,
        "amplifier_gain": current(linearity.gain, "1", linearity.gain_u, linearity.dof, lack),
        "amplifier_offset": current(linearity.offset, "A", linearity.offset_u, linearity.dof, lack),
        "amplifier_linearity": current(
            linearity.deviation, "A", linearity.deviation_u, linearity.deviation_dof, "scatter"
        ),
        "hysteresis_torque": hysteresis,
        "winding_heat_loss": loss,
    }
    return {name: quantity for name, quantity in results.items() if quantity is not None}


def _tables(found: Calibration) -> dict[str, Table]:
    linearity, slopes = found.linearity, found.slopes
    return {
        "torque_constant": Table(
            ("temperature",),
            {
                "temperature": Column(found.temperature, "degC", "of the winding"),
                "torque_constant": Column(found.value, "N m/A", "without the amplifier's ripple"),
                "u": Column(found.u, "N m/A", "standard uncertainty"),
                "dof": dof_column(found.dof),
            },
            signal="torque_constant",
            description="Torque constant against temperature",
        ),
        "linearity": Table(
            ("current_setpoint",),
            {
                "current_setpoint": Column(linearity.current_setpoint, "A"),
                "current": Column(linearity.current, "A", "measured, mean of all plateaus"),
                "deviation": Column(linearity.deviations, "A", "from the straight line"),
            },
            signal="deviation",
            description="DC linearity of the amplifier",
        ),
        "hysteresis": Table(
            ("current",),
            {
                "current": Column(slopes.level, "A"),
                "rising": Column(slopes.rising, "N m", "torque minus the straight line"),
                "falling": Column(slopes.falling, "N m", "torque minus the straight line"),
            },
            signal="rising",
            description="Friction of the shaft in the staircases, mean of all",
        ),
    }


def _notes(
    found: Calibration,
    nominal: float | None,
    range_degc: tuple[float, float],
    *,
    temperature_known: bool,
) -> tuple[str, ...]:
    notes = []
    ratio = 1.0 if nominal is None else found.mean.value / nominal
    if not 1 / FAR_OFF < ratio < FAR_OFF:
        notes.append(
            f"the measured constant is {ratio:.3g} times the data sheet's, rig.torque_constant = "
            f"{nominal:g} N m/A: see to the units of force, arm and current"
        )
    parts = sorted(found.components.items(), key=lambda item: -item[1])
    seen = ROUNDING_PART * parts[0][1] if parts else 0.0
    budget = ", ".join(f"{name} {u * 100:.2g} %" for name, u in parts if u > seen)
    notes.append(f"standard uncertainty of torque_constant_mean: {budget}")
    slopes = found.slopes
    notes.append(
        f"heat in the winding lowered the torque constant by {slopes.heating * 100:.2g} % within "
        f"the staircases (time constant {slopes.time_constant:.2g} s); corrected"
    )
    if not temperature_known:
        notes.append(
            "the temperature was not recorded: no temperature coefficient, and no value at 20 degC"
        )
    elif found.coefficient is None:
        notes.append(
            f"all staircases are within {SAME_TEMPERATURE:g} K of {found.temperature[0]:.4g} degC: "
            "no temperature coefficient and no value at 20 degC; torque_constant_mean holds there "
            "only. Measure at a second temperature"
        )
    else:
        notes.extend(_extrapolation(found, range_degc))
    if found.rotor_angles < 3:
        known = ("unknown angles", "one rotor angle", "2 rotor angles")[found.rotor_angles]
        notes.append(
            f"measured at {known}: the amplifier's ripple does not average out, and its part of "
            "the uncertainty is missing; clamp the arm at 8 angles around the turn"
        )
    return tuple(notes)


def _extrapolation(found: Calibration, range_degc: tuple[float, float]) -> list[str]:
    low, high = float(found.temperature.min()), float(found.temperature.max())
    outside = [t for t in (20.0, *range_degc) if not low - 2 <= t <= high + 2]
    if not outside:
        return []
    listed = ", ".join(f"{t:g}" for t in dict.fromkeys(outside))
    return [f"extrapolated to {listed} degC from {low:.3g} to {high:.3g} degC along the line"]
