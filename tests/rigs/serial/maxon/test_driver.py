"""maxon drives in both framings, each against an emulator on a pseudo-terminal."""

import binascii
import json
import struct
import time
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner
from hypothesis import given
from hypothesis import strategies as st

from rigtool.cli import rigtool
from rigtool.errors import HardwareError, RecipeError
from rigtool.recipe import load_recipe
from rigtool.rigs import Feedforward, Task
from rigtool.rigs.motion import CurrentSteps, SpeedProfile
from rigtool.rigs.operator import Operator
from rigtool.rigs.serial.cia402.objects import MODE, POSITION, TARGET_SPEED, TARGET_TORQUE
from rigtool.rigs.serial.hosted.rig import HostedRig
from rigtool.rigs.serial.line import Line, LineLost
from rigtool.rigs.serial.maxon import driver as maxon
from rigtool.rigs.serial.maxon import guard as maxon_guard
from rigtool.rigs.serial.maxon.frames import OKAY, DleFrames, crc, dle_frame, lock_step_frame
from rigtool.rigs.serial.maxon.objects import CURRENT_TARGET_2
from rigtool.rigs.serial.ports import find_devices
from tests.rigs.performed import perform, require_replayed
from tests.rigs.serial.emulators.faults import Fault, inject, serve
from tests.rigs.serial.emulators.maxon import (
    NOT_AWAITED,
    DesEmulator,
    Epos2Emulator,
    Epos4Emulator,
)
from tests.rigs.serial.recipes import RECIPE, serial_recipe

ROOT = Path(__file__).parents[4]
EPOS4_RECIPE, FIXTURES = ROOT / "recipes" / "maxon-epos4.toml", ROOT / "tests" / "fixtures"
PERIOD = 0.01
FAMILIES = {"epos4": Epos4Emulator, "epos2": Epos2Emulator, "des": DesEmulator}
SHORT = Task(SpeedProfile((0.0, 0.1, 0.3, 0.4), (0.0, 4.0, 4.0, 0.0)))
TO_AND_FRO = Task(SpeedProfile((0.0, 0.05, 0.2, 0.3, 0.4), (0.0, 4.0, 4.0, -4.0, -4.0)))
BRIEF = Task(SpeedProfile((0.0, 0.05, 0.1), (0.0, 1.0, 0.0)))


pytestmark = pytest.mark.usefixtures("short_blocks")


@pytest.fixture(autouse=True)
def no_guard(monkeypatch):
    """Start no process beside each of these tests; test_guard.py has those about it."""
    monkeypatch.setattr(maxon_guard.Guard, "_start", lambda guard: None)
    monkeypatch.setattr(maxon_guard.Guard, "_send", lambda guard, word: None)


@pytest.fixture(params=FAMILIES)
def device(request, monkeypatch):
    monkeypatch.setattr(maxon, "FRAME_TIMEOUT", 0.03)
    device = FAMILIES[request.param]()
    if request.param == "des":
        device.frame_timeout = 0.03
    return device


@pytest.fixture
def epos4():
    return Epos4Emulator()


class PatientRig(HostedRig):
    """Stands a busy computer, and does not wait long for an answer."""

    def _open_line(self):
        line = super()._open_line()
        line.timeout = 0.04
        return line


def maxon_rig(port, *more, operator=None):
    recipe = serial_recipe(port, "serial.watchdog=1.5", *more, driver="maxon", sample_time=PERIOD)
    operator = operator or Operator(say=lambda text: None, present=False, yes=True)
    return PatientRig(recipe, 0.045, "test", operator, maxon.DRIVER)


def settings(device):
    """Return what a user has set, without what moves."""
    if isinstance(device, DesEmulator):
        return dict(device.parameters)
    moving = {0x6040, 0x6071, 0x60B2, 0x60FF, 0x2030, 0x206B, 0x603F}
    return {place: value for place, value in device.objects.items() if place[0] not in moving}


# -- bytes


def test_frames_of_the_manual():
    request = bytes.fromhex("90 02 60 02 01 B0 30 00 2E 62")
    answer = bytes.fromhex("90 02 00 04 00 00 00 00 01 90 90 00 00 9A 5C")
    assert dle_frame(0x60, bytes.fromhex("01 B0 30 00")) == request
    assert dle_frame(0x00, bytes.fromhex("00 00 00 00 01 90 00 00")) == answer


@pytest.mark.parametrize(
    ("index", "sub", "value", "check"),
    [
        (0x6040, 0, 0x0080, 0xF839),
        (0x6040, 0, 0x000F, 0xEF52),
        (0x6060, 0, 0x0003, 0xF4C5),
        (0x6410, 1, 0x16DA, 0x12A3),
        (0x60FF, 0, 0xFFFFFDF3, 0xBA38),
    ],
)
def test_lock_step_check_is_that_of_another_program(index, sub, value, check):
    # objects written to the node 1 of an EPOS by a controller that has each CRC written out
    data = struct.pack("<HBBI", index, sub, 1, value)
    frame = lock_step_frame(0x11, data)
    assert frame == b"\x03" + data + check.to_bytes(2, "little")


@given(st.binary(max_size=40).filter(lambda data: len(data) % 2 == 0), st.integers(0, 255))
def test_any_data_pass_through_a_frame(data, opcode):
    frame = dle_frame(opcode, data)
    stuffed = frame[2:]
    assert b"\x90\x02" not in stuffed.replace(b"\x90\x90", b"")
    body = stuffed.replace(b"\x90\x90", b"\x90")
    assert body[:2] == bytes([opcode, len(data) // 2])
    assert body[2:-2] == data
    # a CRC of CCITT over everything and itself, word by word, leaves nothing
    swapped = b"".join(body[n : n + 2][::-1] for n in range(0, len(body), 2))
    assert binascii.crc_hqx(swapped, 0) == 0


def test_one_flipped_bit_changes_the_crc():
    data = bytes(range(8))
    right = crc(b"\x04\x00", data)
    for bit in range(64):
        wrong = (int.from_bytes(data, "little") ^ 1 << bit).to_bytes(8, "little")
        assert crc(b"\x04\x00", wrong) != right


def test_values_are_read_by_their_width():
    assert POSITION.unpack(b"\xff\xff\xff\xff") == -1
    assert CURRENT_TARGET_2.unpack(b"\xff\xff\x00\x00") == -1
    assert MODE.pack(-3) == b"\xfd\x00\x00\x00"
    with pytest.raises(HardwareError, match=r"target torque cannot be 40000: .* has 16 bit"):
        TARGET_TORQUE.pack(40000)


# -- motions


def test_speed_is_followed_and_logged(device):
    before = settings(device)
    with serve(device) as server, maxon_rig(server.port) as rig:
        got = perform(rig, TO_AND_FRO)
        facts = json.loads(rig.report())
        assert settings(device) != before
    angle = got["encoder"] * 2 * np.pi / 4000
    assert len(got["time"]) == 40
    assert np.abs(angle - got["position_setpoint"]).max() < 0.2
    assert angle.max() == pytest.approx(0.8, abs=0.15)
    moving = np.abs(got["current"]) > 0.04  # coulomb 2.3e-3 N m over 0.045 N m/A
    assert np.median(np.abs(got["current"][moving])) == pytest.approx(0.06, abs=0.02)
    assert np.abs(got["current_setpoint"] - got["current"]).mean() < 0.01
    assert facts["damaged"] == facts["missing_samples"] == 0
    assert device.log[-2:] == ["on: velocity", "off"]
    assert settings(device) == before
    assert server.error is None


def test_current_is_stepped(device):
    with serve(device) as server, maxon_rig(server.port) as rig:
        got = perform(rig, Task(CurrentSteps((0.0, 0.02, 0.04), 0.04)))
        assert rig.lacks("open_loop") is None
    levels = np.unique(got["current"].round(3))
    np.testing.assert_allclose(levels, [0.0, 0.02, 0.04], atol=1.1e-3)
    assert (np.diff(got["current"]) >= 0).all()
    assert device.log[-2:] == ["on: current", "off"]


def test_turns_of_a_rotor_position_are_counted():
    # a DES reports where the rotor is within a turn
    with serve(DesEmulator()) as server, maxon_rig(server.port) as rig:
        got = perform(rig, Task(SpeedProfile((0.0, 0.1, 0.5, 0.6), (0.0, 40.0, 40.0, 0.0))))
    turned = (got["encoder"][-1] - got["encoder"][0]) * 2 * np.pi / 4000
    assert turned == pytest.approx(20.0, abs=1.0)
    assert np.diff(got["encoder"]).max() < 2 * 40 * 4000 / (2 * np.pi) * np.diff(got["time"]).max()


def test_feedforward_of_an_epos4_is_a_torque_offset():
    offsets = set()

    class Recording(Epos4Emulator):
        def apply(self):
            super().apply()
            offsets.add(self.objects[0x60B2, 0])

    with serve(Recording()) as server, maxon_rig(server.port) as rig:
        without = perform(rig, SHORT)
        assert offsets == {0}
        helped = perform(rig, Task(SHORT.motion, Feedforward(coulomb=2.3e-3)))
        assert max(offsets) == round(2.3e-3 / 0.045 / 3.21 * 1e3)  # per mille of 3.21 A
        assert rig.lacks("table") is None

    def lag(got):
        return np.abs(got["encoder"] * 2 * np.pi / 4000 - got["position_setpoint"])[10:30].mean()

    assert lag(helped) < 0.5 * lag(without)


def test_others_take_no_feedforward():
    device = Epos2Emulator()
    with serve(device) as server, maxon_rig(server.port) as rig:
        assert "takes no torque feed-forward" in rig.lacks("table")
        assert rig.lacks("closed_loop") is None


def test_unit_of_speed_is_that_of_the_drive():
    device = Epos4Emulator(x60A9_0=0xFDB44700, x6080_0=10_000_000)
    with serve(device) as server, maxon_rig(server.port) as rig:
        assert "steps of 0.001 rpm" in rig.report()
        assert device.objects[0x6080, 0] == int(60 / (2 * np.pi / 60) * 1e3)
        got = perform(rig, SHORT)
    angle = got["encoder"] * 2 * np.pi / 4000
    assert angle[-1] - angle[0] == pytest.approx(1.2, abs=0.1)


# -- limits and the way out


def test_limits_are_set_in_the_drive_and_never_widened():
    device = Epos4Emulator(x6080_0=300)
    with (
        serve(device) as server,
        maxon_rig(server.port, "serial.limits.current=2", "serial.limits.position=[-5, 50]"),
    ):
        assert device.objects[0x3001, 2] == 2000
        assert device.objects[0x6080, 0] == 300  # lower than 60 rad/s, as its owner set it
        assert device.objects[0x607D, 1] == round(-5 * 4000 / (2 * np.pi))
        assert device.objects[0x607D, 2] == round(50 * 4000 / (2 * np.pi))
    assert device.objects[0x3001, 2] == 15000


def test_limits_of_a_des_are_made_to_count():
    device = DesEmulator()
    with serve(device) as server, maxon_rig(server.port, "serial.limits.current=2"):
        assert device.parameters[14] == device.parameters[15] == 2000
        assert device.parameters[17] == int(60 / (2 * np.pi / 60))
        assert device.parameters[1] == 1 << 8 | 1 << 10  # by software, set points as well
    assert device.parameters == DesEmulator().parameters


def test_nobody_claims_a_watchdog(device):
    with serve(device) as server, maxon_rig(server.port) as rig:
        assert "the drive has no watchdog on this line" in rig.notes[0]
        assert not rig.drive.abilities.watchdog


def test_a_drive_left_alone_goes_on_within_its_limits_until_commanded(device):
    more = ("serial.limits.current=0.5", "serial.limits.speed=20")
    with serve(device) as server:
        rig = maxon_rig(server.port, *more).__enter__()
        running = rig.perform(Task(SpeedProfile((0.0, 0.1, 5.0), (0.0, 4.0, 4.0))))
        next(running)
        rig.line.close()
        with pytest.raises(HardwareError):
            list(running)
        with pytest.raises(
            HardwareError, match="It has no watchdog and may continue: switch its su"
        ):
            rig.__exit__(None, None, None)
        time.sleep(0.2)
        assert device.mode == "velocity"  # that is what the page for the bench warns of
        assert abs(device.motor.speed) < 20
        assert device.motor.current_limit == 0.5
        with maxon_rig(server.port) as rig:
            rig.drive.halt()
            assert device.mode is None


def test_limit_that_is_passed_stops_the_drive(device):
    with serve(device) as server, maxon_rig(server.port, "serial.limits.speed=8") as rig:
        with pytest.raises(HardwareError, match="speed reached .* limit of 8 rad/s"):  # noqa: RUF043
            tripped(rig, device)
        assert device.mode is None


def tripped(rig, device):
    """Run a motion while something else drives the shaft: the drive keeps to no speed."""
    advance = device.motor.advance
    for _ in rig.perform(Task(SpeedProfile((0.0, 0.1, 0.9), (0.0, 1.0, 1.0)))):
        device.motor.advance = lambda mode, position, speed, current: advance(
            mode, position, 30.0, current
        )


def interrupt():
    raise KeyboardInterrupt


def test_interrupt_leaves_the_drive_off_and_as_it_was(device):
    before = settings(device)
    with serve(device) as server:
        with pytest.raises(KeyboardInterrupt), maxon_rig(server.port) as rig:
            broken_off(rig, [], interrupt)
        assert device.mode is None
        assert settings(device) == before


def test_power_cycle_brings_limits_back_and_restores_what_was_first(epos4):
    def switch_off_and_on(question):
        epos4.reset()
        return ""

    operator = Operator(ask=switch_off_and_on, say=lambda text: None, present=True, yes=True)
    with serve(epos4) as server, maxon_rig(server.port, operator=operator) as rig:
        perform(rig, BRIEF)
        rig.power_cycle()
        assert epos4.objects[0x3001, 2] == 10000
        perform(rig, BRIEF)
    assert epos4.objects[0x3001, 2] == 15000


# -- faults

DAMAGE = ("flip", "lose", "double", "cut")


def spread(device, delayed):
    """Return faults that hit samples in the middle of a run, far enough from each other."""
    writes = 1 if isinstance(device, Epos4Emulator) else 3  # for each answer of the device
    if delayed:
        return [Fault("silence", at=40 * writes, duration=0.06), Fault("late", at=100 * writes)]
    places = iter(range(20 * writes, 200 * writes, 20 * writes))
    ways = ("host", "device")
    return [Fault(kind, at=next(places), towards=way) for kind in DAMAGE for way in ways]


@pytest.mark.parametrize("delayed", [False, True], ids=["damage", "delay"])
def test_run_is_complete_after_retries(device, delayed):
    before = settings(device)
    faults = spread(device, delayed)
    with serve(device) as server, maxon_rig(server.port) as rig:
        inject(server, *faults)
        got = perform(rig, SHORT)
        facts = json.loads(rig.report())
    assert len(got["time"]) == 40
    assert np.isfinite(got["current"]).all()
    assert np.abs(got["current"]).max() < 1.5  # nothing that belongs to another question
    angle = got["encoder"] * 2 * np.pi / 4000
    assert (np.abs(np.diff(angle)) < 15.0 * np.diff(got["time"]) + 0.05).all()
    assert facts["retries"] >= len(faults) / 2
    assert device.mode is None
    assert settings(device) == before
    assert server.error is None


@pytest.mark.parametrize("kind", ["flip", "lose", "double", "cut", "late"])
def test_no_value_is_taken_for_another(epos4, kind):
    # answers do not name their question: whichever is damaged, samples stay what they are
    with serve(epos4) as server, maxon_rig(server.port) as rig:
        rig.line.timeout = 0.02
        epos4.motor.position = 1.0
        epos4.motor._step = lambda *arguments: None
        inject(server, *(Fault(kind, at=at) for at in range(3, 120, 16)))
        for _ in range(30):
            sample = rig.drive.read()
            assert sample.position == pytest.approx(1.0, abs=2e-3)
            assert sample.current == sample.current_setpoint == 0.0
        assert rig.line.counts.retries > 0


def test_a_damaged_command_is_answered_with_an_error_and_sent_again(epos4):
    with serve(epos4) as server, maxon_rig(server.port) as rig:
        inject(server, Fault("flip", at=0, towards="device"))
        rig.drive._objects.write(TARGET_SPEED, 48)
        assert rig.line.counts.retries == 1
        assert epos4.objects[0x60FF, 0] == 48


def test_a_device_answers_one_request_at_a_time(device):
    """A host that does not wait gets one answer."""
    if isinstance(device, Epos4Emulator):
        data = bytes.fromhex("01 64 60 00")
        both = dle_frame(0x60, data) + dle_frame(0x60, data)
        assert device.receive(both) == device.receive(dle_frame(0x60, data))
    else:
        opcode = bytes([next(iter(device.lengths))])
        assert device.receive(opcode + opcode) == OKAY
    assert device.log == [NOT_AWAITED]


def broken_off(rig, got, happens):
    """Run a motion in the middle of which something happens."""
    for block in rig.perform(Task(SpeedProfile((0.0, 0.1, 1.0), (0.0, 4.0, 4.0)))):
        if not got:
            happens()
        got.append(block)


@pytest.mark.parametrize(
    ("fault", "message"),
    [
        (Fault("pull", at=10), "cable pulled"),
        (Fault("reset", at=10), "switched off|fault"),
        (Fault("refuse", at=10, count=5), "not in this state|no valid reply"),
        (Fault("silence", at=10, duration=0.5), "no valid reply|late"),
    ],
    ids=lambda value: getattr(value, "kind", ""),
)
def test_run_ends_with_a_message_and_the_drive_off(device, fault, message):
    before = settings(device)
    got = []
    with serve(device) as server:
        with pytest.raises(HardwareError, match=message), maxon_rig(server.port) as rig:
            broken_off(rig, got, lambda: inject(server, fault))
        if fault.kind != "pull":
            assert device.mode is None
            assert settings(device) == before
    assert sum(len(block["time"]) for block in got) >= 1
    assert server.error is None


def test_fault_of_the_drive_is_reported(epos4):
    got = []
    with serve(epos4) as server:
        reported = r"reports the fault 0x2310 .* clear it"
        with pytest.raises(HardwareError, match=reported), maxon_rig(server.port) as rig:
            broken_off(rig, got, lambda: epos4.fault(0x2310))
        with pytest.raises(HardwareError, match="reports the fault"):
            maxon_rig(server.port).__enter__()
    assert got


def test_error_of_a_des_is_reported():
    device = DesEmulator()
    device.error = True
    with serve(device) as server, pytest.raises(HardwareError, match="reports an error"):
        maxon_rig(server.port).__enter__()


def test_des_that_software_cannot_switch_off_is_refused():
    device = DesEmulator()
    device.switch("velocity")
    device.switch = lambda mode: None  # its enable input decides
    before = settings(device)
    with serve(device) as server, pytest.raises(HardwareError, match="its enable input decides"):
        maxon_rig(server.port).__enter__()
    assert settings(device) == before


def test_motor_that_was_not_set_up_is_refused():
    device = Epos4Emulator(x3001_5=46000)
    device.objects[0x3001, 5] = 20000
    with serve(device) as server, pytest.raises(HardwareError, match="enter the motor's data"):
        maxon_rig(server.port).__enter__()


def test_another_encoder_is_refused(device):
    with (
        serve(device) as server,
        pytest.raises(RecipeError, match=r"rig.encoder_counts is 2000, .* 4000 counts"),
    ):
        maxon_rig(server.port, "rig.encoder_counts=2000").__enter__()


def test_without_an_emergency_stop_nothing_runs(epos4, tmp_path):
    with (
        serve(epos4) as server,
        pytest.raises(RecipeError, match=r"no watchdog .* serial.emergency_stop = true"),
    ):
        maxon_rig(server.port, "serial.emergency_stop=false").__enter__()
    assert epos4.log == []


def test_wrong_node_is_said(epos4):
    with (
        serve(epos4) as server,
        pytest.raises(HardwareError, match=r"wrong node: see serial\.node"),
    ):
        maxon_rig(server.port, "serial.node=3").__enter__()


# -- who is there, and records


def test_devices_are_found(device):
    with serve(device) as server:
        (found,) = find_devices([server.port], ["maxon"])
        assert found.driver == "maxon"
        assert found.identity.startswith(
            {"Epos4": "maxon EPOS4, p", "Epos2": "maxon EPOS2, p", "Des": "maxon DES"}[
                type(device).__name__.removesuffix("Emulator")
            ]
        )
        assert device.log in ([], ["frame given up"])


def test_a_device_in_the_middle_of_a_frame_is_found():
    device = Epos2Emulator()
    with serve(device) as server:
        with Line(server.port) as line:
            line.write(b"\x10\x05\x00")  # what other questions may leave behind
        (found,) = find_devices([server.port], ["maxon"])
    assert found.identity.startswith("maxon EPOS2")


def test_nobody_is_nobody(monkeypatch):
    class Deaf(Epos4Emulator):
        def receive(self, data):
            return b""

    monkeypatch.setattr(maxon, "FRAME_TIMEOUT", 0.01)
    with serve(Deaf()) as server:
        with Line(server.port, timeout=0.02, retries=0) as line:
            assert maxon.probe(line) is None
        with pytest.raises(HardwareError, match=r"no maxon drive answers: .* a DES at 38400"):
            maxon_rig(server.port).__enter__()


def test_a_record_plays_back_with_the_same_signals(device, tmp_path):
    require_replayed(maxon_rig, serve(device), BRIEF, tmp_path)


def test_a_single_dle_within_an_answer_is_damage():
    class Sloppy(Epos4Emulator):
        def answer(self, opcode, data):
            return super().answer(opcode, data).replace(b"\x90\x90", b"\x90\x91")

    device = Sloppy()
    device.objects[0x6040, 0] = 0x90
    with serve(device) as server, Line(server.port, timeout=0.02, retries=0) as line:
        with pytest.raises(LineLost, match="single 0x90"):
            DleFrames(line).command(0x60, bytes.fromhex("01 40 60 00"), 8)
        assert line.counts.damaged == 1


# -- the recipe to start from


def test_recipe_says_what_it_would_do(tmp_path):
    arguments = ["fft-ripple", str(EPOS4_RECIPE), "--kt", str(FIXTURES / "kt.h5"), "--dry-run"]
    result = CliRunner().invoke(rigtool, [*arguments, "-o", str(tmp_path / "ripple.h5")])
    assert result.exit_code == 0, result.output
    assert "6 motions to record" in result.output
    assert "Within the limits 2 A, 40 rad/s" in result.output
    assert "no watchdog: where computer or cable fail it continues with its last" in result.output
    assert list(tmp_path.iterdir()) == []


def test_slow_lines_may_have_a_slow_loop_and_a_virtual_rig_may_not():
    assert load_recipe(EPOS4_RECIPE, ("rig.sample_time=0.06",))[0].rig.sample_time == 0.06
    with pytest.raises(RecipeError, match=r"sample_time of a virtual rig is at most 0\.01 s"):
        load_recipe(RECIPE, ("rig.sample_time=0.06",))
