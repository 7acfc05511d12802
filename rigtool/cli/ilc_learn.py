"""`rigtool ilc-learn`: learn the repeatable disturbance."""

from __future__ import annotations

import click

from rigtool.cli.options import current_output, measuring, open_inputs, run_and_print, run_option
from rigtool.experiments.running.options import CommonOptions
from rigtool.inputs import is_recipe


@measuring(
    "rigtool ilc-learn rig.toml --kt kt.h5 -o tables.h5",
    "rigtool ilc-learn rig.toml --kt kt.h5 --implementation D -o tables-loads.h5",
    "rigtool ilc-learn rig.toml --kt kt.h5 --check tables.h5 -o check.h5",
)
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
    help="Implementation by the thesis's letter; default: the recipe's, C unless set.",
)
@click.option(
    "--validate",
    is_flag=True,
    help="Then also sweep, and turn at speeds that were not learned, table off and on.",
)
@run_option(
    "--prior",
    "Run of ilc-learn, of another mounting: its lightest and heaviest load learn the new one "
    "(imported runs).",
)
@run_option(
    "--check", "Run of ilc-learn: check whether its tables still fit, and find what changed."
)
def command(
    sources: tuple[str, ...],
    output: str,
    kt: str | None,
    friction: str | None,
    plant: str | None,
    learning_filter: str | None,
    implementation: str | None,
    validate: bool,
    prior: str | None,
    check: str | None,
    options: CommonOptions,
) -> None:
    """Learn the disturbance that repeats with position and speed.

    \b
    A         turns at one speed; amplitude and phase by speed; needs --friction
    B         turns at -5 to 5 rev/s: by position and speed, friction included
    C         moves to and fro on a limited angle: by position and speed
    D         as C, and by load: lifts known loads, for measure-force --correction
    standard  repeats one move: by time

    Then repeats the motion with the learned table switched on and reports what remains. A and B
    run without the instrument. Thesis section 7.2.4.

    --validate records the motion with the table off and on, one after the other: at speeds between
    the learned ones (A, B, C) and during a sweep over all speeds (A, B). The validation is part of
    the run and is reported whenever the run is analysed again.

    --check learns nothing. It repeats a few of the moves from which the tables were learned and
    compares their disturbance with the tables: does it differ by a shift, a factor, a change of
    friction, or in its pattern? Exit code 4 if the tables do not fit.

    Imported runs of a slowly turning motor need no --kt: the result is a map of the turn. Imported
    runs of known loads, measured by a sensor (reference_torque), give tables of implementation D:
    effort by motion and load, from which measure-force reads torque. With --prior, the tables of
    another mounting, the lightest and the heaviest load are enough.
    """
    from rigtool.experiments.learning import procedure as ilc_learn

    if check is not None:
        for name, given in (
            ("friction", friction),
            ("implementation", implementation),
            ("learning-filter", learning_filter),
            ("validate", validate),
            ("prior", prior),
        ):
            if given:
                raise click.UsageError(
                    f"--{name}: --check repeats the motion with which the tables were learned: "
                    "leave the option out"
                )
        _check(sources, output, options, tables=check, kt=kt, plant=plant)
        return
    stored = not any(map(is_recipe, sources))
    if prior is not None and not (stored and implementation == "D"):
        raise click.UsageError("--prior: is for imported runs with --implementation D")
    options = ilc_learn.asked(options, None if stored else implementation, validate=validate)
    if learning_filter is not None:
        options = options.with_override(f"ilc_learn.learning_filter={learning_filter}")
    procedure = ilc_learn.of_stored(implementation) if stored else ilc_learn.PROCEDURE
    paths = {"kt": kt, "friction": friction, "plant": plant, "prior": prior}
    run_and_print(procedure, sources, output, options, **paths)


def _check(
    sources: tuple[str, ...], output: str, options: CommonOptions, **paths: str | None
) -> None:
    """Compare tables with the disturbance of SOURCE; the exit code is the verdict."""
    from dataclasses import replace

    from rigtool.errors import InsufficientDataError
    from rigtool.experiments.learning.check import procedure as ilc_check
    from rigtool.experiments.running.session import run_command

    with open_inputs(**paths) as inputs:
        options = ilc_check.as_learned(options, sources, inputs["tables"])
        outcome = run_command(ilc_check.PROCEDURE, sources, output, options=options, inputs=inputs)
    to = current_output()
    if options.dry_run:
        to.outcome(outcome, output, dry=True)
        return
    fits = ilc_check.fits(outcome)
    to.outcome(outcome if fits else replace(outcome, notes=outcome.notes[1:]), output, dry=False)
    if not fits:  # the first note is the error message
        raise InsufficientDataError(outcome.notes[0])
