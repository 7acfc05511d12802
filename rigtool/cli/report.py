"""`rigtool report`: tables, figures and one page from run files."""

from __future__ import annotations

from contextlib import ExitStack
from typing import TYPE_CHECKING, Any

import click

from rigtool.cli.options import (
    debug_option,
    echo,
    example,
    json_option,
    overwrite_option,
    quiet_option,
)

if TYPE_CHECKING:
    from rigtool.report.build import Report
    from rigtool.report.formats import ReportTable


@click.command(epilog=example("rigtool report kt.h5 tables.h5 force.h5 -o report"))
@click.argument("paths", nargs=-1, required=True, metavar="RUN.h5...")
@click.option("-o", "--output", required=True, metavar="FOLDER", help="Folder to write.")
@click.option("--pdf", is_flag=True, help="Write report.pdf too (pip install rigtool[pdf]).")
@json_option
@quiet_option
@overwrite_option
@debug_option
def command(
    paths: tuple[str, ...], output: str, pdf: bool, as_json: bool, quiet: bool, overwrite: bool
) -> None:
    """Write tables, figures and one page from any run files.

    Writes Tables 8 and 9 beside the published ones (Markdown, CSV, LaTeX, text), those figures of
    the thesis that the runs can show (SVG, PNG), and index.html with everything in it. Also prints
    the tables.
    """
    from rigtool.report.build import build_report
    from rigtool.report.folder import require_free, terminal_text, write_report
    from rigtool.report.page import require_pdf
    from rigtool.runfile import open_run

    require_free(output, overwrite=overwrite, inputs=paths)
    if pdf:
        require_pdf()
    with ExitStack() as stack:
        runs = [stack.enter_context(open_run(path)) for path in paths]
        report = build_report(runs)
    write_report(report, output, overwrite=overwrite, pdf=pdf)
    if as_json:
        from rigtool.cli.printing import json_text

        echo(json_text(_document(report)))
        return
    if quiet:
        return
    if report.force_tables:
        echo(terminal_text(report), nl=False)
    for warning in report.warnings:
        echo(f"Warning: {warning}", err=True)
    echo(f"Written: {output}", err=True)


def _document(report: Report) -> dict[str, Any]:
    required = report.requirements
    return {
        "title": report.title,
        "requirements": None if required is None else _table(required),
        "tables": {table.name: _table(table) for table in report.force_tables},
        "results": {table.name: _table(table) for table in report.results},
        "figures": [picture.name for picture in report.pictures],
        "warnings": list(report.warnings),
        "remarks": {label: list(notes) for label, notes in report.remarks},
    }


def _table(table: ReportTable) -> dict[str, Any]:
    rows = []
    for cells in table.rows:
        row: dict[str, Any] = {}
        for column, cell in zip(table.columns, cells, strict=True):
            row[column.key] = cell.value
            if column.uncertain:
                row[f"{column.key}_u"] = cell.u
        rows.append(row)
    units = {column.key: column.si_unit for column in table.columns if column.si_unit}
    return {"title": table.title, "units": units, "rows": rows}
