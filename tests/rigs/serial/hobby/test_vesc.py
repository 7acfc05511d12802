"""VESC by its frames, over a line, followed by the host's own loop."""

import json
import math
import struct

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from rigtool.errors import HardwareError, RecipeError
from rigtool.rigs import Feedforward, Task
from rigtool.rigs.motion import CurrentSteps, Triangle
from rigtool.rigs.serial.hobby import vesc
from rigtool.rigs.serial.hosted.rig import HostedRig
from rigtool.rigs.serial.ports import find_devices
from tests.rigs.performed import perform, require_replayed
from tests.rigs.serial.emulators.faults import Fault, serve
from tests.rigs.serial.emulators.vesc import VescEmulator
from tests.rigs.serial.hobby.test_simplefoc import BRIEF, LOOP, QUIET
from tests.rigs.serial.recipes import serial_recipe
from tests.rigs.serial.target.test_driver_faults import wait_until

TO_AND_FRO = Task(Triangle(-1.0, 9.0, 8.0, 1.0, cycles=1), Feedforward(1.5e-5, 2.3e-3, 5e-5))


def vesc_rig(port, *more, operator=QUIET):
    recipe = serial_recipe(port, *LOOP[1:], *more, driver="vesc", sample_time=0.004)
    return HostedRig(recipe, 0.045, "test", operator, vesc.DRIVER)


@pytest.mark.parametrize(
    ("payload", "sent"),
    [
        (b"\4", "02 01 04 40 84 03"),
        (b"\0", "02 01 00 00 00 03"),
        (b"\x1e", "02 01 1e f3 ff 03"),
        (struct.pack(">Bi", 6, 1500), "02 05 06 00 00 05 dc 38 81 03"),
    ],
)
def test_frames_are_those_of_other_programs(payload, sent):
    assert vesc.frame(payload) == bytes.fromhex(sent)


@given(st.binary(min_size=1, max_size=512), st.data())
def test_the_emulator_takes_whole_frames_and_nothing_else(payload, data):
    device = VescEmulator()
    frame = bytearray(vesc.frame(payload))
    device.buffer = bytes(frame)
    assert device.next_frame() == payload
    frame[data.draw(st.integers(0, len(frame) - 1))] ^= 1 << data.draw(st.integers(0, 7))
    device.buffer = bytes(frame)
    assert device.next_frame() != payload


def test_devices_finds_it():
    with serve(VescEmulator()) as server:
        (found,) = find_devices([server.port], ["vesc"])
    assert found.identity == "VESC 60_MK6, firmware 6.05, UUID 000102030405060708090a0b"


def test_a_motion_over_turns_is_followed_and_the_limits_come_back():
    device = VescEmulator()
    before = device.limits
    with serve(device) as server, vesc_rig(server.port, "serial.limits.speed=40") as rig:
        assert device.limits[3] == pytest.approx(40 / 0.8 * 30 / math.pi * 7, rel=1e-6)
        assert rig.lacks("table") is None
        got = perform(rig, TO_AND_FRO)
        facts = json.loads(rig.report())
    angle = got["encoder"] * 2 * np.pi / 4000
    assert np.abs(angle - got["position_setpoint"]).max() < 0.3
    assert np.ptp(angle) > 9.5
    assert np.isfinite(got["temperature"]).all()
    assert facts["retries"] == facts["late_samples"] == 0
    assert device.limits == before
    assert device.mode is None
    assert server.error is None


def test_current_is_stepped_and_measured():
    with serve(VescEmulator()) as server, vesc_rig(server.port) as rig:
        got = perform(rig, Task(CurrentSteps((0.0, 0.02, 0.04), 0.1)))
    assert set(got["current_setpoint"]) == {0.0, 0.02, 0.04}
    settled = got["current_setpoint"] == 0.04
    assert got["current"][settled][2:] == pytest.approx(0.04, abs=0.011)  # in steps of 10 mA


@pytest.mark.parametrize(
    ("device", "error", "message"),
    [
        (VescEmulator(timeout=1.0), RecipeError, r"timeout is longer than .* 0.25 s, or off"),
        (VescEmulator(timeout=0.0), RecipeError, r"timeout is longer than .* 0.25 s, or off"),
        (VescEmulator(old=True), HardwareError, "update its firmware"),
        (VescEmulator(poles=0), HardwareError, "set the number of poles"),
    ],
)
def test_what_cannot_be_driven_is_refused_before_anything_moves(device, error, message):
    if device.poles == 0:
        device.poles = 14
    with serve(device) as server, pytest.raises(error, match=message), vesc_rig(server.port):
        pass
    assert "running" not in device.log
    assert device.limits[3] == 1e5


def test_a_node_behind_it_is_refused():
    with (
        serve(VescEmulator()) as server,
        pytest.raises(RecipeError, match="none behind it on CAN"),
        vesc_rig(server.port, "serial.node=3"),
    ):
        pass


def test_a_motor_without_thermistor_reports_no_temperature():
    with serve(VescEmulator(thermistor=False)) as server, vesc_rig(server.port) as rig:
        assert "does not report its temperature" in rig.lacks("temperature")


def test_questions_do_not_keep_a_motor_on():
    device = VescEmulator()
    with serve(device) as server, vesc_rig(server.port) as rig:
        rig.permit("")
        rig.drive.enable("current")
        rig.drive._ask_state(0.2)
        assert device.mode == "current"
        begin = rig.line.now()
        while device.mode is not None:
            rig.drive.read()
        assert rig.line.now() - begin == pytest.approx(device.timeout, abs=0.03)


def test_wrong_poles_are_noticed():
    device = VescEmulator()
    device.claimed_poles = 4
    with (
        serve(device) as server,
        pytest.raises(HardwareError, match=r"disagree .* the number of poles \(4\)"),
        vesc_rig(server.port) as rig,
    ):
        perform(rig, TO_AND_FRO)
    assert device.mode is None


SURVIVED = {
    "flipped bits": [Fault("flip", at=150), Fault("flip", at=170, towards="device")],
    "lost bytes": [Fault("lose", at=150), Fault("lose", at=170, towards="device")],
    "cut": [Fault("cut", at=150), Fault("cut", at=170, towards="device")],
    "silence": [Fault("silence", at=150, duration=0.06)],
    "an older answer": [Fault("late", at=150)],
}


@pytest.mark.parametrize("name", SURVIVED)
def test_a_run_is_complete_after_retries(name):
    device = VescEmulator()
    with serve(device, *SURVIVED[name]) as server, vesc_rig(server.port) as rig:
        got = perform(rig, BRIEF)
        facts = json.loads(rig.report())
    assert facts["retries"] >= 1
    assert np.isfinite(got["current"]).all()
    assert device.mode is None


@pytest.mark.parametrize("fault", ["pull", "reset", "silence", "refuse"])
def test_a_run_that_fails_ends_with_a_message_and_the_motor_off(fault):
    device = VescEmulator()
    with (
        serve(device, Fault(fault, at=150)) as server,
        pytest.raises(HardwareError) as caught,
        vesc_rig(server.port) as rig,
    ):
        perform(rig, BRIEF)
    if fault == "refuse":
        assert "fault 2 (under voltage)" in str(caught.value)
    if fault == "silence":
        wait_until(lambda: device.mode is None)
        assert "watchdog stops it after 0.25 s" in "".join(caught.value.__notes__)
    assert device.mode is None or fault == "pull"


def test_a_record_plays_back_with_the_same_signals(tmp_path):
    require_replayed(vesc_rig, serve(VescEmulator()), BRIEF, tmp_path)
