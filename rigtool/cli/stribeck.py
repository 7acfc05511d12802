"""`rigtool stribeck`: friction of the motor."""

from __future__ import annotations

import click

from rigtool.cli.options import (
    Command,
    common_options,
    example,
    run_and_print,
    run_option,
    source_arguments,
)
from rigtool.experiments.running.options import CommonOptions


@click.command(
    "stribeck",
    cls=Command,
    epilog=example(
        "rigtool stribeck recipes/briaire-2006.toml --kt kt.h5 -o friction.h5",
        "rigtool stribeck imported/*.h5 -o friction.h5",
    ),
)
@source_arguments
@run_option("--kt", "Run of calibrate-kt: current to torque; not needed for imported runs.")
@common_options
def command(sources: tuple[str, ...], output: str, kt: str | None, options: CommonOptions) -> None:
    """Find friction: Coulomb, viscous, static, and breakaway around the turn.

    SOURCE is a recipe (measure holds, sweeps and breakaway ramps, then analyse) or run files of
    this command (analyse their signals again, pooled; a note names what they do not hold).
    Imported runs hold constant speeds, or any motion: then inertia and friction are fitted to the
    equation of motion. Exit code 4 if no friction model explains the curve.
    """
    from rigtool.experiments.friction.procedure import PROCEDURE

    run_and_print(PROCEDURE, sources, output, options, kt=kt)
