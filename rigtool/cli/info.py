"""`rigtool info`: a run file on one screen."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import click

from rigtool.cli.options import debug_option, echo, example, json_option

if TYPE_CHECKING:
    from rigtool.runfile import Recording


@click.command(
    epilog=example(
        "rigtool info kt.h5",
        "rigtool info kt.h5 --json",
        "rigtool info kt.h5 --plot kt.svg",
        "rigtool info kt.h5 --budget torque_constant_mean",
    )
)
@click.argument("path", metavar="RUN.h5")
@json_option
@click.option("--plot", metavar="FILE", help="Draw its default plot: .png, .svg or .pdf.")
@click.option("--overwrite", is_flag=True, help="Replace a plot that exists.")
@click.option("--budget", metavar="RESULT", help="Show the uncertainty budget of a result.")
@debug_option
def command(
    path: str, as_json: bool, plot: str | None, overwrite: bool, budget: str | None
) -> None:
    """Show the contents of a run file.

    Who made it, when and from what; results with units and uncertainty; recorded signals with
    rate and duration; tables and remarks. Or the uncertainty budget of one result: its components,
    their values, sensitivities, contributions, degrees of freedom and shares of the variance.
    """
    from rigtool.cli.printing import json_text, quantity_json, to_json
    from rigtool.runfile import open_run
    from rigtool.runfile.summary import budget_lines

    with open_run(path) as run:
        if budget is not None:
            result = run.result(budget)
            text = (
                json_text({budget: quantity_json(result)})
                if as_json
                else "\n".join(budget_lines(budget, result))
            )
        elif as_json:
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
