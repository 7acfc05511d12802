"""A physical quantity: value, unit, standard uncertainty and degrees of freedom.

Units are written as in the SI brochure with a space between factors ("N m s/rad"); files hold SI
values, and `format_quantity` shows them in customary multiples ("mN m").
Notation of uncertainty: GUM (JCGM 100:2008) 7.2.2, the short form 45.80(4).
"""

from __future__ import annotations

import math
import re
import sys
from collections.abc import Iterable
from dataclasses import dataclass, replace

from rigtool.errors import NO_RESULT_REMEDY, InsufficientDataError

REFERENCE_DEGC = 20.0
"""Temperature for which a result is stated, degC (ISO 1), a torque constant as well [7.1.1]."""

HOTTEST_DEGC = 250.0
"""Temperature that no motor has, degC: magnets and insulation end below it, kelvin are above it."""

STANDARD_GRAVITY = 9.80665
"""Standard acceleration of free fall, m/s2, exact (3rd CGPM, 1901)."""

CURRENT_READING, THERMOMETER = "gain of the current reading", "thermometer"
"""Lines of a budget that cancel where the same instrument is read again."""


@dataclass(frozen=True)
class Quantity:
    """A value with its unit and standard uncertainty (GUM 2.3.1).

    `u` is None where no uncertainty can be stated; `reason` then gives the reason. `dof` is None
    where the degrees of freedom are unknown or infinite. `budget` lists what `u` is made of, where
    that is known. Raises `ValueError` for neither `u` nor `reason`, and for a negative `u`.
    """

    value: float
    unit: str
    u: float | None = None
    dof: float | None = None
    reason: str | None = None
    budget: tuple[Component, ...] = ()

    def __post_init__(self) -> None:
        if self.u is None and self.reason is None:
            raise ValueError(
                f"a quantity of {self.value} {self.unit} has no standard uncertainty: "
                "give u, or the reason for having none"
            )
        if self.u is not None and not self.u >= 0:
            raise ValueError(f"standard uncertainty must not be negative, got {self.u}")

    def __str__(self) -> str:
        return format_quantity(self)


@dataclass(frozen=True)
class Component:
    """A line of an uncertainty budget (GUM 5.1.3, table H.1): an input and what it contributes.

    `value` in `unit` with the standard uncertainty `u` and its `dof` is the input's estimate;
    `sensitivity` is the derivative of the result by it. An error that is corrected for, or that is
    zero on average, has the value 0.
    """

    name: str
    value: float
    unit: str
    u: float
    dof: float | None = None
    sensitivity: float = 1.0

    @property
    def contribution(self) -> float:
        """Standard uncertainty of the result by this input alone, in the result's unit."""
        return abs(self.sensitivity) * self.u


ROUNDING_PART = 1e-9
"""Part of an uncertainty below which a contribution is the rounding of a sum that cancels."""


def error_line(name: str, u: float, unit: str, dof: float | None = None) -> Component:
    """Return the line of an error that is zero on average, in the unit of the result."""
    return Component(name, 0.0, unit, u, _finite(dof))


def scattered(
    value: float, unit: str, u: float, dof: float | None = None, name: str = "scatter"
) -> Quantity:
    """Return a value whose uncertainty has a single line."""
    line = error_line(name, u, unit, dof)
    return Quantity(value, unit, u, line.dof, budget=(line,))


def input_line(name: str, source: Quantity, sensitivity: float) -> Component:
    """Return the line of an input that is a quantity itself."""
    u, dof = source.u or 0.0, _finite(source.dof)
    return Component(name, source.value, source.unit, u, dof, sensitivity)


def _finite(dof: float | None) -> float | None:
    return dof if dof is not None and math.isfinite(dof) else None


def inherited(source: Quantity, sensitivity: float, name: str) -> list[Component]:
    """Return the lines of an input: those of its own budget, or a single one of this name."""
    if not source.budget:
        return [input_line(name, source, sensitivity)]
    return [replace(line, sensitivity=sensitivity * line.sensitivity) for line in source.budget]


def difference(first: Quantity, second: Quantity) -> Quantity:
    """Return first - second; an input that both budgets name is one and the same.

    Lines of one budget that have a name in common are independent of each other.
    """
    lines: list[Component] = []
    others = list(second.budget)
    for line in first.budget:
        same = next((one for one in others if one.name == line.name), None)
        if same is not None:
            others.remove(same)
            line = replace(same, sensitivity=line.sensitivity - same.sensitivity)
        lines.append(line)
    lines += [replace(line, sensitivity=-line.sensitivity) for line in others]
    return combined(first.value - second.value, first.unit, lines)


def combined(value: float, unit: str, lines: Iterable[Component]) -> Quantity:
    """Return a value with the uncertainty of independent inputs.

    The law of propagation, u2 = sum of (c u(x))2 (GUM 5.1.2); degrees of freedom by Welch and
    Satterthwaite, dof = u4 / sum of (c u(x))4/dof(x) (GUM G.4.1). Inputs that contribute nothing
    but the rounding of a derivative are left out. Raises `InsufficientDataError` for one that is
    NaN.
    """
    every = tuple(lines)
    u = math.hypot(*(line.contribution for line in every))
    if math.isnan(u):
        raise InsufficientDataError(f"{value:g} {unit} has no uncertainty: {NO_RESULT_REMEDY}")
    budget = tuple(line for line in every if line.contribution > ROUNDING_PART * u)
    spread = sum(line.contribution**4 / line.dof for line in budget if line.dof)
    return Quantity(value, unit, u, u**4 / spread if spread > 0 else None, budget=budget)


def scaled(quantity: Quantity, factor: float, unit: str) -> Quantity:
    """Return a quantity times a number that is known exactly."""
    u = None if quantity.u is None else quantity.u * abs(factor)
    budget = tuple(inherited(quantity, factor, "")) if quantity.budget else ()
    return Quantity(quantity.value * factor, unit, u, quantity.dof, quantity.reason, budget)


def without(quantity: Quantity, name: str) -> Quantity:
    """Return a quantity without one line of its budget: of an error that cancels."""
    if all(line.name != name for line in quantity.budget):
        return quantity
    rest = [line for line in quantity.budget if line.name != name]
    return combined(quantity.value, quantity.unit, rest)


_DISPLAY = {
    "N m": (1e3, "mN m"),
    "N m/A": (1e3, "mN m/A"),
    "1/K": (1e2, "%/K"),
    "kg m2": (1e7, "g cm2"),
    "rad": (180 / math.pi, "deg"),
}


_PREFIXED = ("A", "N", "m", "s")
"""Units that are shown with the prefix that suits a value."""

_RELATIVE = re.compile(
    "torque_constant_(constant_error|ripple(_small_current)?)|friction_asymmetry"
    "|model_distance|(error_)?reduction|removed|record_variance_removed|shape_difference"
    "|valid_share|(.*_)?coverage_95"
)
"""Names of results without a unit that are shown in percent."""

_GAIN = re.compile("gain_margin")
"""Names of results without a unit that are shown in decibels."""

FINEST = 1e-16
"""Part of a value that is finer than its digits, as an uncertainty of zero is."""


def display_unit(unit: str, size: float = 1.0) -> tuple[float, str]:
    """Return the factor and the unit in which values of an SI `unit`, of a `size`, are shown."""
    if unit in _PREFIXED and 0 < abs(size) < 0.1:
        return (1e3, f"m{unit}") if abs(size) >= 1e-4 else (1e6, f"µ{unit}")
    return _DISPLAY.get(unit, (1.0, unit))


def customary(name: str, quantity: Quantity, size: float | None = None) -> Quantity:
    """Return a result in the unit in which it is shown: a share in percent, a gain in dB.

    The prefix of a unit suits `size`, the value itself for None.

    >>> str(customary("torque_constant_ripple", Quantity(0.0125, "1", 0.0003)))
    '1.250(30) %'
    """
    value, u = quantity.value, quantity.u
    if quantity.unit == "1" and _GAIN.fullmatch(name) and value > 0:
        slope = 20 / math.log(10) / value
        shown, factor, unit = 20 * math.log10(value), slope, "dB"
    elif quantity.unit == "1" and _RELATIVE.fullmatch(name):
        shown, factor, unit = 100 * value, 100.0, "%"
    else:
        factor, unit = display_unit(quantity.unit, value if size is None else size)
        shown = value * factor
    return Quantity(shown, unit, None if u is None else u * factor, quantity.dof, quantity.reason)


def format_number(value: float, u: float | None) -> str:
    """Return a value with two digits of its uncertainty in the short form of the GUM.

    >>> format_number(45.8012, 0.0414)
    '45.801(41)'
    """
    if not math.isfinite(value):
        return str(value)
    if u is None or not math.isfinite(u) or u <= max(abs(value) * FINEST, sys.float_info.min):
        return f"{value:.4g}"
    power = math.floor(math.log10(max(abs(value), u)))
    if not -4 <= power <= 5:
        return f"{format_number(value / 10.0**power, u / 10.0**power)}e{power:d}"
    exponent = math.floor(math.log10(u))
    # Two digits of the uncertainty; 9.96 would round up to three, so look again after rounding.
    decimals = 1 - exponent
    if round(u * 10**decimals) >= 100:
        decimals -= 1
    if decimals <= 0:
        return f"{round(value, decimals):.0f}({round(u, decimals):.0f})"
    digits = round(u * 10**decimals)
    return f"{value:.{decimals}f}({digits:d})"


def format_quantity(quantity: Quantity, name: str = "") -> str:
    """Return a quantity as text in its display unit: '45.801(41) mN m/A'.

    `name` is that of a result, which may have a unit of its own.
    """
    shown = customary(name, quantity)
    number = format_number(shown.value, shown.u)
    return number if shown.unit in ("", "1") else f"{number} {shown.unit}"
