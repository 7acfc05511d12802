"""Short runs on the virtual rig for tests of procedures."""

from contextlib import ExitStack
from pathlib import Path

from rigtool.experiments.running.options import CommonOptions
from rigtool.experiments.running.session import run_command
from rigtool.quantity import Quantity
from rigtool.runfile import RunWriter, open_run

RECIPE = Path(__file__).parents[2] / "recipes" / "briaire-2006.toml"
TORQUE_CONSTANT = 0.0454
COULOMB, VISCOUS = 2.3e-3, 5.33e-5

# What varies by itself is switched off: results follow from a few parameters.
QUIET = (
    "virtual.motor.cogging=[]",
    "virtual.motor.viscous_modulation=[]",
    "virtual.motor.friction_asymmetry=0",
    "virtual.motor.friction_noise=0",
    "virtual.motor.static_friction=2.3e-3",
    f"virtual.motor.torque_constant={TORQUE_CONSTANT}",
    "virtual.motor.torque_constant_temperature_coefficient=0",
    "virtual.amplifier.offset=0",
    "virtual.amplifier.offset_ripple=[]",
    "virtual.amplifier.gain_ripple=[]",
    "virtual.amplifier.saturation_ripple=[]",
    "virtual.eccentricity.offset=0",
)


def write_results(path, command, **results):
    """Write a run that holds nothing but results, (value, unit) or (value, unit, u) by name."""
    with RunWriter(path, command=command) as writer:
        writer.finish(
            {
                name: Quantity(value, unit, *(u or [0.0]))
                for name, (value, unit, *u) in results.items()
            },
            {},
        )
    return path


def write_kt(folder):
    """Write a run of calibrate-kt with the torque constant of these tests."""
    constant = (TORQUE_CONSTANT, "N m/A")
    gain = (1.0, "1")
    return write_results(
        folder / "kt.h5", "calibrate-kt", torque_constant_mean=constant, amplifier_gain=gain
    )


def run(procedure, source, output, *overrides, seed=None, **inputs):
    """Run a command's procedure from recipe or run file; inputs are paths by option."""
    options = CommonOptions(overwrite=True, seed=seed, overrides=overrides)
    with ExitStack() as stack:
        opened = {name: stack.enter_context(open_run(path)) for name, path in inputs.items()}
        outcome = run_command(procedure, [str(source)], str(output), options=options, inputs=opened)
    object.__setattr__(outcome, "path", output)  # where its signals are
    return outcome
