"""The target's link over a pseudo-terminal and a socket, against the virtual rig itself."""

import numpy as np
import pytest

from rigtool.recipe import load_recipe
from rigtool.rigs import CHANNELS, Feedforward, Load, Task, open_rig
from rigtool.rigs.bench import Bench, Operator
from rigtool.rigs.motion import CurrentRamp, CurrentSteps, SpeedProfile, Triangle
from rigtool.rigs.serial.emulators.server import serve
from rigtool.rigs.serial.emulators.target import TargetEmulator
from tests.rigs.serial.recipes import RECIPE, serial_recipe

KT = 0.0454
BENCH = Bench(yes=True, operator=Operator(say=lambda text: None, present=False))
TRIANGLE = Task(Triangle(0.1, 1.1, 3.0, 0.2, cycles=1), Feedforward(1.5e-5, 2e-3, 5e-5))


def virtual():
    return load_recipe(RECIPE)[0]


def target_rig(port, *more):
    return open_rig(serial_recipe(port, "serial.watchdog=5", *more), KT, "test", BENCH)


def blocks_of(rig, task):
    blocks = list(rig.perform(task))
    return {name: np.concatenate([block[name] for block in blocks]) for name in blocks[0]}


def as_stored(signals):
    return {name: values.astype(CHANNELS[name][1]) for name, values in signals.items()}


def assert_same(got, expected):
    assert set(got) == set(expected)
    for name, values in as_stored(expected).items():
        np.testing.assert_array_equal(as_stored(got)[name], values, err_msg=name)


@pytest.mark.parametrize("log", ["memory", "stream"])
@pytest.mark.parametrize("tcp", [False, True])
def test_signals_are_those_of_the_virtual_rig(log, tcp):
    tasks = [
        TRIANGLE,
        Task(SpeedProfile((0.0, 0.1, 0.4, 0.5), (0.0, 3.0, 3.0, 0.0)), record_every=4),
        Task(CurrentRamp(0.5, 0.2), load=Load(radial_force=5.0), stop_angle=0.05),
        Task(CurrentSteps((0.0, 1.0), 0.1), load=Load(clamped=True), record_every=8),
    ]
    direct = open_rig(virtual(), KT, "test")
    with (
        serve(TargetEmulator(virtual()), tcp=tcp) as server,
        target_rig(server.port, f"serial.log={log}") as rig,
    ):
        for task in tasks:
            for each in (direct, rig):
                if task.load.clamped:
                    each.soak(40.0)
                    each.clamp(0.3)
                each.move_by(0.2)
            expected = blocks_of(direct, task)
            assert_same(blocks_of(rig, task), expected)
    assert server.error is None
