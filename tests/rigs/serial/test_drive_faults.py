"""Faults on the lines of drives: what is recorded is true, or the run ends with a message.

What an emulated motor really did is written down beside it, so that a value shows which belongs to
another question, or to another time. The targets' faults are in test_target_faults.py.
"""

import json
import threading
import time

import numpy as np
import pytest

from rigtool.errors import HardwareError
from rigtool.rigs import Task
from rigtool.rigs.motion import SpeedProfile
from rigtool.rigs.operator import Operator
from rigtool.rigs.serial.hosted import loop
from rigtool.rigs.serial.maxon import driver as maxon
from rigtool.rigs.serial.maxon import guard as maxon_guard
from rigtool.rigs.serial.moteus import driver as moteus
from rigtool.rigs.serial.odrive import driver as odrive
from rigtool.runfile import open_run
from tests.cli.called import call
from tests.rigs.serial.emulators.faults import Fault, serve
from tests.rigs.serial.emulators.maxon import DesEmulator, Epos2Emulator, Epos4Emulator
from tests.rigs.serial.emulators.moteus import MoteusEmulator
from tests.rigs.serial.emulators.odrive import IDLE, ODriveEmulator
from tests.rigs.serial.maxon.test_driver import PatientRig, inject
from tests.rigs.serial.recipes import RECIPE, overrides, serial_recipe
from tests.rigs.serial.target.test_driver_faults import steal, wait_until

KT_FILE = RECIPE.parents[1] / "tests" / "fixtures" / "kt.h5"
DRIVES = {
    "odrive": (ODriveEmulator, odrive, 0.008),
    "moteus": (MoteusEmulator, moteus, 0.004),
    "epos4": (Epos4Emulator, maxon, 0.01),
    "epos2": (Epos2Emulator, maxon, 0.01),
    "des": (DesEmulator, maxon, 0.01),
}
TO_AND_FRO = Task(SpeedProfile((0.0, 0.1, 0.4, 0.5, 0.7, 0.8), (0.0, 4.0, 4.0, -4.0, -4.0, 0.0)))
NOISE = {"odrive": 3e-4, "moteus": 1e-4, "epos4": 3e-4, "epos2": 5e-5, "des": 5e-5}
"""Part of the bytes that each kind of noise hits: in lock-step each costs the frame's timeout."""


@pytest.fixture(autouse=True)
def quick(monkeypatch):
    monkeypatch.setattr(loop, "BLOCK_TIME", 0.05)
    monkeypatch.setattr(maxon, "FRAME_TIMEOUT", 0.03)
    monkeypatch.setattr(maxon_guard.Guard, "_start", lambda guard: None)
    monkeypatch.setattr(maxon_guard.Guard, "_send", lambda guard, word: None)


@pytest.fixture(params=DRIVES)
def name(request):
    return request.param


def watched(name):
    """Return an emulated drive and the list of (time, position, current) of its motor."""
    device = DRIVES[name][0]()
    if name == "des":
        device.frame_timeout = 0.03
    advance, truth = device.motor.advance, []

    def watching(*what, **more):
        advance(*what, **more)
        truth.append((time.monotonic(), device.motor.position, device.motor.current))

    device.motor.advance = watching
    return device, truth


def is_off(device):
    return (
        device.state == IDLE if isinstance(device, ODriveEmulator) else device.mode in (None, 0, 11)
    )


def rig_of(name, port, *more):
    _, module, period = DRIVES[name]
    driver = module.__name__.split(".")[3]
    recipe = serial_recipe(port, "serial.watchdog=1.5", *more, driver=driver, sample_time=period)
    operator = Operator(say=lambda text: None, present=False, yes=True)
    return PatientRig(recipe, 0.045, "test", operator, module.DRIVER)


def recorded(rig, task, got):
    """Run a motion; `got` is added to, also where it ends early."""
    for block in rig.perform(task):
        got.append(block)


def assert_true(got, truth, opened):
    """See that each sample is what the motor did, at about the time that it says."""
    signals = {name: np.concatenate([block[name] for block in got]) for name in got[0]}
    when, position, current = np.array(truth).T
    moments = opened + signals["time"]
    angle = signals["encoder"] * (2 * np.pi / 4000)
    wrong = angle - np.interp(moments, when, position)
    assert np.abs(wrong - np.median(wrong)).max() < 0.12  # 30 ms at 4 rad/s; a bit is far more
    assert np.isfinite(signals["current"]).all()
    assert np.abs(signals["current"]).max() <= np.abs(current).max() + 2e-3
    assert (np.diff(signals["time"]) > 0).all()
    return signals


def test_noise_costs_retries_and_no_sample_is_wrong(name):
    device, truth = watched(name)
    writes = 1 if name in ("odrive", "moteus", "epos4") else 3
    noise = [
        Fault(kind, probability=NOISE[name], towards=towards, seed=seed)
        for seed, kind in enumerate(("flip", "lose", "double"))
        for towards in ("host", "device")
    ]
    noise += [Fault("cut", at=31 * writes), Fault("cut", at=47 * writes, towards="device")]
    got = []
    with serve(device) as server, rig_of(name, server.port) as rig:
        rig.line.retries = 12  # far more noise than a line has
        inject(server, *noise)
        recorded(rig, TO_AND_FRO, got)
        inject(server)
        facts = json.loads(rig.report())
        opened = rig.line.opened
    assert server.error is None
    signals = assert_true(got, truth, opened)
    assert len(signals["time"]) == round(0.8 / DRIVES[name][2])
    assert facts["retries"] > 0
    assert facts["missing_samples"] == 0
    assert is_off(device)


def test_another_program_that_reads_along_makes_no_sample_wrong(name):
    device, truth = watched(name)
    got, error = [], None
    with serve(device) as server:
        thief = threading.Thread(target=steal, args=(server.port, 0.3))
        try:
            with rig_of(name, server.port) as rig:
                opened = rig.line.opened
                recorded(rig, Task(SpeedProfile((0.0, 0.1, 0.2), (0.0, 2.0, 2.0))), got)
                thief.start()
                recorded(rig, TO_AND_FRO, got)
                retries = rig.line.counts.retries
        except HardwareError as failure:
            error = failure
        thief.join()
        wait_until(lambda: is_off(device))
    assert server.error is None
    assert_true(got, truth, opened)
    if error is None:
        assert retries > 0
    else:
        assert any(word in str(error) for word in ("another program", "damaged or missing", "late"))


def test_another_host_is_kept_off_the_port(name):
    device, _ = watched(name)
    with (
        serve(device) as server,
        rig_of(name, server.port),
        pytest.raises(HardwareError, match="another program has it open"),
    ):
        rig_of(name, server.port).__enter__()


LEARNING = (
    "rig.attachment=pulley",
    "rig.controller.crossover_hz=2",
    "rig.controller.integrator_hz=0.2",
    "rig.controller.lowpass_hz=10",
    "ilc_learn.robustness_hz=3",
    "ilc_learn.turning.speeds_rev_per_s=[1]",
    "ilc_learn.turning.low_speeds_rev_per_s=[]",
    "ilc_learn.turning.revolutions=3",
    "ilc_learn.turning.record_every=1",
    "serial.watchdog=0.4",
)


@pytest.mark.parametrize("kind", ["pull", "reset", "refuse", "silence"])
@pytest.mark.parametrize("name", ["odrive", "moteus", "epos4"])
def test_command_ends_with_5_and_what_was_recorded_comes_back(tmp_path, capsys, name, kind):
    make_device, module, _ = DRIVES[name]
    device = make_device()
    driver = module.__name__.split(".")[3]
    with serve(device) as server:
        on_line = overrides(server.port, *LEARNING, driver=driver, sample_time=0.01)
        changes = [part for value in on_line for part in ("--set", value)]
        breaks = threading.Thread(
            target=lambda: (
                wait_until(lambda: device.motor.speed > 5, 10),
                time.sleep(0.3),
                inject(server, Fault(kind, at=0, count=20)),
            )
        )
        breaks.start()
        code, _out, err = call(
            capsys, "ilc-learn", RECIPE, "--implementation", "B", "--kt", KT_FILE,
            "-o", tmp_path / "x.h5", "--yes", *changes,
        )  # fmt: skip
        breaks.join()
        if kind != "pull":
            wait_until(lambda: is_off(device), 5)
    assert code == 5, err
    assert "Traceback" not in err
    assert "samples that were recorded are kept" in err
    assert not (tmp_path / "x.h5").exists()
    assert call(capsys, "recover", tmp_path / "x.h5.part", "-o", tmp_path / "rescued.h5")[0] == 0
    with open_run(tmp_path / "rescued.h5") as run:
        encoder = run.recording("learn_000").read("encoder")
    assert len(encoder) > 20
    assert np.isfinite(encoder).all()
