"""`rigtool stribeck`: friction of the motor."""

from __future__ import annotations

import click

from rigtool.cli.options import measuring, run_and_print, run_option
from rigtool.experiments.running.options import CommonOptions
from rigtool.inputs import is_recipe


@measuring(
    "rigtool stribeck rig.toml --kt kt.h5 -o friction.h5",
    "rigtool stribeck imported/*.h5 -o friction.h5",
    "rigtool stribeck loaded.h5 --against bare.h5 --kt kt.h5 -o payload.h5",
)
@run_option("--kt", "Run of calibrate-kt: current to torque; not needed for imported runs.")
@run_option(
    "--against",
    "Stored run to compare with, of the same motion (imported) or speeds (of stribeck): the change "
    "of inertia, friction and gravity.",
)
@run_option(
    "--reference", "Run with a known change against the same run: the ratio of the two changes."
)
def command(
    sources: tuple[str, ...],
    output: str,
    kt: str | None,
    against: str | None,
    reference: str | None,
    options: CommonOptions,
) -> None:
    """Find Coulomb, viscous, static and breakaway friction.

    SOURCE is a recipe (measure holds, sweeps and breakaway ramps, then analyse) or run files of
    this command (analyse their signals again, pooled; a note names what they do not hold).
    Imported runs hold constant speeds, or any motion: then inertia and friction are fitted to the
    equation of motion. Exit code 4 if no friction model explains the curve.

    --against compares two stored runs of one motion point by point, with and without a payload or
    another change; what they share, such as ripple, cancels. With --reference, a run with a known
    payload, the ratio of the changes weighs the unknown one.
    """
    from rigtool.experiments.friction.procedure import PROCEDURE

    if against is not None and any(map(is_recipe, sources)):
        raise click.UsageError("--against: compares stored runs: measure first, then compare")
    run_and_print(PROCEDURE, sources, output, options, kt=kt, against=against, reference=reference)
