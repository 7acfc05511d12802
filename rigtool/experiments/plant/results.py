"""Results of identify-plant: the response, its fit, the loop's sensitivities and margins."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from rigtool.control.position_loop import position_loop
from rigtool.experiments.outcome import Outcome
from rigtool.experiments.plant.curvature import SlopeRise
from rigtool.experiments.plant.fit import MIN_COHERENCE, PlantFit
from rigtool.experiments.plant.frequency_response import FrequencyResponse
from rigtool.experiments.plant.margins import Margins, margins
from rigtool.numerics.arrays import Array
from rigtool.quantity import Component, Quantity, combined, error_line, inherited
from rigtool.recipe import Recipe
from rigtool.runfile import Column, Table, dof_column

FALLING = 2.0
"""Multiple of its uncertainty by which viscous friction may be below zero, by scatter."""

FALLS = (
    "below zero: friction falls with the speed where the shaft was excited, as in the Stribeck "
    "effect; raise identify_plant.speeds (stroke_speeds with the instrument) or lower swing"
)

RESPONSE_UNIT = "rad/(N m)"
TABLE_POINTS = 200
"""Points of the frequency axis of the tables of fit and sensitivities."""

NOT_CALIBRATED = (
    "the torque constant is the data sheet's, whose uncertainty is not known: give --kt"
)


@dataclass(frozen=True, eq=False)
class IdentifiedPlant:
    """Response and fit; the torque for each ampere (None without --kt); the largest swing.

    `swing` is the peak of the excited speed relative to the speed of the shaft, `rise` the bend of
    friction over the swing.
    """

    response: FrequencyResponse
    fit: PlantFit
    torque_constant: Quantity | None
    swing: float
    rise: SlopeRise

    @property
    def scale_u(self) -> float:
        """Relative standard uncertainty of all torques; zero where it is not known."""
        constant = self.torque_constant
        return 0.0 if constant is None else (constant.u or 0.0) / constant.value

    def quantity(
        self, statistic: Callable[[PlantFit], float], unit: str, *more: Component
    ) -> Quantity:
        """Return a statistic of the fit with its uncertainty, to which it may add `more`."""
        value = statistic(self.fit)
        if self.torque_constant is None:
            return Quantity(value, unit, reason=NOT_CALIBRATED)
        scatter, doubt = self.fit.scatter(statistic), self.fit.doubt(statistic)
        own = [
            error_line("scatter between experiments", scatter, unit, len(self.fit.without) - 1),
            error_line("second mass", doubt, unit),
            *more,
        ]
        scale = statistic(_scaled(self.fit, 1 + self.scale_u)) - value
        constant = self.torque_constant
        per_constant = scale / constant.u if constant.u else 0.0
        return combined(value, unit, [*own, *inherited(constant, per_constant, "torque constant")])

    def columns(self, magnitude: Array, scatter: Array, dof: float, what: str) -> dict[str, Column]:
        """Return u and its degrees of freedom for responses (k,), by Welch and Satterthwaite.

        `scatter` (k,) has `dof`; the torque constant is common to all lines.
        """
        scale = self.scale_u * magnitude
        constant = self.torque_constant
        common = 0.0 if constant is None or not constant.dof else 1 / constant.dof
        u = np.hypot(scatter, scale)
        spread = scatter**4 / dof + scale**4 * common
        # Far above a slow current loop's corner nothing is left, and nothing is uncertain.
        known = np.divide(u**4, spread, out=np.full(u.shape, np.inf), where=spread > 0)
        return {"u": Column(u, RESPONSE_UNIT, f"standard, {what}"), "dof": dof_column(known)}


def _scaled(fit: PlantFit, factor: float) -> PlantFit:
    """Return the fit with all torques scaled by a factor."""
    model = fit.model
    return replace(
        fit, model=replace(model, inertia=factor * model.inertia, viscous=factor * model.viscous)
    )


def plant_outcome(found: IdentifiedPlant, recipe: Recipe) -> Outcome:
    """Return results, tables and notes."""
    loop = _Loop(found, recipe)
    return Outcome(
        {**_plant_results(found), **loop.results()},
        {
            "frequency_response": _response_table(found),
            "fit": _fit_table(found, loop.frequency),
            "sensitivities": loop.table(),
        },
        tuple(_notes(found, recipe)),
    )


def _plant_results(found: IdentifiedPlant) -> dict[str, Quantity]:
    fit, response = found.fit, found.response
    results = {
        "inertia": found.quantity(lambda f: f.model.inertia, "kg m2"),
        "viscous_friction": _viscous_friction(found),
        "mass_line_crossing": found.quantity(lambda f: f.model.mass_line_crossing, "Hz"),
    }
    if not fit.model.rigid:
        results |= {
            "inertia_motor_side": found.quantity(
                lambda f: f.model.inertia * (f.model.motor_side or 1.0), "kg m2"
            ),
            "antiresonance_frequency": found.quantity(lambda f: f.model.antiresonance_hz, "Hz"),
            "antiresonance_damping": found.quantity(lambda f: f.model.damping, "1"),
            "resonance_frequency": found.quantity(lambda f: f.model.resonance_hz, "Hz"),
        }
    off = np.abs(response.response / fit.response(response.frequency) - 1)[fit.used]
    return {
        **results,
        "delay": found.quantity(lambda f: f.delay, "s"),
        "model_distance": Quantity(
            float(off.max()), "1", reason="the largest deviation includes the scatter"
        ),
        "coherence_min": Quantity(
            float(response.coherence[fit.used].min()), "1", reason="a measure of scatter itself"
        ),
    }


def _viscous_friction(found: IdentifiedPlant) -> Quantity:
    """Return the mean slope of friction, or its value with the reason where friction falls.

    The slope of fast motion lies between it and the one an rms of the swing above (rectangular).
    """
    unit = "N m s/rad"
    mean = found.quantity(lambda f: f.model.viscous, unit)
    if mean.u is not None and mean.value < -FALLING * mean.u:
        return Quantity(mean.value, unit, reason=FALLS)
    bend = error_line("bend of friction", found.rise.shown / math.sqrt(3), unit)
    return found.quantity(lambda f: f.model.viscous, unit, bend)


def _response_table(found: IdentifiedPlant) -> Table:
    response, fit = found.response, found.fit
    value, scale = response.response, found.scale_u * np.abs(response.response)
    return Table(
        ("frequency",),
        {
            "frequency": Column(response.frequency, "Hz"),
            "magnitude": Column(np.abs(value), RESPONSE_UNIT, "angle for each torque"),
            "phase": Column(np.unwrap(np.angle(value)), "rad"),
            **found.columns(np.abs(value), response.u, response.dof, "of the magnitude"),
            "u_phase": Column(response.u / np.abs(value), "rad", "standard, of the phase"),
            "radius": Column(
                np.hypot(response.radius, 2 * scale),
                RESPONSE_UNIT,
                "of the circle that holds the true response at 95 %",
            ),
            "u_quantisation": Column(
                response.quantisation, RESPONSE_UNIT, "part of u from the encoder's steps"
            ),
            "coherence": Column(response.coherence, "1", "with the excitation, in one period"),
            "distance": Column(
                np.abs(value / fit.model.response(response.frequency, fit.sample_time) - 1),
                "1",
                "from the model without delay, relative",
            ),
            "used": Column(fit.used.astype(np.int32), "1", "1 where the fit rests on the line"),
        },
        "magnitude",
        "frequency response of the plant, torque to angle",
    )


def _fit_table(found: IdentifiedPlant, frequency: Array) -> Table:
    fit = found.fit
    value = fit.response(frequency)
    omega = 2 * np.pi * frequency
    without = np.stack([np.abs(other.response(frequency)) for other in fit.without])
    count = len(without)
    scatter = np.sqrt((count - 1) * without.var(axis=0))
    return Table(
        ("frequency",),
        {
            "frequency": Column(frequency, "Hz"),
            "magnitude": Column(np.abs(value), RESPONSE_UNIT, "fit, with delay and roll-off"),
            "phase": Column(np.unwrap(np.angle(value)), "rad"),
            **found.columns(
                np.abs(value), scatter, count - 1, "of the magnitude, if the model is right"
            ),
            "mass_line": Column(
                1 / (fit.model.inertia * omega**2), RESPONSE_UNIT, "1/(J w2): -40 dB a decade"
            ),
        },
        "magnitude",
        "fitted response of the plant",
    )


class _Loop:
    """The fitted plant in the recipe's loop."""

    def __init__(self, found: IdentifiedPlant, recipe: Recipe) -> None:
        self._found = found
        self._controller = position_loop(**recipe.rig.loop_design).controller
        self._half_rate = 0.5 / recipe.rig.sample_time
        low = found.response.frequency[0] / 4
        self.frequency = np.geomspace(low, 0.999 * self._half_rate, TABLE_POINTS)

    def _margins(self, fit: PlantFit) -> Margins:
        return margins(
            lambda f: self._controller.response(f) * fit.response(f), 0.999 * self._half_rate
        )

    def results(self) -> dict[str, Quantity]:
        """Return margins and bandwidth, computed once for each of the fits."""
        known: dict[PlantFit, Margins] = {}

        def of(name: str) -> Callable[[PlantFit], float]:
            def statistic(fit: PlantFit) -> float:
                if fit not in known:
                    known[fit] = self._margins(fit)
                return float(getattr(known[fit], name))

            return statistic

        quantity = self._found.quantity
        return {
            "crossover_frequency": quantity(of("crossover_hz"), "Hz"),
            "bandwidth": quantity(of("bandwidth_hz"), "Hz"),
            "gain_margin": quantity(of("gain"), "1"),
            "phase_margin": quantity(of("phase"), "rad"),
            "modulus_margin": quantity(of("modulus"), "1"),
        }

    def table(self) -> Table:
        """Return S, T, Sp and the open loop over frequency."""
        frequency = self.frequency
        plant = self._found.fit.response(frequency)
        open_loop = self._controller.response(frequency) * plant
        sensitivity = 1 / (1 + open_loop)
        curves = {
            "t": (open_loop * sensitivity, "1", "complementary sensitivity T"),
            "s": (sensitivity, "1", "sensitivity S"),
            "sp": (plant * sensitivity, RESPONSE_UNIT, "process sensitivity Sp"),
            "open_loop": (open_loop, "1", "controller times plant"),
        }
        columns = {"frequency": Column(frequency, "Hz")}
        for name, (value, unit, what) in curves.items():
            columns[f"{name}_magnitude"] = Column(np.abs(value), unit, what)
            columns[f"{name}_phase"] = Column(np.unwrap(np.angle(value)), "rad", what)
        return Table(
            ("frequency",),
            columns,
            "t_magnitude",
            "the loop of the recipe's controller and the fitted plant",
        )


def _notes(found: IdentifiedPlant, recipe: Recipe) -> list[str]:
    fit, response = found.fit, found.response
    band = response.frequency[fit.used]
    steps = (response.quantisation / np.abs(response.response))[fit.used]
    share = np.median(np.square(response.quantisation / response.u)[fit.used])
    notes = [
        f"{len(response.each)} experiments; fit on {fit.used.sum()} of {len(fit.used)} lines, "
        f"{band[0]:.4g} to {band[-1]:.4g} Hz: those with a coherence of at least {MIN_COHERENCE}",
        f"the encoder's steps, as white noise, make a line's response uncertain by at most "
        f"{100 * steps.max():.2g} %, {share:.2g} of its variance (median)",
        _swing_note(found.swing, found.rise),
        _model_note(fit),
        f"delay and roll-off model amplifier and hold: "
        f"{fit.delay * 1e6:+.3g} us beyond half a sample, gain "
        f"{100 * math.expm1(-fit.roll_off * (2 * math.pi * band[-1]) ** 2):+.2g} % at "
        f"{band[-1]:.4g} Hz",
    ]
    nominal = recipe.rig.nominal_inertia
    notes.append(
        f"the nominal inertia is {nominal:.4g} kg m2, the measured one "
        f"{100 * (fit.model.inertia / nominal - 1):+.2g} % from it"
    )
    if found.torque_constant is not None:
        notes.append("torque by the torque constant at the recorded temperature of the motor")
    else:
        notes.append(
            f"torques rest on the data sheet's torque constant, {recipe.rig.torque_constant} "
            "N m/A: inertia and friction have its relative error; give --kt"
        )
    return notes


def _swing_note(swing: float, rise: SlopeRise) -> str:
    if swing < 1 and rise.shown:
        return (
            f"the slope of friction rises by {rise.shown:.2g} N m s/rad over one rms of the swing "
            f"(its speed swung by up to {100 * swing:.3g} %), as where friction falls with the "
            "speed at its slow end: viscous_friction is lower than that of fast motion, its u "
            "holds this; raise identify_plant.speeds (stroke_speeds with the instrument) or lower "
            "swing"
        )
    if swing < 1:
        return (
            f"the shaft never stopped (its speed swung by up to {100 * swing:.3g} %), so Coulomb "
            "friction is a constant; its slope is the same over the swing within "
            f"{2 * rise.u:.2g} N m s/rad"
        )
    return (
        f"the shaft stopped (its speed swung by up to {100 * swing:.3g} %): viscous_friction "
        "includes Coulomb friction; lower identify_plant.swing"
    )


def _model_note(fit: PlantFit) -> str:
    if fit.model.rigid:
        model = "one rigid inertia explains the response"
        if fit.rigid_rejected < 1:
            model += (
                f", two masses as well (F test, p = {fit.rigid_rejected:.1g}): what they would "
                "change is in the uncertainty"
            )
    else:
        model = (
            "a rigid inertia does not explain the response (F test, p = "
            f"{fit.rigid_rejected:.1g}): two masses were fitted; `inertia` moves below the "
            f"resonance at {fit.model.resonance_hz:.3g} Hz, friction that grows with the torque "
            "between them included, `inertia_motor_side` above it"
        )
    return f"{model}; deviations are {fit.misfit:.3g} times their expected scatter"
