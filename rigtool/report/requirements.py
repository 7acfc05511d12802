"""Requirements of a recipe, and whether the runs meet them.

A figure meets a limit where the whole interval of its expanded uncertainty (k = 2) does, and misses
it where the whole interval does; otherwise the runs do not decide (ISO 14253-1).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from rigtool.quantity import format_number
from rigtool.report.formats import NO_VALUE, Cell, ReportColumn, ReportTable
from rigtool.runfile import Run

COVERAGE_FACTOR = 2.0

MET, MISSED, UNDECIDED = "met", "missed", "not decided: within the uncertainty"
NOT_SHOWN = "no run shows it"


@dataclass(frozen=True)
class Shown:
    """What one run shows of a requirement: a figure, its standard uncertainty, how it was found."""

    value: float
    u: float
    how: str


@dataclass(frozen=True)
class _Requirement:
    """One requirement: its words, unit and the factor to it, which run shows it and how."""

    words: str
    unit: str
    factor: float
    shown_by: Callable[[Run], Shown | None]
    at_least: bool = False


_COLUMNS = (
    ReportColumn("requirement", "Required", numeric=False, wraps=True),
    ReportColumn("limit", "Limit"),
    ReportColumn("value", "Measured", uncertain=True),
    ReportColumn("unit", "Unit", numeric=False),
    ReportColumn("verdict", "Verdict", numeric=False, wraps=True),
    ReportColumn("shown", "Shown by", numeric=False, wraps=True),
)


def requirements_table(labelled: Sequence[tuple[str, Run]]) -> ReportTable | None:
    """Return each requirement of the runs' recipes beside what the runs show; None without any."""
    limits: dict[str, float] = {}
    for _, run in labelled:
        required = None if run.recipe is None else run.recipe.requirements
        for name in _REQUIREMENTS:
            limit = getattr(required, name, None)
            if limit is not None:
                limits.setdefault(name, limit)
    rows = [row for name, limit in limits.items() for row in _rows(name, limit, labelled)]
    if not rows:
        return None
    note = "A verdict holds with twice the standard uncertainty."
    return ReportTable("requirements", "Requirements of the recipe", _COLUMNS, tuple(rows), note)


def verdict(shown: Shown, limit: float, *, at_least: bool) -> str:
    """Return whether a figure keeps a limit, with its expanded uncertainty."""
    margin = (shown.value - limit) if at_least else (limit - shown.value)
    if margin >= COVERAGE_FACTOR * shown.u:
        return MET
    return MISSED if margin < -COVERAGE_FACTOR * shown.u else UNDECIDED


def _rows(
    name: str, limit: float, labelled: Sequence[tuple[str, Run]]
) -> Iterator[tuple[Cell, ...]]:
    own = _REQUIREMENTS[name]
    bound = "at least" if own.at_least else "at most"
    head = Cell(own.words, name), Cell(f"{bound} {limit * own.factor:g}", limit)
    unit = Cell(own.unit, own.unit)
    found = [(label, shown) for label, run in labelled if (shown := own.shown_by(run))]
    for label, shown in found:
        text = format_number(shown.value * own.factor, shown.u * own.factor)
        found_to_be = verdict(shown, limit, at_least=own.at_least)
        yield (
            *head,
            Cell(text, shown.value, shown.u),
            unit,
            Cell(found_to_be, found_to_be),
            Cell(f"{label}: {shown.how}", label),
        )
    if not found:
        yield (*head, NO_VALUE, unit, Cell(NOT_SHOWN, NOT_SHOWN), NO_VALUE)


def _force_error(run: Run) -> Shown | None:
    if run.command != "measure-force" or "loads" not in run.tables:
        return None
    table = run.table("loads")
    applied, force = table["applied_torque"], table["applied_force"]
    with np.errstate(divide="ignore", invalid="ignore"):
        error = np.where(applied != 0, np.abs(table["error_torque"] / applied), np.nan)
    if not np.isfinite(error).any():
        return None
    worst = int(np.nanargmax(error))
    u = float(table["mean_torque_u"][worst] / abs(applied[worst]))
    return Shown(float(error[worst]), u, f"the load of {force[worst]:.4g} N")


def _force_resolution(run: Run) -> Shown | None:
    single = run.results.get("std_torque_no_load")
    if run.command != "measure-force" or single is None or run.recipe is None:
        return None
    lever = run.recipe.rig.load_arm
    u = 0.0 if single.u is None else single.u
    how = f"{COVERAGE_FACTOR:g} standard deviations of single readings without load"
    return Shown(COVERAGE_FACTOR * single.value / lever, COVERAGE_FACTOR * u / lever, how)


def _force_bandwidth(run: Run) -> Shown | None:
    if run.command != "measure-force" or run.recipe is None:
        return None
    measured = run.results.get("bandwidth")
    if measured is not None and measured.u is not None:
        return Shown(measured.value, measured.u, "amplitude against the reference within 5 %")
    if "loads" in run.tables:
        own = run.recipe.measure_force.lowpass_hz
        return Shown(own, 0.0, "low-pass of the readings of known loads")
    return None


def _residual_torque(run: Run) -> Shown | None:
    left = run.results.get("residual_rms")
    if run.command != "ilc-learn" or left is None or not math.isfinite(left.value):
        return None
    return Shown(left.value, 0.0 if left.u is None else left.u, "table on, all learned speeds")


_REQUIREMENTS = {
    "force_error": _Requirement("error of a known load, largest", "%", 100.0, _force_error),
    "force_resolution": _Requirement(
        "force that one reading distinguishes from none", "mN", 1e3, _force_resolution
    ),
    "force_bandwidth_hz": _Requirement(
        "bandwidth of the force", "Hz", 1.0, _force_bandwidth, at_least=True
    ),
    "residual_torque": _Requirement("remaining disturbance, rms", "mN m", 1e3, _residual_torque),
}
"""By their names in a recipe."""
