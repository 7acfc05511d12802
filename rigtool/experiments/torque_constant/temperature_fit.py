"""Torque constant against temperature, with its uncertainty budget [7.1.1, Fig. 20].

Each staircase s has a torque constant k_s at a temperature T_s and a rotor angle a:

    k_s = r_a (k0 + b (T_s - T0))

r_a is the amplifier's ripple, a relative gain that depends on the angle and averages to 1 over a
turn: a sum of orders of rotation as random effects (`rigtool.numerics.angle_effects`). The thesis's
relative coefficient is b / k(20 degC). Length of the arm and calibration of the gauge are common
to all points: they scale the result (GUM 5.2, correlated input quantities) and do not scatter it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from rigtool.errors import InsufficientDataError
from rigtool.experiments.torque_constant.ripple_over_turn import (
    Alias,
    alias_of,
    carried_by_arm,
    first_ripple,
    ripple_over_turn,
    stated_ripple,
)
from rigtool.experiments.torque_constant.staircases.fit import (
    Slopes,
    fit_staircases,
)
from rigtool.experiments.torque_constant.staircases.model import (
    COPPER_COEFFICIENT,
    SAME_TEMPERATURE,
)
from rigtool.experiments.torque_constant.staircases.plateaus import (
    Linearity,
    Plateaus,
    amplifier_linearity,
)
from rigtool.numerics.angle_effects import fit_angle_effects
from rigtool.numerics.arrays import Array
from rigtool.numerics.turn_mean import group_angles
from rigtool.quantity import (
    CURRENT_READING,
    REFERENCE_DEGC,
    THERMOMETER,
    Component,
    Quantity,
    combined,
    error_line,
    input_line,
)

PATH_U, TREND_U = 0.2, 0.06
"""What no law of one exponent shows, since friction changes the path that it follows: standard
uncertainty of a slope, times the squared part that friction takes of it, and of the change of that
part with temperature, relative. Beyond what the other lines of the budget explain, slopes of 89
drawn rigs scatter by 0.14 (0.10 to 0.18) of that, maximum likelihood, with eight times the usual
friction by 0.16 (0.12 to 0.21); changes of 61 rigs by none (0 to 0.03, at most 0.06 at 95 %)."""

MODEL_OF_FRICTION = "model of friction"
"""Name of the line of a budget that has it."""

LINEARITY = "gauge linearity"
"""Name of the line of a budget that has it: it does not cancel where two torques are compared."""

LINEARITY_LIMIT = 5e-3
"""Largest deviation of the amplifier from a straight line, relative to the span."""

FEW_ANGLES = 8
"""Rotor angles below which the constant may hide ripple that they do not show."""

LARGEST_GAIN = 10.0
"""Measured current for 1 A of set point beyond that of any amplifier; its inverse is below."""

HIDDEN_RIPPLE = 5e-3
"""Relative standard uncertainty by ripple of orders that fewer angles than these do not show, where
the orders that they show would state less: nothing in the data bounds it."""


@dataclass(frozen=True)
class Calibration:
    """Torque constant of the motor, and linearity of the amplifier.

    `torque_constant` holds at 20 degC and `coefficient` is its relative change a kelvin, both None
    where only one temperature was measured; `mean` holds over the reference range (or at the only
    temperature), `constant_error` is the largest relative error of its use over the range.
    `temperature` (k,) in degC, `value` and `u` (k,) in N m/A with its `dof` are the points of
    Fig. 20.
    `ripple` is the relative standard deviation of the constant over the rotor angles, None for
    fewer than three and without uncertainty for fewer than `RIPPLE_ANGLES`: a torque read at one
    angle is uncertain by it; `first_ripple` is that where the current is small.
    `components` are relative standard uncertainties of `mean` by source;
    `rotor_angles` counts the angles of the arm (0 where unknown).
    """

    torque_constant: Quantity | None
    coefficient: Quantity | None
    mean: Quantity
    constant_error: Quantity | None
    ripple: Quantity | None
    first_ripple: Quantity | None
    temperature: Array
    value: Array
    u: Array
    dof: Array
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
    gauge_linearity: float = 0.0,
    thermometer_u: float = 0.0,
    current_reading_relative_u: float = 0.0,
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

    def relative(u: float, dof: float | None = None) -> Quantity:
        return Quantity(1.0, "1", u, dof)

    # orders that are multiples of the number of angles, beyond `turn`
    few = 2 <= fit.angles < FEW_ANGLES
    hidden = math.sqrt(max(HIDDEN_RIPPLE**2 - fit.turn**2, 0.0)) if few else 0.0
    common = {
        "arm length": Quantity(arm_length, "m", arm_length_u),
        "gauge calibration": relative(gauge_relative_u),
        "heat in the winding": relative(slopes.heating_u, slopes.heating_dof),
        "friction of the shaft": relative(slopes.friction_u, slopes.friction_dof),
        "ripple that few angles hide": relative(hidden),
        "cogging that equal angles hide": relative(fit.alias.constant if fit.alias else 0.0),
        MODEL_OF_FRICTION: relative(PATH_U * slopes.friction_share**2),
        "gauge resolution": relative(slopes.resolution_u),
        LINEARITY: relative(gauge_linearity / math.sqrt(3)),  # GUM 4.3.7
        CURRENT_READING: relative(current_reading_relative_u),
    }
    law = _Law(fit, common, thermometer_u)
    temperature, value, scatter = _points(slopes, fit)

    def point(k: float, own: float) -> Quantity:
        lines = [input_line(name, one, k / one.value) for name, one in common.items()]
        lines.append(Component(THERMOMETER, 0.0, "K", thermometer_u, None, -fit.slope))
        return combined(k, "N m/A", [error_line("scatter", own, "N m/A", slopes.dof), *lines])

    points = list(map(point, value.tolist(), scatter.tolist()))
    low, high = reference_range_degc
    middle = (low + high) / 2 if fit.slope_known else fit.temperature
    mean = law.at(middle)
    steeper = input_line(LINEARITY, common[LINEARITY], fit.ripple.value)
    ripple = combined(fit.ripple.value, "1", [*fit.ripple.budget, steeper])
    components = {name: (one.u or 0.0) / one.value for name, one in common.items()}
    components["scatter"] = fit.scatter
    components["ripple over rotor angles"] = fit.turn
    components[THERMOMETER] = abs(fit.slope) / fit.value * thermometer_u
    return Calibration(
        torque_constant=law.stated(law.at(REFERENCE_DEGC), "N m/A") if fit.slope_known else None,
        coefficient=law.stated(law.coefficient(), "1/K") if fit.slope_known else None,
        mean=law.stated(mean, "N m/A"),
        constant_error=law.constant_error(mean, (low, high)) if fit.slope_known else None,
        ripple=stated_ripple(ripple, fit.angles, fit.single, fit.alias),
        first_ripple=first_ripple(slopes) if fit.angles >= 3 else None,
        temperature=temperature,
        value=value,
        u=np.array([point.u for point in points]),
        dof=np.array([point.dof or math.inf for point in points]),
        components=components,
        rotor_angles=fit.angles,
        slopes=slopes,
        linearity=linearity,
    )


def _require_linear(linearity: Linearity) -> None:
    if not 1 / LARGEST_GAIN < abs(linearity.gain) < LARGEST_GAIN:
        raise InsufficientDataError(
            f"the amplifier shows {linearity.gain:.3g} A for 1 A of set point: it is off, or its "
            "current is not measured, or in another unit than the set point"
        )
    limit = LINEARITY_LIMIT * float(np.ptp(linearity.current_setpoint))
    if linearity.deviation > max(limit, 4 * linearity.deviation_u):
        raise InsufficientDataError(
            f"the amplifier deviates by {linearity.deviation:.3g} A from a straight line, limit "
            f"{limit:.3g} A: set point and current are not proportional, so no torque constant "
            "turns one into torque; repair the amplifier or lower current_max"
        )


@dataclass(frozen=True)
class _Fit:
    """k(T) = value + slope (T - temperature); gain of all points.

    Each uncertainty stands with its degrees of freedom. An error of the value changes the slope by
    `tilt` times it (ripple that the angles do not show scales both); `slope_u` is independent of
    it. `trend_u` is what the model of the staircases adds to that of the slope, `lag_u` what the
    winding's lag does.
    """

    temperature: float
    value: float
    value_u: tuple[float, float]
    slope: float
    slope_u: tuple[float, float]
    tilt: float  # 1/K
    trend_u: float
    lag_u: float
    slope_known: bool
    gain: Array  # (m,) r of each staircase
    scatter: float  # relative part of value_u from the scatter that the slopes state
    turn: float  # relative part of value_u from the ripple
    ripple: Quantity  # relative standard deviation of r over a turn
    alias: Alias | None
    single: float  # relative standard uncertainty of one staircase
    angles: int


def _fit_temperature(slopes: Slopes) -> _Fit:
    """Fit the model at the top of this module."""
    centre = float(np.average(slopes.temperature, weights=slopes.u**-2))
    rise = slopes.temperature - centre
    known = float(np.ptp(slopes.temperature)) > SAME_TEMPERATURE
    design = np.column_stack([np.ones(len(rise)), rise]) if known else np.ones((len(rise), 1))
    size = np.ones(len(rise))
    for _ in range(2):  # the ripple's size follows the slope by little
        found = fit_angle_effects(design, slopes.slope, slopes.u, slopes.rotor_angle, size=size)
        value, slope = float(found.parameters[0]), float(found.parameters[1]) if known else 0.0
        size = 1 + slope / value * rise
    covariance, tilt, slope_u = found.covariance, 0.0, (0.0, math.inf)
    if known:
        tilt = float(covariance[0, 1] / covariance[0, 0])
        rest = float(covariance[1, 1]) - tilt * float(covariance[0, 1])
        slope_u = math.sqrt(max(rest, 0.0)), float(found.dof[1])
    value_u = math.sqrt(covariance[0, 0])
    unknown = bool(np.all(np.isnan(slopes.rotor_angle)))
    carried = None if unknown else carried_by_arm(slopes)
    ripple = ripple_over_turn(found, value, slopes, carried)
    scatter = value_u if unknown else min(float(np.sum(slopes.u**-2)) ** -0.5, value_u)
    return _Fit(
        temperature=centre,
        value=value,
        value_u=(value_u, float(found.dof[0])),
        slope=slope,
        slope_u=slope_u,
        tilt=tilt,
        # An error from friction may be the same at all temperatures, or grow with the constant;
        # what passes for a loss by heat is taken off in proportion to the winding's resistance.
        trend_u=math.hypot(
            slopes.trend_u,
            slopes.heating_u * value / (1 / COPPER_COEFFICIENT + centre - REFERENCE_DEGC),
            slopes.friction_u * slope,
            TREND_U * slopes.friction_share * slope,
        ),
        lag_u=slopes.lag_u,
        slope_known=known,
        gain=1 + found.effect / value,
        scatter=scatter / value,
        turn=math.sqrt(value_u**2 - scatter**2) / value,
        ripple=ripple,
        alias=alias_of(ripple, found, value, slopes, carried),
        single=math.hypot(float(np.median(slopes.u)) / value, slopes.resolution_u),
        angles=0 if unknown else len(group_angles(slopes.rotor_angle)[0]),
    )


@dataclass(frozen=True)
class _Uncertain:
    """A number and its derivatives (n,) by the inputs of `_Law`."""

    value: float
    derivatives: Array

    def over(self, other: _Uncertain) -> _Uncertain:
        """Return the ratio of two numbers of the same inputs."""
        ratio = self.value / other.value
        return _Uncertain(ratio, (self.derivatives - ratio * other.derivatives) / other.value)


class _Law:
    """k(T) = g (k0 + b (T - T0)) with its derivatives by each input, all independent.

    The inputs are the factors of g, common to all points, k0, b and T0: a thermometer that is off
    by d shows T + d at the temperature T.
    """

    def __init__(self, fit: _Fit, common: dict[str, Quantity], thermometer_u: float) -> None:
        self._fit = fit
        self._inputs = common | {"staircases": Quantity(fit.value, "N m/A", *fit.value_u)}
        self._relative = np.array([1 / one.value for one in common.values()])
        # An error of the gauge that grows with the force grows with k: it adds k2, not k.
        self._of_slope = self._relative * [1 + (name == LINEARITY) for name in common]
        if fit.slope_known:
            self._inputs |= {
                "slope of the staircases": Quantity(fit.slope, "N m/(A K)", *fit.slope_u),
                "friction and resolution in the slope": Quantity(0.0, "N m/(A K)", fit.trend_u),
                "lag of the winding in the slope": Quantity(0.0, "N m/(A K)", fit.lag_u),
                THERMOMETER: Quantity(0.0, "K", thermometer_u),
            }

    def at(self, temperature: float) -> _Uncertain:
        """Return k at a temperature in degC, N m/A."""
        rise = temperature - self._fit.temperature if self._fit.slope_known else 0.0
        change = self._fit.slope * rise
        own = [1.0]
        if self._fit.slope_known:
            own = [1.0 + self._fit.tilt * rise, rise, rise, rise, self._fit.slope]
        common = self._fit.value * self._relative + change * self._of_slope
        return _Uncertain(self._fit.value + change, np.append(common, own))

    def coefficient(self) -> _Uncertain:
        """Return b / k(20 degC), 1/K; the factors that are common to all points cancel."""
        slope = np.append(self._fit.slope * self._of_slope, [self._fit.tilt, 1.0, 1.0, 1.0, 0.0])
        return _Uncertain(self._fit.slope, slope).over(self.at(REFERENCE_DEGC))

    def stated(self, found: _Uncertain, unit: str) -> Quantity:
        """Return a number with its budget."""
        each = zip(self._inputs.items(), found.derivatives.tolist(), strict=True)
        lines = [input_line(name, one, derivative) for (name, one), derivative in each if one.u]
        return combined(found.value, unit, lines)

    def constant_error(self, mean: _Uncertain, range_degc: tuple[float, float]) -> Quantity:
        """Return the largest relative error of one value, at an end of the range [7.1.1]."""
        ratios = [mean.over(self.at(end)) for end in range_degc]
        worst = max(ratios, key=lambda ratio: abs(ratio.value - 1))
        sign = 1 if worst.value >= 1 else -1
        error = _Uncertain(sign * (worst.value - 1), sign * worst.derivatives)
        return self.stated(error, "1")


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
