"""A rig with its instruments out of a spy file: what happened at the bench happens again."""

import json
import re
from dataclasses import replace

import numpy as np
import pytest

from rigtool.errors import HardwareError
from rigtool.rigs import Load, Task
from rigtool.rigs.motion import CurrentSteps
from rigtool.rigs.operator import Operator
from rigtool.rigs.serial.transport.spy import read_spy
from tests.rigs.serial import toy
from tests.rigs.serial.emulators.faults import Fault, serve
from tests.rigs.serial.emulators.instruments import (
    Mark10Emulator,
    NumberLinesEmulator,
    SauterEmulator,
)
from tests.rigs.serial.hosted.test_hosted import toy_rig
from tests.rigs.serial.instruments.test_runs import Loaded

STEPS = Task(CurrentSteps((0.0, 0.5, 1.0, 0.2), 0.2), load=Load(clamped=True))
PERSON = Operator(ask=lambda question: "", say=lambda text: None, present=True)


def beside(**ports):
    return tuple(
        setting
        for channel, (driver, port) in ports.items()
        for setting in (f"serial.{channel}.driver={driver}", f'serial.{channel}.port="{port}"')
    )


def run(port, *more, spy=None):
    """Return the blocks of two motions, what the rig reports, and what ended them."""
    operator = replace(PERSON, yes=True, spy=None if spy is None else str(spy))
    blocks, ended = [], ""
    rig = toy_rig(port, "serial.watchdog=2", *more, operator=operator)
    try:
        with rig:
            for _ in range(2):
                blocks.extend(rig.perform(STEPS))
    except HardwareError as error:
        ended = "\n".join([str(error), *getattr(error, "__notes__", ())])
    return blocks, json.loads(rig.report()), ended


def twice(tmp_path, force, *faults, driver, more=()):
    """Return a run over pseudo-terminals, and its record played back."""
    spy = tmp_path / "bench.spy"
    device = toy.ToyEmulator()
    device.motor = Loaded()  # clamped: it pushes, and does not turn
    degc = NumberLinesEmulator(lambda: 20 + device.motor.current, unit="C", decimals=2)
    gauge = force(device.motor)
    with serve(device) as drive, serve(gauge, *faults) as line, serve(degc) as thermometer:
        ports = {"force": (driver, line.port), "temperature": ("number-lines", thermometer.port)}
        first = run(drive.port, *beside(**ports), *more, spy=spy)
    nowhere = {"force": (driver, "/dev/gone"), "temperature": ("number-lines", "/dev/gone")}
    return first, run(f"replay://{spy}", *beside(**nowhere), *more), spy


def assert_same(first, again):
    assert len(first) == len(again)
    for block, same in zip(first, again, strict=True):
        assert block.keys() == same.keys()
        for name, values in block.items():
            np.testing.assert_array_equal(same[name], values, err_msg=name)


def newtons(motor):
    return 20 * motor.current


GAUGES = {
    "mark10": lambda motor: Mark10Emulator(lambda: newtons(motor)),
    "sauter": lambda motor: SauterEmulator(lambda: -newtons(motor), decimals=2),
    "number-lines": lambda motor: NumberLinesEmulator(lambda: newtons(motor)),
}
BAD_LINE = [
    *(Fault(kind, at=8 + 7 * n) for n, kind in enumerate(("flip", "lose", "double", "cut"))),
    Fault("late", at=40),
    Fault("silence", at=50, duration=0.1),
    Fault("flip", at=70, towards="device"),
]


@pytest.mark.parametrize("driver", GAUGES)
def test_instruments_play_back_bit_for_bit(driver, tmp_path, monkeypatch):
    monkeypatch.setattr("rigtool.rigs.serial.instruments.readings.Polled.timeout", 0.05)
    (first, facts, ended), (again, reported, _), _ = twice(
        tmp_path, GAUGES[driver], *BAD_LINE, driver=driver
    )
    assert ended == ""
    assert np.ptp(np.concatenate([block["force"] for block in first])) > 15
    assert_same(first, again)
    assert reported["instruments"] == facts["instruments"]
    force = facts["instruments"]["force"]
    assert force["discarded_lines"] + force["retries"] + force["spikes"] > 0


@pytest.mark.parametrize(
    ("make", "driver", "fault", "message"),
    [
        (GAUGES["mark10"], "mark10", Fault("pull", at=60), "the line is lost"),
        (GAUGES["mark10"], "mark10", Fault("silence", at=60), "no valid reply to"),
        (GAUGES["mark10"], "mark10", Fault("refuse", at=60), "the gauge refuses: \\*11"),
        (GAUGES["number-lines"], "number-lines", Fault("pull", at=60), "the line is lost"),
        (
            lambda motor: Mark10Emulator(lambda: newtons(motor), highest=15),
            "mark10",
            None,
            "it last sent: overload",
        ),
    ],
)
def test_gauge_that_fails_fails_again(make, driver, fault, message, tmp_path, monkeypatch):
    monkeypatch.setattr("rigtool.rigs.serial.instruments.readings.Polled.timeout", 0.02)
    faults = () if fault is None else (fault,)
    (first, _, ended), (again, _, ended_again), _ = twice(tmp_path, make, *faults, driver=driver)
    assert re.search(message, ended)
    assert ended_again == re.sub("/dev/pts/[0-9]+", "/dev/gone", ended)
    assert_same(first, again)


def test_file_tells_the_lines_apart(tmp_path):
    _, _, spy = twice(tmp_path, GAUGES["mark10"], driver="mark10")
    driver, events = read_spy(spy)
    heads = [line for line in spy.read_text().splitlines() if line.startswith("#")]
    assert driver == "odrive"
    assert heads[0] == "# rigtool spy 2 driver=odrive"
    assert heads[1].startswith("# force driver=mark10 port='/dev/pts/")
    assert heads[2].startswith("# temperature driver=number-lines port='/dev/pts/")
    assert {event.role for event in events} == {"", "force", "temperature"}
    asked = [event for event in events if event.role == "force" and event.kind == ">"]
    assert {event.data for event in asked} == {b"?C\r"}
    times = [event.time for event in events]
    assert max(np.diff(np.maximum.accumulate(times))) < 0.5  # one clock for all
    assert max(np.maximum.accumulate(times) - times) < 0.1
