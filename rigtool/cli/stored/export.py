"""`rigtool export`: a run, or a learned table, in formats of other programs."""

from __future__ import annotations

from pathlib import Path

import click

from rigtool.cli.options import (
    FILE_ARGUMENT,
    command_with,
    completed,
    current_output,
    open_inputs,
    output_option,
    run_option,
)


def _parts(path: str) -> list[str]:
    from rigtool.runfile import open_run
    from rigtool.runfile.export import run_parts

    with open_run(path) as run:
        return list(run_parts(run))


@command_with(
    "rigtool export friction.h5 --part tables/friction_model -o friction.csv",
    "rigtool export friction.h5 --part recordings/holds -o holds.parquet",
    "rigtool export friction.h5 -o friction.mat",
    "rigtool export tables.h5 -o table.h",
    "rigtool export tables-loads.h5 --kt kt.h5 --format c-sensor -o sensor.h",
)
@click.argument("path", type=FILE_ARGUMENT, metavar="RUN.h5")
@output_option("FILE", ".csv, .parquet, .mat, .nc, .h, .json.", required=True)
@click.option(
    "--part",
    metavar="NAME",
    shell_complete=completed(_parts),
    help="For .csv, .parquet: results, recordings/NAME or tables/NAME.",
)
@click.option(
    "--format",
    "wanted",
    type=click.Choice(["c", "c-int16", "table", "moteus", "odrive", "fourier", "c-sensor"]),
    help="Format of what was learned, where the suffix of FILE does not determine it.",
)
@click.option("--speed", type=float, help="For moteus, odrive, fourier: speed of the motor, rad/s.")
@run_option("--kt", "For moteus, odrive, c-sensor: run of calibrate-kt, current to torque.")
def command(
    path: str,
    output: str,
    part: str | None,
    wanted: str | None,
    speed: float | None,
    kt: str | None,
) -> None:
    """Write a run, or a learned table, for other programs.

    CSV, Parquet, MATLAB, netCDF; for learned tables also a C header and formats of drives.

    A .csv holds one part of the run, with units in its header; a .parquet holds one part, with
    units in its metadata (needs pyarrow: pip install rigtool[parquet]). A .mat or .nc holds the
    whole run.

    A learned table (of ilc-learn) becomes a C header with its interpolation (.h; --format c-int16
    for half the size), a .csv or .json, or by --format: moteus, the 1024 codes of that drive's
    cogging table (.cfg); odrive, 3600 values of the turn; fourier, the orders above the noise;
    table, a .mat of the table alone. The loss by rounding is reported.

    --format c-sensor writes the force sensor of measure-force --record in C99, from tables of
    implementation D: one header that reads the torque on the output from current and encoder.
    """
    from rigtool.experiments.deploy.stored_export import chosen_format, export_table
    from rigtool.runfile import open_run
    from rigtool.runfile.export import export

    remarks: tuple[str, ...] = ()
    to = current_output()
    with open_run(path) as run, open_inputs(kt=kt) as inputs:
        chosen = chosen_format(run, Path(output), part, wanted)
        if chosen is None:
            if speed is not None or kt is not None:
                raise click.UsageError("--speed and --kt are for learned tables: give --format")
            export(run, output, part, to.overwrite)
        else:
            remarks = export_table(
                run, Path(output), chosen, speed=speed, kt=inputs.get("kt"), overwrite=to.overwrite
            )
        what = part or ("the whole run" if chosen is None else f"learned table, format {chosen}")
        to.written(output, f"{what} of {path}")
        to.document(rig=run.rig, output=output, notes=list(remarks))
    for remark in remarks:
        to.note(f"Note: {remark}")
