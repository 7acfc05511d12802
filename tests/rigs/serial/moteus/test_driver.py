"""The moteus driver against an emulator that speaks its protocol on a pseudo-terminal."""

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
from rigtool.experiments.learning.procedure_design import design_filters
from rigtool.recipe import load_recipe
from rigtool.rigs import Feedforward, Task
from rigtool.rigs.motion import CurrentSteps, SpeedProfile, Triangle
from rigtool.rigs.operator import Operator
from rigtool.rigs.serial.drive import SetPoint
from rigtool.rigs.serial.hosted.rig import HostedRig
from rigtool.rigs.serial.line import Line, LineLost
from rigtool.rigs.serial.moteus import driver as moteus
from rigtool.rigs.serial.moteus import frames
from rigtool.rigs.serial.ports import find_devices
from tests.cli.called import call
from tests.rigs.performed import perform, require_replayed
from tests.rigs.serial.emulators.faults import Fault, serve
from tests.rigs.serial.emulators.moteus import MoteusEmulator, reply
from tests.rigs.serial.recipes import serial_recipe
from tests.rigs.serial.target.test_driver_faults import wait_until

ROOT = Path(__file__).parents[4]
MOTEUS_R4, FIXTURES = ROOT / "recipes" / "moteus-r4.toml", ROOT / "tests" / "fixtures"
PERIOD = 0.004
SHORT = Task(SpeedProfile((0.0, 0.1, 0.3, 0.4), (0.0, 4.0, 4.0, 0.0)))
QUIET = Operator(say=lambda text: None, present=False)


def moteus_rig(port, *more, operator=None):
    recipe = serial_recipe(port, *more, driver="moteus", sample_time=PERIOD)
    return HostedRig(
        recipe,
        0.045,
        "test",
        operator or replace(QUIET, yes=True),
        moteus.DRIVER,
    )


def assert_off_and_as_before(device):
    assert device.mode == 0
    assert printed(device.config) == printed(device.stored)


def printed(settings):
    return {name: f"{value:.6f}" for name, value in settings.items()}


# -- bytes, as the protocol's documentation has them


def test_the_documented_frame():
    frame = (
        frames.write(0, [10], frames.INT8)
        + frames.write(0x20, [96, 288, -176], frames.INT16)
        + frames.read(0, 4, frames.INT16)
        + frames.read(0x0D, 3, frames.INT8)
    )
    assert frame.hex() == "01000a07206000200150ff140400130d"
    assert frames.send_line(0x8001, frame) == b"can send 8001 01000a07206000200150ff140400130d"


def test_the_documented_reply():
    identifier, frame = frames.received(b"rcv 100 2404000a005000000170ff230d181400")
    assert identifier == 0x100
    assert frames.registers_of(frame) == {
        0: 10,
        1: 80,
        2: 256,
        3: -144,
        0x0D: 24,
        0x0E: 20,
        0x0F: 0,
    }


NIBBLES = bytes.fromhex("0097b92ee5725ccb5dcae473b82f0196")


@given(st.binary(max_size=40))
def test_crc_is_the_documented_one_by_nibbles(data):
    crc = 0
    for byte in data:
        for nibble in (byte >> 4, byte & 15):
            crc = NIBBLES[(crc >> 4) ^ nibble] ^ (crc << 4 & 0xFF)
    assert frames.crc8(data) == crc


@given(st.binary(min_size=1, max_size=30), st.integers(0, 239))
def test_every_flipped_bit_of_a_sealed_line_is_seen(data, bit):
    line = bytearray(frames.sealed(data.hex().encode()))
    bit %= 8 * len(line)
    line[bit // 8] ^= 1 << bit % 8
    with pytest.raises(frames.BadFrame):
        frames.unsealed(bytes(line))


@given(
    st.integers(0, 0x1FF),
    st.lists(st.floats(width=32, allow_nan=False), min_size=1, max_size=6),
)
def test_registers_come_back_from_a_reply(first, values):
    found = frames.registers_of(frames.padded(reply(first, values)))
    assert found == {first + i: value for i, value in enumerate(values)}


def test_an_error_and_a_cut_reply_are_told_apart():
    with pytest.raises(frames.RegisterError, match="read of register 0x150: error 2"):
        frames.registers_of(bytes([0x31, 0xD0, 0x02, 2]))
    with pytest.raises(frames.BadFrame, match="is cut"):
        frames.registers_of(reply(1, [1.0, 2.0])[:-1])


# -- who is there


@pytest.mark.parametrize("uart", [True, False])
def test_devices_asks_and_changes_nothing(uart):
    device = MoteusEmulator(uart=uart, node=2)
    with serve(device) as server:
        (found,) = find_devices([server.port], ["moteus"])
    assert found.driver == "moteus"
    serial = "000030000000004200005a17"
    assert found.identity == f"moteus 2, model 0x220, firmware 1.3.5, serial {serial}"
    assert device.log == []
    assert not device.checksums


def test_probe_of_something_else_finds_nothing():
    from tests.rigs.serial.toy import ToyEmulator

    with serve(ToyEmulator()) as server, Line(server.port, timeout=0.05, retries=0) as line:
        assert moteus.probe(line) is None


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"motor__poles": 0}, "no calibrated motor"),
        ({"servo__voltage_mode_control": 1}, "voltage_mode_control is on"),
        ({"motor_position__rotor_to_output_ratio": -1.0}, "must be above 0"),
        ({"motor__rotation_current_cutoff_A": 5.0}, "cutoff_A = 5 A"),
    ],
)
def test_a_drive_that_cannot_be_measured_with_is_refused(options, message):
    device = MoteusEmulator(**options)
    with serve(device) as server, pytest.raises(HardwareError, match=message):
        moteus_rig(server.port).__enter__()
    assert_off_and_as_before(device)


def test_a_fault_is_for_its_owner_to_look_at():
    device = MoteusEmulator()
    device.mode, device.fault = 1, 33
    with serve(device) as server, pytest.raises(HardwareError, match="fault 33, motor driver"):
        moteus_rig(server.port).__enter__()


# -- motion


@pytest.mark.parametrize(("uart", "ratio"), [(True, 1.0), (False, 0.25)])
def test_motion_is_followed_and_logged(uart, ratio):
    device = MoteusEmulator(uart=uart, motor_position__rotor_to_output_ratio=ratio)
    task = Task(Triangle(0.1, 1.1, 4.0, 0.3, cycles=1), Feedforward(inertia=1.5e-5))
    with serve(device) as server, moteus_rig(server.port, "serial.node=1") as rig:
        got = perform(rig, task)
        facts = json.loads(rig.report())
        assert device.config["servo.max_current_A"] == 10.0
        assert device.config["servo.max_velocity"] == pytest.approx(
            60 / (2 * np.pi) * ratio, rel=1e-6
        )
        assert device.config["servo.default_timeout_s"] == 0.25
        assert device.config["servo.timeout_mode"] == 0
        assert device.config["servo.motor_fault_temperature"] == 90.0
        assert device.config["servopos.position_max"] == pytest.approx(
            1e5 / (2 * np.pi) * ratio, rel=1e-6
        )
    assert server.error is None
    angle = got["encoder"] * 2 * np.pi / 4000
    assert np.abs(angle - got["position_setpoint"]).max() < 0.1
    assert np.isfinite(got["current"]).all()
    np.testing.assert_allclose(got["current"], got["current_setpoint"], atol=1e-4)
    np.testing.assert_allclose(got["temperature"], 25.0, rtol=1e-6)
    assert facts["retries"] == facts["missing_samples"] == 0
    assert "serial 00003000" in facts["identity"]
    assert ("UART with checksums" in facts["identity"]) == uart
    assert_off_and_as_before(device)


def test_feedforward_arrives_as_that_current():
    device = MoteusEmulator()
    with serve(device) as server, moteus_rig(server.port) as rig:
        drive = rig.drive
        drive.enable("position")
        sent = drive._command(SetPoint(current=0.5))
        drive.halt()
    written = frames.Subframes(sent[3:])
    resolution, count, first = written.registers(written.byte())
    assert (resolution, first) == (frames.FLOAT, 0x20)
    torque = written.values(resolution, count)[2]
    assert torque / device._torque_constant() == pytest.approx(0.5, rel=1e-5)


def test_current_is_what_was_asked_although_the_drive_has_a_table():
    table = {f"motor__cogging_dq_comp__{i}": 100 for i in range(1024)}
    device = MoteusEmulator(motor__cogging_dq_scale=0.01, **table)
    with serve(device) as server, moteus_rig(server.port) as rig:
        assert "cogging table is on, scale 0.01 A" in json.loads(rig.report())["identity"]
        got = perform(rig, Task(CurrentSteps((0.0, 0.02, 0.04), 0.04)))
        assert device.config["motor.cogging_dq_scale"] == 0.0
        perform(rig, Task(SpeedProfile((0.0, 0.05, 0.1), (0.0, 1.0, 0.0))))
        assert device.config["motor.cogging_dq_scale"] == 0.01
    assert set(got["current"].round(3)) >= {0.0, 0.02, 0.04}
    assert got["current"].max() < 0.0401
    assert_off_and_as_before(device)


# -- what goes wrong

SURVIVED = {
    "flipped bits": [Fault("flip", at=150), Fault("flip", at=170, towards="device")],
    "lost bytes": [Fault("lose", at=150), Fault("lose", at=170, towards="device")],
    "doubled bytes": [Fault("double", at=150), Fault("double", at=170, towards="device")],
    "cut": [Fault("cut", at=150), Fault("cut", at=170, towards="device")],
    "late": [Fault("late", at=160)],
    "silence": [Fault("silence", at=160, duration=0.08)],
    "damaged from the first byte on": [
        Fault("flip", at=0, towards="device"),
        Fault("flip", at=3),
        Fault("cut", at=9),
        Fault("lose", at=21, towards="device"),
    ],
}


@pytest.mark.parametrize("name", SURVIVED)
def test_run_is_complete_after_retries(name):
    device = MoteusEmulator()
    with serve(device, *SURVIVED[name]) as server, moteus_rig(server.port) as rig:
        got = perform(rig, SHORT)
        facts = json.loads(rig.report())
    assert server.error is None
    assert len(got["time"]) == 100
    assert np.isfinite(got["current"]).all()
    assert facts["retries"] >= 1
    assert_off_and_as_before(device)


@pytest.mark.parametrize(
    ("fault", "message"),
    [
        (Fault("pull", at=200), "cable pulled"),
        (Fault("reset", at=200), "switched off, mode .: it was reset"),
        (Fault("refuse", at=200), "refuses: read of register"),
        (Fault("silence", at=200, duration=0.6), "no valid reply|watchdog"),
    ],
)
def test_run_ends_with_a_message_and_the_drive_off(fault, message):
    device = MoteusEmulator()
    got = []
    with serve(device, fault) as server:
        with pytest.raises(HardwareError, match=message), moteus_rig(server.port) as rig:
            got.extend(rig.perform(SHORT))
        assert server.error is None
        if fault.kind != "pull":
            wait_until(lambda: device.mode in (0, 11))
            assert_off_and_as_before(device)
    assert sum(len(block["time"]) for block in got) > 5


def test_a_sample_that_came_late_is_measured_anew():
    fast = Task(SpeedProfile((0.0, 0.1, 0.4, 0.5), (0.0, 20.0, 20.0, 0.0)))
    device = MoteusEmulator()
    with (
        serve(device, Fault("silence", at=170, duration=0.02)) as server,
        moteus_rig(server.port) as rig,
    ):
        got = perform(rig, fast)
    # the first answer was lost for 50 ms, the second came at once: without the second the time
    # would be 25 ms off, 0.5 rad
    angle = got["encoder"] * 2 * np.pi / 4000
    moving = slice(20, None)
    wrong = angle - got["position_setpoint"]
    assert np.abs(wrong[moving] - np.median(wrong[moving])).max() < 0.3


def test_a_position_that_is_lost_ends_the_run_and_is_not_recorded():
    device = MoteusEmulator()
    got = []
    with serve(device) as server, moteus_rig(server.port) as rig:
        running = rig.perform(Task(SpeedProfile((0.0, 0.1, 2.0), (0.0, 4.0, 4.0))))
        got.append(next(running))
        device._position = lambda: math.nan
        with pytest.raises(HardwareError, match="lost its position"):
            got.extend(running)
    assert all(np.isfinite(block["encoder"]).all() for block in got)
    assert device.mode == 0


def test_a_fault_of_the_drive_is_reported_by_name():
    device = MoteusEmulator()
    with serve(device) as server, moteus_rig(server.port) as rig:
        running = rig.perform(Task(SpeedProfile((0.0, 0.1, 2.0), (0.0, 4.0, 4.0))))
        next(running)
        device.temperature = 89.0
        device.config["servo.motor_fault_temperature"] = 80.0
        with pytest.raises(HardwareError, match="fault 38, over temperature"):
            list(running)
    assert_off_and_as_before(device)


@pytest.mark.parametrize("task", [SpeedProfile((0.0, 0.1, 5.0), (0.0, 4.0, 4.0)), None])
def test_silent_host_is_stopped_by_the_watchdog(task):
    device = MoteusEmulator()
    with serve(device) as server:
        rig = moteus_rig(server.port, "serial.watchdog=0.1").__enter__()
        running = rig.perform(Task(task or CurrentSteps((0.06,), 5.0)))
        next(running)
        assert device.mode == 10
        rig.line.close()
        wait_until(lambda: device.mode == 11)
        assert device.log[-1] == "watchdog"
        device.turn()
        assert device.motor.current == 0.0
        with pytest.raises((LineLost, HardwareError)):
            list(running)


def test_after_the_watchdog_the_next_program_can_go_on():
    device = MoteusEmulator()
    device.mode = 11
    with serve(device) as server, moteus_rig(server.port) as rig:
        got = perform(rig, Task(SpeedProfile((0.0, 0.05, 0.1), (0.0, 1.0, 0.0))))
    assert len(got["time"]) == 25
    assert_off_and_as_before(device)


def test_limit_that_is_passed_stops_the_drive_and_keeps_the_samples():
    device = MoteusEmulator()
    got = []
    with serve(device) as server, moteus_rig(server.port, "serial.limits.speed=8") as rig:
        with pytest.raises(HardwareError, match=r"speed reached .* limit of 8 rad/s"):
            got.extend(rig.perform(Task(CurrentSteps((0.2,), 1.0))))
        assert device.mode == 0
    assert 1 <= sum(len(block["time"]) for block in got) < 100
    assert_off_and_as_before(device)


def test_limits_that_the_drive_has_already_are_not_raised():
    device = MoteusEmulator(servo__max_current_A=3.0, servopos__position_min=-2e4)
    with serve(device) as server, moteus_rig(server.port) as rig:
        assert device.config["servo.max_current_A"] == 3.0
        lowest = rig._limits.position[0] / (2 * math.pi)
        assert device.config["servopos.position_min"] == pytest.approx(lowest, rel=1e-6)
    assert_off_and_as_before(device)


def test_bounds_at_which_the_drive_clamps_set_points_are_refused():
    """The firmware's own, 0.01 turns either way: the shaft would stand still without a fault."""
    device = MoteusEmulator(servopos__position_min=-0.01, servopos__position_max=0.01)
    with serve(device) as server:
        message = r"position_min is -0.01 turns, -0.06283 rad and .*position_max.*clamps set points"
        with pytest.raises(HardwareError, match=message), moteus_rig(server.port):
            pass
    assert_off_and_as_before(device)
    assert device.config["servopos.position_min"] == -0.01


def test_a_shaft_that_does_not_follow_stops_the_drive():
    device = MoteusEmulator()
    device.motor.coulomb = 1.0  # blocked: the limit of current makes 0.45 N m
    got = []
    with (
        serve(device) as server,
        moteus_rig(server.port, "serial.limits.following_error=0.4") as rig,
    ):
        with pytest.raises(
            HardwareError, match=r"following_error = 0.4 rad: the motor was stopped"
        ):
            got.extend(rig.perform(Task(SpeedProfile((0.0, 0.1, 2.0), (0.0, 4.0, 4.0)))))
        assert device.mode == 0
    assert 1 <= sum(len(block["time"]) for block in got) < 100
    assert_off_and_as_before(device)


def test_drive_without_thermometer_says_so():
    device = MoteusEmulator(servo__enable_motor_temperature=0)
    with serve(device) as server, moteus_rig(server.port) as rig:
        assert "does not report its temperature" in rig.lacks("temperature")
        assert any("no thermometer on the motor" in note for note in rig.notes)
        assert rig.lacks("table") is None
        assert rig.lacks("open_loop") is None
        assert math.isnan(rig.drive.read().temperature)


def test_a_record_plays_back_with_the_same_signals(tmp_path):
    brief = Task(SpeedProfile((0.0, 0.05, 0.1), (0.0, 1.0, 0.0)))
    require_replayed(moteus_rig, serve(MoteusEmulator()), brief, tmp_path)


def test_rate_of_the_line_is_well_above_the_loop():
    with serve(MoteusEmulator()) as server, moteus_rig(server.port) as rig:
        start = time.monotonic()
        for _ in range(100):
            rig.drive.read()
        assert (time.monotonic() - start) / 100 < PERIOD


# -- the recipe to start from


@pytest.mark.parametrize("command", ["calibrate-kt", "stribeck", "fft-ripple", "ilc-learn"])
def test_recipe_says_what_it_would_do(tmp_path, capsys, command):
    gauge = ["--set", "serial.force.driver=mark10", "--set", "serial.force.port=/dev/ttyUSB0"]
    kt = gauge if command == "calibrate-kt" else ["--kt", FIXTURES / "kt.h5"]
    code, out, err = call(capsys, command, MOTEUS_R4, *kt, "-o", tmp_path / "x.h5", "--dry-run")
    assert code == 0, err
    assert "Within the limits 3 A, 20 rad/s, -500 to 500 rad" in out
    assert list(tmp_path.iterdir()) == []


def test_recipe_has_a_loop_that_can_be_learned_with():
    recipe, _ = load_recipe(MOTEUS_R4)
    loop = design_filters(recipe).learning
    # the loop follows cogging, as often a turn as 12 slots and 14 poles meet
    cogging = 84 * np.array(recipe.ilc_learn.turning.speeds_rev_per_s)
    assert np.abs(loop.loop_response(cogging)).min() > 0.5
    # the gains that the recipe gives for the drive make the loop that it describes
    kp, kd, inertia = 1.6, 0.039, recipe.rig.nominal_inertia
    crossover = kd / (4 * math.pi**2 * inertia)
    assert recipe.rig.controller.crossover_hz == pytest.approx(crossover, rel=0.02)
    lead = 2 * math.pi * crossover * kd / kp
    assert recipe.rig.controller.lead_ratio == pytest.approx(lead, rel=0.05)


def test_emulator_scales_integers_and_refuses_unknown_registers():
    """A quarter of a turn as int16 is 2500; the documented steps of mjbots' protocol."""
    device = MoteusEmulator(uart=False)
    turned = frames.write(0, [10], frames.INT8) + frames.write(0x20, [2500], frames.INT16)
    device._frame(turned)
    device.mode = 10
    device._frame(turned)
    assert device.command[0x20] == pytest.approx(0.25, rel=1e-12)
    device.motor.position = math.pi / 2
    found = frames.registers_of(device._frame(frames.read(1, 1, frames.INT16)))
    assert found[1] == pytest.approx(2500, abs=1)
    with pytest.raises(frames.RegisterError, match="read of register 0x0ab"):
        frames.registers_of(device._frame(frames.read(0x0AB)))


@pytest.mark.parametrize(
    ("line", "answer"),
    [
        (b"can send 8001 110004 BF", b"OK"),
        (b"can send 8001 11000", b"ERR data invalid length"),
        (b"can send 8001 1100zz", b"ERR invalid data"),
        (b"can send 8001 110004 *5A", b"ERR unknown flag"),
        (b"can send 40000000 110004", b"ERR bad id"),
        (b"can send 8001", b"ERR insufficient options"),
        (b"can speak 8001 110004", b"ERR unknown subcommand"),
    ],
)
def test_fdcanusb_refuses_in_the_words_of_its_firmware(line, answer):
    assert MoteusEmulator(uart=False).receive(line + b"\n").startswith(answer + b"\r\n")


def test_fdcanusb_takes_no_checksums_and_is_used_without():
    device = MoteusEmulator(uart=False)
    with serve(device) as server, moteus_rig(server.port) as rig:
        assert "fdcanusb" in rig.report()
        perform(rig, Task(SpeedProfile((0.0, 0.05, 0.1), (0.0, 1.0, 0.0))))
    assert_off_and_as_before(device)
    device.on_bus = False
    with (
        serve(device) as server,
        pytest.raises(HardwareError, match="off its bus: send it 'can on'"),
        moteus_rig(server.port),
    ):
        pass
