"""The base of all models of a recipe: unknown keys are refused, values never change.

A description names the unit of its value, as a part of its own between commas; the unit has bounds.
They are wider than any bench of motor, encoder and amplifier, and find slips: mN m for N m, kelvin
for degC, millimetres for metres, an exponent too many.
"""

import re
from collections.abc import Iterator
from typing import Annotated, ClassVar

from pydantic import BaseModel, ConfigDict, Field, ValidationInfo, field_validator

from rigtool.quantity import HOTTEST_DEGC

UNIT_BOUNDS = {
    "N m s/rad": (1e-12, 1e3),
    "N m/rad": (1e-9, 1e9),
    "N m/A": (1e-4, 20.0),
    "N m/N": (1e-9, 10.0),
    "N m/s": (1e-9, 1e3),
    "N m": (1e-9, 1e3),
    "N/m": (1e-3, 1e9),
    "N": (1e-6, 1e4),
    "kg m2": (1e-12, 10.0),
    "kg": (1e-6, 1e4),
    "rad/s": (1e-4, 1e4),
    "rev/s": (1e-4, 1e3),
    "rad": (1e-9, 1e6),
    "deg": (0.0, 36e3),
    "degC": (0.0, HOTTEST_DEGC),
    "Hz": (1e-4, 1e6),
    "s": (1e-6, 86400.0),
    "m": (1e-9, 10.0),
    "A": (1e-9, 1e3),
    "Pa": (1e6, 1e13),
    "K/W": (1e-6, 1e6),
    "J/K": (1e-6, 1e6),
    "1/K": (1e-9, 0.1),
    "K": (1e-9, 100.0),
    "ohm": (1e-6, 1e6),
    "relative": (0.0, 100.0),
}
"""Smallest and largest magnitude by unit, beside zero.

A motor turns with at most 95,000 rpm; torque constants go from coreless motors of a gram to direct
drives."""

_UNIT = re.compile(rf"(?:^|, )({'|'.join(map(re.escape, UNIT_BOUNDS))})(?=$|[ ,;])")


def unit_of(description: str | None) -> str | None:
    """Return the unit that a description names, None where there is none."""
    found = _UNIT.search(description or "")
    return found[1] if found else None


def _numbers(value: object) -> Iterator[float]:
    if isinstance(value, tuple):
        for part in value:
            yield from _numbers(part)
    elif isinstance(value, int | float) and not isinstance(value, bool):
        yield value


Positive = Annotated[float, Field(gt=0)]


class Section(BaseModel):
    """One table of a recipe; unknown keys are refused, values are physical and frozen."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

    LARGEST_COUNT: ClassVar[int] = 100_000
    """Of motions, samples, lines: more would never end."""

    @field_validator("*")
    @classmethod
    def _is_physical(cls, value: object, info: ValidationInfo) -> object:
        unit = unit_of(cls.model_fields[str(info.field_name)].description)
        for number in _numbers(value):
            if isinstance(number, int) and abs(number) > cls.LARGEST_COUNT:
                raise ValueError(f"must be at most {cls.LARGEST_COUNT}")
            if unit is None or number == 0:
                continue
            low, high = UNIT_BOUNDS[unit]
            if not low <= abs(number) <= high:
                raise ValueError(f"must be from {low:g} to {high:g} {unit}, got {number:g}")
        return value
