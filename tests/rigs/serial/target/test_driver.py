"""The target's link over a pseudo-terminal and a socket, against the virtual rig itself."""

import json
import time
from dataclasses import replace

import numpy as np
import pytest

from rigtool.control.lookup_table import LookupTable
from rigtool.recipe import load_recipe
from rigtool.recipe.virtual import Tissue
from rigtool.rigs import Feedforward, Load, Task, open_rig
from rigtool.rigs.motion import CurrentRamp, CurrentSteps, SpeedProfile, Triangle
from rigtool.rigs.operator import Operator
from rigtool.rigs.serial.emulators.target import TargetEmulator
from rigtool.signals import CHANNELS
from tests.rigs.performed import perform
from tests.rigs.serial.emulators.faults import Fault, serve
from tests.rigs.serial.recipes import RECIPE, serial_recipe

KT = 0.0454
OPERATOR = Operator(say=lambda text: None, present=False, yes=True)
TRIANGLE = Task(Triangle(0.1, 1.1, 3.0, 0.2, cycles=1), Feedforward(1.5e-5, 2e-3, 5e-5))

TABLE = LookupTable(
    np.linspace(0.0, 1.2, 200),
    np.array([-3.0, -1.0, 1.0, 3.0]),
    np.random.default_rng(1).normal(0.0, 1e-3, (4, 200)),
    np.array([0.0, 0.5, 1.0]),
    np.array([0.0, 0.7, 1.0]),
)
SIGNAL = np.random.default_rng(2).normal(0.0, 1e-3, 777)


def virtual():
    return load_recipe(RECIPE)[0]


def target_rig(port, *more):
    return open_rig(serial_recipe(port, "serial.watchdog=5", *more), KT, "test", OPERATOR)


def as_stored(signals):
    return {name: values.astype(CHANNELS[name][1]) for name, values in signals.items()}


def assert_same(got, expected):
    assert set(got) == set(expected)
    for name, values in as_stored(expected).items():
        np.testing.assert_array_equal(as_stored(got)[name], values, err_msg=name)


@pytest.mark.real_time
@pytest.mark.parametrize("log", ["memory", "stream"])
@pytest.mark.parametrize("tcp", [False, True])
def test_signals_are_those_of_the_virtual_rig(log, tcp):
    tasks = [
        TRIANGLE,
        Task(TRIANGLE.motion, Feedforward(1.5e-5, table=TABLE, signal=SIGNAL), record_every=3),
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
            expected = perform(direct, task)
            assert_same(perform(rig, task), expected)
    assert server.error is None


def test_contacts_of_the_emulators_recipe_act_and_are_not_recorded():
    tissue = Tissue(kind="tissue", at=(0.0,), angle_deg=20.0, stiffness=0.1)
    recipe = virtual()
    changed = recipe.virtual.model_copy(update={"contact": (tissue,)})
    touching = recipe.model_copy(update={"virtual": changed})
    direct = open_rig(touching, KT, "test")
    expected = perform(direct, replace(TRIANGLE, touched=True))
    assert expected.pop("reference_torque").max() > 0.01
    with serve(TargetEmulator(touching)) as server, target_rig(server.port) as rig:
        assert rig.lacks("reference_torque") is not None
        assert_same(perform(rig, TRIANGLE), expected)
    assert server.error is None


def test_times_of_the_target_are_reported_in_the_hosts():
    with (
        serve(TargetEmulator(virtual(), paced=True)) as server,
        target_rig(server.port, "serial.log=stream") as rig,
    ):
        motion = SpeedProfile((0.0, 0.2, 0.6), (0.0, 1.0, 0.0))
        begin = time.monotonic()
        got = perform(rig, Task(motion, record_every=8))
        end = time.monotonic()
        moments = rig.line.opened + rig._host_time(got["time"])
    assert begin < moments[0] < begin + 1.0
    assert moments[-1] - moments[0] == pytest.approx(0.6, abs=2e-3)
    assert moments[-1] < end + 0.3


def test_streamed_samples_are_handed_on_at_once_and_recorded_as_they_were():
    late, seen = [], []

    def watch(block):
        moments = rig.line.opened + rig._host_time(block["time"])
        late.append(time.monotonic() - moments.min())
        seen.append(block)

    with (
        serve(TargetEmulator(virtual(), paced=True)) as server,
        target_rig(server.port, "serial.log=stream", "rig.attachment=pulley") as rig,
    ):
        assert rig.streams
        rig.watcher = watch
        got = perform(rig, Task(SpeedProfile((0.0, 0.5, 2.0), (0.0, 3.0, 3.0))))
    assert max(late) < 12e-3  # of emulated time; what takes 8 ms together stays within 20 ms
    for name, values in got.items():
        np.testing.assert_array_equal(np.concatenate([block[name] for block in seen]), values)


def test_8_khz_stream_without_loss_and_few_questions_beside_it():
    """How much of a processor it takes is measured by `make bench`."""
    with (
        serve(TargetEmulator(virtual(), paced=True)) as server,
        target_rig(server.port, "serial.log=stream", "rig.attachment=pulley") as rig,
    ):
        before = replace(rig.line.counts)
        got = perform(rig, Task(SpeedProfile((0.0, 0.5, 2.0), (0.0, 3.0, 3.0))))
        facts = json.loads(rig.report())
    assert len(got["time"]) == 16000
    assert facts["missing_samples"] == facts["retries"] == 0
    assert facts["requests"] - before.requests < 50  # one each 0.1 s, and what begins a motion
    size = sum(np.dtype(CHANNELS[name][1]).itemsize for name in got)
    assert facts["bytes_received"] - before.bytes_received < 1.06 * 16000 * size


def test_blocks_come_down_in_frames_as_long_as_can_be():
    """So many bytes a second as the line carries: `make bench` measures 15 MB/s."""
    with serve(TargetEmulator(virtual())) as server, target_rig(server.port) as rig:
        task = Task(SpeedProfile((0.0, 1.0, 8.0), (0.0, 3.0, 3.0)))
        running = rig.perform(task)
        first = next(running)
        before = replace(rig.line.counts)
        samples = sum(len(block["time"]) for block in running)
        after = rig.line.counts
    size = sum(np.dtype(CHANNELS[name][1]).itemsize for name in first)
    assert after.bytes_received - before.bytes_received < 1.03 * samples * size
    assert after.requests - before.requests < 1.1 * samples * size / 4096 + 20


@pytest.mark.parametrize("log", ["memory", "stream"])
def test_a_record_plays_back_bit_for_bit(log, tmp_path):
    path = str(tmp_path / "line.spy")
    recipe = serial_recipe("none", f"serial.log={log}", "serial.watchdog=5")
    signals = []
    with serve(TargetEmulator(virtual()), Fault("cut", at=25), Fault("late", at=33)) as server:
        for driver, port, spy in (("target", server.port, path), ("replay", path, None)):
            line = recipe.serial.model_copy(update={"driver": driver, "port": port})
            operator = replace(OPERATOR, spy=spy)
            with open_rig(recipe.model_copy(update={"serial": line}), KT, "test", operator) as rig:
                signals.append(perform(rig, TRIANGLE))
                assert json.loads(rig.report())["retries"] > 0
    assert_same(*signals)
