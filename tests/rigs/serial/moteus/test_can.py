"""A moteus on CAN FD: the driver of the fdcanusb, frames by python-can."""

import numpy as np
import pytest

from rigtool.errors import HardwareError, RecipeError
from rigtool.rigs import Task
from rigtool.rigs.motion import SpeedProfile
from rigtool.rigs.operator import Operator
from rigtool.rigs.serial import open_serial_rig
from rigtool.rigs.serial.drive import SetPoint
from rigtool.rigs.serial.hosted.rig import HostedRig
from rigtool.rigs.serial.line import Line
from rigtool.rigs.serial.moteus import can
from rigtool.rigs.serial.ports import find_devices
from tests.rigs.performed import perform
from tests.rigs.serial.emulators.can_drives import MoteusCanEmulator
from tests.rigs.serial.emulators.faults import Fault, serve
from tests.rigs.serial.recipes import serial_recipe

PERIOD = 0.01
TO_AND_FRO = Task(SpeedProfile((0.0, 0.05, 0.2, 0.3, 0.4), (0.0, 4.0, 4.0, -4.0, -4.0)))
QUIET = Operator(say=lambda text: None, present=False, yes=True)


pytestmark = pytest.mark.usefixtures("short_blocks")


def can_rig(port, *more, operator=QUIET):
    recipe = serial_recipe(
        f"can:slcan:{port}?fd=true", *more, driver="moteus-can", sample_time=PERIOD
    )
    return HostedRig(recipe, 0.045, "test", operator, can.DRIVER)


def test_motion_follows_and_settings_come_back():
    device = MoteusCanEmulator()
    before = dict(device.device.config)
    with serve(device) as server, can_rig(server.port) as rig:
        assert "CAN FD" in rig.report()
        found = perform(rig, TO_AND_FRO)
        assert server.error is None
    off = found["encoder"] * 2 * np.pi / 4000 - found["position_setpoint"]
    assert np.abs(off).max() < 0.1
    assert device.device.config == pytest.approx(before, nan_ok=True, rel=1e-6)


def test_record_plays_back(tmp_path):
    spy = tmp_path / "line.spy"
    operator = Operator(say=lambda text: None, present=False, yes=True, spy=spy)
    with serve(MoteusCanEmulator()) as server, can_rig(server.port, operator=operator) as rig:
        found = perform(rig, TO_AND_FRO)
    recipe = serial_recipe(spy, driver="replay", sample_time=PERIOD)
    with open_serial_rig(recipe, 0.045, "test", QUIET) as rig:
        again = perform(rig, TO_AND_FRO)
    for column, values in found.items():
        np.testing.assert_array_equal(values, again[column])


def test_silent_host_is_noticed_by_the_watchdog(world):
    device = MoteusCanEmulator()
    with serve(device) as server, can_rig(server.port) as rig:
        rig.drive.enable("velocity")
        world.sleep(0.3)
        assert device.device.log[-1] == "watchdog"
        with pytest.raises(HardwareError, match="its watchdog received nothing"):
            rig.drive.step(SetPoint(speed=1.0))


def test_lost_frames_are_asked_again():
    faults = (Fault("lose", probability=1e-4, seed=3), Fault("silence", at=900, duration=0.06))
    with serve(MoteusCanEmulator(), *faults) as server, can_rig(server.port) as rig:
        perform(rig, TO_AND_FRO)
        assert rig.line.counts.retries > 0


def test_bus_without_fd_is_refused_and_not_asked():
    with serve(MoteusCanEmulator()) as server:
        port = f"can:slcan:{server.port}"
        recipe = serial_recipe(port, driver="moteus-can", sample_time=PERIOD)
        with pytest.raises(RecipeError, match=r"CAN FD alone: .*\?fd=true"):
            HostedRig(recipe, 0.045, "test", QUIET, can.DRIVER).__enter__()
        (found,) = find_devices([port], ["moteus-can"])
        assert found.driver == ""
        (found,) = find_devices([f"{port}?fd=true"], ["moteus-can"])
        assert found.identity.startswith("moteus 1, model 0x220")


def test_table_is_read_over_the_bus():
    device = MoteusCanEmulator(motor__cogging_dq_scale=0.5)
    recipe = serial_recipe("can:slcan:x?fd=true", driver="moteus-can")
    with serve(device) as server, Line(f"can:slcan:{server.port}?fd=true", 1_000_000) as line:
        store = can.DRIVER.table_store(can.make_drive(line, recipe))
        assert store.connect().startswith("moteus 1")
        assert store.link.number("motor.cogging_dq_scale") == 0.5
