"""`rigtool report`: tables, figures and one page from run files."""

from __future__ import annotations

from contextlib import ExitStack
from typing import TYPE_CHECKING, Any

import click

from rigtool.cli.options import FILE_ARGUMENT, command_with, current_output, output_option
from rigtool.cli.output import table_document

if TYPE_CHECKING:
    from rigtool.report.build import Report


@command_with("rigtool report kt.h5 tables.h5 force.h5 -o report")
@click.argument("paths", nargs=-1, required=True, type=FILE_ARGUMENT, metavar="RUN.h5...")
@output_option("FOLDER", "Folder to write.", required=True)
@click.option("--pdf", is_flag=True, help="Write report.pdf too (pip install rigtool[pdf]).")
def command(paths: tuple[str, ...], output: str, pdf: bool) -> None:
    """Write tables, figures and one page from any run files.

    Writes Tables 8 and 9 beside the published ones (Markdown, CSV, LaTeX, text), those figures of
    the thesis that the runs can show (SVG, PNG), and index.html with everything in it. Also prints
    the tables.
    """
    from rigtool.report.build import build_report
    from rigtool.report.figures.style import import_undocumented
    from rigtool.report.folder import require_free, terminal_text, write_report
    from rigtool.report.page import require_pdf
    from rigtool.runfile import open_run

    to = current_output()
    require_free(output, overwrite=to.overwrite, inputs=paths)
    if pdf:
        require_pdf()
    with ExitStack() as stack:
        runs = [stack.enter_context(open_run(path)) for path in paths]
        import_undocumented()
        report = build_report(runs)
    write_report(report, output, overwrite=to.overwrite, pdf=pdf)
    count = len(report.pictures)
    to.written(output, f"report, index.html with {count} figure{'' if count == 1 else 's'}")
    to.document(**_document(report, output))
    if report.force_tables:
        to.line(terminal_text(report), nl=False)
    for warning in report.warnings:
        to.note(f"Warning: {warning}")


def _document(report: Report, output: str) -> dict[str, Any]:
    required = report.requirements
    return {
        "rig": ", ".join(report.rigs) or None,
        "output": output,
        "title": report.title,
        "requirements": None if required is None else table_document(required),
        "tables": {table.name: table_document(table) for table in report.force_tables},
        "results": {table.name: table_document(table) for table in report.results},
        "figures": [picture.name for picture in report.pictures],
        "warnings": list(report.warnings),
        "remarks": {label: list(notes) for label, notes in report.remarks},
    }
