"""`rigtool export`: a run for those who want a table."""

from __future__ import annotations

import click

from rigtool.cli.options import debug_option, example


@click.command(
    epilog=example(
        "rigtool export friction.h5 --part tables/friction_model -o friction.csv",
        "rigtool export friction.h5 --part recordings/holds -o holds.parquet",
        "rigtool export friction.h5 -o friction.mat",
    )
)
@click.argument("path", metavar="RUN.h5")
@click.option("-o", "--output", required=True, metavar="FILE", help=".csv, .parquet, .mat or .nc.")
@click.option("--part", metavar="NAME", help="Of a table: results, recordings/NAME or tables/NAME.")
@click.option("--overwrite", is_flag=True, help="Replace an output that exists.")
@debug_option
def command(path: str, output: str, part: str | None, overwrite: bool) -> None:
    """Write a run as CSV, Parquet, MATLAB or netCDF file.

    A .csv holds one part of the run, units in its head; so does a .parquet, units in its metadata
    (it needs pyarrow: pip install rigtool[parquet]). .mat and .nc hold all of it.
    """
    from rigtool.runfile import open_run
    from rigtool.runfile.export import export

    with open_run(path) as run:
        export(run, output, part, overwrite)
