"""A physical quantity: value, unit, standard uncertainty and degrees of freedom.

Units are written as in the SI brochure with a space between factors ("N m s/rad"); files hold SI
values, and `format_quantity` shows them in customary multiples ("mN m").
Notation of uncertainty: GUM (JCGM 100:2008) 7.2.2, the short form 45.80(4).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

REFERENCE_DEGC = 20.0
"""Temperature for which a result is stated, degC (ISO 1), a torque constant as well [7.1.1]."""


@dataclass(frozen=True)
class Quantity:
    """A value with its unit and standard uncertainty (GUM 2.3.1).

    `u` is None where no uncertainty can be stated; `reason` then gives the reason. `dof` is None
    where the degrees of freedom are unknown or infinite. Raises `ValueError` for neither `u` nor
    `reason`, and for a negative `u`.
    """

    value: float
    unit: str
    u: float | None = None
    dof: float | None = None
    reason: str | None = None

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


_DISPLAY = {
    "N m": (1e3, "mN m"),
    "N m/A": (1e3, "mN m/A"),
    "1/K": (1e2, "%/K"),
    "kg m2": (1e7, "g cm2"),
    "rad": (180 / math.pi, "deg"),
}


_PREFIXED = ("A", "N", "m", "s")
"""Units that are shown with the prefix that suits a value."""


def display_unit(unit: str, size: float = 1.0) -> tuple[float, str]:
    """Return the factor and the unit in which values of an SI `unit`, of a `size`, are shown."""
    if unit in _PREFIXED and 0 < abs(size) < 0.1:
        return (1e3, f"m{unit}") if abs(size) >= 1e-4 else (1e6, f"µ{unit}")
    return _DISPLAY.get(unit, (1.0, unit))


def format_number(value: float, u: float | None) -> str:
    """Return a value with two digits of its uncertainty in the short form of the GUM.

    >>> format_number(45.8012, 0.0414)
    '45.801(41)'
    """
    if not math.isfinite(value):
        return str(value)
    if u is None or not math.isfinite(u) or u == 0:
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


def format_quantity(quantity: Quantity) -> str:
    """Return a quantity as text in its display unit: '45.801(41) mN m/A'."""
    factor, unit = display_unit(quantity.unit, quantity.value)
    u = None if quantity.u is None else quantity.u * factor
    number = format_number(quantity.value * factor, u)
    return number if unit in ("", "1") else f"{number} {unit}"
