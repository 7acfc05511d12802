"""The target in C: tests of the Python emulator, currents of the virtual rig, the same tables."""

import json
import shutil
import time
import zlib
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from rigtool.control.lookup_table import LookupTable
from rigtool.errors import HardwareError
from rigtool.rigs import Feedforward, Task, open_rig
from rigtool.rigs.motion import CurrentSteps, Move, SpeedProfile, Triangle
from rigtool.rigs.serial.emulators.server import serve
from rigtool.rigs.serial.line import LineLost
from rigtool.rigs.serial.target import link, protocol
from rigtool.rigs.serial.target.link import FrameKind, Slot, TargetState
from tests.rigs.performed import perform
from tests.rigs.serial.emulators.firmware import Bare, Firmware, library, pointer
from tests.rigs.serial.target import test_driver_emulator, test_driver_faults
from tests.rigs.serial.target.test_driver import (
    KT,
    SIGNAL,
    TABLE,
    as_stored,
    target_rig,
    virtual,
)
from tests.rigs.serial.target.test_driver_faults import wait_until

pytestmark = pytest.mark.skipif(shutil.which("cc") is None, reason="there is no C compiler cc")

STRICTER = (
    "-fsanitize=undefined",
    "-fno-sanitize-recover=undefined",
    "-Wconversion",
    "-Wno-sign-conversion",
)


@pytest.fixture(scope="module", autouse=True)
def c(tmp_path_factory):
    """The target as a library that ends the program where its behaviour is undefined."""
    Bare.c = library(tmp_path_factory.mktemp("target"), *STRICTER)
    return Bare.c


def assert_alike(got, expected, task=None):
    """Compare samples, and the steps of their clocks: that of the virtual rig may stand still.

    A motion in open loop has no set point of position.
    """
    assert np.abs(np.diff(got["time"]) - np.diff(expected["time"])).max() < 1e-9
    left_out = {"time"}
    if task is not None and isinstance(task.motion, CurrentSteps):
        left_out.add("position_setpoint")
    for name in set(got) - left_out:
        # Set points begin where a piece begins, which differs by rounding: a last digit of float32
        bound = 2e-7 if name.endswith("setpoint") else 0
        values = as_stored(expected)[name]
        np.testing.assert_allclose(as_stored(got)[name], values, rtol=bound, err_msg=name)


PROFILES = (
    Task(SpeedProfile((0.0, 0.1, 0.4, 0.5), (0.0, 3.0, 3.0, 0.0)), Feedforward(1.5e-5)),
    Task(
        SpeedProfile((0.0, 0.2, 0.4, 0.7), (0.0, 4.0, -4.0, 0.0)),
        Feedforward(1.5e-5, 0.0, 5e-5, TABLE, SIGNAL),
    ),
)
STROKES = (
    Task(Triangle(0.1, 1.1, 6.0, 0.2, cycles=1), Feedforward(1.5e-5, 2e-3, 5e-5)),
    Task(CurrentSteps((0.0, 0.3, -0.3), 0.05)),
)


@pytest.mark.parametrize("log", ["memory", "stream"])
def test_signals_are_those_of_the_virtual_rig(log):
    device, direct = Firmware(virtual()), open_rig(virtual(), KT, "test")
    with serve(device) as server, target_rig(server.port, f"serial.log={log}") as rig:
        for task in (*PROFILES, *STROKES):
            for each in (direct, rig):
                each.move_by(0.2)
            assert_alike(perform(rig, task), perform(direct, task), task)
        assert device.difference < 1e-11
        facts = json.loads(rig.report())
    assert facts["retries"] == facts["missing_samples"] == 0
    assert server.error is None


def test_floats_ask_for_the_same_currents_within_their_precision(tmp_path, monkeypatch):
    floats = library(tmp_path, *STRICTER, "-DRIGTOOL_TARGET_FLOAT", name="floats.so")
    monkeypatch.setattr(Bare, "c", floats)
    device = Firmware(virtual())
    with serve(device) as server, target_rig(server.port) as rig:
        largest = max(np.abs(perform(rig, task)["current_setpoint"]).max() for task in PROFILES)
    assert 0.0 < device.difference < 1e-3 * largest


def test_samples_are_means():
    task = replace(PROFILES[1], record_every=5)
    device, direct = Firmware(virtual()), open_rig(virtual(), KT, "test")
    with serve(device) as server, target_rig(server.port) as rig:
        got, expected = perform(rig, task), perform(direct, task)
    for name in ("position_setpoint", "encoder", "current_setpoint", "table_current"):
        np.testing.assert_allclose(got[name], expected[name], rtol=1e-6, atol=1e-9)
    assert len(got["time"]) == 1120


def rising(size):
    steps = st.lists(st.floats(0.01, 3.0), min_size=size, max_size=size)
    return steps.map(lambda values: np.cumsum(values))


@st.composite
def tables(draw):
    """Return a table of any form, with one direction or both."""
    n, negative, positive = (
        draw(st.integers(2, 9)),
        draw(st.integers(0, 3)),
        draw(st.integers(0, 3)),
    )
    speeds = np.concatenate([-draw(rising(negative))[::-1], draw(rising(positive))])
    if not speeds.size:
        speeds = np.array([1.5])
    low = np.linspace(0.0, np.abs(speeds).min(), draw(st.integers(2, 5)))
    amplitude = np.concatenate([[0.0], np.full(low.size - 2, draw(st.floats(-2.0, 2.0))), [1.0]])
    seed = draw(st.integers(0, 1000))
    torque = np.random.default_rng(seed).normal(0.0, 1e-3, (speeds.size, n))
    start, step = draw(st.floats(-10.0, 10.0)), draw(st.floats(1e-3, 1.0))
    return LookupTable(start + step * np.arange(n), speeds, torque, low, amplitude)


@settings(max_examples=60)
@given(tables(), st.integers(0, 1000))
def test_tables_are_equal_bit_for_bit(table, seed):
    random = np.random.default_rng(seed)
    position = random.uniform(table.position[0] - 0.5, table.position[-1] + 0.5, 60)
    speed = random.uniform(-1.2, 1.2, 60) * np.abs(table.speed).max()
    position = np.concatenate([position, table.position, table.position])
    speed = np.concatenate([speed, np.resize(table.speed, table.position.size)])
    speed = np.concatenate([speed, np.resize(table.low_speed, table.position.size)])
    given, torque = np.stack([position, speed], axis=1), np.zeros(len(speed))
    data = link.pack_table(table)
    assert Bare.c.firmware_table(data, len(data), len(speed), pointer(given), pointer(torque))
    np.testing.assert_array_equal(torque, table.evaluate(position, speed))


@given(st.binary(max_size=400))
def test_no_object_is_read_beyond_its_end(data):
    """Under the sanitizer, and a table that is taken has values."""
    torque = np.zeros(1)
    Bare.c.firmware_table(data, len(data), 1, pointer(np.array([0.3, 1.0])), pointer(torque))


# -- the tests of the Python emulator


ARGUMENTS = (
    "test_a_session",
    "test_a_request_sent_twice_is_done_once",
    "test_another_host_may_begin_with_the_number_that_was_last",
    "test_hello_in_the_middle_stops_and_forgets",
    "test_motions_that_cannot_be_are_refused_or_trip",
)


@pytest.fixture
def host(monkeypatch):
    device = Bare()
    monkeypatch.setattr(test_driver_emulator, "emulator", lambda: device)
    return test_driver_emulator.Host(device)


@pytest.mark.parametrize("name", ARGUMENTS)
def test_a_host_is_answered_as_by_the_emulator(host, name):
    getattr(test_driver_emulator, name)(host)


def test_refusals_say_why(host):
    (cases,) = (mark.args[1] for mark in test_driver_emulator.test_refusals_say_why.pytestmark)
    for case in cases:
        host.device.reset()
        test_driver_emulator.test_refusals_say_why(host, *case)


@pytest.mark.usefixtures("host")
def test_whatever_is_sent_is_answered():
    test_driver_emulator.test_whatever_is_sent_is_answered()


@given(st.sampled_from(list(Slot)[:-1]), st.binary(max_size=64))
@settings(max_examples=60)
def test_whatever_object_comes_up_is_taken_or_refused(slot, data):
    host = test_driver_emulator.Host(Bare())
    host.set_up(Move(0.1, 0.01))
    host.ask(FrameKind.BEGIN, link.BEGIN.pack(slot, len(data)))
    host.ask(FrameKind.CHUNK, link.CHUNK.pack(slot, 0) + data)
    host.send(FrameKind.COMMIT, link.COMMIT.pack(slot, len(data), zlib.crc32(data)))
    if host.send(FrameKind.ARM, test_driver_emulator.arm()).kind == FrameKind.ARM | link.REPLY:
        host.ask(FrameKind.START)
        host.device.idle()


@pytest.fixture
def in_c(monkeypatch):
    """Let the tests of faults meet the target in C."""
    monkeypatch.setattr(protocol, "REPLY_TIMEOUT", 0.15)
    monkeypatch.setattr(test_driver_faults, "TargetEmulator", Firmware)
    monkeypatch.setattr(test_driver_faults, "assert_same", assert_alike)
    short = replace(test_driver_faults.MOTION, motion=Triangle(0.1, 1.1, 6.0, 0.2, cycles=1))
    monkeypatch.setattr(test_driver_faults, "MOTION", short)


@pytest.fixture
def expected(in_c):
    with serve(Firmware(virtual())) as server, target_rig(server.port) as rig:
        return perform(rig, test_driver_faults.MOTION)


@pytest.mark.parametrize("log", ["memory", "stream"])
def test_runs_are_complete_after_retries(log, expected):
    for name in test_driver_faults.SURVIVED:
        test_driver_faults.test_run_is_complete_and_correct_after_retries(name, log, expected)


@pytest.mark.usefixtures("in_c")
@pytest.mark.parametrize(
    "name",
    [
        "test_reset_in_the_middle_is_noticed",
        "test_pulled_cable_ends_at_once",
    ],
)
@pytest.mark.parametrize("log", ["memory", "stream"])
def test_a_line_that_fails_ends_the_run(name, log):
    getattr(test_driver_faults, name)(log)


@pytest.mark.usefixtures("in_c")
@pytest.mark.parametrize(
    "name",
    [
        "test_drive_that_refuses_says_why",
        "test_motion_beyond_the_limits_is_never_sent",
        "test_log_that_does_not_fit_is_refused_before_it_moves",
        "test_recipe_of_another_loop_is_refused",
    ],
)
def test_limits_and_faults_are_those_of_the_emulator(name):
    getattr(test_driver_faults, name)()


def test_a_speed_beyond_the_limit_trips_within_milliseconds_and_keeps_the_log():
    """0.3 A turn the shaft by up to 900 rad/s2: 20 rad/s after some 26 ms."""
    task, got = Task(CurrentSteps((0.3,), 1.0), record_every=8), []
    more = ("serial.limits.speed=20", "rig.attachment=pulley")
    with (
        serve(Firmware(virtual())) as server,
        target_rig(server.port, *more) as rig,
        pytest.raises(HardwareError, match=r"speed reached 2\d.* limit of 20 rad/s"),
    ):
        got.extend(rig.perform(task))
    angle = np.concatenate([block["encoder"] for block in got]) * 2 * np.pi / 4000
    assert 20 < np.diff(angle).max() / 1e-3 < 25


@pytest.mark.usefixtures("in_c")
def test_samples_that_are_gone_are_nan_and_counted(expected):
    test_driver_faults.test_samples_that_are_gone_are_nan_and_counted(expected)


def test_a_silent_host_stops_the_motor():
    device = Firmware(virtual(), paced=True)
    motion = Task(SpeedProfile((0.0, 0.5, 20.0), (0.0, 5.0, 5.0)))
    with serve(device) as server:
        rig = target_rig(server.port, "serial.watchdog=0.2", "serial.log=stream").__enter__()
        running = rig.perform(motion)
        next(running)
        assert device.state is TargetState.RUNNING
        rig.line.close()  # as if the program had been killed
        begin = time.monotonic()
        wait_until(lambda: device.state is TargetState.TRIPPED)
        assert time.monotonic() - begin < 0.3
        with pytest.raises(LineLost):
            list(running)
