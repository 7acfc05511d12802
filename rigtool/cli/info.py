"""`rigtool info`: a run file on one screen."""

from __future__ import annotations

from typing import TYPE_CHECKING

import click

from rigtool.cli.options import FILE_ARGUMENT, command_with, current_output
from rigtool.errors import UsageError, did_you_mean

if TYPE_CHECKING:
    from rigtool.quantity import Quantity
    from rigtool.runfile import Run


@command_with(
    "rigtool info kt.h5",
    "rigtool info kt.h5 --json",
    "rigtool info kt.h5 --plot kt.svg",
    "rigtool info kt.h5 --budget torque_constant_mean",
)
@click.argument("path", type=FILE_ARGUMENT, metavar="RUN.h5")
@click.option(
    "--plot", type=FILE_ARGUMENT, metavar="FILE", help="Draw its default plot: .png, .svg or .pdf."
)
@click.option("--budget", metavar="RESULT", help="Show the uncertainty budget of a result.")
def command(path: str, plot: str | None, budget: str | None) -> None:
    """Show the contents of a run file.

    Who made it, when and from what; results with units and uncertainty; recorded signals with
    rate and duration; tables and remarks. Or the uncertainty budget of one result: its components,
    their values, sensitivities, contributions, degrees of freedom and shares of the variance.
    """
    from rigtool.cli.output import quantity_document, width
    from rigtool.runfile import open_run
    from rigtool.runfile.summary import budget_lines, folded

    if budget is not None and plot is not None:
        raise UsageError("--budget and --plot each show something else: give one of them")
    to = current_output()
    with open_run(path) as run:
        if budget is not None:
            found = _result(run, budget)
            results = {budget: quantity_document(found)}
            to.document(command=run.command, rig=run.rig, results=results)
            to.line("\n".join(budget_lines(budget, found, width())))
            return
        if plot is not None:
            from rigtool.report.default_plot import write_plot
            from rigtool.report.figures.style import import_undocumented

            import_undocumented()
            shown = write_plot(run, plot, overwrite=to.overwrite)
            to.written(plot, f"plot of {shown}")
        to.run(run, None)
        to.line("\n".join(folded(run.summary(), width())))


def _result(run: Run, name: str) -> Quantity:
    """Return a result; `UsageError` with the results that have a budget where it is missing."""
    if name in run.results:
        return run.results[name]
    budgets = [key for key, result in run.results.items() if result.budget]
    known = (
        f"results with a budget are {', '.join(budgets)}" if budgets else "no result has a budget"
    )
    remedy = did_you_mean(name, run.results, f"rigtool info {run.path} lists all results")
    raise UsageError(f"{run.path}: has no result {name!r}; {known}; {remedy}")
