"""Tables of force over time: where it is largest, and its accuracy against a sensor."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np

from rigtool.experiments.force_filter.accuracy import off_zero
from rigtool.report.formats import Cell, ReportColumn, ReportTable, mean_cell, number_cell
from rigtool.report.published import published_accuracy
from rigtool.runfile import Run
from rigtool.runfile.schema import IMPORT

_ACCURACY = (
    ReportColumn("source", "From", numeric=False),
    ReportColumn("split", "Judged by", numeric=False),
    ReportColumn("bandwidth", "Bandwidth", "Hz", "Hz"),
    ReportColumn("rmse_closing", "RMSE closing", "mN m", "N m"),
    ReportColumn("rmse_opening", "opening", "mN m", "N m"),
    ReportColumn("rmse_moving", "all that moves", "mN m", "N m"),
    ReportColumn("coverage_95", "95 % intervals hold", "%", "1"),
)

_OVER_TIME = (
    ReportColumn("time", "Time", "s", "s"),
    ReportColumn("torque", "Torque", "mN m", "N m", uncertain=True),
    ReportColumn("low", "from", "mN m", "N m"),
    ReportColumn("high", "to", "mN m", "N m"),
    ReportColumn("force", "Force", "N", "N"),
)

_JUDGED = tuple(column.key for column in _ACCURACY[2:])
"""Results that are compared with what others published."""

TIME_SECTIONS = 10
"""Sections of the time of a force over time that the table shows."""

_SPLITS = ("runs kept from learning", "random part of the samples")


def instrument_tables(run: Run, label: str) -> list[ReportTable]:
    """Return the tables of force over time.

    For an imported run that had a sensor this is its accuracy; without known loads, torque and
    force with their band.
    """
    if all(name in run.results for name in _JUDGED):
        return [_accuracy_table(run, label)]
    if "force" in run.tables and "loads" not in run.tables:
        return [_over_time_table(run, label)]
    return []


def _over_time_table(run: Run, label: str) -> ReportTable:
    """Return torque and force where the torque is surely largest, in each section of the time."""
    force = run.table("force")
    names = [name for name in (*(one.key for one in _OVER_TIME), "u") if name in force.columns]
    far, rows = off_zero(force["low"], force["high"]), []
    for section in np.array_split(np.arange(far.size), TIME_SECTIONS):
        if not np.isfinite(far[section]).any():
            continue
        row = {name: float(force[name][section[far[section].argmax()]]) for name in names}
        u, force_n = row.get("u", math.nan), row.get("force", math.nan)
        of_torque = _digits(1e3 * u)
        cells = {
            "time": number_cell(row["time"], ".2f", 1),
            "torque": mean_cell(row["torque"], u),
            "low": number_cell(row["low"], of_torque),
            "high": number_cell(row["high"], of_torque),
            "force": number_cell(force_n, _digits(u * abs(force_n / (row["torque"] or 1.0))), 1),
        }
        rows.append(tuple(cells[column.key] for column in _OVER_TIME))
    return ReportTable(
        name=f"table-over-time-{label}",
        title=f"Torque and force over time, where largest in each section ({label})",
        columns=_OVER_TIME,
        rows=tuple(rows),
        note="From and to are the ends of the 95 % interval of the torque. Each row is where it is "
        "farthest from zero.",
    )


def _digits(u: float) -> str:
    """Return the format of a number with two digits of its standard uncertainty."""
    return f".{max(0, 1 - math.floor(math.log10(u)))}f" if 0 < u < math.inf else ".4g"


def _accuracy_table(run: Run, label: str) -> ReportTable:
    own = {name: run.result(name).value for name in _JUDGED}
    inputs = run.provenance["inputs"]
    folders = {Path(one["path"]).parent.name for one in inputs if one["command"] == IMPORT}
    rows = [_accuracy_row("rigtool", {"split": 0, **own})]
    rows += [
        _accuracy_row(row["source"], row) for row in published_accuracy(run.rig or "", folders)
    ]
    return ReportTable(
        name=f"table-accuracy-{label}",
        title=f"Error against the sensor ({label})",
        columns=_ACCURACY,
        rows=tuple(rows),
        note="Closing and opening: strokes against and with the load, faster than 0.25 rad/s; the "
        "first and last second of each run are left out.",
    )


def _accuracy_row(source: str, row: dict[str, Any]) -> tuple[Cell, ...]:
    split = _SPLITS[int(row["split"])]
    return (
        Cell(source, source),
        Cell(split, split),
        Cell(f"{row['bandwidth']:g}", row["bandwidth"]),
        *(number_cell(row.get(f"rmse_{kind}"), ".2f") for kind in ("closing", "opening", "moving")),
        number_cell(row.get("coverage_95"), ".1f", 100),
    )
