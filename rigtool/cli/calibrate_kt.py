"""`rigtool calibrate-kt`: the torque constant."""

from __future__ import annotations

from rigtool.cli.options import measuring, run_and_print
from rigtool.experiments.running.options import CommonOptions


@measuring("rigtool calibrate-kt rig.toml -o kt.h5", "rigtool calibrate-kt imported/*.h5 -o kt.h5")
def command(sources: tuple[str, ...], output: str, options: CommonOptions) -> None:
    """Find the torque constant against temperature.

    SOURCE is a recipe (measure staircases of current against a force gauge, then analyse) or run
    files of this command (analyse their signals again, pooled). Reports the amplifier's linearity,
    the torque constant at 20 degC, its temperature coefficient, and the error of using one value
    over the reference range of temperature.

    Imported runs hold plateaus or slow ramps of current against a torque or force sensor.
    """
    from rigtool.experiments.torque_constant.procedure import PROCEDURE

    run_and_print(PROCEDURE, sources, output, options)
