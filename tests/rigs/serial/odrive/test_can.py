"""An ODrive over CANSimple, python-can's slcan between."""

import time

import numpy as np
import pytest

from rigtool.errors import HardwareError, RecipeError
from rigtool.rigs import Feedforward, Task
from rigtool.rigs.motion import CurrentSteps, SpeedProfile
from rigtool.rigs.operator import Operator
from rigtool.rigs.serial import open_serial_rig
from rigtool.rigs.serial.hosted.rig import HostedRig
from rigtool.rigs.serial.odrive import can
from rigtool.rigs.serial.ports import find_devices
from tests.rigs.performed import perform
from tests.rigs.serial.emulators.can_drives import IDLE, ODriveCanEmulator
from tests.rigs.serial.emulators.faults import Fault, serve
from tests.rigs.serial.recipes import serial_recipe

PERIOD = 0.01
CONSTANT = "serial.drive_torque_constant=0.045"
TO_AND_FRO = Task(SpeedProfile((0.0, 0.05, 0.2, 0.3, 0.4), (0.0, 4.0, 4.0, -4.0, -4.0)))
FAST = Task(SpeedProfile((0.0, 0.1, 4.0), (0.0, 10.0, 10.0)))
STEPS = Task(CurrentSteps((0.1, -0.08), 0.2))
QUIET = Operator(say=lambda text: None, present=False, yes=True)


pytestmark = pytest.mark.usefixtures("short_blocks")


@pytest.fixture(params=[False, True], ids=["0.5", "0.6"])
def device(request):
    return ODriveCanEmulator(new=request.param)


def can_rig(port, *more, operator=QUIET):
    recipe = serial_recipe(
        f"can:slcan:{port}", *(more or [CONSTANT]), driver="odrive-can", sample_time=PERIOD
    )
    return HostedRig(recipe, 0.045, "test", operator, can.DRIVER)


def test_motion_follows_its_set_points(device):
    with serve(device) as server, can_rig(server.port) as rig:
        found = perform(rig, TO_AND_FRO)
        assert device.limits == pytest.approx((60 / (2 * np.pi), 10.0), rel=1e-6)
        assert server.error is None
    off = found["encoder"] * 2 * np.pi / 4000 - found["position_setpoint"]
    assert np.abs(off).max() < 0.1
    assert device.log == ["reset", "state 8", "state 1"]
    assert device.bit_rate == "S5"


@pytest.mark.parametrize("direction", [1, -1])
def test_set_points_of_current_are_the_current(direction):
    device = ODriveCanEmulator(direction=direction)
    constant = f"serial.drive_torque_constant={0.045 * direction}"
    with serve(device) as server, can_rig(server.port, constant) as rig:
        found = perform(rig, STEPS)
    at = found["time"] - found["time"][0]
    assert found["current"][(at > 0.1) & (at < 0.18)].mean() == pytest.approx(0.1, abs=2e-3)
    assert found["current"][at > 0.3].mean() == pytest.approx(-0.08, abs=2e-3)


@pytest.mark.parametrize("constant", [0.03, -0.045])
def test_wrong_torque_constant_is_seen_in_the_current(constant):
    with (
        serve(ODriveCanEmulator()) as server,
        pytest.raises(HardwareError, match=r"not serial.drive_torque_constant = .* but 0.045"),
        can_rig(server.port, f"serial.drive_torque_constant={constant}") as rig,
    ):
        perform(rig, STEPS)


def test_feedforward_is_the_current_that_flows(device):
    device.motor.coulomb, device.motor.load = 0.0, 0.0045
    with serve(device) as server, can_rig(server.port) as rig:
        feedforward = Feedforward(signal=np.full(40, 0.0045))
        found = perform(rig, Task(SpeedProfile((0.0, 0.4), (0.0, 0.0)), feedforward=feedforward))
    assert found["current"][20:].mean() == pytest.approx(0.1, abs=5e-3)


def test_pulled_cable_is_stopped_by_the_watchdog(device):
    with (
        serve(device, Fault("pull", at=150, towards="device")) as server,
        pytest.raises(HardwareError, match="the line is lost"),
        can_rig(server.port) as rig,
    ):
        perform(rig, FAST)
    time.sleep(0.25)
    device.live()
    assert device.state == IDLE
    assert device.log[-1] == "watchdog"


def test_drive_whose_watchdog_is_off_needs_an_emergency_stop():
    device = ODriveCanEmulator(watchdog=None)
    with serve(device) as server:
        with pytest.raises(RecipeError, match=r"did not run out in 0\.25 s of silence"):
            can_rig(server.port).__enter__()
        with can_rig(server.port, CONSTANT, "serial.emergency_stop=true") as rig:
            assert not rig.drive.abilities.watchdog
            perform(rig, TO_AND_FRO)
    assert device.log == ["reset", "state 8", "state 1"]


def test_torque_constant_must_be_stated():
    with (
        serve(ODriveCanEmulator()) as server,
        pytest.raises(RecipeError, match=r"serial\.drive_torque_constant is missing"),
    ):
        can_rig(server.port, "serial.node=0").__enter__()


@pytest.mark.parametrize(
    ("new", "error", "reported"),
    [
        (False, 0x40, "MOTOR_FAILED"),
        (True, 0x20000, "REQUESTED_CURRENT_TOO_HIGH"),
        (True, 0x400000, "0x400000"),
    ],
)
def test_fault_is_named_and_stays(new, error, reported):
    device = ODriveCanEmulator(new=new)
    device.error = error
    with serve(device) as server, pytest.raises(HardwareError, match=f"reports {reported}"):
        can_rig(server.port).__enter__()
    assert device.error & error


def test_error_of_the_encoder_is_named_where_the_axis_reports_none():
    device = ODriveCanEmulator()
    device.encoder_flag = 1
    with serve(device) as server, pytest.raises(HardwareError, match="reports encoder error"):
        can_rig(server.port).__enter__()


def test_axis_that_is_not_calibrated_does_not_close_its_loop(device):
    device.calibrated = False
    with (
        serve(device) as server,
        pytest.raises(HardwareError, match="are motor and encoder calibrated"),
        can_rig(server.port) as rig,
    ):
        perform(rig, TO_AND_FRO)


def test_reset_during_a_motion_ends_it(device):
    with (
        serve(device, Fault("reset", at=150, towards="device")) as server,
        pytest.raises(HardwareError, match=r"instead of its closed loop|no valid reply"),
        can_rig(server.port) as rig,
    ):
        perform(rig, FAST)


def test_silent_bus_is_reported():
    device = ODriveCanEmulator()
    device.live = lambda: None
    with serve(device) as server, pytest.raises(HardwareError, match="no heartbeat of node 0"):
        can_rig(server.port).__enter__()


def test_thermistor_of_0_6_is_read():
    device = ODriveCanEmulator(new=True, thermistor=True)
    with serve(device) as server, can_rig(server.port) as rig:
        assert rig.lacks("temperature") is None
        assert perform(rig, TO_AND_FRO)["temperature"] == pytest.approx(31.25)


def test_record_plays_back(tmp_path, device):
    spy = tmp_path / "line.spy"
    operator = Operator(say=lambda text: None, present=False, yes=True, spy=spy)
    with serve(device) as server, can_rig(server.port, operator=operator) as rig:
        found = perform(rig, TO_AND_FRO)
    recipe = serial_recipe(spy, CONSTANT, driver="replay", sample_time=PERIOD)
    with open_serial_rig(recipe, 0.045, "test", QUIET) as rig:
        again = perform(rig, TO_AND_FRO)
    for column, values in found.items():
        np.testing.assert_array_equal(values, again[column])


def test_drive_is_found_by_its_heartbeat(device):
    with serve(device) as server:
        (found,) = find_devices([f"can:slcan:{server.port}"], ["odrive-can"])
    assert (found.driver, found.identity) == ("odrive-can", "ODrive, node 0")
