"""`rigtool measure-force`: known loads, force from current."""

from __future__ import annotations

from dataclasses import replace

import click

from rigtool.cli.options import (
    Integer,
    Number,
    current_output,
    measuring,
    run_and_print,
    run_option,
)
from rigtool.experiments.running.options import CommonOptions
from rigtool.inputs import is_recipe


@measuring(
    "rigtool measure-force rig.toml --kt kt.h5 --tables tables.h5 -o force.h5",
    "rigtool measure-force rig.toml --kt kt.h5 --tables tables-loads.h5 "
    "--record 60 -o force-over-time.h5",
)
@run_option("--kt", "Run of calibrate-kt; not needed for imported runs.")
@run_option("--tables", "Run of ilc-learn, of this rig and attachment.", required=True)
@click.option(
    "--correction",
    type=click.Choice(["none", "load", "full"]),
    help="Correction for effects of the load; load and full need tables of implementation D. "
    "[default: the recipe's, none unless set]",
)
@click.option(
    "--record",
    type=Number(min=0, min_open=True),
    metavar="SECONDS",
    help="Read an unknown force over time while the rig moves as [measure_force.motion] states.",
)
@click.option(
    "--observe",
    type=Number(min=0, min_open=True),
    metavar="SECONDS",
    help="Read an unknown force over time while another controller, or a hand, moves the rig.",
)
@click.option(
    "--stream",
    is_flag=True,
    help="Write the force to stdout while it is measured, a line of JSON each millisecond.",
)
@click.option(
    "--every",
    type=Integer(min=1),
    metavar="N",
    help="With --stream or --live, show one of N estimates.  [default: 1]",
)
def command(
    sources: tuple[str, ...],
    output: str,
    kt: str | None,
    tables: str,
    correction: str | None,
    record: float | None,
    observe: float | None,
    stream: bool,
    every: int | None,
    options: CommonOptions,
) -> None:
    """Measure known loads, or force over time, from current.

    Lifts and lowers each load of the recipe with the learned table switched on; reads the torque at
    one angle of each rising stroke: mean, scatter, error. With an instrument, also reports friction
    that grows with load, and stiffness. --correction load subtracts friction that grows with load
    from this reading and corrects for compliance; full reads whole strokes and also corrects for
    ripple by current and motor temperature.

    --record and --observe read an unknown force over time, with its 95 % interval, in any motion. A
    stored run without known loads is also read over time. Needs tables of implementation D. --live
    and --live-window draw the force while it is measured; --stream writes it for another program.

    Imported runs need tables of implementation D from runs of the same rig; the reference_torque of
    a sensor, where recorded, is compared with the result.
    """
    from rigtool.experiments.force.procedure import PROCEDURE
    from rigtool.experiments.force_sensor.procedure_live import over_time_live

    procedure, seconds = PROCEDURE, record if observe is None else observe
    if seconds is None and (stream or every is not None):
        raise click.UsageError(
            "--stream and --every go with --record or --observe: add one of them"
        )
    if every is not None and not stream and options.live is None:
        raise click.UsageError(f"--every {every} is for --stream and --live: add one of them")
    if stream and current_output().json:
        raise click.UsageError(
            "--stream and --json both write to stdout: leave --json out, and read the run file"
        )
    if seconds is not None:
        _require_over_time(sources, correction, both=record is not None and observe is not None)
        procedure = over_time_live(seconds, observed=observe is not None, every=every or 1)
        options = replace(options, stream=stream)
        current_output().stream = stream
    if correction is not None:
        options = options.with_override(f"measure_force.correction={correction}")
    run_and_print(procedure, sources, output, options, kt=kt, tables=tables)


def _require_over_time(sources: tuple[str, ...], correction: str | None, *, both: bool) -> None:
    """Raise `click.UsageError` for options that do not go with a force over time."""
    if both:
        raise click.UsageError("--record moves the rig, --observe does not: give one of them")
    if correction is not None:
        raise click.UsageError(
            f"--correction {correction} is one of known loads: leave it out, force over time has "
            "all corrections"
        )
    if not any(map(is_recipe, sources)):
        raise click.UsageError(
            "--record and --observe measure on the rig of a recipe; a stored run is read as it "
            "is: leave them out"
        )
