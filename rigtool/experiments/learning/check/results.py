"""Results of `ilc-learn --check` on a table's health: numbers, waveforms, and words."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from rigtool.experiments.learning.check.imported import FITS_RESULT as FITS
from rigtool.experiments.learning.check.table_health import HealthChange, ParityPart, TableHealth
from rigtool.experiments.learning.learned_table import LearnedTable
from rigtool.experiments.learning.rows import Row
from rigtool.experiments.outcome import Outcome
from rigtool.numerics.arrays import Array
from rigtool.quantity import Quantity, scattered
from rigtool.runfile import Column, Table, dof_column

NO_PATTERN = "the table holds no pattern above its noise"
BOUND_DESCRIPTION = "the part above the scatter of the mean; compare with non_repeatable_rms"


def outcome_of(
    found: TableHealth,
    parts: Sequence[ParityPart],
    rows: Sequence[Row],
    position: Array,
    learned: LearnedTable,
    counts: int,
) -> Outcome:
    """Return the outcome of a check; the first note is the verdict."""
    dof = float(min(len(part.moves) for part in parts) - 1)
    results = _results(found, counts, dof)
    tables = {"table_health": _by_speed(rows, position, learned)}
    tables["health_waveforms"] = _waveforms(rows, position, learned)
    notes = [table_verdict(found, counts)]
    notes += ["the table was off while recording; positive shift: the pattern is at larger angles"]
    if found.friction is None:
        notes.append("one direction alone: friction and offset cannot be separated")
    return Outcome(results, tables, tuple(notes))


def _results(found: TableHealth, counts: int, dof: float) -> dict[str, Quantity]:
    def quantity(estimate: HealthChange | None, unit: str, factor: float = 1.0) -> Quantity:
        if estimate is None:
            return Quantity(math.nan, unit, reason=NO_PATTERN)
        return scattered(estimate.value * factor, unit, estimate.u * factor, dof)

    per_count = counts / (2 * math.pi)
    results = {
        FITS: Quantity(float(found.fits), "1", reason="a verdict: 1 it fits, 0 it does not"),
        "table_shift": quantity(found.shift, "rad"),
        "table_shift_counts": quantity(found.shift, "count", per_count),
        "table_scale": quantity(found.scale, "1"),
        "offset_change": quantity(found.offset, "N m"),
        "shape_difference": quantity(found.unexplained, "1"),
        "mismatch_rms": Quantity(found.mismatch, "N m", reason=BOUND_DESCRIPTION),
        "pattern_mismatch_rms": Quantity(found.shape, "N m", reason=BOUND_DESCRIPTION),
        "shifted_mismatch_rms": Quantity(found.shifted, "N m", reason=BOUND_DESCRIPTION),
        "non_repeatable_rms": scattered(found.limit, "N m", found.limit / math.sqrt(2 * dof), dof),
    }
    if found.friction is not None:
        results["friction_change"] = quantity(found.friction, "N m")
    return results


def table_verdict(found: TableHealth, counts: int) -> str:
    """State in words whether the table fits, its changes, and whether a shift would correct it."""
    limit = f"a single move scatters by {found.limit * 1e3:.2g} mN m rms"
    off = f"the table is off by {found.mismatch * 1e3:.2g} mN m rms"
    if found.fits:
        return f"the table fits: {limit}, {off} beyond the scatter"
    changes = [*_pattern(found, counts), *_means(found)]
    changed = "; ".join(changes) or "several parts changed slightly"
    remedy = ""
    if not found.shift_is_enough:
        remedy = "; a shift is not enough: learn again"
    elif found.friction_changed or found.offset_changed:
        remedy = "; a shift alone is not enough: learn again"
    return f"the table does not fit, {off} while {limit}: {changed}{remedy}"


def _pattern(found: TableHealth, counts: int) -> list[str]:
    """State how the pattern changed; nothing where it still fits."""
    if found.pattern_fits:
        return []
    if found.scale_is_enough and found.scale is not None:
        return [f"the pattern is at the same position, {found.scale.value:.3g} times as large"]
    if found.shift_is_enough and found.shift is not None:
        return [_shifted(found.shift, found.shifted, counts)]
    if found.even >= found.odd:
        what = "the part independent of direction has another shape, as after a power cycle"
        what += " of the amplifier"
    else:
        what = "friction by position has another shape"
    if not found.whole_turn and found.shift is not None:
        what += (
            f" (or it is shifted by {math.degrees(found.shift.value):.3g} deg, or by more than "
            f"{math.degrees(found.reach):.3g}: a part of the turn does not show which)"
        )
    return [f"{what}; shift and scale leave {100 * found.unexplained.value:.0f} % of its variance"]


def _shifted(shift: HealthChange, left: float, counts: int) -> str:
    degrees, u = math.degrees(shift.value), math.degrees(shift.u)
    steps, steps_u = (x * counts / (2 * math.pi) for x in (shift.value, shift.u))
    rest = f"{left * 1e3:.2g} mN m rms" if left > 0 else "nothing above the scatter"
    half = abs(abs(shift.value) - math.pi) <= max(3 * shift.u, 1e-2)
    return (
        f"it is the same pattern, shifted by {'half a turn, ' if half else ''}{degrees:.2f} +- "
        f"{u:.2f} deg ({steps:.0f} +- {steps_u:.0f} counts), as after another index; shifting the "
        f"table by that is enough, and leaves {rest}"
    )


def _means(found: TableHealth) -> list[str]:
    changes = []
    if found.friction_changed and found.friction is not None:
        change, u = found.friction.value * 1e3, found.friction.u * 1e3
        changes.append(f"friction has changed by {change:+.2g} +- {u:.1g} mN m")
    if found.offset_changed:
        change, u = found.offset.value * 1e3, found.offset.u * 1e3
        what = "both directions are" if found.friction is not None else "friction, or an offset, is"
        changes.append(f"{what} off by {change:+.2g} +- {u:.1g} mN m")
    return changes


def _by_speed(rows: Sequence[Row], position: Array, learned: LearnedTable) -> Table:
    off = [row.mean - _tabulated(row, position, learned) for row in rows]
    return Table(
        ("speed",),
        {
            "speed": Column([row.speed for row in rows], "rad/s", "of the motor shaft"),
            "mismatch_rms": Column([np.sqrt(np.mean(o**2)) for o in off], "N m", "now - table"),
            "mean_change": Column([o.mean() for o in off], "N m", "now - table"),
            "non_repeatable_rms": Column(
                [row.non_repeatable_rms for row in rows], "N m", "of a single move"
            ),
        },
        "mismatch_rms",
        "error of the table, scatter of the mean included",
    )


def _waveforms(rows: Sequence[Row], position: Array, learned: LearnedTable) -> Table:
    return Table(
        ("speed", "position"),
        {
            "speed": Column([row.speed for row in rows], "rad/s", "of the motor shaft"),
            "position": Column(position, "rad", "set point of the motor shaft"),
            "now": Column([row.mean for row in rows], "N m", "as it would be learned now"),
            "learned": Column(
                [_tabulated(row, position, learned) for row in rows], "N m", "by the table"
            ),
            "u": Column([row.u for row in rows], "N m", "standard uncertainty of now"),
            "dof": dof_column([row.dof for row in rows]),
        },
        "now",
        "disturbance now and as it was learned",
    )


def _tabulated(row: Row, position: Array, learned: LearnedTable) -> Array:
    return learned.table.evaluate(position, np.full(position.size, row.speed))
