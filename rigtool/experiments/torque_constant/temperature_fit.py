"""Torque constant against temperature, with its uncertainty budget [7.1.1, Fig. 20].

Each staircase s has a torque constant k_s at a temperature T_s and a rotor angle a:

    k_s = r_a (k0 + b (T_s - T0))

r_a is the amplifier's ripple, a relative gain that depends on the angle and averages to 1 over a
turn. Where each angle was measured at several temperatures, it has an r of its own; else r is a
sum of orders of rotation. k0 and b come from weighted least squares. The thesis's relative
coefficient is b / k(20 degC). Length of the arm and calibration of the gauge are common to all
points: they scale the result (GUM 5.2, correlated input quantities) and do not scatter it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from rigtool.errors import InsufficientDataError
from rigtool.experiments.torque_constant.staircase import Linearity, Plateaus, amplifier_linearity
from rigtool.experiments.torque_constant.staircase_fit import Slopes, fit_staircases
from rigtool.numerics.arrays import Array
from rigtool.numerics.turn_mean import TurnMean, group_angles, mean_over_turn
from rigtool.quantity import Quantity

REFERENCE_DEGC = 20.0
"""Temperature for which a torque constant is stated, degC [7.1.1]."""

SAME_TEMPERATURE = 2.0
"""Range of staircases that count as one temperature, K."""

LINEARITY_LIMIT = 5e-3
"""Largest deviation of the amplifier from a straight line, relative to the span."""


@dataclass(frozen=True)
class Calibration:
    """Torque constant of the motor, and linearity of the amplifier.

    `torque_constant` holds at 20 degC and `coefficient` is its relative change a kelvin, both None
    where only one temperature was measured; `mean` holds over the reference range (or at the only
    temperature), `constant_error` is the largest relative error of its use over the range.
    `temperature` (k,) in degC, `value` and `u` (k,) in N m/A are the points of Fig. 20.
    `ripple` is the relative standard deviation of the constant over the rotor angles, None for
    fewer than three: a torque read at one angle is uncertain by it. `components` are relative
    standard uncertainties of `mean` by source; `rotor_angles` counts the angles of the arm (0 where
    unknown).
    """

    torque_constant: Quantity | None
    coefficient: Quantity | None
    mean: Quantity
    constant_error: Quantity | None
    ripple: Quantity | None
    temperature: Array
    value: Array
    u: Array
    components: dict[str, float]
    rotor_angles: int
    slopes: Slopes
    linearity: Linearity


def calibrate(
    plateaus: Plateaus,
    *,
    arm_length: float,
    arm_length_u: float,
    gauge_relative_u: float,
    reference_range_degc: tuple[float, float],
) -> Calibration:
    """Return the torque constant against temperature from the plateaus of all staircases.

    Raises `InsufficientDataError` where the amplifier or the torque is not linear in current, or
    where the staircases do not carry a torque constant.
    """
    linearity = amplifier_linearity(plateaus)
    _require_linear(linearity)
    slopes = fit_staircases(plateaus)
    fit = _fit_temperature(slopes)
    if fit.slope != 0:
        # With the coefficient, the drift within a staircase can be taken out of its torque.
        slopes = fit_staircases(plateaus, fit.slope / fit.value)
        fit = _fit_temperature(slopes)
    common = {
        "arm length": (arm_length_u / arm_length, math.inf),
        "gauge calibration": (gauge_relative_u, math.inf),
        "ripple over rotor angles": fit.turn,
        "heat in the winding": (slopes.heating_u, slopes.heating_dof),
        "friction of the shaft": (slopes.friction_u, math.inf),
    }
    law = _Law(fit, common)
    temperature, value, scatter = _points(slopes, fit)
    common_u = math.hypot(*(u for u, _ in common.values()))
    low, high = reference_range_degc
    middle = (low + high) / 2 if fit.slope_known else fit.temperature
    mean = law.at(middle)
    components = {name: u for name, (u, _) in common.items()}
    components["scatter"] = fit.value_u / fit.value
    return Calibration(
        torque_constant=_quantity(law.at(REFERENCE_DEGC), "N m/A") if fit.slope_known else None,
        coefficient=_quantity(law.coefficient(), "1/K") if fit.slope_known else None,
        mean=_quantity(mean, "N m/A"),
        constant_error=_constant_error(law, mean, (low, high)) if fit.slope_known else None,
        ripple=_ripple(slopes.rotor_angle, fit.gain),
        temperature=temperature,
        value=value,
        u=np.hypot(scatter, common_u * value),
        components=components,
        rotor_angles=fit.angles,
        slopes=slopes,
        linearity=linearity,
    )


def _require_linear(linearity: Linearity) -> None:
    limit = LINEARITY_LIMIT * float(np.ptp(linearity.current_setpoint))
    if linearity.deviation > max(limit, 4 * linearity.deviation_u):
        raise InsufficientDataError(
            f"the amplifier deviates by {linearity.deviation:.3g} A from a straight line, limit "
            f"{limit:.3g} A: set point and current are not proportional, so no torque constant "
            "turns one into torque; repair the amplifier or lower current_max"
        )


@dataclass(frozen=True)
class _Fit:
    """k(T) = value + slope (T - temperature), with covariance; gain and turn of all points."""

    temperature: float
    value: float
    slope: float
    value_u: float
    slope_u: float
    correlation: float
    dof: float
    slope_known: bool
    gain: Array  # (m,) r of each staircase
    turn: tuple[float, float]  # relative uncertainty of the mean over a turn, dof
    angles: int


def _fit_temperature(slopes: Slopes) -> _Fit:
    """Fit the model at the top of this module by weighted least squares."""
    angle, index = group_angles(slopes.rotor_angle)
    total = len(slopes.slope)
    repeated = 2 * len(angle) <= total
    ripple = np.eye(len(angle))[index] if repeated else _orders(angle[index])
    weight = 1 / slopes.u
    centre = float(np.average(slopes.temperature, weights=weight**2))
    rise = slopes.temperature - centre
    known = float(np.ptp(slopes.temperature)) > SAME_TEMPERATURE
    gain = np.ones(total)
    for _ in range(4):  # linear for given gains; these differ from 1 by little
        design = np.column_stack([ripple, gain * rise]) if known else ripple
        inverse = np.linalg.pinv(design * weight[:, None])
        parameters = inverse @ (slopes.slope * weight)
        level = parameters[: ripple.shape[1]]
        turn = (
            mean_over_turn(angle, level)
            if repeated
            else TurnMean(float(level[0]), 0.0, math.inf, 0.0)
        )
        gain = ripple @ level / turn.value
    dof = total - int(np.linalg.matrix_rank(design))
    residual = (slopes.slope - design @ parameters) * weight
    # Scatter counts where it exceeds the uncertainties of the points (Birge ratio).
    scale = max(1.0, float(residual @ residual) / dof) if dof > 0 else 1.0
    covariance = inverse @ inverse.T * scale
    # The value as a combination of the parameters: a mean over angles, or the constant order
    combination = np.zeros(len(parameters))
    combination[: len(level)] = 1 / len(level) if repeated else np.eye(len(level))[0]
    value_u = math.sqrt(float(combination @ covariance @ combination))
    slope_u = math.sqrt(float(covariance[-1, -1])) if known else 0.0
    between = float(combination @ covariance[:, -1]) if known else 0.0
    return _Fit(
        temperature=centre,
        value=turn.value,
        slope=float(parameters[-1]) if known else 0.0,
        value_u=value_u,
        slope_u=slope_u,
        correlation=between / (value_u * slope_u) if slope_u > 0 else 0.0,
        # Scatter from the points has their degrees of freedom; else those of the plateaus.
        dof=float(dof if scale > 1 else slopes.dof),
        slope_known=known,
        gain=gain,
        turn=(0.0 if math.isnan(turn.u) else float(turn.u / turn.value), turn.dof or math.inf),
        angles=0 if np.all(np.isnan(slopes.rotor_angle)) else len(angle),
    )


def _ripple(angle: Array, gain: Array) -> Quantity | None:
    """Return the standard deviation of r_a over the rotor angles; its u after GUM E.4.3."""
    index = group_angles(angle)[1]
    count = int(index.max()) + 1
    if count < 3:
        return None
    std = float(np.std(np.bincount(index, weights=gain) / np.bincount(index), ddof=1))
    return Quantity(std, "1", std / math.sqrt(2 * (count - 1)), float(count - 1))


def _orders(angle: Array) -> Array:
    """Return 1 and the orders of rotation that angles (m,) resolve, (m, 1 + 2 orders)."""
    orders = max(0, min(len(angle) // 4, (len(angle) - 4) // 2))
    phase = np.outer(angle, np.arange(1, orders + 1))
    return np.column_stack([np.ones(len(angle)), np.cos(phase), np.sin(phase)])


class _Law:
    """k(T) as an uncertain number: scatter of the fit and the components common to all points."""

    def __init__(self, fit: _Fit, common: dict[str, tuple[float, float]]) -> None:
        import GTC

        self._temperature = fit.temperature
        scale = GTC.constant(1.0)
        for name, (u, dof) in common.items():
            scale = scale * GTC.ureal(1.0, u, dof, label=name)
        if fit.slope_known:
            value, slope = GTC.multiple_ureal(
                [fit.value, fit.slope], [fit.value_u, fit.slope_u], fit.dof
            )
            GTC.set_correlation(fit.correlation, value, slope)
        else:
            value, slope = GTC.ureal(fit.value, fit.value_u, fit.dof), GTC.constant(0.0)
        self._value, self._slope, self._scale = value, slope, scale

    def at(self, temperature: float) -> Any:
        """Return k at a temperature in degC, N m/A, as an uncertain number."""
        return self._scale * (self._value + self._slope * (temperature - self._temperature))

    def coefficient(self) -> Any:
        """Return b / k(20 degC), 1/K; the scale of all points cancels."""
        return self._slope * self._scale / self.at(REFERENCE_DEGC)


def _constant_error(law: _Law, mean: Any, range_degc: tuple[float, float]) -> Quantity:
    """Return the largest relative error of one constant value, at an end of the range [7.1.1]."""
    import GTC

    errors = [mean / law.at(end) - 1 for end in range_degc]
    worst = max(errors, key=lambda error: abs(GTC.value(error)))
    return _quantity(worst if GTC.value(worst) >= 0 else -worst, "1")


def _points(slopes: Slopes, fit: _Fit) -> tuple[Array, Array, Array]:
    """Return temperature, torque constant without ripple, and its scatter, of each group (k,)."""
    order = np.argsort(slopes.temperature)
    groups: list[list[int]] = []
    for number in order.tolist():
        new = not groups or (
            slopes.temperature[number] - slopes.temperature[groups[-1][0]] > SAME_TEMPERATURE
        )
        groups.append([number]) if new else groups[-1].append(number)
    flat = slopes.slope / fit.gain
    temperature = np.array([np.mean(slopes.temperature[group]) for group in groups])
    value = np.array([np.mean(flat[group]) for group in groups])
    own = np.array(
        [math.sqrt(float(np.sum(slopes.u[group] ** 2))) / len(group) for group in groups]
    )
    return temperature, value, own


def _quantity(number: Any, unit: str) -> Quantity:
    import GTC

    dof = float(GTC.dof(number))
    return Quantity(
        float(GTC.value(number)),
        unit,
        float(GTC.uncertainty(number)),
        dof if math.isfinite(dof) else None,
    )
