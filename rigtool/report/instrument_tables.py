"""Tables of a real instrument, measured against a sensor: Table 8 of its own, and accuracy."""

from __future__ import annotations

import math
import tomllib
from functools import cache
from importlib.resources import files
from typing import TYPE_CHECKING, Any

from rigtool.quantity import format_number
from rigtool.report.formats import MISSING, NO_VALUE, Cell, Column, ReportTable

if TYPE_CHECKING:
    from rigtool.runfile import Run

_MILLI = 1e3

_LEVELS = (
    Column("strokes", "Strokes"),
    Column("applied_torque", "Applied (sensor)", "mN m", "N m"),
    Column("mean_torque", "Mean", "mN m", "N m", uncertain=True),
    Column("std_torque", "S", "mN m", "N m"),
    Column("error_torque", "Error", "mN m", "N m"),
    Column("error_percent", "Error", "%", "%"),
)

_ACCURACY = (
    Column("source", "From", numeric=False),
    Column("split", "Judged by", numeric=False),
    Column("bandwidth", "Bandwidth", "Hz", "Hz"),
    Column("rmse_closing", "RMSE closing", "mN m", "N m"),
    Column("rmse_opening", "opening", "mN m", "N m"),
    Column("rmse_moving", "all that moves", "mN m", "N m"),
    Column("coverage_95", "95 % intervals hold", "%", "1"),
)

_SPLITS = ("runs kept from learning", "random part of the samples")


def instrument_tables(run: Run, label: str) -> list[ReportTable]:
    """Return the tables of an imported run of measure-force that a sensor judged, else none."""
    found = []
    if "levels" in run.tables:
        found.append(_levels_table(run, label))
    if "accuracy" in run.tables:
        found.append(_accuracy_table(run, label))
    return found


def _levels_table(run: Run, label: str) -> ReportTable:
    levels = run.table("levels")
    rows = []
    for index in range(levels.shape[0]):
        row = {name: float(levels[name][index]) for name in levels.columns}
        mean, u = row["mean_torque"], row["mean_torque_u"]
        rows.append(
            (
                Cell(f"{row['strokes']:.0f}", row["strokes"]),
                _cell(row["applied_torque"], ".4g"),
                Cell(format_number(mean * _MILLI, u * _MILLI), mean, u),
                _cell(row["std_torque"], ".2f"),
                _cell(row["error_torque"], "+.2f"),
                _cell(row["error_percent"], "+.1f", 1),
            )
        )
    return ReportTable(
        name=f"table-levels-{label}",
        title=f"Torque of a real instrument against its sensor ({label})",
        columns=_LEVELS,
        rows=tuple(rows),
        note=levels.description.capitalize() + ".",
    )


def _accuracy_table(run: Run, label: str) -> ReportTable:
    accuracy = run.table("accuracy")
    rows = []
    for index in range(accuracy.shape[0]):
        row = {name: float(accuracy[name][index]) for name in accuracy.columns}
        rows.append(_accuracy_row("rigtool", row))
    rows += [_accuracy_row(row["source"], row) for row in _published(run.rig or "")]
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
        *(_cell(row.get(f"rmse_{kind}"), ".2f") for kind in ("closing", "opening", "moving")),
        _cell(row.get("coverage_95"), ".1f", 100),
    )


def _cell(value: float | None, form: str, factor: float = _MILLI) -> Cell:
    if value is None:
        return NO_VALUE
    if not math.isfinite(value):
        return Cell(MISSING, None)
    return Cell(format(value * factor, form), value)


def _published(rig: str) -> list[dict[str, Any]]:
    """Return what others reached on the data of a rig, by how its name begins."""
    rows: list[dict[str, Any]] = []
    for name, entry in _reference().items():
        if rig.startswith(name):
            rows += entry["rows"]
    return rows


@cache
def _reference() -> dict[str, Any]:
    text = files("rigtool.report").joinpath("published_instruments.toml").read_text("utf-8")
    return tomllib.loads(text)
