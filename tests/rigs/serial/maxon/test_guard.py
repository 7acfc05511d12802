"""A maxon drive is switched off although rigtool was killed, or hangs: by a process beside it."""

import os
import re
import signal
import subprocess
import sys
import threading
from pathlib import Path

import pytest

from rigtool.errors import HardwareError
from rigtool.rigs import Task
from rigtool.rigs.motion import SpeedProfile
from rigtool.rigs.operator import Operator
from rigtool.rigs.serial.emulators.server import serve
from rigtool.rigs.serial.hosted.rig import HostedRig
from rigtool.rigs.serial.maxon import driver as maxon
from rigtool.rigs.serial.maxon import guard_process
from rigtool.rigs.serial.maxon.guard import Guard
from tests.rigs.serial.emulators.maxon import DesEmulator, Epos2Emulator, Epos4Emulator
from tests.rigs.serial.maxon.test_driver import maxon_rig
from tests.rigs.serial.recipes import RECIPE, overrides, serial_recipe
from tests.rigs.serial.target.test_driver_faults import wait_until
from tests.thorough import thorough

ROOT = Path(__file__).parents[4]
KT = ROOT / "tests" / "fixtures" / "kt.h5"
RIGTOOL = str(Path(sys.executable).with_name("rigtool"))
SLOW = Task(SpeedProfile((0.0, 0.1, 5.0), (0.0, 4.0, 4.0)))


TURNS = """
import sys
from tests.rigs.serial.maxon.test_guard import SLOW, patient_rig
with patient_rig(sys.argv[1]) as rig:
    list(rig.perform(SLOW))
"""


def patient_rig(port):
    """Return a rig that bears a machine that stalls for seconds."""
    recipe = serial_recipe(port, "serial.watchdog=10", driver="maxon", sample_time=0.1)
    operator = Operator(say=lambda text: None, present=False, yes=True)
    return HostedRig(recipe, 0.045, "test", operator, maxon.DRIVER)


def program(*arguments):
    """Return a program that turns a motor for a while, as a process of its own."""
    return subprocess.Popen([*map(str, arguments)], stderr=subprocess.PIPE, text=True, cwd=ROOT)


def learning(port, folder):
    settings = overrides(
        port,
        "rig.attachment=pulley",
        "rig.controller.crossover_hz=2",
        "rig.controller.integrator_hz=0.2",
        "rig.controller.lowpass_hz=10",
        "ilc_learn.robustness_hz=3",
        "serial.watchdog=3",
        driver="maxon",
        sample_time=0.04,
    )
    changes = [part for value in settings for part in ("--set", value)]
    learn = (RIGTOOL, "ilc-learn", RECIPE, "--implementation", "B", "--kt", KT, "--yes")
    return program(*learn, "-o", folder / "x.h5", *changes)


def until_it_turns(device, process):
    wait_until(lambda: device.mode == "velocity" or process.poll() is not None)
    wait_until(lambda: device.motor.speed > 1 or process.poll() is not None)
    assert process.poll() is None, process.communicate()[1]


@pytest.mark.real_time
@pytest.mark.parametrize("make_device", [Epos4Emulator, DesEmulator, *thorough(Epos2Emulator)])
def test_killed_program_leaves_it_off(make_device):
    device = make_device()
    with serve(device) as server, program(sys.executable, "-c", TURNS, server.port) as process:
        until_it_turns(device, process)
        process.send_signal(signal.SIGKILL)
        wait_until(lambda: device.mode is None)
        assert "it is switched off now" in process.stderr.read()
    assert device.log[-1] == "off"


@pytest.mark.real_time
def test_rigtool_that_hangs_leaves_it_off_and_says_so_when_it_goes_on(tmp_path):
    device = Epos4Emulator()
    with serve(device) as server, learning(server.port, tmp_path) as process:
        until_it_turns(device, process)
        start = device.motor.position  # some turns are recorded
        wait_until(lambda: abs(device.motor.position - start) > 30 or process.poll() is not None)
        process.send_signal(signal.SIGSTOP)
        wait_until(lambda: device.mode is None)
        process.send_signal(signal.SIGCONT)
        reported = process.stderr.read()
        assert process.wait(60) == 5
    assert (
        "was killed, hangs or lost the line while the drive was on: it is switched off" in reported
    )
    assert re.search("ms late|is switched off|is gone", reported)
    assert (tmp_path / "x.h5.part").exists()


@pytest.mark.real_time
def test_a_guard_that_is_not_needed_does_nothing():
    device = Epos4Emulator()
    with serve(device) as server:
        guard = Guard(server.port, 115200, 1, silence=0.1)
        guard.beat()  # nothing is on: nothing is started
        assert guard.process is None
        guard.watch()
        guard.rest()
        device.switch("velocity")  # somebody else's, afterwards
        guard.beat()
        guard.close()
        wait_until(lambda: guard.process.poll() is not None)
    assert guard.process.returncode == 0
    assert device.mode == "velocity"


class Notes:
    """A guard that only notes what it is reported."""

    def __init__(self):
        self.reported = []

    def __getattr__(self, word):
        return lambda: self.reported.append(word)


def test_a_guard_is_informed_when_the_drive_is_on_alive_and_off():
    """Between motions, however long they are apart, it is not to switch anything off."""
    short = Task(SpeedProfile((0.0, 0.1, 0.2, 0.3), (0.0, 4.0, 4.0, 0.0)))
    with serve(Epos4Emulator()) as server, maxon_rig(server.port) as rig:
        notes = rig.drive.guard = Notes()
        for _ in range(2):
            notes.reported.clear()
            list(rig.perform(short))
            on, off = notes.reported.index("watch"), notes.reported.index("rest")
            assert notes.reported.count("watch") == 1
            assert notes.reported[on + 1 : off].count("beat") > 5
            assert set(notes.reported[off:]) <= {"rest", "beat"}
    assert notes.reported[-1] == "close"


def turned_while_its_guard_is_killed(rig):
    for _ in rig.perform(SLOW):
        rig.drive.guard.process.kill()


@pytest.mark.real_time
def test_without_its_guard_a_motion_ends():
    device = Epos4Emulator()
    with (
        serve(device) as server,
        pytest.raises(HardwareError, match="is gone: it was ended"),
        patient_rig(server.port) as rig,
    ):
        turned_while_its_guard_is_killed(rig)
    assert device.mode is None


@pytest.mark.real_time
def test_a_guard_that_cannot_be_started_keeps_the_motor_off(monkeypatch):
    device = Epos4Emulator()
    monkeypatch.setattr(sys, "executable", "/bin/false")
    with (
        serve(device) as server,
        pytest.raises(HardwareError, match="cannot be started"),
        patient_rig(server.port) as rig,
    ):
        list(rig.perform(SLOW))
    assert device.log == []


@pytest.mark.real_time
def test_signals_do_not_end_a_guard():
    """They are for the program that it watches, and end it with that."""
    device = Epos4Emulator()
    with serve(device) as server:
        guard = Guard(server.port, 115200, 1, silence=30.0)
        guard.watch()
        device.switch("velocity")
        for sent in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
            guard.process.send_signal(sent)
        guard.beat()
        guard.close()
        wait_until(lambda: guard.process.poll() is not None)
    assert guard.process.returncode == 0
    assert device.mode is None


@pytest.mark.real_time
def test_a_guard_that_was_stopped_does_not_stop_the_loop_with_it():
    """It reads no more: when no word fits into the pipe, the motion ends as without a guard."""
    guard = Guard("/dev/no-such-port", 115200, 1, silence=1000.0)
    guard.watch()
    said = []

    def beat():
        try:
            while True:
                guard.beat()
        except HardwareError as error:
            said.append(str(error))

    guard.process.send_signal(signal.SIGSTOP)
    loop = threading.Thread(target=beat, daemon=True)
    try:
        loop.start()
        loop.join(60)
        assert not loop.is_alive()
    finally:
        guard.process.kill()
    assert "is gone" in said[0]


def test_rigtool_that_hangs_is_ended_where_it_keeps_its_port_to_itself(monkeypatch):
    ended = []
    monkeypatch.setattr(guard_process.os, "kill", lambda *process: ended.append(process))
    guard_process._free_port()
    assert ended == []
    monkeypatch.setattr(guard_process, "WINDOWS", True)
    guard_process._free_port()
    assert ended == [(os.getppid(), signal.SIGTERM)]
