"""Dates and clock times as text, in seconds since the first of them."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from datetime import date

import numpy as np

from rigtool.numerics.arrays import Array

DAY = 86400.0

CLOCK = re.compile(
    r"(?P<h>\d{1,2}):(?P<m>\d\d)(:(?P<s>\d\d)([.,:](?P<f>\d{1,9}))?)?\s*(?P<half>[AaPp]\.?[Mm]\.?)?"
    r"(?P<zone>[+-]\d\d:?\d\d)?"
)
DATE = re.compile(r"(\d{1,4})[-/.](\d{1,2})[-/.](\d{1,4})")
BASIC = re.compile(r"\b(\d{4})(\d\d)(\d\d)T(\d\d)(\d\d)(\d\d)")
"""A date and a clock time in the basic format of ISO 8601."""

MIDNIGHT_FALL = 0.5
"""Part of a day by which a clock without date falls at midnight."""


def is_date(text: str) -> bool:
    """Return whether a text holds a clock time."""
    return CLOCK.search(text) is not None or BASIC.search(text) is not None


def seconds_of(texts: Sequence[str]) -> Array:
    """Return seconds (n,) since the first text; NaN for a text that is no date or clock time.

    A date is year, month, day; or day.month.year; or month/day/year, where that is possible. The
    clock is that of the place, a change to summer time a gap, unless its difference to UTC stands
    behind it. Without a date, a fall of half a day is midnight.
    """
    texts = [BASIC.sub(r"\1-\2-\3 \4:\5:\6", text) for text in texts]
    days = np.array([_day(text) for text in texts])
    clocks = np.array([_clock(text) for text in texts])
    if np.isnan(days).all():
        known = np.where(np.isnan(clocks), 0.0, clocks)
        days = np.concatenate([[0.0], np.cumsum(np.diff(known) < -MIDNIGHT_FALL * DAY)])
    first = next(iter(days[np.isfinite(days)]), 0.0)
    found: Array = (days - first) * DAY + clocks  # differences of days are exact
    good = found[np.isfinite(found)]
    return found - good[0] if good.size else found


def _clock(text: str) -> float:
    """Return the seconds of a day, NaN where there is no clock time."""
    found = CLOCK.search(text)
    if found is None:
        return math.nan
    hours = int(found["h"])
    if found["half"]:
        hours = hours % 12 + 12 * (found["half"][0] in "Pp")
    rest = float(f"{found['s'] or 0}.{found['f'] or 0}")
    zone = (found["zone"] or "+0000").replace(":", "")
    east = int(f"{zone[0]}1") * (60 * int(zone[1:3]) + int(zone[3:]))
    return 3600.0 * hours + 60.0 * (int(found["m"]) - east) + rest


def _day(text: str) -> float:
    """Return the number of the day, NaN where there is no date."""
    found = DATE.search(text)
    if found is None:
        return math.nan
    first, second, third = (int(part) for part in found.groups())
    if len(found[1]) == 4:
        year, month, day = first, second, third
    elif "/" in found[0] and first <= 12:
        month, day, year = first, second, third
    else:
        day, month, year = first, second, third
    try:
        return float(date(year if year > 99 else 2000 + year, month, day).toordinal())
    except ValueError:
        return math.nan
