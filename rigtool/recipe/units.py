"""Units of files of other programs, and the ways in which they are written."""

from __future__ import annotations

import math
import re
import unicodedata
from collections.abc import Sequence

from rigtool.errors import did_you_mean
from rigtool.quantity import STANDARD_GRAVITY

RATED = "% of rated torque"
"""Unit of drives that report torque relative to the motor's rated torque."""

DATE = "date"
"""Unit of a column of dates or clock times as text; it is turned into seconds since the first."""

POUND, INCH = 0.45359237, 0.0254
"""International pound, kg, and inch, m."""

UNITS: dict[str, tuple[float, str]] = {
    "1": (1.0, "1"),
    "%": (1e-2, "1"),
    "s": (1.0, "s"),
    "ms": (1e-3, "s"),
    "us": (1e-6, "s"),
    "ns": (1e-9, "s"),
    "min": (60.0, "s"),
    "h": (3600.0, "s"),
    "day": (86400.0, "s"),
    DATE: (1.0, "s"),
    "count": (1.0, "count"),
    "count/s": (1.0, "count/s"),
    "rad": (1.0, "rad"),
    "mrad": (1e-3, "rad"),
    "deg": (math.pi / 180, "rad"),
    "rev": (2 * math.pi, "rad"),
    "rad/s": (1.0, "rad/s"),
    "deg/s": (math.pi / 180, "rad/s"),
    "rpm": (math.pi / 30, "rad/s"),
    "rev/s": (2 * math.pi, "rad/s"),
    "m": (1.0, "m"),
    "cm": (1e-2, "m"),
    "mm": (1e-3, "m"),
    "um": (1e-6, "m"),
    "in": (INCH, "m"),
    "m/s": (1.0, "m/s"),
    "cm/s": (1e-2, "m/s"),
    "mm/s": (1e-3, "m/s"),
    "m/min": (1 / 60, "m/s"),
    "A": (1.0, "A"),
    "mA": (1e-3, "A"),
    "uA": (1e-6, "A"),
    "V": (1.0, "V"),
    "mV": (1e-3, "V"),
    "N": (1.0, "N"),
    "mN": (1e-3, "N"),
    "kN": (1e3, "N"),
    "g": (1e-3 * STANDARD_GRAVITY, "N"),
    "kg": (STANDARD_GRAVITY, "N"),
    "lbf": (POUND * STANDARD_GRAVITY, "N"),
    "ozf": (POUND / 16 * STANDARD_GRAVITY, "N"),
    "N m": (1.0, "N m"),
    "mN m": (1e-3, "N m"),
    "uN m": (1e-6, "N m"),
    "N cm": (1e-2, "N m"),
    "N mm": (1e-3, "N m"),
    "g cm": (1e-5 * STANDARD_GRAVITY, "N m"),
    "kg cm": (1e-2 * STANDARD_GRAVITY, "N m"),
    "oz in": (POUND / 16 * STANDARD_GRAVITY * INCH, "N m"),
    "lbf in": (POUND * STANDARD_GRAVITY * INCH, "N m"),
    "lbf ft": (12 * POUND * STANDARD_GRAVITY * INCH, "N m"),
    "degC": (1.0, "degC"),
    "degF": (5 / 9, "degC"),
    "K": (1.0, "degC"),
}
"""Units that files may have: factor and SI unit. A mass is the weight that it has."""

ZEROS = {"degF": -32 * 5 / 9, "K": -273.15}
"""What 0 of a unit is in its SI unit, where that is not 0."""

SPELLINGS = {
    "s": ("sec", "second", "seconds"),
    "ms": ("msec", "millisecond", "milliseconds"),
    "us": ("usec",),
    "h": ("hour", "hours"),
    "min": ("minutes",),
    "day": ("d", "days"),
    "deg": ("°", "degree", "degrees"),
    "rev": ("turn", "turns", "revolutions"),
    "count": ("counts", "inc", "qc", "ticks", "tick", "cnt", "pulses"),
    "count/s": ("counts/s", "inc/s", "qc/s", "ticks/s", "cnt/s"),
    "rpm": ("1/min", "u/min", "r/min", "rev/min", "min-1", "min^-1"),
    "deg/s": ("°/s", "dps"),
    "rev/s": ("rps",),
    "m/s": ("m s-1",),
    "A": ("amp", "amps", "ampere", "amperes"),
    "V": ("volt", "volts"),
    "%": ("percent",),
    "1": ("-", "none", "ratio"),
    "degC": ("°c", "celsius"),
    "degF": ("°f", "fahrenheit"),
    "K": ("kelvin",),
    "g": ("gf",),
    "kg": ("kgf", "kp"),
    "g cm": ("gf cm",),
    "kg cm": ("kgf cm",),
    "oz in": ("ozf in", "in oz"),
    "lbf in": ("lb in", "in lbf", "in lb"),
    "lbf ft": ("lb ft", "ft lbf", "ft lb"),
    "lbf": ("lb",),
    "ozf": ("oz",),
    "in": ("inch", "inches"),
}
"""Other ways to write a unit, in lower case."""

_OTHERS = {other: name for name, others in SPELLINGS.items() for other in others}
_JOINED = {name.replace(" ", ""): name for name in UNITS if " " in name}
_PRODUCT = re.compile(r"\s*[*.\u00b7\u22c5]\s*|\s+|(?<=[^\W\d])-(?=[^\W\d])")


def spelled(unit: str) -> dict[str, float]:
    """Return the factors of all units whose SI unit this is, by their spellings in lower case."""
    return {
        spelling.lower(): factor
        for name, (factor, si) in UNITS.items()
        if si == unit
        for spelling in (name, *SPELLINGS.get(name, ()))
    }


def unit_name(text: str) -> str:
    """Return the name in `UNITS` of a unit as people write it: Nm, °C, µA, 1/min.

    What is known in no spelling comes back as it is.
    """
    if text in UNITS or text == RATED:
        return text
    # NFKC makes one letter of the two mu.
    plain = unicodedata.normalize("NFKC", text.strip("[]() ")).replace("\u03bc", "u")
    plain = _PRODUCT.sub(" ", plain).strip()
    if plain in UNITS:
        return plain
    return _JOINED.get(plain) or _OTHERS.get(plain.lower()) or _by_case(plain) or text


def _by_case(plain: str) -> str | None:
    """Return the only unit that differs by capital letters, of which M is also mega."""
    if len(plain) < 2:
        return None
    same = [name for name in UNITS if name.lower() == plain.lower() and plain[0] != "M"]
    return same[0] if len(same) == 1 else None


def require_unit(unit: str, more: Sequence[str] = ()) -> str:
    """Return the name of a unit that is in `UNITS` or among `more`; raise ValueError."""
    found = unit_name(unit)
    if found not in (*UNITS, *more):
        near = did_you_mean(found, UNITS, f"known are {', '.join([*UNITS, *more])}")
        raise ValueError(f"is no known unit, got {unit!r}: {near}")
    return found
