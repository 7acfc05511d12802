"""Whole commands with instruments and an operator beside a drive, over pseudo-terminals."""

import json
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from rigtool.control.lookup_table import LookupTable
from rigtool.errors import HardwareError
from rigtool.experiments.force.procedure import PROCEDURE as MEASURE_FORCE
from rigtool.experiments.learning.rows import Amplitudes
from rigtool.experiments.learning.stored_table import tables_of
from rigtool.experiments.running import session
from rigtool.experiments.running.options import CommonOptions
from rigtool.experiments.running.session import run_command
from rigtool.experiments.torque_constant.procedure import PROCEDURE as CALIBRATE_KT
from rigtool.recipe import load_recipe
from rigtool.rigs import Load, Task
from rigtool.rigs.motion import CurrentSteps
from rigtool.rigs.operator import Operator
from rigtool.rigs.serial import drivers
from rigtool.rigs.serial.emulators.motor import EmulatedMotor
from rigtool.runfile import RunWriter, open_run
from tests.rigs.serial import toy
from tests.rigs.serial.emulators.faults import Fault, serve
from tests.rigs.serial.emulators.instruments import Mark10Emulator, NumberLinesEmulator
from tests.rigs.serial.hosted.test_hosted import toy_rig
from tests.rigs.serial.recipes import RECIPE, overrides, serial_recipe

SILENT = Operator(ask=lambda q: "", say=lambda t: None, present=True, yes=True)
FIXTURES = Path(__file__).parents[3] / "fixtures"
ARM = load_recipe(RECIPE)[0].rig.arm.length
RADIUS = 0.014
"""Of the pulley on which loads hang, m."""


class Loaded(EmulatedMotor):
    """A motor that is clamped where it takes currents."""

    def _step(self, dt, mode, position, speed, current):
        if mode == "current":
            self.current = self.current_setpoint = current
        else:
            super()._step(dt, mode, position, speed, current)

    @property
    def push(self):
        """Force of the arm on the gauge, N."""
        return self.torque_constant * self.current / ARM


@pytest.fixture
def device(monkeypatch):
    monkeypatch.setitem(drivers.DRIVER_MODULES, "odrive", "tests.rigs.serial.toy")
    device = toy.ToyEmulator()
    device.motor = Loaded()
    return device


def run(procedure, port, more, output, monkeypatch, ask, inputs=None, **more_of_it):
    said, driver = more_of_it.get("say", lambda text: None), more_of_it.get("driver", "odrive")
    person = Operator(ask=ask, say=said, present=True)
    monkeypatch.setattr(session, "Operator", lambda **asked: replace(person, **asked))
    settings = overrides(port, "serial.watchdog=2", *more, driver=driver, sample_time=0.01)
    options = CommonOptions(overrides=settings, yes=True, spy=more_of_it.get("spy"))
    return run_command(procedure, [str(RECIPE)], str(output), options=options, inputs=inputs or {})


def test_torque_constant_by_a_gauge_and_an_operator_with_a_thermometer(
    device, tmp_path, monkeypatch
):
    asked = []

    def person():
        answers = {"temperature [degC]:": iter(["2l", "26", "21", "36"])}
        takes = iter(["r", "", ""])

        def ask(question):
            asked.append(question)
            if question in answers:
                return next(answers[question])
            return next(takes) if "Enter to take it" in question else ""

        return ask

    spy = str(tmp_path / "bench.spy")
    gauge = Mark10Emulator(lambda: device.motor.push / 4.4482216, unit="lbF", decimals=4)
    with serve(device) as server, serve(gauge, Fault("flip", at=60)) as beside:
        more = (
            "calibrate_kt.temperatures_degc=[21, 36]",
            "calibrate_kt.rotor_positions=1",
            "calibrate_kt.steps=4",
            "calibrate_kt.staircases=1",
            "calibrate_kt.step_time=0.25",
            "calibrate_kt.settle_time=0.2",
            "calibrate_kt.record_every=1",
            "serial.force.driver=mark10",
            f'serial.force.port="{beside.port}"',
            "serial.temperature.driver=operator",
        )
        output = tmp_path / "kt.h5"
        found = run(CALIBRATE_KT, server.port, more, output, monkeypatch, person(), spy=spy)
    assert found.results["torque_constant_mean"].value == pytest.approx(0.045, rel=5e-3)
    assert asked[0] == "Bring the motor to 21 degC and wait until it has it throughout, " + (
        "then press Enter:"
    )
    assert asked[1].startswith("Clamp the arm on the force gauge with the shaft at 0.0 deg")
    assert "temperature 26 degC: Enter to take it, r to repeat:" in asked
    with open_run(tmp_path / "kt.h5") as stored:
        line = json.loads(stored.provenance["line"])
        degc = stored.recording("staircase").read("temperature")
    assert sorted(set(degc.tolist())) == [21.0, 36.0]  # the repeated reading is not in it
    force = line["instruments"]["force"]
    assert force["identity"] == "Mark-10 force gauge"
    assert force["missing_samples"] == 0
    assert line["instruments"]["temperature"]["driver"] == "operator"
    output = tmp_path / "again.h5"  # the same, without the bench
    run(CALIBRATE_KT, spy, more, output, monkeypatch, person(), driver="replay")
    with open_run(tmp_path / "kt.h5") as first, open_run(output) as again:
        assert again.content_sha256 == first.content_sha256
        there, here = (json.loads(stored.provenance["line"]) for stored in (first, again))
    assert here["instruments"] == there["instruments"]


def nothing_learned(path, recipe, kt):
    """Write tables of a motor that has no ripple."""
    speed, position = np.array([-10.0, 10.0]), np.linspace(0, np.pi, 50)
    low, amplitude = np.array([0.0, 10.0]), np.array([0.0, 1.0])
    nothing = np.zeros((2, 50))
    table = LookupTable(position, speed, nothing, low, amplitude)
    lookup = tables_of(
        table, nothing, Amplitudes.fading(low[-1]), np.full(len(table.speed), np.inf)
    )
    options = {"command": "ilc-learn", "recipe": recipe, "recipe_text": "", "inputs": [kt]}
    with RunWriter(path, **options) as writer:
        writer.finish({}, lookup)
    return path


def test_force_with_loads_that_the_operator_hangs_on(device, tmp_path, monkeypatch):
    asked = []
    torque = {"Hang 2.5 N": 2.5 * RADIUS, "Take all": 0.0}

    def ask(question):
        asked.append(question)
        for words, load in torque.items():
            if question.startswith(words):
                device.motor.load = load
        return ""

    more = (
        "measure_force.forces=[2.5]",
        "rig.attachment=pulley",
        "measure_force.speed_rev_per_s=1",
        "measure_force.cycles=4",
        "measure_force.record_every=1",
        "rig.controller.crossover_hz=2",
        "rig.controller.integrator_hz=0.2",
        "rig.controller.lowpass_hz=10",
        "measure_force.correction=none",
        "serial.temperature.driver=number-lines",
        "serial.force.driver=mark10",
        'serial.force.port="/dev/no-such-gauge"',  # unplugged, and of no use here
    )
    said = []
    logger = NumberLinesEmulator(lambda: 24.5, unit="C", decimals=1)
    with serve(device) as server, serve(logger) as beside, ExitStack() as stack:
        more = (*more, f'serial.temperature.port="{beside.port}"')
        kt = stack.enter_context(open_run(FIXTURES / "kt.h5"))
        recipe = serial_recipe(server.port, *more, driver="odrive", sample_time=0.01)
        tables = stack.enter_context(open_run(nothing_learned(tmp_path / "tables.h5", recipe, kt)))
        inputs = {"kt": kt, "tables": tables}
        output = tmp_path / "f.h5"
        found = run(
            MEASURE_FORCE, server.port, more, output, monkeypatch, ask, inputs, say=said.append
        )
    assert f"temperature is read: sends numbers on {beside.port}" in said[0]
    assert "serial.force is not used: its channel is not recorded" in said[0]
    loads = found.tables["loads"].columns
    assert asked[0].startswith("Hang 2.5 N (254.9 g) on the cord on the pulley, see that")
    assert loads["mean_torque"].values[1] == pytest.approx(2.5 * RADIUS, rel=0.025)
    with open_run(tmp_path / "f.h5") as stored:
        degc = stored.recording("load_001").read("temperature")
    np.testing.assert_allclose(degc, 24.5, rtol=1e-9)


def with_gauge(beside, *more):
    return ("serial.force.driver=mark10", f'serial.force.port="{beside.port}"', *more)


@pytest.mark.parametrize(
    ("fault", "message"),
    [
        (Fault("pull", at=30), "the line is lost"),
        (Fault("refuse", at=30), "the gauge refuses"),
    ],
)
def test_drive_stops_where_the_gauge_is_lost(device, fault, message):
    gauge = Mark10Emulator(lambda: device.motor.push)
    long = Task(CurrentSteps((0.0, 0.5, 1.0), 1.0), load=Load(clamped=True))
    got = []
    with serve(device) as server, serve(gauge, fault) as beside:
        with (
            pytest.raises(HardwareError, match=message),
            toy_rig(server.port, *with_gauge(beside), operator=SILENT) as rig,
        ):
            got.extend(rig.perform(long))
        assert device.mode is None
        assert device.limit == 20.0
    assert 0 < sum(len(block["time"]) for block in got) < 700


def test_overload_stops_the_drive_and_what_was_measured_is_kept(device):
    gauge = Mark10Emulator(lambda: device.motor.push, highest=0.06)
    got = []
    with serve(device) as server, serve(gauge) as beside:
        with (
            pytest.raises(HardwareError, match="it last sent: overload"),
            toy_rig(server.port, *with_gauge(beside), operator=SILENT) as rig,
        ):
            got.extend(rig.perform(Task(CurrentSteps((0.0, 1.0), 0.6), load=Load(clamped=True))))
        assert device.mode is None
    force = np.concatenate([block["force"] for block in got])
    assert np.isfinite(force[:80]).all()
    assert np.isnan(force[-1])


def test_operator_cannot_read_a_force_that_changes_with_each_step(device):
    with (
        serve(device) as server,
        toy_rig(server.port, "serial.force.driver=operator") as rig,
    ):
        assert "the force changes with every step" in rig.lacks("force")


def test_moves_between_recordings_ask_for_no_reading(device):
    asked = []

    def ask(question):
        asked.append(question)
        return "25" if question == "temperature [degC]:" else ""

    operator = Operator(ask=ask, say=lambda text: None, present=True, yes=True)
    # Followed by speeds, it lags by what friction asks of the loop over this gain.
    more = ("serial.temperature.driver=operator", "serial.position_gain=40")
    with (
        serve(device) as server,
        toy_rig(server.port, *more, operator=operator) as rig,
    ):
        rig.move_by(0.2)
        assert asked == []
        assert device.motor.position == pytest.approx(0.2, abs=0.05)
