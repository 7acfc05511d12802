"""`rigtool identify-plant`: frequency response of the plant, and its inertia."""

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
    "identify-plant",
    epilog=example(
        "rigtool identify-plant recipes/briaire-2006.toml --kt kt.h5 -o plant.h5",
        "rigtool identify-plant recipes/briaire-2006.toml --kt kt.h5 "
        "--set rig.attachment=pulley -o plant-pulley.h5",
    ),
)
@source_arguments
@run_option("--kt", "Run of calibrate-kt: without it torques rest on the data sheet.")
@common_options
def command(sources: tuple[str, ...], output: str, kt: str | None, options: CommonOptions) -> None:
    """Measure the frequency response of the plant; fit inertia and friction.

    A multisine is added to the controller's torque while the shaft moves at constant speed. The
    plant goes to `ilc-learn --plant`. Data in which the excitation is lost, or that reach the
    current limit, end with exit code 4. Thesis sections 7.2.3 and 7.2.4.2.
    """
    from rigtool.cli.printing import print_outcome
    from rigtool.experiments.plant.procedure import PROCEDURE
    from rigtool.experiments.session import run_command

    with open_inputs(kt=kt) as inputs:
        outcome = run_command(PROCEDURE, sources, output, options=options, inputs=inputs)
    print_outcome(outcome, output, options)
