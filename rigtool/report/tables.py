"""Tables 8 and 9, and all results of a run; for the thesis's rig beside the published values."""

from __future__ import annotations

from dataclasses import replace

from rigtool.quantity import customary, format_number, format_quantity
from rigtool.report.formats import (
    NO_VALUE,
    Cell,
    ReportColumn,
    ReportTable,
    mean_cell,
    number_cell,
    records,
)
from rigtool.report.instrument_tables import instrument_tables
from rigtool.report.published import is_of_thesis, published_table, published_value
from rigtool.runfile import Run
from rigtool.runfile.summary import budget_shares

_FORCE_COLUMNS = (
    ReportColumn("applied_force", "Force", "mN", "N"),
    ReportColumn("applied_torque", "Applied", "mN m", "N m"),
    ReportColumn("mean_torque", "Mean", "mN m", "N m", uncertain=True),
    ReportColumn("mean_torque_published", "published", "mN m", "N m"),
    ReportColumn("std_torque", "S", "mN m", "N m"),
    ReportColumn("std_torque_published", "published", "mN m", "N m"),
    ReportColumn("error_torque", "Error", "mN m", "N m"),
    ReportColumn("error_torque_published", "published", "mN m", "N m"),
    ReportColumn("error_percent", "Error", "%", "%"),
    ReportColumn("error_percent_published", "published", "%", "%"),
)


UNCORRECTED_TABLE = "loads_uncorrected"
"""Table of the loads as the thesis reads them, in a run whose table `loads` is corrected."""


def force_tables(run: Run, label: str) -> list[ReportTable]:
    """Return Table 8 or 9 of a run of measure-force, and tables of its force over time.

    Where its loads are corrected, a table of three readings comes first (published, the thesis's
    way, corrected), then a table of each of the latter two.
    """
    over_time = instrument_tables(run, label)
    if "loads" not in run.tables:
        return over_time
    if UNCORRECTED_TABLE not in run.tables:
        found = [force_table(run, label)]
    else:
        found = [
            three_times(run, label),
            force_table(run, f"{label}, none", UNCORRECTED_TABLE),
            force_table(run, f"{label}, {correction_of(run)}"),
        ]
    return over_time + (found if is_of_thesis(run.rig) else [_as_own(table) for table in found])


def _as_own(table: ReportTable) -> ReportTable:
    """Return a table of another rig than the thesis's: without published columns and numbers."""
    none = {"applied_force"} if all(row[0] is NO_VALUE for row in table.rows) else set()
    own = [
        n
        for n, column in enumerate(table.columns)
        if "published" not in column.key and column.key not in none
    ]
    _, _, name = table.name.split("-", 2)
    return replace(
        table,
        name=f"loads-{name}",
        title=f"Measured against applied torque ({name})",
        columns=tuple(table.columns[n] for n in own),
        rows=tuple(tuple(row[n] for n in own) for row in table.rows),
        note=table.note.replace("; the thesis is silent", ""),
    )


def force_table(run: Run, label: str, table: str = "loads") -> ReportTable:
    """Return Table 8 (instrument) or Table 9 (pulley) from a run of measure-force.

    Each row is beside the published one of the same force and torque, where there is one.
    `label` distinguishes this run from others. Raises `RunFileError` where the run has no such
    table.
    """
    attachment = attachment_of(run) or "instrument"
    published = published_table(attachment)
    correction = "none" if table == UNCORRECTED_TABLE else correction_of(run)
    note = _FULL_NOTE if correction == "full" else _zero_note(run)
    if correction == "none" and attachment == "instrument":
        note = f"{note} {_LOAD_NOTE}".lstrip()
    rows = [
        _force_row(load, published.row(load["applied_force"], load["applied_torque"]))
        for load in records(run.table(table))
        if load["applied_torque"] != 0  # the thesis's tables have no cycles without load
    ]
    return ReportTable(
        name=f"table-{published.number}-{label.replace(', ', '-')}",
        title=f"Table {published.number}. {published.title} ({label})",
        columns=_FORCE_COLUMNS,
        rows=tuple(rows),
        note=note,
    )


def three_times(run: Run, label: str) -> ReportTable:
    """Return the loads three times: as published, without and with correction.

    Raises `RunFileError` where the run lacks either table.
    """
    published = published_table(attachment_of(run) or "instrument")
    correction = correction_of(run)
    ways = {"none": run.table(UNCORRECTED_TABLE), correction: run.table("loads")}
    common = ("applied_force", "applied_torque", "mean_torque_published", "error_percent_published")
    read = {"mean_torque": None, "std_torque": "S", "error_percent": "Error"}
    known = {column.key: column for column in _FORCE_COLUMNS}
    columns = [*map(known.__getitem__, common[:-1]), replace(known[common[-1]], title="Error")]
    columns += [
        replace(known[key], key=f"{key}_{way}", title=title or way)
        for way in ways
        for key, title in read.items()
    ]
    rows = []
    for loads in zip(*(records(table) for table in ways.values()), strict=True):
        force, torque = (loads[-1][name] for name in ("applied_force", "applied_torque"))
        if force > 0:
            stated = published.row(force, torque)
            cells = [dict(zip(known, _force_row(load, stated), strict=True)) for load in loads]
            shown = [own[key] for own in cells for key in read]
            rows.append((*(cells[-1][key] for key in common), *shown))
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
    compared = is_of_thesis(run.rig)
    rows = []
    for name, quantity in run.results.items():
        published = published_value(run.command, name, attachment) if compared else None
        shown, beside = customary(name, quantity), (NO_VALUE, NO_VALUE)
        if published is not None:  # in the unit in which the result is shown
            stated = replace(quantity, value=published.value, u=None, reason="published")
            text = f"{customary(name, stated, quantity.value).value:.4g}"
            beside = Cell(text, published.value), Cell(published.section, published.section)
        rows.append(
            (
                Cell(name, name),
                Cell(format_number(shown.value, shown.u), quantity.value, quantity.u),
                Cell("" if shown.unit == "1" else shown.unit, quantity.unit),
                *beside,
                Cell(quantity.reason or "", quantity.reason or ""),
            )
        )
    columns = (
        ReportColumn("result", "Result", numeric=False),
        ReportColumn("value", "Value", uncertain=True),
        ReportColumn("unit", "Unit", numeric=False),
        ReportColumn("published", "Published"),
        ReportColumn("section", "Thesis section", numeric=False),
        ReportColumn("reason", "No uncertainty because", numeric=False, wraps=True),
    )
    kept = [n for n, c in enumerate(columns) if compared or c.key not in ("published", "section")]
    return ReportTable(
        f"results-{label}",
        f"Results of {run.command} ({label})",
        tuple(columns[n] for n in kept),
        tuple(tuple(row[n] for n in kept) for row in rows),
    )


HEADLINE_RESULTS = {
    "calibrate-kt": "torque_constant_mean",
    "stribeck": "coulomb_friction",
    "identify-plant": "inertia",
    "suspension": "spring_constant",
    "measure-force": "mean_torque_load_",
}
"""Result of each command whose budget the report shows; of loads the one with the most force."""

_BUDGET_COLUMNS = (
    ReportColumn("component", "Component", numeric=False),
    ReportColumn("value", "Estimate"),
    ReportColumn("u", "u"),
    ReportColumn("unit", "Unit", numeric=False),
    ReportColumn("sensitivity", "Sensitivity"),
    ReportColumn("contribution", "Contribution"),
    ReportColumn("dof", "Degrees of freedom"),
    ReportColumn("share", "Share of the variance"),
)


def budget_tables(run: Run, label: str) -> list[ReportTable]:
    """Return the uncertainty budget of the run's headline result, where the run holds one."""
    start = HEADLINE_RESULTS.get(run.command)
    named = [name for name, q in run.results.items() if start and name.startswith(start)]
    found = [name for name in named if run.results[name].budget]
    if not found:
        return []
    name = found[-1] if run.command == "measure-force" else found[0]
    quantity = run.results[name]
    rows = []
    for line, share in budget_shares(quantity):
        numbers = (line.u, line.sensitivity, line.contribution)
        u, sensitivity, contribution = (number_cell(number, ".3g", 1) for number in numbers)
        rows.append(
            (
                Cell(line.name, line.name),
                Cell(f"{line.value:.5g}", line.value),
                u,
                Cell("" if line.unit == "1" else line.unit, line.unit),
                sensitivity,
                contribution,
                Cell("inf", None) if line.dof is None else number_cell(line.dof, ".3g", 1),
                Cell(f"{100 * share:.1f} %", share),
            )
        )
    dof = "inf" if quantity.dof is None else f"{quantity.dof:.3g}"
    return [
        ReportTable(
            f"budget-{label}",
            f"Uncertainty budget of {name} ({label})",
            _BUDGET_COLUMNS,
            tuple(rows),
            f"Together {format_quantity(quantity)}, {dof} degrees of freedom; contributions, "
            f"sensitivity times u, are in {quantity.unit} (JCGM 100, table H.1).",
        )
    ]


def attachment_of(run: Run) -> str | None:
    """Return the attachment of a run's recipe, None where the run holds no recipe."""
    return None if run.recipe is None else run.recipe.rig.attachment


def correction_of(run: Run) -> str:
    """Return the correction of a run's loads: none, load or full."""
    return "none" if run.recipe is None else run.recipe.measure_force.correction


_FULL_NOTE = (
    "Loads read from whole strokes, less the disturbance learned at known loads and the reading "
    "without load."
)


_LOAD_NOTE = (
    "Standard uncertainties, in brackets, leave out what a load does to the reading: friction that "
    "grows with it, and stretch. The error shows it; --correction full takes it off."
)


def _zero_note(run: Run) -> str:
    """Return whether the reading without load was subtracted; the thesis does not state it.

    Without a recipe, what the loads are."""
    if run.recipe is None:
        return run.table("loads").description.capitalize() + "."
    if "mean_torque_no_load" not in run.results:
        return ""
    zero = format_quantity(run.results["mean_torque_no_load"])
    if run.recipe.measure_force.zero:
        return f"The mean reading without load, {zero}, is subtracted; the thesis is silent."
    return f"The mean reading without load, {zero}, is not subtracted."


def _force_row(measured: dict[str, float], published: dict[str, float] | None) -> tuple[Cell, ...]:
    stated = published or {}
    return (
        number_cell(measured["applied_force"], ".4g"),
        number_cell(measured["applied_torque"], ".4g"),
        mean_cell(measured["mean_torque"], measured["mean_torque_u"]),
        number_cell(stated.get("mean_torque"), ".4g"),
        number_cell(measured["std_torque"], ".2f"),
        number_cell(stated.get("std_torque"), ".2f"),
        number_cell(measured["error_torque"], "+.2f"),
        number_cell(stated.get("error_torque"), "+.4g"),
        number_cell(measured["error_percent"], "+.1f", 1),
        number_cell(stated.get("error_percent"), "+.0f", 1),
    )
