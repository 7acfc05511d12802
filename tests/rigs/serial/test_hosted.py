"""Motions on a drive that is driven from the host, over a pseudo-terminal."""

import json

import numpy as np
import pytest

from rigtool.rigs import Feedforward, Task
from rigtool.rigs.bench import Bench, Operator
from rigtool.rigs.motion import Triangle
from rigtool.rigs.serial.emulators.server import serve
from rigtool.rigs.serial.hosted import HostedRig
from tests.rigs.serial import toy
from tests.rigs.serial.recipes import serial_recipe

PERIOD = 0.004


def toy_rig(port, *more, bench=None, **options):
    recipe = serial_recipe(port, *more, driver="odrive", **{"sample_time": PERIOD, **options})
    bench = bench or Bench(yes=True, operator=Operator(say=lambda text: None, present=False))
    return HostedRig(
        recipe, 0.045, "test", bench, make_drive=toy.make_drive, baud_rate=toy.BAUD_RATE
    )


def perform(rig, task):
    blocks = list(rig.perform(task))
    return {name: np.concatenate([block[name] for block in blocks]) for name in blocks[0]}


def test_motion_is_followed_and_logged():
    device = toy.ToyEmulator()
    with serve(device) as server, toy_rig(server.port) as rig:
        got = perform(
            rig, Task(Triangle(0.5, 1.5, 4.0, 0.3, cycles=1), Feedforward(inertia=1.5e-5))
        )
        facts = json.loads(rig.report())
    assert len(got["time"]) == 200
    angle = got["encoder"] * 2 * np.pi / 4000
    assert np.abs(angle - got["position_setpoint"]).max() < 0.1
    assert got["position_setpoint"].max() == pytest.approx(1.5, abs=0.01)
    assert np.diff(got["time"]).mean() == pytest.approx(PERIOD, rel=0.02)
    assert facts["samples"] > 200
    assert facts["rate_hz"] == pytest.approx(1 / PERIOD, rel=0.05)
    assert facts["retries"] == facts["missing_samples"] == 0
    assert device.log[-1] == "limit 20.0"  # as it was
    assert device.mode is None
