"""`rigtool diff`: differences between two runs."""

from __future__ import annotations

import click

from rigtool.cli.options import FILE_ARGUMENT, Number, command_with, current_output


@command_with("rigtool diff kt.h5 kt-again.h5 --rtol 1e-6")
@click.argument("first", type=FILE_ARGUMENT, metavar="RUN.h5")
@click.argument("second", type=FILE_ARGUMENT, metavar="RUN.h5")
@click.option("--rtol", type=Number(min=0), default=0.0, help="Relative tolerance.")
@click.option("--atol", type=Number(min=0), default=0.0, help="Absolute tolerance, SI.")
@click.pass_context
def command(ctx: click.Context, first: str, second: str, rtol: float, atol: float) -> None:
    """Show where two runs differ.

    Compares results, tables and signals, but not provenance and notes. An analysis of a stored run
    has no signals of its own: results and tables are compared with that run. Of runs of different
    commands, what both have is compared, and the rest is counted. Values agree if they differ by at
    most atol + rtol * the larger one. Exit code 1 if anything differs.
    """
    from rigtool.runfile import open_run
    from rigtool.runfile.comparison import Tolerance, differences

    to, found = current_output(), []
    with open_run(first) as one, open_run(second) as other:
        for line in differences(one, other, Tolerance(rtol, atol)):
            to.line(line)
            found.append(line)
    to.document(differences=found)
    if found:
        ctx.exit(1)
    to.note("no difference")
