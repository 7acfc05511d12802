"""`rigtool deploy`: a learned table into the drive."""

from __future__ import annotations

import click

from rigtool.cli.options import (
    FILE_ARGUMENT,
    command_with,
    current_output,
    open_inputs,
    run_option,
    set_option,
)


@command_with(
    "rigtool deploy turning.h5 --rig moteus.toml --kt kt.h5 --speed 12.566 --dry-run",
    "rigtool deploy turning.h5 --rig moteus.toml --kt kt.h5 --speed 12.566 --yes",
)
@click.argument("tables", type=FILE_ARGUMENT, metavar="TABLES.h5")
@click.option(
    "--rig", required=True, type=FILE_ARGUMENT, metavar="RECIPE.toml", help="Recipe with the drive."
)
@click.option("--speed", type=float, help="One of the learned motor speeds, rad/s.")
@run_option("--kt", "Run of calibrate-kt: torque to current.")
@set_option
@click.option("--dry-run", is_flag=True, help="Show what would be stored; change nothing.")
@click.option("--yes", is_flag=True, help="Store without asking first.")
@click.option(
    "--spy", type=FILE_ARGUMENT, metavar="FILE", help="Write every byte on the serial line."
)
def command(
    tables: str,
    rig: str,
    speed: float | None,
    kt: str | None,
    overrides: tuple[str, ...],
    dry_run: bool,
    yes: bool,
    spy: str | None,
) -> None:
    """Store a learned table in a drive that adds it by itself.

    For drives that keep a table of the turn: moteus. The table must be periodic (ilc-learn
    --implementation A or B), of one speed, and of this rig. The stored table is read back and
    compared, in memory and from flash; if anything fails, the previous table is restored. Nothing
    moves.

    The drive adds the table in position mode only. It writes all of its settings to flash together:
    settings that were changed in memory only become permanent.
    """
    from rigtool.experiments.deploy.procedure import deploy
    from rigtool.recipe import load_recipe
    from rigtool.rigs.operator import Operator
    from rigtool.runfile import open_run
    from rigtool.runfile.outputs import require_output

    output = current_output()
    if spy is not None:
        read = [tables, rig, *([kt] if kt is not None else [])]
        require_output(spy, overwrite=output.overwrite, inputs=read)
    recipe, _ = load_recipe(rig, overrides)
    with open_run(tables) as run, open_inputs(kt=kt) as inputs:
        done = deploy(
            run,
            recipe,
            speed=speed,
            kt=inputs.get("kt"),
            dry_run=dry_run,
            operator=Operator(yes=yes, spy=spy),
        )
    output.document(rig=recipe.rig.name, lines=list(done.lines), notes=list(done.remarks))
    for line in done.lines:
        output.line(line)
    for remark in done.remarks:
        output.note(f"Note: {remark}")
