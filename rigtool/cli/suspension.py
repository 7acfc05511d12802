"""`rigtool suspension`: leaf springs and pulleys out of centre."""

from __future__ import annotations

from typing import TYPE_CHECKING

import click

from rigtool.cli.options import common_options, example, source_arguments

if TYPE_CHECKING:
    from rigtool.experiments.options import CommonOptions


@click.command(epilog=example("rigtool suspension recipes/briaire-2006.toml -o suspension.h5"))
@source_arguments
@common_options
def command(sources: tuple[str, ...], output: str, options: CommonOptions) -> None:
    """Measure the motor's leaf springs; compute what eccentric pulleys do.

    Known forces pull at the motor, a micrometer reads its deflection. Reported are the stiffness,
    beside that by dimensions, the eigenfrequency of motor and springs, and the torque that pulleys
    out of centre make. Thesis appendices E and J.
    """
    from rigtool.cli.printing import print_outcome
    from rigtool.experiments.session import run_command
    from rigtool.experiments.suspension.procedure import PROCEDURE

    outcome = run_command(PROCEDURE, sources, output, options=options, inputs={})
    print_outcome(outcome, output, options)
