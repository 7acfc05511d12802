"""rigtool stribeck."""

from __future__ import annotations

import click

from rigtool.cli.options import (
    common_options,
    example,
    open_inputs,
    run_option,
    source_arguments,
)
from rigtool.experiments.options import CommonOptions


@click.command(
    "stribeck",
    epilog=example(
        "rigtool stribeck recipes/briaire-2006.toml --kt kt.h5 -o friction.h5",
        "rigtool stribeck imported/*.h5 -o friction.h5",
    ),
)
@source_arguments
@run_option("--kt", "Run of calibrate-kt: current to torque; needed but for imported runs.")
@common_options
def command(sources: tuple[str, ...], output: str, kt: str | None, options: CommonOptions) -> None:
    """Find friction: Coulomb, viscous, static, and breakaway around the turn.

    SOURCE is a recipe (measure holds, sweeps and breakaway ramps, then analyse) or run files of
    this command (analyse their signals again, pooled; what they do not hold is left out and said
    so). Imported runs are holds at constant speeds, or of any motion, then by inertia and friction
    in its equation of motion. A curve that no friction model explains ends with exit code 4.
    """
    from rigtool.cli.printing import print_outcome
    from rigtool.experiments.friction.procedure import PROCEDURE
    from rigtool.experiments.session import run_command

    with open_inputs(kt=kt) as inputs:
        outcome = run_command(PROCEDURE, sources, output, options=options, inputs=inputs)
    print_outcome(outcome, output, options)
