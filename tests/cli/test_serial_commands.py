"""Commands on a rig at the end of a line, as a user types them."""

import json
import os
import re
import signal
import subprocess
import sys
from pathlib import Path

import h5py
import pytest

from rigtool.recipe import load_recipe
from rigtool.rigs.serial.emulators.target import TargetEmulator
from rigtool.rigs.serial.target.link import TargetState
from rigtool.runfile import open_run
from tests.cli.called import call
from tests.rigs.serial.emulators.faults import Fault, serve
from tests.rigs.serial.recipes import RECIPE, overrides
from tests.rigs.serial.target.test_driver_faults import wait_until
from tests.thorough import thorough

pytestmark = pytest.mark.usefixtures("world")
KT = Path(__file__).parents[1] / "fixtures" / "kt.h5"
SHORT = [
    "calibrate_kt.temperatures_degc=[20, 35]",
    "calibrate_kt.rotor_positions=2",
    "calibrate_kt.steps=6",
    "calibrate_kt.staircases=1",
    "calibrate_kt.record_every=160",
]


def device(**options):
    return TargetEmulator(load_recipe(RECIPE)[0], **options)


def settings(*values):
    return [part for value in values for part in ("--set", value)]


def calibrate(capsys, folder, port, *options, more=()):
    on_line = overrides(port, "serial.watchdog=5", *more)
    output = folder / "kt.h5"
    arguments = [RECIPE, "-o", output, *settings(*SHORT, *on_line), *options]
    return call(capsys, "calibrate-kt", *arguments)


def test_it_measures_with_yes_and_tells_of_the_line(tmp_path, capsys):
    with serve(device(), Fault("flip", at=40)) as server:
        code, out, err = calibrate(capsys, tmp_path, server.port, "--yes", "--json")
    assert code == 0, err
    assert "rigtool target emulator, link version 1, 8000 Hz" in err
    assert "4 times current steps: 5.2 s, current up to 4 A" in err
    line = json.loads(out)["provenance"]["line"]
    assert line["driver"] == "target"
    assert line["port"] == server.port
    assert line["retries"] >= 1
    assert line["missing_samples"] == 0
    code, out, err = call(capsys, "verify", tmp_path / "kt.h5")
    assert code == 0


def test_without_a_terminal_and_without_yes_it_refuses(tmp_path, capsys):
    with serve(device()) as server:
        code, _out, err = calibrate(capsys, tmp_path, server.port)
    assert code == 2
    assert "look at --dry-run, then add --yes" in err
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("answer", ["n", "", "y"])
def test_it_asks_at_a_terminal(tmp_path, capsys, monkeypatch, answer):
    monkeypatch.setattr("sys.stdin.isatty", lambda: True, raising=False)
    monkeypatch.setattr("sys.stdin.readline", lambda: answer + "\n", raising=False)
    with serve(device()) as server:
        code, _out, err = calibrate(capsys, tmp_path, server.port)
    assert "Move now? [y/N]" in err
    assert code == (0 if answer == "y" else 2)
    assert (tmp_path / "kt.h5").exists() == (answer == "y")


def test_dry_run_opens_no_port_and_writes_nothing(tmp_path, capsys):
    code, out, err = calibrate(capsys, tmp_path, "/dev/no-such-port", "--dry-run")
    assert code == 0, err
    assert "4 times current steps: 5.2 s, current up to 4 A" in out
    assert "At the bench:\n  bring the motor to 20, " in out
    assert "degC\n  clamp the arm at several angles\n" in out
    assert "Within the limits 10 A, 60 rad/s" in out
    assert list(tmp_path.iterdir()) == []


def test_dry_run_says_which_loads_will_hang(tmp_path, capsys):
    more = ["serial.limits.speed=1000", "serial.limits.duration=6000", "fft_ripple.torques=[14e-3]"]
    on_line = settings(*overrides("/dev/no-such-port", *more))
    arguments = [RECIPE, "--kt", KT, "-o", tmp_path / "r.h5", "--dry-run", *on_line]
    code, out, err = call(capsys, "fft-ripple", *arguments)
    assert code == 0, err
    assert "At the bench:\n" in out
    assert "Load the shaft with 14 mN m (weight on a cord)" in out


@pytest.mark.parametrize(("driver", "expected"), [("odrive", 3), ("target", 0)])
def test_dry_run_refuses_what_no_drive_measures(tmp_path, capsys, driver, expected):
    more = [f"serial.driver={driver}"]
    code, out, err = calibrate(capsys, tmp_path, "/dev/none", "--dry-run", more=more)
    assert code == expected
    if expected:
        assert "it records force, which odrive does not measure: add [serial.force]" in err
    else:
        assert "Whether the drive offers all of this is checked when it is connected" in out


@pytest.mark.parametrize(("name", "port"), [("sqale", "/dev/none"), ("sauter", "")])
def test_dry_run_refuses_instruments_that_nobody_can_read(tmp_path, capsys, name, port):
    more = [f"serial.force.driver={name}", f'serial.force.port="{port}"']
    code, _out, err = calibrate(capsys, tmp_path, "/dev/none", "--dry-run", more=more)
    assert code == 3
    assert ("serial.force.port is missing" if name == "sauter" else "use one of operator") in err


def test_dry_run_refuses_what_is_beyond_the_limits(tmp_path, capsys):
    more = ["serial.limits.current=3"]
    code, _out, err = calibrate(capsys, tmp_path, "/dev/none", "--dry-run", more=more)
    assert code == 3
    assert "current 4 A beyond serial.limits.current = 3 A" in err


def test_command_that_needs_more_is_refused_at_the_start(tmp_path, capsys):
    with serve(device(channels=("time", "encoder", "current_setpoint"))) as server:
        code, _out, err = calibrate(capsys, tmp_path, server.port, "--yes")
    assert code == 5
    assert "calibrate-kt cannot run on this rig" in err
    assert "it records force: the target does not record its force: add [serial.force]" in err
    assert "it records current:" in err
    assert list(tmp_path.iterdir()) == []


def test_no_such_port(tmp_path, capsys):
    code, _out, err = calibrate(capsys, tmp_path, "/dev/no-such-port", "--yes")
    assert code == 5
    assert "there is no such port; `rigtool devices`" in err
    assert list(tmp_path.iterdir()) == []


def test_pulled_cable_keeps_what_was_recorded(tmp_path, capsys):
    with serve(device(), Fault("pull", at=60)) as server:
        code, _out, err = calibrate(capsys, tmp_path, server.port, "--yes")
    assert code == 5
    assert "cable pulled" in err
    assert "see that it stands still" in err
    assert "samples that were recorded are kept" in err
    part = tmp_path / "kt.h5.part"
    assert call(capsys, "recover", part, "-o", tmp_path / "rescued.h5")[0] == 0
    with open_run(tmp_path / "rescued.h5") as run:
        assert len(run.recording("staircase").read("current")) > 200


def test_a_spy_file_plays_back_as_the_rig(tmp_path, capsys):
    spy = tmp_path / "line.spy"
    with serve(device(), Fault("flip", at=50), Fault("cut", at=300)) as server:
        code, _out, err = calibrate(capsys, tmp_path, server.port, "--yes", "--spy", spy)
    assert code == 0, err
    (tmp_path / "kt.h5").rename(tmp_path / "first.h5")
    with h5py.File(tmp_path / "first.h5") as file:
        recording = file["entry/recordings/staircase"]
        # 160 samples of the loop make one: 50 a second. About a second is in a chunk.
        assert {channel.chunks for channel in recording.values()} == {(64,)}
    more = ["serial.driver=replay"]
    code, _out, err = calibrate(capsys, tmp_path, spy, "--yes", more=more)
    assert code == 0, err
    with open_run(tmp_path / "first.h5") as first, open_run(tmp_path / "kt.h5") as again:
        assert again.content_sha256 == first.content_sha256
        retries = [json.loads(run.provenance["line"])["retries"] for run in (first, again)]
    assert retries[0] == retries[1] > 0
    more = ["serial.driver=replay", "calibrate_kt.rotor_positions=3"]
    code, _out, err = calibrate(capsys, tmp_path, spy, "--yes", "--overwrite", more=more)
    assert code == 5
    assert "play a record back with the recipe it was made with" in err


@pytest.mark.real_time
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGKILL, *thorough(signal.SIGTERM)])
def test_however_it_ends_the_motor_is_off_and_signals_are_kept(tmp_path, capsys, number):
    emulated = device(paced=True)
    with serve(emulated) as server:
        on_line = overrides(server.port, "serial.watchdog=0.4", "serial.log=stream")
        line = [Path(sys.executable).with_name("rigtool"), "stribeck", RECIPE, "--kt", KT, "--yes"]
        line += ["-o", tmp_path / "f.h5", *settings(*on_line, "stribeck.record_every=1")]
        with subprocess.Popen(
            [str(part) for part in line], stderr=subprocess.PIPE, text=True, cwd=tmp_path
        ) as process:
            try:
                wait_until(lambda: emulated.state is TargetState.RUNNING)
                # a kill leaves whole chunks only, and the host may be seconds late
                enough = 40000 if number == signal.SIGKILL else 12000
                wait_until(lambda: emulated._visible >= enough)
                os.kill(process.pid, number)
                err = process.communicate(timeout=60)[1]
            finally:
                process.kill()
        wait_until(lambda: emulated.state in (TargetState.OFF, TargetState.TRIPPED))
        if number == signal.SIGKILL:
            assert "watchdog" in emulated.text
        else:
            assert emulated.text == "stopped by the host"
            assert process.returncode == 128 + number
            assert "samples that were recorded are kept" in err
    assert server.error is None
    part = tmp_path / "f.h5.part"
    code, out, _ = call(capsys, "recover", part)
    assert code == 0
    assert int(re.search(r"holds: (\d+) samples", out)[1]) >= 4000


def test_devices(tmp_path, capsys):
    with serve(device()) as server:
        code, out, _err = call(capsys, "devices", server.port, "--driver", "target")
        assert code == 0
        assert out.startswith(f"{server.port}: target: rigtool target emulator, link version 1")
        code, out, err = call(
            capsys, "devices", "/dev/no-such", server.port, "--json", "--driver", "target"
        )
    assert (code, err) == (5, "Error: /dev/no-such: not queried, the reason is above\n")
    found = json.loads(out)["devices"]
    assert found[0]["problem"].startswith("cannot be opened: there is no such port")
    assert found[1]["driver"] == "target"
    assert call(capsys, "devices", "--driver", "toaster")[0] == 2


def test_a_seed_is_refused_where_the_recipe_describes_no_virtual_rig(tmp_path, capsys):
    recipe = Path(RECIPE).with_name("moteus-r4.toml")
    given = (recipe, "--seed", "3", "--dry-run", "-o", tmp_path / "x.h5")
    code, _, err = call(capsys, "calibrate-kt", *given)
    assert (code, "is on a line, not virtual" in err) == (2, True)


def test_options_that_have_nothing_to_do_are_refused(tmp_path, capsys):
    output = ["-o", tmp_path / "x.h5"]
    code, _, err = call(capsys, "calibrate-kt", KT, "--dry-run", *output)
    assert (code, "nothing would move" in err) == (2, True)
    code, _, err = call(capsys, "calibrate-kt", RECIPE, "--spy", tmp_path / "spy", *output)
    assert (code, "there is no line" in err) == (2, True)
    with serve(device()) as server:
        code, _, err = calibrate(capsys, tmp_path, server.port, "--yes", "--seed", "3")
        assert (code, "is on a line, not virtual" in err) == (2, True)
        code, _, err = calibrate(capsys, tmp_path, server.port, "--yes", "--spy", tmp_path)
        assert (code, "is a folder" in err) == (2, True)
    assert list(tmp_path.iterdir()) == []
