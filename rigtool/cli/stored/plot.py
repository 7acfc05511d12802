"""`rigtool plot`: a table, a signal or a figure of a run, as a picture."""

from __future__ import annotations

import click

from rigtool.cli.options import (
    FILE_ARGUMENT,
    command_with,
    completed,
    current_output,
    output_option,
)


def _names(path: str) -> list[str]:
    from rigtool.report.default_plot import plot_names
    from rigtool.runfile import open_run

    with open_run(path) as run:
        return plot_names(run)


@command_with(
    "rigtool plot friction.h5",
    "rigtool plot friction.h5 torque_speed -o curve.pdf",
    "rigtool plot friction.h5 recordings/holds/encoder -o encoder.png",
    "rigtool plot friction.h5 figure-30",
)
@click.argument("path", type=FILE_ARGUMENT, metavar="RUN.h5")
@click.argument("name", required=False, shell_complete=completed(_names))
@output_option("FILE", "Picture to write: .png, .svg or .pdf.  [default: RUN-NAME.svg]")
def command(path: str, name: str | None, output: str | None) -> None:
    """Draw a table, a signal or a figure of a run.

    NAME is a table, a recording or one of its signals, or a figure of the report (figure-30);
    without it, the first table is drawn. For an unknown NAME, the message lists tables and figures
    of the run.
    """
    from pathlib import Path

    from rigtool.report.default_plot import write_plot
    from rigtool.report.figures.style import import_undocumented
    from rigtool.runfile import open_run

    to = current_output()
    with open_run(path) as run:
        stem = "-".join([Path(path).stem, *(name or "plot").split("/")])
        output = output or f"{stem}.svg"
        import_undocumented()
        shown = write_plot(run, output, name, overwrite=to.overwrite)
        to.written(output, f"plot of {shown}")
        to.document(rig=run.rig, output=output, shown=shown)
