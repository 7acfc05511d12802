"""`rigtool fft-ripple`: torque ripple by order of rotation."""

from __future__ import annotations

from rigtool.cli.options import measuring, run_and_print, run_option
from rigtool.experiments.running.options import CommonOptions


@measuring(
    "rigtool fft-ripple rig.toml --kt kt.h5 -o ripple.h5",
    "rigtool fft-ripple imported/comp_0.h5 imported/nocomp_0.h5 -o ripple.h5",
)
@run_option("--kt", "Run of calibrate-kt: current to torque; not needed for imported runs.")
def command(sources: tuple[str, ...], output: str, kt: str | None, options: CommonOptions) -> None:
    """Measure torque ripple by order, speed and torque.

    An order is a multiple of the frequency of rotation. Turns the bare motor steadily at each
    speed, under each constant torque and after restarts of the amplifier; separates repeatable
    from non-repeatable ripple. Thesis section 7.1.3. Imported runs are grouped by their conditions
    and compared by order; imported maps are compared with each other.
    """
    from rigtool.experiments.ripple.procedure import PROCEDURE

    run_and_print(PROCEDURE, sources, output, options, kt=kt)
