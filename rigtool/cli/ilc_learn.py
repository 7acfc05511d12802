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
    from rigtool.experiments.options import CommonOptions


@click.command(
    epilog=example(
        "rigtool ilc-learn recipes/briaire-2006.toml --kt kt.h5 -o tables.h5",
        "rigtool ilc-learn recipes/briaire-2006.toml --kt kt.h5 --check tables.h5 -o check.h5",
    )
)
@source_arguments
@run_option("--kt", "Run of calibrate-kt: current to torque.")
@run_option("--friction", "Run of stribeck: feed its friction forward while learning.")
@run_option("--plant", "Run of identify-plant: the measured plant instead of the nominal one.")
@click.option(
    "--learning-filter",
    type=click.Choice(["zpetc", "frf"]),
    help="L: zero-phase inverse of the model (the recipe's default), or of the measured response.",
)
@click.option(
    "--implementation",
    type=click.Choice(["A", "B", "C", "D", "standard"]),
    help="Way to learn, by the thesis's letter; without it the recipe's, C by default.",
)
@click.option(
    "--validate",
    is_flag=True,
    help="Afterwards also turn at speeds that were not learned, and sweep, table off and on.",
)
@run_option("--check", "Learned tables: do they still fit SOURCE, and if not, what changed?")
@common_options
def command(
    sources: tuple[str, ...],
    output: str,
    kt: str | None,
    friction: str | None,
    plant: str | None,
    learning_filter: str | None,
    implementation: str | None,
    validate: bool,
    check: str | None,
    options: CommonOptions,
) -> None:
    """Learn the disturbance that repeats with position and speed.

    \b
    A         turns at one speed; amplitude and phase by speed; needs --friction
    B         turns at -5 to 5 rev/s: by position and speed, friction included
    C         moves to and fro on a limited angle: by position and speed
    D         as C, then lifts known loads: by load, too, for measure-force --correction
    standard  repeats one move: by time

    Then moves with what was learned switched on, and says what remains. A and B take the
    instrument off. Thesis section 7.2.4.

    --validate belongs to the run: table off and on are recorded one after the other, between the
    learned speeds (A, B, C) and while the speed sweeps from end to end (A, B). A run that was
    recorded with it reports it whenever it is analysed again.

    With --check nothing is learned: a few moves are made as the tables were learned, and what they
    show is compared with the tables: shifted, larger, another friction, another pattern? Exit code
    4 where they do not fit.

    Imported runs of a slowly turning motor do without --kt: they give a map of the turn. Those of
    known loads, measured by a sensor (reference_torque), give implementation D: effort by motion
    and load, that measure-force reads torque with.
    """
    from rigtool.cli.printing import print_outcome
    from rigtool.experiments.imported_load.procedure import PROCEDURE as BY_LOAD
    from rigtool.experiments.learning import procedure as ilc_learn
    from rigtool.experiments.session import run_command

    if check is not None:
        for name, given in (
            ("friction", friction),
            ("implementation", implementation),
            ("learning-filter", learning_filter),
            ("validate", validate),
        ):
            if given:
                raise click.UsageError(f"--{name}: --check moves as the tables were learned")
        _check(sources, output, options, tables=check, kt=kt, plant=plant)
        return
    # Run files that were imported have no recipe to say how to learn: D is by known loads.
    by_load = implementation == "D" and not any(source.endswith(".toml") for source in sources)
    if not by_load:
        options = ilc_learn.asked(options, implementation, validate=validate)
    if learning_filter is not None:
        options = options.with_override(f"ilc_learn.learning_filter={learning_filter}")
    with open_inputs(kt=kt, friction=friction, plant=plant) as inputs:
        procedure = BY_LOAD if by_load else ilc_learn.PROCEDURE
        outcome = run_command(procedure, sources, output, options=options, inputs=inputs)
    print_outcome(outcome, output, options)


def _check(
    sources: tuple[str, ...], output: str, options: CommonOptions, **paths: str | None
) -> None:
    """Compare tables with what SOURCE shows; the verdict is printed, and is the exit code."""
    from dataclasses import replace

    from rigtool.cli.printing import print_outcome
    from rigtool.errors import InsufficientDataError
    from rigtool.experiments.learning.check import procedure as ilc_check
    from rigtool.experiments.session import run_command

    with open_inputs(**paths) as inputs:
        options = ilc_check.as_learned(options, sources, inputs["tables"])
        outcome = run_command(ilc_check.PROCEDURE, sources, output, options=options, inputs=inputs)
    if options.dry_run:
        print_outcome(outcome, output, options)
        return
    fits = ilc_check.fits(outcome)
    shown = outcome if fits or options.json else replace(outcome, notes=outcome.notes[1:])
    print_outcome(shown, output, options)
    if not fits:  # what was not shown is the error
        raise InsufficientDataError(outcome.notes[0])
