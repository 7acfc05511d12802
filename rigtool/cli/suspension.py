"""`rigtool suspension`: leaf springs and eccentric pulleys."""

from __future__ import annotations

from rigtool.cli.options import measuring, run_and_print
from rigtool.experiments.running.options import CommonOptions


@measuring("rigtool suspension rig.toml -o suspension.h5")
def command(sources: tuple[str, ...], output: str, options: CommonOptions) -> None:
    """Measure leaf springs; compute what eccentric pulleys do.

    Known forces pull at the motor, and a micrometer reads its deflection. Reports the measured
    stiffness beside the one computed from dimensions, the eigenfrequency of motor and springs, and
    the torque of eccentric pulleys. Thesis appendices E and J.
    """
    from rigtool.experiments.suspension.procedure import PROCEDURE

    run_and_print(PROCEDURE, sources, output, options)
