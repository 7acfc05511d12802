"""Drives of CiA 402: canopen's own node behind an slcan adapter, python-can at the host's end."""

import json
import time
from pathlib import Path

import canopen
import numpy as np
import pytest

from rigtool.errors import HardwareError, RecipeError
from rigtool.rigs import Feedforward, Task
from rigtool.rigs.motion import CurrentSteps, SpeedProfile
from rigtool.rigs.operator import Operator
from rigtool.rigs.serial import open_serial_rig
from rigtool.rigs.serial.drive import SetPoint
from rigtool.rigs.serial.drivers import driver
from rigtool.rigs.serial.hosted.rig import HostedRig
from rigtool.rigs.serial.ports import find_devices
from tests.cli.called import call
from tests.rigs.performed import perform
from tests.rigs.serial.emulators.canopen import (
    I16,
    RATED,
    U32,
    CiA402Emulator,
    Epos4CanEmulator,
)
from tests.rigs.serial.emulators.faults import Fault, serve
from tests.rigs.serial.recipes import serial_recipe

ROOT = Path(__file__).parents[4]
PERIOD = 0.01
FAST = Task(SpeedProfile((0.0, 0.1, 4.0), (0.0, 10.0, 10.0)))
TO_AND_FRO = Task(SpeedProfile((0.0, 0.05, 0.2, 0.3, 0.4), (0.0, 4.0, 4.0, -4.0, -4.0)))
KINDS = {"cia402": CiA402Emulator, "maxon-can": Epos4CanEmulator}
MOVING = {0x6040, 0x6071, 0x60B2, 0x60FF, 0x607A}


pytestmark = pytest.mark.usefixtures("short_blocks")


@pytest.fixture(params=KINDS)
def name(request):
    return request.param


def can_rig(port, *more, name="cia402", spy=None):
    recipe = serial_recipe(f"can:slcan:{port}", *more, driver=name, sample_time=PERIOD)
    operator = Operator(say=lambda text: None, present=False, yes=True, spy=spy)
    return HostedRig(recipe, 0.045, "test", operator, driver(name))


def test_motion_follows_its_set_points_and_settings_come_back(name):
    device = KINDS[name]()
    before = {place: device.value(*place) for place in device.kept if place[0] not in MOVING}
    with serve(device) as server:
        with can_rig(server.port, "serial.limits.current=2", name=name) as rig:
            found = perform(rig, TO_AND_FRO)
            assert device.limit() == pytest.approx(2.0, abs=RATED * 1e-3)
            assert device.value(0x1016, 1) == 0  # off, and not watched
        assert server.error is None
    off = found["encoder"] * 2 * np.pi / 4000 - found["position_setpoint"]
    assert np.abs(off).max() < 0.1
    assert device.log == ["on: velocity", "off"]
    assert {place: device.value(*place) for place in before} == before
    assert device.bit_rate == "S8"


@pytest.mark.parametrize(("mode", "objects"), [(9, {}), (3, {(0x607F, 0): (U32, 30_000)})])
def test_drive_turns_no_faster_than_its_own_limits(mode, objects):
    """40 rpm by 6080, 30 by the limit of profiles: 8 rad/s are 76 rpm."""
    device = CiA402Emulator(
        {(0x6502, 0): (U32, 1 << (mode - 1)), (0x6080, 0): (U32, 40), **objects}
    )
    device.motor.coulomb = device.motor.viscous = 0.0  # against which its loop would droop
    with serve(device) as server, can_rig(server.port) as rig:
        rig.drive.enable("velocity")
        for _ in range(40):
            rig.drive.step(SetPoint(speed=8.0))
            rig.line.pause(0.005)
        own = (30 if objects else 40) * 2 * np.pi / 60
        assert device.motor.speed == pytest.approx(own, rel=0.03)


def test_set_points_of_current_are_the_current(name):
    device = KINDS[name]()
    with serve(device) as server, can_rig(server.port, name=name) as rig:
        steps = Task(CurrentSteps((0.05, -0.04), 0.2))
        found = perform(rig, steps)
    late = found["time"] - found["time"][0]
    assert found["current"][(late > 0.1) & (late < 0.18)].mean() == pytest.approx(0.05, abs=2e-3)
    assert found["current"][late > 0.3].mean() == pytest.approx(-0.04, abs=2e-3)
    steady = found["current_setpoint"][(late > 0.1) & (late < 0.18)]
    assert steady.mean() == pytest.approx(0.05, abs=2e-3)


def test_drive_without_demand_does_not_report_it():
    device = CiA402Emulator({(0x6074, 0): (I16, None)})
    with serve(device) as server, can_rig(server.port) as rig:
        assert "does not report its current_setpoint" in rig.lacks("current_setpoint")
        assert np.isnan(perform(rig, TO_AND_FRO)["current_setpoint"]).all()


def test_feedforward_is_the_current_that_flows(name):
    device = KINDS[name]()
    device.motor.coulomb = 0.0
    with serve(device) as server, can_rig(server.port, name=name) as rig:
        rest = SpeedProfile((0.0, 0.4), (0.0, 0.0))
        # a load that holds the feed-forward's torque: the loops add nothing
        device.motor.load = 0.0045
        feedforward = Feedforward(signal=np.full(40, 0.0045))
        found = perform(rig, Task(rest, feedforward=feedforward))
    assert found["current"][20:].mean() == pytest.approx(0.1, abs=5e-3)


def test_watchdog_stops_a_drive_whose_cable_is_pulled(name):
    device = KINDS[name]()
    pulled = Fault("pull", at=250, towards="device")
    with (
        serve(device, pulled) as server,
        pytest.raises(HardwareError, match="the line is lost"),
        can_rig(server.port, name=name) as rig,
    ):
        perform(rig, FAST)
    assert device.mode == "velocity"
    begin = time.monotonic()
    while device.mode is not None and time.monotonic() - begin < 1.0:
        time.sleep(0.01)
        device.live()
    assert time.monotonic() - begin == pytest.approx(0.25, abs=0.03)
    assert device.log[-2:] == ["off", "fault 0x8130"]
    # the next session clears what the end of this one left
    with serve(device) as server, can_rig(server.port, name=name) as rig:
        perform(rig, TO_AND_FRO)
    assert "reset communication" in device.log


def test_host_that_stalls_is_reported_that_the_watchdog_acted():
    device = CiA402Emulator()
    with serve(device) as server, can_rig(server.port) as rig:
        rig.drive.enable("velocity")
        time.sleep(0.3)
        assert device.mode is None
        with pytest.raises(HardwareError, match="heard nothing for 250 ms"):
            rig.drive.step(SetPoint(speed=1.0))


def test_drive_without_consumer_of_heartbeats_needs_an_emergency_stop():
    bare = {(0x1016, 1): (U32, None)}
    with serve(CiA402Emulator(bare)) as server:
        with pytest.raises(RecipeError, match=r"watches no heartbeat \(1016\)"):
            can_rig(server.port).__enter__()
        with can_rig(server.port, "serial.emergency_stop=true") as rig:
            assert not rig.drive.abilities.watchdog
            perform(rig, TO_AND_FRO)


def test_drive_that_ignores_silence_is_named():
    device = CiA402Emulator({(0x6007, 0): (I16, None)})
    with serve(device) as server, can_rig(server.port) as rig:
        assert any("6007" in note for note in rig.notes)


@pytest.mark.parametrize(
    ("objects", "reported"),
    [
        ({(0x1000, 0): (U32, 0x000F0191)}, "is no drive of CiA 402"),
        ({(0x60A9, 0): (U32, None)}, "set serial.speed_unit_rpm"),
        ({(0x60A9, 0): (U32, 0x00010000)}, "unit of speed"),
        ({(0x6075, 0): (U32, 0)}, "rated current"),
        ({(0x6502, 0): (U32, 0x21)}, "none of the modes"),
        ({(0x608F, 1): (U32, 2000)}, "set to 2000 counts"),
    ],
)
def test_drive_that_cannot_be_measured_with_is_refused_before_anything_moves(objects, reported):
    device = CiA402Emulator(objects)
    with serve(device) as server, pytest.raises((HardwareError, RecipeError), match=reported):
        can_rig(server.port).__enter__()
    assert device.log == []


@pytest.mark.parametrize(
    ("supported", "modes"),
    [
        (0x3A5, {"velocity": 9, "current": 10}),
        (0x00D, {"velocity": 3, "current": 4}),
        (0x080, {"position": 8}),
    ],
)
def test_modes_are_those_that_the_drive_has(supported, modes):
    device = CiA402Emulator({(0x6502, 0): (U32, supported)})
    with serve(device) as server, can_rig(server.port, "rig.sample_time=0.02") as rig:
        assert rig.drive._modes == modes
        found = perform(rig, TO_AND_FRO)
        assert (rig.lacks("feedforward") is None) == (supported != 0x00D)
        assert "between two samples" in rig.lacks("held_current")
    off = found["encoder"] * 2 * np.pi / 4000 - found["position_setpoint"]
    assert np.abs(off).max() < 0.2


def test_foreign_fault_stays(name):
    device = KINDS[name]()
    device.fault(0x2310)
    with serve(device) as server, pytest.raises(HardwareError, match="the fault 0x2310"):
        can_rig(server.port, name=name).__enter__()
    assert device.state == "fault"


def test_fault_during_a_motion_ends_it(name):
    device = KINDS[name]()
    rate = device.live

    def hot():
        rate()
        if device.motor.position > 1.0 and device.state == "enabled":
            device.fault(0x4310)

    device.live = hot
    with (
        serve(device) as server,
        pytest.raises(HardwareError, match="the fault 0x4310"),
        can_rig(server.port, name=name) as rig,
    ):
        perform(rig, FAST)


def test_record_plays_back(tmp_path, name):
    spy = tmp_path / "line.spy"
    with serve(KINDS[name]()) as server, can_rig(server.port, name=name, spy=spy) as rig:
        found = perform(rig, TO_AND_FRO)
    recipe = serial_recipe(spy, driver="replay", sample_time=PERIOD)
    operator = Operator(say=lambda text: None, present=False, yes=True)
    with open_serial_rig(recipe, 0.045, "test", operator) as rig:
        again = perform(rig, TO_AND_FRO)
    for column, values in found.items():
        np.testing.assert_array_equal(values, again[column])


def test_lost_bytes_and_silence_are_repeated_and_counted():
    device = CiA402Emulator()
    faults = (Fault("lose", probability=2e-4, seed=5), Fault("silence", at=300, duration=0.02))
    with serve(device, *faults) as server, can_rig(server.port) as rig:
        found = perform(rig, TO_AND_FRO)
        counts = json.loads(rig.report())
    assert counts["retries"] > 0
    off = found["encoder"] * 2 * np.pi / 4000 - found["position_setpoint"]
    assert np.abs(off).max() < 0.2


def test_eds_of_the_maker_is_read(tmp_path):
    eds = tmp_path / "drive.eds"
    device = CiA402Emulator()
    with eds.open("w") as file:
        canopen.export_od(device.node.object_dictionary, file, "eds")
    with serve(device) as server:
        with can_rig(server.port, f'serial.eds="{eds}"') as rig:
            perform(rig, TO_AND_FRO)
        eds.write_text("no EDS")
        with pytest.raises(RecipeError, match="cannot be read as an EDS"):
            can_rig(server.port, f'serial.eds="{eds}"').__enter__()


def test_drive_is_found_by_asking_and_by_its_maker(name):
    with serve(KINDS[name]()) as server:
        (found,) = find_devices([f"can:slcan:{server.port}"])
    family = {"cia402": "CiA 402 drive", "maxon-can": "maxon EPOS4"}[name]
    assert found.driver == name
    assert found.identity == f"{family}, node 1, product 0x63500000, serial 0x1234"


@pytest.mark.parametrize(("port", "name"), [("/dev/null", "cia402"), ("can:slcan:x", "maxon")])
def test_driver_on_the_wrong_kind_of_port_is_refused(port, name):
    recipe = serial_recipe(port, driver=name)
    operator = Operator(say=lambda text: None, present=False, yes=True)
    with pytest.raises(RecipeError, match=r"serial\.port is"):
        HostedRig(recipe, 0.045, "test", operator, driver(name)).__enter__()


def test_current_at_a_steady_speed_is_that_of_friction(name):
    device = KINDS[name]()
    with serve(device) as server, can_rig(server.port, name=name) as rig:
        found = perform(rig, Task(SpeedProfile((0.0, 0.1, 0.5), (0.0, 8.0, 8.0))))
    steady = found["time"] - found["time"][0] > 0.3
    friction = (device.motor.coulomb + 8.0 * device.motor.viscous) / device.motor.torque_constant
    assert found["current"][steady].mean() == pytest.approx(friction, rel=0.02)


@pytest.mark.parametrize("name", ["cia402-drive", "maxon-epos4-can"])
def test_what_would_move_with_a_shipped_recipe_is_reported(name, tmp_path, capsys):
    recipe, kt = ROOT / "recipes" / f"{name}.toml", ROOT / "tests" / "fixtures" / "kt.h5"
    arguments = [recipe, "-o", tmp_path / "r.h5", "--dry-run"]
    code, out, err = call(capsys, "stribeck", *arguments, "--kt", kt)
    assert code == 0, err
    assert "Within the limits 2 A, 40 rad/s" in out
    code, out, err = call(capsys, "calibrate-kt", *arguments)
    assert code == 0, err
