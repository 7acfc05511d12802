"""What a loop that the host drives reads of friction and load, against what the motor has.

In emulated time: the only error left is that of the method.
"""

import json
import math

import numpy as np
import pytest

from rigtool.errors import HardwareError, RecipeError
from rigtool.experiments.friction.holds import find_holds, pool
from rigtool.experiments.friction.procedure import hold_profile
from rigtool.experiments.friction.stribeck_fit import fit_direction
from rigtool.recipe.commands import Stribeck
from rigtool.rigs import Feedforward, Task
from rigtool.rigs.motion import SpeedProfile
from rigtool.rigs.operator import Operator
from rigtool.rigs.serial.drive import Abilities
from rigtool.rigs.serial.drivers import Driver
from rigtool.rigs.serial.emulators import server
from rigtool.rigs.serial.hosted.rig import HostedRig
from rigtool.rigs.serial.maxon import driver as maxon
from rigtool.rigs.serial.moteus import driver as moteus
from rigtool.rigs.serial.odrive import driver as odrive
from tests.rigs.performed import perform
from tests.rigs.serial import toy
from tests.rigs.serial.emulators.maxon import Epos4Emulator
from tests.rigs.serial.emulators.moteus import MoteusEmulator
from tests.rigs.serial.emulators.odrive import ODriveEmulator
from tests.rigs.serial.recipes import serial_recipe
from tests.thorough import thorough

CONSTANT = 0.045
COUNT = 2 * math.pi / 4000
DRIVES = {
    "toy": (toy.ToyEmulator, toy.make_drive),
    "odrive": (ODriveEmulator, odrive.make_drive),
    "moteus": (MoteusEmulator, moteus.make_drive),
    "maxon": (Epos4Emulator, maxon.make_drive),
}
HOLD = Task(SpeedProfile((0.0, 0.2, 1.2), (0.0, 12.0, 12.0)))


class PositionsOnly(toy.ToyDrive):
    """Takes positions, and stands still between them as far as its set point goes."""

    abilities = Abilities(frozenset({"position"}), True, frozenset({"current", "current_setpoint"}))


def make_positions_only(line, recipe):
    return PositionsOnly(line)


def emulated(world, name, period, *more, make_drive=None, delay=3e-4):
    make_device, usual = DRIVES[name]
    world.delay, world.tick = delay, 0.02  # a motor that is asked turns up to then all the same
    device = make_device()
    line = server.PtyServer(device)  # that of emulated time
    line.start()
    driver = "odrive" if name == "toy" else name
    recipe = serial_recipe(line.port, *more, driver=driver, sample_time=period)
    operator = Operator(say=lambda text: None, present=False, yes=True)
    make_drive = make_drive or usual
    rig = HostedRig(recipe, CONSTANT, "test", operator, Driver(toy.probe, (115200,), make_drive))
    return device, rig


def friction_fits(rig, **settings):
    parts = []
    for direction in (1, -1):
        got = perform(rig, Task(hold_profile(Stribeck(speed_max=30, **settings), direction)))
        parts.append(
            find_holds(
                time=got["time"],
                angle=got["encoder"] * COUNT,
                torque=CONSTANT * got["current_setpoint"],
                setpoint=got["position_setpoint"],
                inertia=1.5e-5,
            )
        )
    holds = pool(parts)
    for sign in (1, -1):
        k = holds.speed * sign > 0
        yield fit_direction(holds.speed[k] * sign, holds.torque[k] * sign, holds.u[k])


@pytest.mark.parametrize(
    ("name", "period", "delay", "tolerance"),
    [
        ("toy", 0.01, 3e-4, 1e-3),
        *thorough(
            ("toy", 0.004, 8e-4, 1e-3),
            ("odrive", 0.004, 3e-4, 1e-3),
            ("moteus", 0.004, 3e-4, 1e-3),
            ("moteus", 0.01, 8e-4, 1e-3),
        ),
        # It reports current in mA, 45 uN m: half of that over 28 rad/s is 3 % of viscous friction.
        ("maxon", 0.02, 3e-4, 0.03),
    ],
)
def test_viscous_friction_is_that_of_the_motor(world, name, period, delay, tolerance):
    device, rig = emulated(world, name, period, delay=delay)
    with rig:
        fits = list(friction_fits(rig, hold_speeds=(5, 10, 20, 30), hold_time=0.5))
    for fit in fits:
        assert fit.viscous[0] == pytest.approx(device.motor.viscous, rel=tolerance)
        assert fit.coulomb[0] == pytest.approx(device.motor.coulomb, rel=tolerance)


def test_a_drive_that_follows_steps_of_position_reads_friction_that_is_not_there(world):
    """And what was read between the set points says by how much, within a tenth."""
    device, rig = emulated(world, "toy", 0.01, make_drive=make_positions_only)
    with rig:
        got = perform(rig, HOLD)
        facts = json.loads(rig.report())
    steady = got["time"] - got["time"][0] > 0.6
    friction = (device.motor.coulomb + device.motor.viscous * 12.0) / CONSTANT
    lacking = friction - got["current_setpoint"][steady].mean()
    assert lacking < -3 * friction
    (found,) = facts["between_set_points"]
    assert facts["steps_in_position"]
    assert found["speed"] == 12.0
    assert found["lacking_current"] == pytest.approx(lacking, rel=0.1)


@pytest.mark.parametrize("name", DRIVES)
def test_current_is_the_same_all_through_the_period(world, name):
    device, rig = emulated(world, name, 0.02)
    with rig:
        perform(rig, Task(SpeedProfile((0.0, 0.2, 3.2), (0.0, 12.0, 12.0))))
        facts = json.loads(rig.report())
    (found,) = facts["between_set_points"]
    friction = (device.motor.coulomb + device.motor.viscous * 12.0) / CONSTANT
    assert abs(found["lacking_current"]) < 3 * found["u"] < 0.06 * friction
    assert found["readings"] > 30
    assert not facts["steps_in_position"]


def test_steps_of_position_need_a_line_that_shows_them(world):
    options = {"make_drive": make_positions_only, "delay": 1.5e-3}
    with pytest.raises(RecipeError, match=r"two readings and a half, .* takes 7\.50 ms .* 0\.02 s"):
        emulated(world, "toy", 0.005, **options)[1].__enter__()


def test_a_single_repeated_reading_does_not_refuse_a_good_line(world):
    """It costs 50 ms, and 40 readings have 160: their mean would be beyond the period."""
    device, rig = emulated(world, "toy", 0.002, "serial.watchdog=0.25")
    answer, asked = device.receive, []

    def receive(data):
        asked.append(data)
        return b"" if len(asked) == 20 else answer(data)

    device.receive = receive
    with rig:
        assert rig.line.counts.retries == 1


SLOW_HOST, SLOW_LINE = "this computer did not let rigtool run", "exchanges with the drive took"


def test_a_loop_that_is_late_says_that_this_computer_stalled(world):
    world.stalls = {0.7: 0.3}
    device, rig = emulated(world, "toy", 0.004)
    with rig, pytest.raises(HardwareError, match=rf"late after \d+ .* for 300 ms .*{SLOW_HOST}"):
        perform(rig, HOLD)
    assert device.mode is None


def test_a_loop_that_is_late_says_that_the_line_is_slow(world):
    device, rig = emulated(world, "toy", 0.004)
    with rig:
        running = rig.perform(HOLD)
        next(running)
        world.delay = 0.01
        with pytest.raises(HardwareError, match=rf"late after \d+ .*{SLOW_LINE} \d+ ms more than"):
            list(running)
    assert device.mode is None


def test_a_busy_computer_skips_set_points_and_the_motion_ends_in_time(world):
    world.stalls = {0.5 + n: 0.22 for n in range(6)}
    _, rig = emulated(world, "toy", 0.004)
    with rig:
        got = perform(rig, Task(SpeedProfile((0.0, 1.0, 6.0, 7.0), (0.0, 1.0, 1.0, 0.0))))
        facts = json.loads(rig.report())
    assert 6 * 53 <= facts["skipped_samples"] <= 6 * 56
    assert len(got["time"]) + facts["skipped_samples"] == 1750
    assert got["time"][-1] - got["time"][0] == pytest.approx(7.0, abs=0.02)
    assert facts["longest_gap_s"] == pytest.approx(0.22, abs=0.02)
    wanted = np.interp(got["time"] - got["time"][0], [0, 1, 6, 7], [0, 0.5, 5.5, 6.0])
    assert np.abs(got["position_setpoint"] - got["position_setpoint"][0] - wanted).max() < 0.2


def test_a_signal_with_a_sample_for_each_tick_skips_none(world):
    world.stalls = {0.5: 0.1}
    _, rig = emulated(world, "toy", 0.004)
    excited = Feedforward(signal=np.zeros(250))
    with rig:
        got = perform(rig, Task(SpeedProfile((0.0, 1.0, 2.0), (0.0, 1.0, 0.0)), excited))
        facts = json.loads(rig.report())
    assert facts["skipped_samples"] == 0
    assert len(got["time"]) == 500
    assert facts["late_samples"] > 10
