"""`rigtool recover`: a run file from the remains of an interrupted run."""

from __future__ import annotations

import click

from rigtool.cli.options import FILE_ARGUMENT, command_with, current_output, output_option


@command_with("rigtool recover kt.h5.part", "rigtool recover kt.h5.part -o rescued.h5 --overwrite")
@click.argument("part", type=FILE_ARGUMENT, metavar="RUN.h5.part")
@output_option("RUN.h5", "Run file to write.")
def command(part: str, output: str | None) -> None:
    """Make a run file from the remains of an interrupted run.

    Brings back every sample that reached the disk, with the provenance of the run. The file has no
    results: give it to its command as SOURCE. The .part stays as it is.
    """
    from rigtool.runfile.recovery import recover

    to = current_output()
    found = recover(part, output, overwrite=to.overwrite)
    what = f"what was recorded before {part} was interrupted; remove {part} afterwards"
    to.written(found.output, what)
    for name, samples in found.samples.items():
        to.line(f"{name}: {samples} samples")
    if found.lost:
        to.note(f"{found.lost} samples were damaged and are left out")
    to.document(output=str(found.output), samples=dict(found.samples), lost=found.lost)
