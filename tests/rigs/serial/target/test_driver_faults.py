"""Whatever goes wrong on the line: the very signals, or a clear message and a motor that is off."""

import contextlib
import json
import threading
import time

import pytest
import serial

from rigtool.errors import HardwareError, RecipeError
from rigtool.rigs import Feedforward, Task, open_rig
from rigtool.rigs.motion import CurrentSteps, SpeedProfile, Triangle
from rigtool.rigs.serial.emulators.target import TargetEmulator
from rigtool.rigs.serial.line import LineLost
from rigtool.rigs.serial.target import protocol
from rigtool.rigs.serial.target.link import TargetState
from tests.rigs.performed import perform
from tests.rigs.serial.emulators.faults import Fault, serve
from tests.rigs.serial.recipes import serial_recipe
from tests.rigs.serial.target.test_driver import KT, assert_same, target_rig, virtual

MOTION = Task(Triangle(0.1, 1.1, 6.0, 0.2, cycles=3), Feedforward(1.5e-5), record_every=2)


@pytest.fixture(autouse=True)
def impatient(monkeypatch):
    """Repeat soon: an emulator answers within milliseconds."""
    monkeypatch.setattr(protocol, "REPLY_TIMEOUT", 0.15)


@pytest.fixture(scope="module")
def expected():
    return perform(open_rig(virtual(), KT, "test"), MOTION)


SURVIVED = {
    "flipped bits": [Fault("flip", probability=2e-5), Fault("flip", at=9, towards="device")],
    "lost bytes": [Fault("lose", probability=2e-5), Fault("lose", at=9, towards="device")],
    "doubled bytes": [Fault("double", probability=2e-5), Fault("double", at=9, towards="device")],
    "cut frames": [Fault("cut", at=3), Fault("cut", at=21), Fault("cut", at=11, towards="device")],
    "silence": [Fault("silence", at=12, duration=0.4)],
    "older answers": [Fault("late", at=5), Fault("late", at=19)],
}


@pytest.mark.parametrize("log", ["memory", "stream"])
@pytest.mark.parametrize("name", SURVIVED)
def test_run_is_complete_and_correct_after_retries(name, log, expected):
    device = TargetEmulator(virtual())
    with (
        serve(device, *SURVIVED[name]) as server,
        target_rig(server.port, f"serial.log={log}") as rig,
    ):
        assert_same(perform(rig, MOTION), expected)
        facts = json.loads(rig.report())
    assert facts["retries"] > 0
    assert facts["missing_samples"] == 0
    assert device.state is TargetState.OFF
    assert server.error is None


def failing(device, *faults, log="memory", task=MOTION):
    with (
        serve(device, *faults) as server,
        pytest.raises(HardwareError) as caught,
        target_rig(server.port, f"serial.log={log}") as rig,
    ):
        perform(rig, task)
    assert server.error is None
    return caught.value


@pytest.mark.parametrize("log", ["memory", "stream"])
def test_reset_in_the_middle_is_noticed(log):
    device = TargetEmulator(virtual(), paced=True)
    error = failing(device, Fault("reset", at=30), log=log)
    assert "reset" in str(error)
    assert "lost" in str(error)
    assert device.state is TargetState.OFF


@pytest.mark.parametrize("log", ["memory", "stream"])
def test_pulled_cable_ends_at_once(log):
    start = time.monotonic()
    error = failing(TargetEmulator(virtual(), paced=True), Fault("pull", at=30), log=log)
    assert isinstance(error, LineLost)
    assert "cable pulled" in str(error)
    assert "watchdog stops it after 5 s" in "".join(error.__notes__)
    assert time.monotonic() - start < 2


def test_answers_come_between_streamed_samples_on_a_line_that_is_slower_than_the_target(world):
    """With the watchdog of a recipe that says none."""
    world.rate = 5e5
    motion = Task(SpeedProfile((0.0, 1.0, 15.0), (0.0, 3.0, 3.0)), record_every=2)
    recipe = serial_recipe("none", "serial.log=stream").serial
    with (
        serve(TargetEmulator(virtual())) as server,
        target_rig(server.port, "serial.log=stream", f"serial.watchdog={recipe.watchdog}") as rig,
    ):
        assert len(perform(rig, motion)["time"]) == 60000
        facts = json.loads(rig.report())
    assert facts["retries"] == facts["missing_samples"] == 0


def test_silence_for_good_is_given_up(monkeypatch):
    monkeypatch.setattr(protocol, "REPLY_TIMEOUT", 0.03)
    error = failing(TargetEmulator(virtual()), Fault("silence", at=20))
    assert isinstance(error, LineLost)
    assert "9 attempts" in str(error)
    assert "check power, cable" in str(error)


def test_drive_that_refuses_says_why():
    device = TargetEmulator(virtual())
    error = failing(device, Fault("refuse", at=12))
    assert "undervoltage" in str(error)
    assert device.state is TargetState.OFF


def test_line_that_damages_everything_is_given_up(monkeypatch):
    monkeypatch.setattr(protocol, "REPLY_TIMEOUT", 0.03)
    error = failing(TargetEmulator(virtual()), Fault("flip", probability=0.05))
    assert isinstance(error, LineLost)


def test_silent_host_stops_the_motor():
    device = TargetEmulator(virtual(), paced=True)
    motion = Task(SpeedProfile((0.0, 0.5, 20.0), (0.0, 5.0, 5.0)))
    with serve(device) as server:
        rig = target_rig(server.port, "serial.watchdog=0.2", "serial.log=stream").__enter__()
        running = rig.perform(motion)
        assert len(next(running)["time"]) == 4000
        assert device.state is TargetState.RUNNING
        rig.line.close()  # as if the program had been killed
        wait_until(lambda: device.state is TargetState.TRIPPED)
        assert "watchdog" in device.text
        with pytest.raises(LineLost):
            list(running)
    assert server.error is None


def test_limit_that_is_passed_while_running_trips_and_keeps_the_log():
    device = TargetEmulator(virtual())
    task = Task(CurrentSteps((0.3,), 1.0), record_every=8)  # nothing holds the shaft: it races
    with (
        serve(device) as server,
        target_rig(server.port, "serial.limits.speed=20", "rig.attachment=pulley") as rig,
    ):
        got = []
        with pytest.raises(HardwareError, match=r"speed reached .* limit of 20 rad/s"):
            got.extend(rig.perform(task))
        assert sum(len(block["time"]) for block in got) > 50
    assert device.state in (TargetState.OFF, TargetState.TRIPPED)


def test_motion_beyond_the_limits_is_never_sent():
    device = TargetEmulator(virtual())
    with serve(device) as server, target_rig(server.port, "serial.limits.speed=5") as rig:
        with pytest.raises(RecipeError, match=r"speed 6 rad/s beyond serial.limits.speed = 5"):
            perform(rig, MOTION)
        with pytest.raises(RecipeError, match="would last 1e"):
            rig.move_by(2e5)
        assert device.state is TargetState.OFF


def test_samples_that_are_gone_are_nan_and_counted(expected):
    device = TargetEmulator(virtual(), keeps_log=False)
    with (
        serve(device, Fault("lose", probability=5e-5)) as server,
        target_rig(server.port, "serial.log=stream") as rig,
    ):
        got = perform(rig, MOTION)
        missing = json.loads(rig.report())["missing_samples"]
    assert missing > 0
    lost = got["current"] != got["current"]
    assert lost.sum() == missing
    assert len(lost) == len(expected["time"])
    assert abs(got["time"] - expected["time"]).max() < 1e-6
    assert (got["encoder"][~lost] == expected["encoder"][~lost]).all()


def test_another_host_is_kept_out():
    with (
        serve(TargetEmulator(virtual())) as server,
        target_rig(server.port),
        pytest.raises(HardwareError, match="another program"),
    ):
        target_rig(server.port).__enter__()


def test_another_program_that_reads_along_costs_retries_only(expected):
    with serve(TargetEmulator(virtual())) as server, target_rig(server.port) as rig:
        thief = threading.Thread(target=steal, args=(server.port, 0.4))
        thief.start()
        got = perform(rig, MOTION)
        thief.join()
        facts = json.loads(rig.report())
    assert_same(got, expected)
    assert facts["retries"] > 0


def steal(port, seconds):
    """Read from a port without asking whose it is, with pauses."""
    other = serial.serial_for_url(port, timeout=3e-4)
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        with contextlib.suppress(serial.SerialException):
            other.read(100)
        time.sleep(0.001)
    other.close()


def test_recipe_of_another_loop_is_refused():
    with (
        serve(TargetEmulator(virtual())) as server,
        pytest.raises(RecipeError, match=r"sample_time is 0.001 .* 0.000125"),
    ):
        target_rig(server.port, "rig.sample_time=1e-3").__enter__()


def test_log_that_does_not_fit_is_refused_before_it_moves():
    device = TargetEmulator(virtual(), log_bytes=1000)
    error = failing(device)
    assert "record less often, or stream" in str(error)


def wait_until(condition, limit=60.0):
    """Wait; the limit is for what never happens, however busy the machine is."""
    end = time.monotonic() + limit
    while not condition():
        assert time.monotonic() < end
        time.sleep(0.01)
