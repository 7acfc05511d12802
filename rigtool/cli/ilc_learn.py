"""`rigtool ilc-learn`: learn the repeatable disturbance."""

from __future__ import annotations

from typing import TYPE_CHECKING

import click

from rigtool.cli.options import (
    common_options,
    example,
    open_inputs,
    run_option,
    source_arguments,
)

if TYPE_CHECKING:
    from rigtool.procedures.options import CommonOptions


@click.command(
    epilog=example("rigtool ilc-learn recipes/briaire-2006.toml --kt kt.h5 -o tables.h5")
)
@source_arguments
@run_option("--kt", "Run of calibrate-kt: current to torque.", required=True)
@run_option("--friction", "Run of stribeck: feed its friction forward while learning.")
@run_option("--plant", "Run of identify-plant: the measured plant instead of the nominal one.")
@click.option(
    "--learning-filter",
    type=click.Choice(["zpetc", "frf"]),
    help="L: zero-phase inverse of the model (the recipe's default), or of the measured response.",
)
@click.option(
    "--implementation",
    default="C",
    show_default=True,
    type=click.Choice(["A", "B", "C", "D", "standard"]),
    help="Way to learn, by the thesis's letter.",
)
@common_options
def command(
    sources: tuple[str, ...],
    output: str,
    kt: str,
    friction: str | None,
    plant: str | None,
    learning_filter: str | None,
    implementation: str,
    options: CommonOptions,
) -> None:
    """Learn the disturbance that repeats with position and speed.

    Moves to and fro at each speed, learns in one update, and says what remains with the table
    switched on. Thesis section 7.2.4.2.
    """
    from rigtool.cli.printing import print_outcome
    from rigtool.procedures import ilc_learn
    from rigtool.procedures.session import run_command

    ilc_learn.require_implementation(implementation)
    if learning_filter is not None:
        options = options.with_override(f"ilc_learn.learning_filter={learning_filter}")
    with open_inputs(kt=kt, friction=friction, plant=plant) as inputs:
        outcome = run_command(ilc_learn, sources, output, options=options, inputs=inputs)
    print_outcome(outcome, output, options)
