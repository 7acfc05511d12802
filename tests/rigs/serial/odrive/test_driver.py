"""An ODrive by its ASCII protocol, over a pseudo-terminal."""

import json
import math
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from rigtool.errors import HardwareError
from rigtool.recipe.serial import Limits
from rigtool.rigs import Feedforward, Task
from rigtool.rigs.motion import CurrentSteps, SpeedProfile, Triangle
from rigtool.rigs.operator import Operator
from rigtool.rigs.serial.drive import SetPoint
from rigtool.rigs.serial.hosted.rig import HostedRig
from rigtool.rigs.serial.line import DamagedReply, Line, LineLost, RequestRefused
from rigtool.rigs.serial.odrive import driver as odrive
from rigtool.rigs.serial.odrive.text import (
    DIALECT_06,
    OdriveProtocol,
    agrees,
    describe_errors,
    seal,
    unseal,
    xor_checksum,
)
from rigtool.rigs.serial.ports import find_devices
from tests.cli.called import call
from tests.rigs.performed import perform, require_replayed
from tests.rigs.serial.emulators.faults import Fault, serve
from tests.rigs.serial.emulators.odrive import CLOSED_LOOP, IDLE, ODriveEmulator
from tests.rigs.serial.recipes import serial_recipe
from tests.rigs.serial.target.test_driver_faults import wait_until

ROOT = Path(__file__).parents[4]
HOBBY_MOTOR, FIXTURES = ROOT / "recipes" / "odrive-hobby-motor.toml", ROOT / "tests" / "fixtures"
PERIOD = 0.008
TURN = 2 * math.pi
KT = 0.045
LIMITS = Limits(current=10, speed=60, position=(-1e5, 1e5), temperature_degc=90, duration=60)
QUIET = Operator(say=lambda text: None, present=False)
SHORT = Task(SpeedProfile((0.0, 0.1, 0.3, 0.4), (0.0, 4.0, 4.0, 0.0)))
BRIEF = Task(SpeedProfile((0.0, 0.05, 0.1), (0.0, 1.0, 0.0)))
ENDLESS = Task(SpeedProfile((0.0, 0.1, 5.0), (0.0, 4.0, 4.0)))
FIRMWARES = [(0, 5, 1), (0, 5, 6), (0, 6, 10)]


def odrive_rig(port, *more, operator=None, kt=KT):
    recipe = serial_recipe(port, *more, driver="odrive", sample_time=PERIOD)
    return HostedRig(
        recipe,
        kt,
        "test",
        operator or replace(QUIET, yes=True),
        odrive.DRIVER,
    )


def settings(device):
    """Return what its owner has set: neither inputs nor errors."""
    return {name: value for name, value in device.properties.items() if "config" in name}


@pytest.fixture
def drive():
    """A drive that is connected, and the device."""
    device = ODriveEmulator(direction=-1)
    with serve(device) as server, Line(server.port, timeout=0.1) as line:
        found = odrive.ODrive(line, 0, PERIOD)
        found.connect()
        found.configure(LIMITS, 0.25)
        yield found, device


# -- bytes


def test_checksum_of_the_documentation():
    assert seal("r vbus_voltage") == b"r vbus_voltage *93\n"


@given(st.from_regex(r"-?[0-9]{1,4}\.[0-9]{6} -?[0-9]\.[0-9]{6}", fullmatch=True), st.data())
def test_any_flipped_bit_of_a_reply_is_noticed(text, data):
    line = bytearray(b"%s*%d" % (text.encode(), xor_checksum(text.encode())))
    assert unseal(bytes(line)) == text
    at = data.draw(st.integers(0, len(line) - 1))
    line[at] ^= 1 << data.draw(st.integers(0, 7))
    with pytest.raises(DamagedReply):
        unseal(bytes(line))


@given(st.floats(-9999, 9999, width=32))
def test_a_value_cut_to_nine_characters_is_known_again(value):
    text = f"{value:f}"[:9]
    assert agrees(text, value)
    assert not agrees(text, value * 1.001 + math.copysign(0.002, value))


def test_truths_are_numbers_and_infinity_is_itself():
    assert agrees("true", 1)
    assert agrees("False", 0)
    assert agrees("inf", math.inf)
    assert not agrees("1", 0)
    with pytest.raises(DamagedReply):
        agrees("maybe", 1)


@pytest.mark.parametrize(
    ("sent", "answered"),
    [
        (b"f 0\n", b"0.000000 0.000000\r\n"),
        (b"f 0!", b"0.000000 0.000000\r\n"),
        (seal("f 0"), b"0.000000 0.000000*32\r\n"),
        (b"f 0 *1\n", b""),  # wrong checksum: ignored in silence
        (b"f 0 ; how are you\r", b"0.000000 0.000000\r\n"),
        (b"f 0\r\n", b"0.000000 0.000000\r\nunknown command\r\n"),
        (b"f 3\n", b"invalid motor 3\r\n"),
        (b"f\n", b"invalid command format\r\n"),
        (b"r axis0.nothing\n", b"invalid property\r\n"),
        (b"w axis0.controller.input_vel 1.5\nr axis0.controller.input_vel\n", b"1.500000\r\n"),
        (b"w axis0.controller.input_pos -1234.5678\nr axis0.controller.input_pos\n", b"-1234.567"),
        (b"p 0 1 2 3\nr axis0.controller.config.control_mode\n", b"3\r\n"),
        (b"v 0 1\nr axis0.controller.config.control_mode\n", b"2\r\n"),
        (b"c 0 1\nr axis0.controller.config.control_mode\n", b"1\r\n"),
    ],
)
def test_emulator_answers_as_the_firmware(sent, answered):
    assert ODriveEmulator().receive(sent).startswith(answered)
    assert bool(ODriveEmulator().receive(sent)) == bool(answered)


def test_a_line_longer_than_the_buffer_is_forgotten():
    device = ODriveEmulator()
    assert device.receive(b"r " + b"x" * 300) == b""
    assert device.receive(b"\nf 0\n").endswith(b"0.000000 0.000000\r\n")


def test_firmware_06_drops_a_reply_while_it_sends():
    questions = b"f 0\nr axis0.current_state\n"
    assert ODriveEmulator((0, 5, 6)).receive(questions).count(b"\n") == 2
    assert ODriveEmulator((0, 6, 10)).receive(questions).count(b"\n") == 1


# -- who is there


@pytest.mark.parametrize("firmware", FIRMWARES)
def test_devices_finds_it(firmware):
    device = ODriveEmulator(firmware)
    before = dict(device.properties)
    with serve(device) as server:
        (found,) = find_devices([server.port], ["odrive"])
    version = ".".join(map(str, firmware))
    assert found.driver == "odrive"
    assert found.identity == f"ODrive v3.6-56, firmware {version}, serial number 2060358F524B"
    assert device.properties == before


def set_to(name, value):
    def change(device):
        device.properties[name] = value

    return change


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda device: setattr(device, "firmware", (0, 4, 12)), "positions were counts"),
        (set_to("motor.config.motor_type", 2), "gimbal"),
        (set_to("motor.config.motor_type", 3), "an induction motor"),
        (set_to("motor.config.torque_constant", 0.0), "torque_constant is 0 N m/A"),
        (lambda device: device.trip(0x140), "reports MOTOR_FAILED, ENCODER_FAILED"),
        (set_to("controller.error", 1), r"reports controller.error 0x1"),
    ],
)
def test_what_cannot_be_driven_is_refused(change, message):
    device = ODriveEmulator()
    change(device)
    before = dict(device.properties)
    with serve(device) as server, pytest.raises(HardwareError, match=message):
        odrive_rig(server.port).__enter__()
    assert device.properties == before


def test_axis_that_it_does_not_have_is_refused():
    remedy = "invalid property; a board with one axis has node 0"
    with serve(ODriveEmulator()) as server, pytest.raises(RequestRefused, match=remedy):
        odrive_rig(server.port, "serial.node=1").__enter__()


def test_motor_that_is_not_calibrated_is_not_moved():
    device = ODriveEmulator()
    device.calibrated = False
    with (
        serve(device) as server,
        pytest.raises(HardwareError, match=r"INVALID_STATE.*calibrated"),
        odrive_rig(server.port) as rig,
    ):
        perform(rig, BRIEF)
    assert settings(device) == settings(ODriveEmulator())


# -- set points and samples


def test_set_points_go_out_in_the_drives_units(drive):
    found, device = drive
    for mode, point, control_mode, inputs in (
        ("position", SetPoint(0.3, 0.0, 0.1), 3, {"pos": 0.3 / TURN, "vel": 0, "torque": 0.1 * KT}),
        ("velocity", SetPoint(0.3, 2.0, 0.1), 2, {"vel": 2 / TURN, "torque": 0.1 * KT}),
        ("current", SetPoint(0.3, 2.0, 0.1), 1, {"vel": 0, "torque": 0.1 * KT}),
    ):
        found.enable(mode)
        found.step(point)
        assert device["controller.config.control_mode"] == control_mode
        for name, value in inputs.items():
            assert device[f"controller.input_{name}"] == pytest.approx(value, abs=2e-7)
        found.halt()
    assert [line for line in device.log if "loop" in line or "idle" in line] == [
        "closed loop",
        "idle",
    ] * 3


def test_speed_is_corrected_by_what_is_left_of_the_position(drive):
    found, device = drive
    found.enable("position")
    last = found.step(SetPoint(0.0, 0.0))
    found.step(SetPoint(last.position + 0.1, 2.0))
    assert device["controller.config.control_mode"] == 2
    gain = min(20.0, 0.3 / PERIOD)
    corrected = TURN * device["controller.input_vel"]
    assert 2.0 < corrected < 2.0 + gain * 0.1  # the motion went on since that sample
    assert corrected == pytest.approx(2.0 + gain * 0.1, rel=0.3)
    found.step(SetPoint(0.3, 0.0))
    assert device["controller.config.control_mode"] == 3
    found.halt()


def test_current_is_positive_towards_a_rising_position(drive):
    """Its own sign of Iq follows the direction of the encoder, which is -1 here."""
    found, device = drive
    found.enable("current")
    start = time.monotonic()
    while time.monotonic() - start < 0.05:
        sample = found.step(SetPoint(current=0.5))
    assert sample.current == pytest.approx(0.5, rel=1e-4)
    assert sample.current_setpoint == pytest.approx(0.5, rel=1e-4)
    assert sample.position > 0.01
    assert sample.speed > 1.0
    found.halt()
    assert device.state == IDLE


@pytest.mark.parametrize("firmware", FIRMWARES)
def test_motion_is_followed_and_logged(firmware):
    device = ODriveEmulator(firmware, words=firmware >= (0, 6, 0), thermistor=True, direction=-1)
    before = dict(device.properties)
    task = Task(Triangle(0.02, 0.62, 4.0, 0.2, cycles=1), Feedforward(inertia=1.5e-5))
    with serve(device) as server, odrive_rig(server.port) as rig:
        got = perform(rig, task)
        facts = json.loads(rig.report())
        assert rig.lacks("table") is None
        assert rig.lacks("temperature") is None
        assert any("no limit of position" in note for note in rig.notes)
    assert len(got["time"]) == 62
    angle = got["encoder"] * 2 * np.pi / 4000
    assert np.abs(angle - got["position_setpoint"]).max() < 0.15
    assert got["position_setpoint"].max() == pytest.approx(0.62, abs=0.03)
    assert (got["temperature"] == 31.25).all()
    assert np.isfinite(got["current_setpoint"]).all()
    assert facts["rate_hz"] == pytest.approx(1 / PERIOD, rel=0.05)
    assert facts["retries"] == facts["missing_samples"] == 0
    assert settings(device) == {name: before[name] for name in settings(device)}
    assert device.state == IDLE
    assert server.error is None


def test_current_is_that_of_friction_without_bias_by_the_steps_of_the_set_point():
    device = ODriveEmulator()
    task = Task(SpeedProfile((0.0, 0.1, 0.6), (0.0, 12.0, 12.0)))
    with serve(device) as server, odrive_rig(server.port) as rig:
        got = perform(rig, task)
    steady = got["time"] - got["time"][0] > 0.25
    expected = (device.motor.coulomb + device.motor.viscous * 12.0) / device.motor.torque_constant
    # Followed by positions a step would be worth 0.06 * 20 * 12 * 8e-3 = 0.12 A: friction, twice.
    assert np.median(got["current"][steady]) == pytest.approx(expected, rel=0.05)


def test_current_flows_as_asked_whatever_torque_constant_the_drive_has():
    device = ODriveEmulator()
    device.properties[device.dialect.torque_constant] = 0.09
    with serve(device) as server, odrive_rig(server.port) as rig:
        got = perform(rig, Task(CurrentSteps((0.0, 0.02, 0.04), 0.08)))
    assert np.unique(got["current"].round(4)) == pytest.approx([0.0, 0.02, 0.04], abs=2e-4)
    assert device["controller.config.control_mode"] == 3  # as it was


# -- settings


def test_limits_and_watchdog_are_set_while_it_is_used():
    device = ODriveEmulator()
    more = ("serial.limits.current=2.5", "serial.limits.speed=31.4159265", "serial.watchdog=0.2")
    with serve(device) as server, odrive_rig(server.port, *more) as rig:
        assert device["motor.config.current_lim"] == 2.5
        assert device["controller.config.vel_limit"] == pytest.approx(5.0, rel=1e-6)
        assert device["config.watchdog_timeout"] == pytest.approx(0.2, rel=1e-6)
        assert device["controller.config.input_mode"] == odrive.PASSTHROUGH
        assert not device["config.enable_watchdog"]  # it would run out at rest
        running = rig.perform(ENDLESS)
        next(running)
        assert device["config.enable_watchdog"]
    assert settings(device) == settings(ODriveEmulator())


def test_limits_that_are_lower_already_stay():
    device = ODriveEmulator(thermistor=True)
    device.properties["motor.config.current_lim"] = 1.0
    device.properties["controller.config.vel_limit"] = 3.0
    with serve(device) as server, odrive_rig(server.port):
        assert device["motor.config.current_lim"] == 1.0
        assert device["controller.config.vel_limit"] == 3.0
        assert device["motor.motor_thermistor.config.temp_limit_upper"] == 90.0
        assert device["motor.motor_thermistor.config.temp_limit_lower"] == 85.0
    assert device["motor.motor_thermistor.config.temp_limit_upper"] == 120.0
    assert not any("current_lim" in line for line in device.log)


def test_owners_watchdog_comes_back_and_its_error_is_no_obstacle():
    device = ODriveEmulator()
    device.properties |= {"config.enable_watchdog": True, "config.watchdog_timeout": 0.05}
    with serve(device) as server:
        wait_until(lambda: "watchdog" in device.log)
        with odrive_rig(server.port) as rig:
            perform(rig, BRIEF)
        assert device.properties["config.enable_watchdog"] is True
        assert device["config.watchdog_timeout"] == pytest.approx(0.05, rel=1e-6)


def perform_after_reset(rig, device):
    device.reset()
    perform(rig, BRIEF)


def test_drive_that_was_reset_between_motions_has_no_limits_and_is_not_moved():
    device = ODriveEmulator()
    with (
        serve(device) as server,
        pytest.raises(HardwareError, match=r"current_lim is 30\.0+, not 10 .*reset"),
        odrive_rig(server.port) as rig,
    ):
        perform_after_reset(rig, device)
    assert "closed loop" not in device.log


def test_refusing_once_does_not_keep_it_from_being_stopped_and_restored(drive):
    found, device = drive
    found.enable("velocity")
    device.refuse(1)
    found.halt()
    assert device.state == IDLE
    device.refuse(1)
    found.restore()
    assert settings(device) == settings(ODriveEmulator(direction=-1))


def test_power_cycle_brings_the_drive_back_and_its_settings_in_the_end():
    device = ODriveEmulator()

    def switch_off_and_on(question):
        device.reset()
        return ""

    operator = Operator(ask=switch_off_and_on, say=QUIET.say, present=True, yes=True)
    with serve(device) as server, odrive_rig(server.port, operator=operator) as rig:
        rig.power_cycle()
        assert device["motor.config.current_lim"] == 10.0
        perform(rig, BRIEF)
    assert settings(device) == settings(ODriveEmulator())


# -- what goes wrong


SURVIVED = {
    "flipped bits": lambda n: [Fault("flip", at=n), Fault("flip", at=n + 20, towards="device")],
    "lost bytes": lambda n: [Fault("lose", at=n), Fault("lose", at=n + 20, towards="device")],
    "doubled bytes": lambda n: [
        Fault("double", at=n),
        Fault("double", at=n + 20, towards="device"),
    ],
    "cut": lambda n: [Fault("cut", at=n), Fault("cut", at=n + 20, towards="device")],
    "silence": lambda n: [Fault("silence", at=n, duration=0.15)],
    "a reply to an older question": lambda n: [Fault("late", at=n), Fault("late", at=n + 20)],
    "while it is set up": lambda n: [Fault("flip", at=at) for at in (2, 10, 20)],
}
MOVING = {(0, 5, 6): 105, (0, 6, 10): 300}
"""Number of a write while the motion goes on: one question at a time makes more of them."""


@pytest.mark.parametrize(
    ("firmware", "name"),
    [
        *[((0, 5, 6), name) for name in SURVIVED],
        ((0, 6, 10), "flipped bits"),
        ((0, 6, 10), "a reply to an older question"),
    ],
)
def test_run_is_complete_after_retries(name, firmware):
    device = ODriveEmulator(firmware)
    faults = SURVIVED[name](MOVING[firmware])
    with serve(device, *faults) as server, odrive_rig(server.port, "serial.watchdog=0.5") as rig:
        got = perform(rig, SHORT)
        facts = json.loads(rig.report())
    assert len(got["time"]) == 50
    assert np.isfinite(got["current"]).all()
    angle = got["encoder"] * 2 * np.pi / 4000
    assert np.abs(angle - got["position_setpoint"]).max() < 1.0  # 4 rad/s, 0.2 s of silence
    assert facts["retries"] >= 1
    assert settings(device) == settings(ODriveEmulator(firmware))
    assert device.state == IDLE
    assert server.error is None


def test_noise_while_its_loop_is_opened_and_closed():
    device = ODriveEmulator()
    faults = [Fault("flip", probability=0.003, towards=towards) for towards in ("host", "device")]
    with serve(device, *faults) as server, Line(server.port, timeout=0.02, retries=8) as line:
        found = odrive.ODrive(line, 0, PERIOD)
        found.connect()
        found.configure(LIMITS, 1.0)
        for _ in range(3):
            found.enable("velocity")
            assert device.state == CLOSED_LOOP
            found.halt()
            assert device.state == IDLE
        found.restore()
        assert line.counts.retries > 5
    assert settings(device) == settings(ODriveEmulator())


@pytest.mark.parametrize(
    ("fault", "message"),
    [
        (Fault("pull", at=125), "cable pulled"),
        (Fault("reset", at=125), "is in state 1 .*watchdog, reset"),
        (Fault("refuse", at=125), "not implemented"),
        (Fault("silence", at=125, duration=0.5), "no valid reply"),
    ],
)
def test_run_ends_with_a_message_and_the_drive_off(fault, message):
    device = ODriveEmulator()
    got = []
    with serve(device, fault) as server:
        with pytest.raises(HardwareError, match=message), odrive_rig(server.port) as rig:
            got.extend(rig.perform(ENDLESS))
        if fault.kind != "pull":
            wait_until(lambda: device.state == IDLE)
    assert sum(len(block["time"]) for block in got) > 20
    if fault.kind in ("reset", "refuse"):
        assert settings(device) == settings(ODriveEmulator())
    assert server.error is None


def stop_at_first_block(rig, act):
    for _ in rig.perform(ENDLESS):
        act()


def interrupt():
    raise KeyboardInterrupt


def test_fault_of_the_drive_is_named():
    device = ODriveEmulator()
    with (
        serve(device) as server,
        pytest.raises(HardwareError, match=r"state 1 instead .*\(ESTOP_REQUESTED\)"),
        odrive_rig(server.port) as rig,
    ):
        stop_at_first_block(rig, lambda: device.trip(0x4000))
    assert settings(device) == settings(ODriveEmulator())


def test_silent_host_is_stopped_by_the_watchdog():
    device = ODriveEmulator()
    with serve(device) as server:
        rig = odrive_rig(server.port, "serial.watchdog=0.2").__enter__()
        running = rig.perform(ENDLESS)
        next(running)
        assert device.state == CLOSED_LOOP
        rig.line.close()
        wait_until(lambda: device.state == IDLE)
        assert "watchdog" in device.log
        with pytest.raises(LineLost):
            list(running)
        with pytest.raises(HardwareError, match="watchdog stops it"):
            rig.__exit__(None, None, None)


def test_interrupt_leaves_it_off_and_as_it_was():
    device = ODriveEmulator()
    with serve(device) as server:
        with pytest.raises(KeyboardInterrupt), odrive_rig(server.port) as rig:
            stop_at_first_block(rig, interrupt)
        assert device.state == IDLE
        assert settings(device) == settings(ODriveEmulator())


def test_speed_beyond_the_limit_ends_the_run():
    device = ODriveEmulator()
    device.saved["controller.config.enable_vel_limit"] = False
    with (
        serve(device) as server,
        pytest.raises(HardwareError, match=r"speed reached|CONTROLLER_FAILED"),
        odrive_rig(server.port, "serial.limits.speed=20") as rig,
    ):
        perform(rig, Task(CurrentSteps((0.0, 0.5), 0.3)))
    assert device.state == IDLE
    assert np.abs(device.motor.speed) < 60.0


def test_a_record_plays_back_with_the_same_signals(tmp_path):
    faulty = serve(ODriveEmulator(), Fault("flip", at=125))
    require_replayed(odrive_rig, faulty, SHORT, tmp_path)


def test_a_property_that_never_takes_a_value_is_an_error():
    class Stubborn(ODriveEmulator):
        def _write(self, name, text):
            return ()

    with serve(Stubborn()) as server, Line(server.port, timeout=0.1) as line:
        with pytest.raises(LineLost, match=r"input_vel is 0.000000 after 1"):
            OdriveProtocol(line).put("axis0.controller.input_vel", "1")
        start = time.monotonic()
        with pytest.raises(RequestRefused):
            OdriveProtocol(line).get("axis0.nothing")
        assert time.monotonic() - start < 0.1  # a refusal is not asked again


@pytest.mark.parametrize("command", ["calibrate-kt", "identify-plant"])
def test_recipe_of_a_hobby_motor_says_what_it_would_do(tmp_path, capsys, command):
    gauge = ["--set", "serial.force.driver=mark10", "--set", "serial.force.port=/dev/ttyUSB0"]
    kt = gauge if command == "calibrate-kt" else ["--kt", FIXTURES / "kt.h5"]
    arguments = [HOBBY_MOTOR, *kt, "-o", tmp_path / "x.h5", "--dry-run"]
    code, out, err = call(capsys, command, *arguments)
    assert code == 0, err
    assert "Within the limits 5 A, 40 rad/s" in out
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("code", "reported"),
    [
        (0x20000, ["REQUESTED_CURRENT_TOO_HIGH"]),
        (0x1000020, ["DRV_FAULT", "WATCHDOG_TIMER_EXPIRED"]),
        (0x20400020, ["DRV_FAULT", "0x20400000"]),
        (0, []),
    ],
)
def test_each_bit_of_an_error_is_named_or_counted(code, reported):
    assert describe_errors(code, DIALECT_06.error_names) == reported
