"""measure-force and stribeck through a loop that the host drives: true, or refused."""

import math
from contextlib import ExitStack

import numpy as np
import pytest

from rigtool.control.lookup_table import LookupTable
from rigtool.errors import InsufficientDataError
from rigtool.experiments.force.procedure import PROCEDURE as MEASURE_FORCE
from rigtool.experiments.friction.procedure import PROCEDURE as STRIBECK
from rigtool.experiments.learning.rows import Amplitudes
from rigtool.experiments.learning.stored_table import tables_of
from rigtool.quantity import Quantity
from rigtool.runfile import RunWriter, open_run
from tests.rigs.serial.hosted.test_hosted_bias import CONSTANT, emulated, make_positions_only
from tests.thorough import first_of, thorough

PULLEY = "rig.attachment=pulley"
FORCES = (0.25, 1.0, 2.5)


@pytest.fixture
def chain(tmp_path):
    """Return a function that runs a command on an emulated rig: its run, and the motor's truth."""
    with ExitStack() as stack:

        def written(command, recipe, results, tables, used=()):
            path = tmp_path / f"{command}.h5"
            options = {"command": command, "recipe": recipe, "recipe_text": "", "inputs": used}
            with RunWriter(path, overwrite=True, **options) as writer:
                writer.finish(results, tables)
            return stack.enter_context(open_run(path))

        def inputs(recipe, procedure):
            constants = {
                "torque_constant_mean": Quantity(CONSTANT, "N m/A", 0.0),
                "amplifier_gain": Quantity(1.0, "1", 0.0),
            }
            kt = written("calibrate-kt", recipe, constants, {})
            if procedure is STRIBECK:
                return {"kt": kt}
            top = 2 * math.pi * recipe.measure_force.speed_rev_per_s
            speed, position = np.array([-top, top]), np.linspace(0, math.pi, 100)
            low, amplitude = np.array([0.0, top]), np.array([0.0, 1.0])
            nothing = np.zeros((2, 100))
            table = LookupTable(position, speed, nothing, low, amplitude)
            lookup = tables_of(
                table, nothing, Amplitudes.fading(low[-1]), np.full(len(table.speed), np.inf)
            )
            return {"kt": kt, "tables": written("ilc-learn", recipe, {}, lookup, [kt])}

        def run(procedure, device, rig):
            recipe = rig._recipe
            used = inputs(recipe, procedure)
            rig._set_load = lambda load: setattr(device.motor, "load", load.force * 0.014)
            path = tmp_path / "run.h5"
            options = {"command": procedure.command, "recipe": recipe, "recipe_text": ""}
            plan = procedure.recordings(recipe)
            with RunWriter(path, overwrite=True, recordings=plan, **options) as writer:
                with rig:
                    procedure.measure(rig, recipe, writer, **used)
                report = rig.report()
                writer.note_line(report)
                recorded = writer.recorded()
                recorded.provenance["line"] = report
                outcome = procedure.analyse([recorded], recipe, **used)
                writer.finish(outcome.results, outcome.tables, outcome.notes)
            with open_run(path) as stored:  # says the same once it is stored
                again = procedure.analyse([stored], recipe, **used)
            assert again.notes == outcome.notes
            assert again.results == outcome.results
            return outcome

        yield run


SLOW_LOOP = (
    PULLEY,
    "serial.watchdog=0.5",
    "rig.controller.crossover_hz=2",
    "rig.controller.lowpass_hz=10",
    "rig.controller.integrator_hz=0.2",
    f"measure_force.forces={list(FORCES)}",
    "measure_force.cycles=3",
    "measure_force.record_every=1",
)


def force_rig(world, name, period, rev_per_s, *more, **options):
    speed = f"measure_force.speed_rev_per_s={rev_per_s}"
    return emulated(world, name, period, *SLOW_LOOP, speed, *more, **options)


@pytest.mark.parametrize(
    ("name", "period", "rev_per_s", "stiffness"),
    [
        ("toy", 0.01, 1.0, 0.2),  # steps of speed make 4 mN m while it turns around
        ("maxon", 0.01, 1.0, 0.06),
        *thorough(
            ("moteus", 0.01, 0.5, 0.06),
            ("toy", 0.01, 1.0, 0.06),
            ("toy", 0.01, 0.4, 0.06),
            ("toy", 0.004, 1.0, 0.06),
            ("odrive", 0.004, 1.0, 0.2),
            ("odrive", 0.004, 2.0, 0.06),
            ("moteus", 0.004, 2.0, 0.06),
            ("maxon", 0.02, 0.5, 0.06),
        ),
    ],
)
def test_loads_and_friction_are_within_their_uncertainty(
    world, chain, name, period, rev_per_s, stiffness
):
    device, rig = force_rig(world, name, period, rev_per_s)
    device.motor.gain_speed = stiffness
    outcome = chain(MEASURE_FORCE, device, rig)
    loads = outcome.tables["loads"]
    assert (np.abs(loads["error_torque"][1:]) <= 2 * loads["mean_torque_u"][1:] + 1e-9).all()
    assert (np.abs(loads["error_percent"][1:]) < 2.5).all()
    motor, read = device.motor, outcome.results["mean_torque_no_load"]
    friction = motor.coulomb + motor.viscous * 2 * math.pi * rev_per_s
    assert abs(read.value - friction) <= 2 * read.u + 1e-9
    assert read.u < 0.15 * friction


@pytest.mark.parametrize(
    ("period", "rev_per_s", "why"),
    [
        (0.01, 2.0, r"recording load_003: the output passes 90 deg at .* \(limit: 30 % off\)"),
        (0.004, 4.0, r"go up and down 3\.27 times a second, .* of 5 Hz lets 2\.5 pass: set"),
    ],
)
def test_loads_that_are_moved_too_fast_are_refused(world, chain, period, rev_per_s, why):
    with pytest.raises(InsufficientDataError, match=why):
        chain(MEASURE_FORCE, *force_rig(world, "toy", period, rev_per_s))


@pytest.mark.parametrize(
    ("period", "rev_per_s", "lowpass_hz", "gain"),
    first_of([(0.01, 2.0, 15, 30), (0.004, 4.0, 30, 60)]),
)
def test_fast_loads_are_read_with_a_low_pass_and_a_gain_that_fit(
    world, chain, period, rev_per_s, lowpass_hz, gain
):
    more = (
        f"measure_force.lowpass_hz={lowpass_hz}",
        f"serial.position_gain={gain}",
        "measure_force.cycles=5",
    )
    device, rig = force_rig(world, "toy", period, rev_per_s, *more)
    loads = chain(MEASURE_FORCE, device, rig).tables["loads"]
    assert (np.abs(loads["error_torque"][1:]) <= 2 * loads["mean_torque_u"][1:]).all()
    assert (np.abs(loads["error_percent"][1:]) < 1.5).all()


def test_steps_of_position_are_in_the_uncertainty_or_refused(world, chain):
    options = {"make_drive": make_positions_only}
    device, rig = force_rig(world, "toy", 0.01, 0.4, **options)
    outcome = chain(MEASURE_FORCE, device, rig)
    read = outcome.results["mean_torque_no_load"]
    friction = device.motor.coulomb + device.motor.viscous * 0.8 * math.pi
    assert read.value > 1.5 * friction  # it is wrong,
    assert abs(read.value - friction) < 2 * read.u  # and known to be
    assert any("mN m at the output, which is in the uncertainty" in n for n in outcome.notes)
    with pytest.raises(InsufficientDataError, match=r"13\.\d mN m .* more than 3\.5 mN m, 10 % of"):
        chain(MEASURE_FORCE, *force_rig(world, "toy", 0.01, 2.0, **options))


HOLDS = (
    "rig.controller.crossover_hz=2",
    "rig.controller.lowpass_hz=10",
    "stribeck.speed_max=30",
    "stribeck.hold_speeds=[5, 10, 20, 30]",
    "stribeck.hold_time=0.5",
    "stribeck.hold_revolutions=1",
    "stribeck.sweep_time=3",
    "stribeck.breakaway_positions=3",
    "stribeck.breakaway_rate=0.004",
    "stribeck.radial_force=0",
    "stribeck.record_every=1",
    "serial.watchdog=0.5",
)


@pytest.mark.parametrize(
    ("name", "period", "u"),
    [
        ("toy", 0.01, 0.01),
        *thorough(
            ("maxon", 0.02, 0.05),
            ("toy", 0.004, 0.01),
            ("odrive", 0.01, 0.01),
            ("moteus", 0.01, 0.01),
        ),
    ],
)
def test_friction_is_within_its_uncertainty(world, chain, name, period, u):
    """`u`: viscous friction is as uncertain, relative, with drives that report it or do not."""
    device, rig = emulated(world, name, period, *HOLDS)
    found = chain(STRIBECK, device, rig).results
    for result, truth in (
        ("viscous_friction", device.motor.viscous),
        ("coulomb_friction", device.motor.coulomb),
    ):
        read = found[result]
        assert abs(read.value - truth) <= 2 * read.u + 1e-3 * truth
        assert read.u < u * truth


def test_friction_by_steps_of_position_is_refused(world, chain):
    device, rig = emulated(world, "toy", 0.01, *HOLDS, make_drive=make_positions_only)
    with pytest.raises(
        InsufficientDataError, match=r"torque between set points .* 10 % of the torque"
    ):
        chain(STRIBECK, device, rig)
