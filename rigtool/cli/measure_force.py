"""`rigtool measure-force`: known loads, force from current."""

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
    epilog=example(
        "rigtool measure-force recipes/briaire-2006.toml --kt kt.h5 --tables tables.h5 -o force.h5"
    )
)
@source_arguments
@run_option("--kt", "Run file of calibrate-kt; needed but for imported runs.")
@run_option("--tables", "Run file of ilc-learn, of this rig and attachment.", required=True)
@click.option(
    "--correction",
    type=click.Choice(["none", "load", "full"]),
    help="Of what a load does to the reading; load and full need tables of implementation D. "
    "[default: the recipe's: none]",
)
@common_options
def command(
    sources: tuple[str, ...],
    output: str,
    kt: str | None,
    tables: str,
    correction: str | None,
    options: CommonOptions,
) -> None:
    """Measure known loads, reading force from current.

    Lifts and lowers each load of the recipe with the learned table switched on; reads the torque at
    one angle of each rising stroke: mean, scatter, error. With an instrument, also friction that
    grows with load, and stiffness. --correction load takes friction that grows with load off this
    reading; full reads whole strokes, with compliance, ripple by current and motor temperature.

    Imported runs are measured with tables of implementation D from runs of the same rig; where they
    hold a sensor's reference_torque it judges the result.
    """
    from rigtool.cli.printing import print_outcome
    from rigtool.experiments.force.procedure import PROCEDURE
    from rigtool.experiments.session import run_command

    if correction is not None:
        options = options.with_override(f"measure_force.correction={correction}")
    with open_inputs(kt=kt, tables=tables) as inputs:
        outcome = run_command(PROCEDURE, sources, output, options=options, inputs=inputs)
    print_outcome(outcome, output, options)
