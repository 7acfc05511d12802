"""`rigtool recover`: what an interrupted run left behind, made into a run file."""

from __future__ import annotations

import click

from rigtool.cli.options import debug_option, example


@click.command(
    epilog=example(
        "rigtool recover kt.h5.part", "rigtool recover kt.h5.part -o rescued.h5 --overwrite"
    )
)
@click.argument("part", metavar="RUN.h5.part")
@click.option("-o", "--output", metavar="RUN.h5", help="Run file to write.")
@click.option("--overwrite", is_flag=True, help="Replace an output that exists.")
@debug_option
def command(part: str, output: str | None, overwrite: bool) -> None:
    """Make a run file of what an interrupted run left.

    Brings back every sample that reached the disk, with the provenance of the run; results are
    missing, so give the file to the command again as its SOURCE. The part stays as it is.
    """
    from rigtool.runfile.recovery import recover

    found = recover(part, output, overwrite=overwrite)
    for name, samples in found.samples.items():
        click.echo(f"{name}: {samples} samples")
    if found.lost:
        click.echo(f"{found.lost} samples were damaged and are left out", err=True)
    click.echo(f"Written: {found.output}; remove {part} when you have looked at it", err=True)
