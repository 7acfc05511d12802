"""Tables 8 and 9, and every result of a run, beside what the thesis states."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from rigtool.quantity import Quantity, display_unit, format_number, format_quantity
from rigtool.report.formats import MISSING, NO_VALUE, Cell, Column, ReportTable
from rigtool.report.instrument_tables import instrument_tables
from rigtool.report.published import published_table, published_value

if TYPE_CHECKING:
    from rigtool.runfile import Run

_MILLI = 1e3

_FORCE_COLUMNS = (
    Column("applied_force", "Force", "mN", "N"),
    Column("applied_torque", "Applied", "mN m", "N m"),
    Column("mean_torque", "Mean", "mN m", "N m", uncertain=True),
    Column("mean_torque_published", "published", "mN m", "N m"),
    Column("std_torque", "S", "mN m", "N m"),
    Column("std_torque_published", "published", "mN m", "N m"),
    Column("error_torque", "Error", "mN m", "N m"),
    Column("error_torque_published", "published", "mN m", "N m"),
    Column("error_percent", "Error", "%", "%"),
    Column("error_percent_published", "published", "%", "%"),
)


UNCORRECTED = "loads_uncorrected"
"""Table of a run that holds the loads as the thesis reads them, where `loads` is corrected."""


def force_tables(run: Run, label: str) -> list[ReportTable]:
    """Return Table 8 or 9 of a run of measure-force, those of a sensor where it has no loads.

    Where its loads are corrected: what the thesis publishes, its way and the corrected one side by
    side, then each of the two by itself.
    """
    if "loads" not in run.tables:
        return instrument_tables(run, label)
    if UNCORRECTED not in run.tables:
        return [force_table(run, label)]
    return [
        three_times(run, label),
        force_table(run, f"{label}, none", UNCORRECTED),
        force_table(run, f"{label}, {correction_of(run)}"),
    ]


def force_table(run: Run, label: str, table: str = "loads") -> ReportTable:
    """Return Table 8 (instrument) or Table 9 (pulley) from a run of measure-force.

    Each loaded row stands beside the published one of the same force and torque, where there is
    one. `label` tells this run from others. Raises `RunFileError` where the run has no such table.
    """
    attachment = attachment_of(run) or "instrument"
    published = published_table(attachment)
    loads = run.table(table)
    rows = []
    for index, force in enumerate(loads["applied_force"]):
        if force <= 0:
            continue  # the unloaded cycles are not in the thesis's tables
        measured = {name: float(loads[name][index]) for name in loads.columns}
        row = published.row(measured["applied_force"], measured["applied_torque"])
        rows.append(_force_row(measured, row))
    return ReportTable(
        name=f"table-{published.number}-{label.replace(', ', '-')}",
        title=f"Table {published.number}. {published.title} ({label})",
        columns=_FORCE_COLUMNS,
        rows=tuple(rows),
        note=_zero_note(run) if table == UNCORRECTED or correction_of(run) != "full" else _FULL,
    )


def three_times(run: Run, label: str) -> ReportTable:
    """Return the loads three times: as published, without and with correction.

    Raises `RunFileError` where the run does not hold both.
    """
    published = published_table(attachment_of(run) or "instrument")
    correction = correction_of(run)
    ways = {"none": run.table(UNCORRECTED), correction: run.table("loads")}
    columns = [
        Column("applied_force", "Force", "mN", "N"),
        Column("applied_torque", "Applied", "mN m", "N m"),
        Column("mean_torque_published", "published", "mN m", "N m"),
        Column("error_percent_published", "Error", "%", "%"),
    ]
    for way in ways:
        columns += [
            Column(f"mean_torque_{way}", way, "mN m", "N m", uncertain=True),
            Column(f"std_torque_{way}", "S", "mN m", "N m"),
            Column(f"error_percent_{way}", "Error", "%", "%"),
        ]
    rows = []
    for index, force in enumerate(run.table("loads")["applied_force"]):
        if force <= 0:
            continue
        applied = float(run.table("loads")["applied_torque"][index])
        stated = published.row(float(force), applied) or {}
        cells = [_cell(float(force), ".4g"), _cell(applied, ".4g")]
        cells.append(_cell(stated.get("mean_torque", math.nan), ".4g"))
        cells.append(_cell(stated.get("error_percent", math.nan), "+.0f", 1))
        for loads in ways.values():
            mean, u, std, error = (
                float(loads[name][index])
                for name in ("mean_torque", "mean_torque_u", "std_torque", "error_percent")
            )
            cells += [_mean_cell(mean, u), _cell(std, ".2f"), _cell(error, "+.1f", 1)]
        rows.append(tuple(cells))
    return ReportTable(
        name=f"table-{published.number}-three-times-{label}",
        title=f"Table {published.number} three times: published, --correction none, "
        f"--correction {correction} ({label})",
        columns=tuple(columns),
        rows=tuple(rows),
    )


def results_table(run: Run, label: str) -> ReportTable:
    """Return all results of a run, with uncertainty, beside the published values."""
    attachment = attachment_of(run)
    rows = []
    for name, quantity in run.results.items():
        published = published_value(run.command, name, attachment)
        rows.append(
            (
                Cell(name, name),
                _quantity_cell(quantity),
                Cell(_unit(quantity.unit), quantity.unit),
                NO_VALUE if published is None else _published_cell(published.value, quantity.unit),
                NO_VALUE if published is None else Cell(published.section, published.section),
                Cell(quantity.reason or "", quantity.reason or ""),
            )
        )
    columns = (
        Column("result", "Result", numeric=False),
        Column("value", "Value", uncertain=True),
        Column("unit", "Unit", numeric=False),
        Column("published", "Published"),
        Column("section", "Section", numeric=False),
        Column("reason", "No uncertainty because", numeric=False, wraps=True),
    )
    return ReportTable(f"results-{label}", f"Results of {run.command} ({label})", columns, (*rows,))


def attachment_of(run: Run) -> str | None:
    """Return what the motor drove in this run, None where the run holds no recipe."""
    return None if run.recipe is None else run.recipe.rig.attachment


def correction_of(run: Run) -> str:
    """Return what was taken off the loads of a run: none, load or full."""
    return "none" if run.recipe is None else run.recipe.measure_force.correction


_FULL = (
    "Loads read from whole strokes, the disturbance learned at known loads and the cycles without "
    "load taken off."
)


def _zero_note(run: Run) -> str:
    """Say what was done about the reading without load: the thesis does not say what it did."""
    if run.recipe is None or "mean_torque_no_load" not in run.results:
        return ""
    zero = format_quantity(run.results["mean_torque_no_load"])
    if run.recipe.measure_force.zero:
        return f"The mean reading without load, {zero}, is taken off; the thesis does not say."
    return f"The mean reading without load, {zero}, is not taken off."


def _force_row(measured: dict[str, float], published: dict[str, float] | None) -> tuple[Cell, ...]:
    mean, u = measured["mean_torque"], measured["mean_torque_u"]
    ours = {
        "applied_force": _cell(measured["applied_force"], ".4g"),
        "applied_torque": _cell(measured["applied_torque"], ".4g"),
        "mean_torque": _mean_cell(mean, u),
        "std_torque": _cell(measured["std_torque"], ".2f"),
        "error_torque": _cell(measured["error_torque"], "+.2f"),
        "error_percent": _cell(measured["error_percent"], "+.1f", 1),
    }
    theirs = {"mean_torque": ".4g", "std_torque": ".2f", "error_torque": "+.4g"}
    cells = []
    for column in _FORCE_COLUMNS:
        name = column.key.removesuffix("_published")
        if name == column.key:
            cells.append(ours[name])
        elif published is None:
            cells.append(NO_VALUE)
        elif name == "error_percent":
            cells.append(_cell(published[name], "+.0f", 1))
        else:
            cells.append(_cell(published[name], theirs[name]))
    return tuple(cells)


def _cell(value: float, form: str, factor: float = _MILLI) -> Cell:
    if not math.isfinite(value):
        return Cell(MISSING, None)
    text = format(value * factor, form)
    return Cell(text.lstrip("+-") if float(text) == 0 else text, value)


def _mean_cell(mean: float, u: float) -> Cell:
    if not math.isfinite(mean):
        return NO_VALUE
    return Cell(format_number(mean * _MILLI, u * _MILLI), mean, u)


def _quantity_cell(quantity: Quantity) -> Cell:
    factor = display_unit(quantity.unit)[0]
    u = None if quantity.u is None else quantity.u * factor
    return Cell(format_number(quantity.value * factor, u), quantity.value, quantity.u)


def _published_cell(value: float, unit: str) -> Cell:
    return Cell(f"{value * display_unit(unit)[0]:.4g}", value)


def _unit(unit: str) -> str:
    shown = display_unit(unit)[1]
    return "" if shown == "1" else shown
