"""`rigtool measure-force`: known loads, force from current."""

from __future__ import annotations

import click

from rigtool.cli.options import common_options, example, run_and_print, run_option, source_arguments
from rigtool.experiments.running.options import CommonOptions


@click.command(
    epilog=example(
        "rigtool measure-force recipes/briaire-2006.toml --kt kt.h5 --tables tables.h5 -o force.h5"
    )
)
@source_arguments
@run_option("--kt", "Run of calibrate-kt; not needed for imported runs.")
@run_option("--tables", "Run of ilc-learn, of this rig and attachment.", required=True)
@click.option(
    "--correction",
    type=click.Choice(["none", "load", "full"]),
    help="Correction for effects of the load; load and full need tables of implementation D. "
    "[default: the recipe's, none unless set]",
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
    one angle of each rising stroke: mean, scatter, error. With an instrument, also reports friction
    that grows with load, and stiffness. --correction load subtracts friction that grows with load
    from this reading; full reads whole strokes and also corrects for compliance, ripple by current
    and motor temperature.

    Imported runs need tables of implementation D from runs of the same rig; the reference_torque of
    a sensor, where recorded, is compared with the result.
    """
    from rigtool.experiments.force.procedure import PROCEDURE

    if correction is not None:
        options = options.with_override(f"measure_force.correction={correction}")
    run_and_print(PROCEDURE, sources, output, options, kt=kt, tables=tables)
