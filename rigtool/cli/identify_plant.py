"""`rigtool identify-plant`: frequency response of the plant, and its inertia."""

from __future__ import annotations

from rigtool.cli.options import measuring, run_and_print, run_option
from rigtool.experiments.running.options import CommonOptions


@measuring(
    "rigtool identify-plant rig.toml --kt kt.h5 -o plant.h5",
    "rigtool identify-plant rig.toml --kt kt.h5 --set rig.attachment=pulley -o plant-pulley.h5",
)
@run_option("--kt", "Run of calibrate-kt; without it the data sheet's torque constant is used.")
def command(sources: tuple[str, ...], output: str, kt: str | None, options: CommonOptions) -> None:
    """Measure the frequency response; fit inertia and friction.

    A multisine is added to the controller's torque while the shaft moves at constant speed.
    `ilc-learn --plant` uses the result. Exit code 4 if the excitation is lost in noise or the
    current reaches its limit. Thesis sections 7.2.3 and 7.2.4.2.
    """
    from rigtool.experiments.plant.procedure import PROCEDURE

    run_and_print(PROCEDURE, sources, output, options, kt=kt)
