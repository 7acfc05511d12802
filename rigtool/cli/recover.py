"""`rigtool recover`: a run file from the remains of an interrupted run."""

from __future__ import annotations

import click

from rigtool.cli.options import debug_option, echo, example


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
    """Make a run file from the remains of an interrupted run.

    Brings back every sample that reached the disk, with the provenance of the run. The file has no
    results: give it to its command as SOURCE. The .part stays as it is.
    """
    from rigtool.runfile.recovery import recover

    found = recover(part, output, overwrite=overwrite)
    for name, samples in found.samples.items():
        echo(f"{name}: {samples} samples")
    if found.lost:
        echo(f"{found.lost} samples were damaged and are left out", err=True)
    echo(f"Written: {found.output}; remove {part} when you have looked at it", err=True)
