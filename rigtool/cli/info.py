"""`rigtool info`: a run file on one screen."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import click

from rigtool.cli.options import debug_option, echo, example, json_option

if TYPE_CHECKING:
    from rigtool.runfile import Recording


@click.command(
    epilog=example(
        "rigtool info kt.h5", "rigtool info kt.h5 --json", "rigtool info kt.h5 --plot kt.svg"
    )
)
@click.argument("path", metavar="RUN.h5")
@json_option
@click.option("--plot", metavar="FILE", help="Draw its default plot: .png, .svg or .pdf.")
@click.option("--overwrite", is_flag=True, help="Replace a plot that exists.")
@debug_option
def command(path: str, as_json: bool, plot: str | None, overwrite: bool) -> None:
    """Show the contents of a run file.

    Who made it, when and from what; results with units and uncertainty; recorded signals with
    rate and duration; tables and remarks.
    """
    from rigtool.cli.printing import to_json
    from rigtool.runfile import open_run

    with open_run(path) as run:
        if as_json:
            text = to_json(
                run.results,
                run.tables,
                run.provenance,
                run.notes,
                command=run.command,
                rig=run.rig,
                recordings={name: _recording(item) for name, item in run.recordings.items()},
            )
        else:
            text = "\n".join(run.summary())
        if plot is not None:
            from rigtool.report.default_plot import write_default_plot

            write_default_plot(run, plot, overwrite=overwrite)
    echo(text)


def _recording(recording: Recording) -> dict[str, Any]:
    return {
        "size": recording.size,
        "rate": recording.rate(),
        "duration": recording.duration(),
        "channels": recording.units,
        "conditions": {
            name: {"value": item.value, "unit": item.unit}
            for name, item in recording.conditions.items()
        },
    }
