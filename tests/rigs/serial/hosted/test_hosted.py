"""Motions on a drive that is driven from the host, over a pseudo-terminal."""

import json
import time
from dataclasses import replace

import numpy as np
import pytest

from rigtool.errors import HardwareError, RecipeError
from rigtool.experiments.friction.procedure import PROCEDURE as STRIBECK
from rigtool.experiments.running.dry_run import rehearse, require_offered
from rigtool.rigs import NEED_DESCRIPTIONS, Feedforward, Load, Task
from rigtool.rigs.motion import CurrentRamp, CurrentSteps, Observe, SpeedProfile, Triangle
from rigtool.rigs.operator import Operator
from rigtool.rigs.serial.drive import Abilities
from rigtool.rigs.serial.hosted.rig import HostedRig
from rigtool.rigs.serial.line import LineLost
from tests.rigs.performed import perform, require_replayed
from tests.rigs.serial import toy
from tests.rigs.serial.emulators.faults import Fault, serve
from tests.rigs.serial.recipes import serial_recipe
from tests.rigs.serial.target.test_driver_faults import wait_until
from tests.rigs.serial.test_safety import operator

PERIOD = 0.004
SHORT = Task(SpeedProfile((0.0, 0.1, 0.3, 0.4), (0.0, 4.0, 4.0, 0.0)))
BRIEF = Task(SpeedProfile((0.0, 0.05, 0.1), (0.0, 1.0, 0.0)))


def toy_rig(port, *more, operator=None, make_drive=toy.make_drive):
    recipe = serial_recipe(port, *more, driver="odrive", sample_time=PERIOD)
    operator = operator or Operator(say=lambda text: None, present=False, yes=True)
    driver = replace(toy.DRIVER, make_drive=make_drive)
    return HostedRig(recipe, 0.045, "test", operator, driver)


def test_motion_is_followed_and_logged():
    device = toy.ToyEmulator()
    task = Task(Triangle(0.1, 1.1, 4.0, 0.3, cycles=1), Feedforward(inertia=1.5e-5))
    with serve(device) as server, toy_rig(server.port) as rig:
        got = perform(rig, task)
        facts = json.loads(rig.report())
    assert len(got["time"]) == 200
    angle = got["encoder"] * 2 * np.pi / 4000
    assert np.abs(angle - got["position_setpoint"]).max() < 0.1
    assert got["position_setpoint"].max() == pytest.approx(1.1, abs=0.02)
    assert np.diff(got["time"]).mean() == pytest.approx(PERIOD, rel=0.05)
    assert facts["samples"] > 200
    assert facts["rate_hz"] == pytest.approx(1 / PERIOD, rel=0.05)
    assert facts["retries"] == facts["missing_samples"] == 0
    assert device.log[-1] == "limit 20.0"  # as it was
    assert device.mode is None


def test_current_is_stepped_and_stopped_by_the_angle():
    with serve(toy.ToyEmulator()) as server, toy_rig(server.port) as rig:
        got = perform(rig, Task(CurrentSteps((0.0, 0.02, 0.04), 0.04), record_every=2))
        levels, counts = np.unique(got["current"].round(3), return_counts=True)
        assert set(levels) >= {0.0, 0.02, 0.04}  # a pair across a step, where a tick was late
        assert counts.sum() == 15
        assert (np.diff(got["current"]) >= 0).all()
        ramp = perform(rig, Task(CurrentRamp(2.0, 1.0), stop_angle=0.2))
    assert 0.0 < ramp["current"][-1] < 0.9
    turned = (ramp["encoder"][-1] - ramp["encoder"][0]) * 2 * np.pi / 4000
    assert 0.2 < turned < 1.0


def test_drive_that_takes_speeds_only_is_held_in_position_by_the_host():
    class Slow(toy.ToyDrive):
        abilities = Abilities(frozenset({"velocity"}), False, frozenset({"current"}))

    device = toy.ToyEmulator()
    make = lambda line, recipe: Slow(line)  # noqa: E731
    with serve(device) as server, toy_rig(server.port, make_drive=make) as rig:
        got = perform(rig, Task(Triangle(0.0, 1.0, 4.0, 0.3, cycles=1)))
        assert rig.lacks("table") == "this odrive takes no torque feed-forward beside its set point"
        assert rig.lacks("open_loop") is not None
        assert rig.lacks("current_setpoint") == "this odrive does not report its current_setpoint"
        assert "add [serial.temperature]" in rig.lacks("temperature")
        assert "add [serial.force]" in rig.lacks("force")
        assert rig.lacks("closed_loop") is None
    angle = got["encoder"] * 2 * np.pi / 4000
    assert np.abs(angle - got["position_setpoint"]).max() < 0.15


SURVIVED = {
    "flipped bits": [Fault("flip", at=70), Fault("flip", at=90, towards="device")],
    "lost bytes": [Fault("lose", at=70), Fault("lose", at=90, towards="device")],
    "doubled bytes": [Fault("double", at=70), Fault("double", at=90, towards="device")],
    "cut": [Fault("cut", at=70), Fault("cut", at=90, towards="device")],
    "silence": [Fault("silence", at=80, duration=0.08)],
}


@pytest.mark.parametrize("name", SURVIVED)
def test_run_is_complete_after_retries(name):
    device = toy.ToyEmulator()
    with serve(device, *SURVIVED[name]) as server, toy_rig(server.port) as rig:
        got = perform(rig, SHORT)
        facts = json.loads(rig.report())
    assert len(got["time"]) == 100
    assert np.isfinite(got["current"]).all()
    assert facts["retries"] >= 1
    assert device.mode is None
    assert server.error is None


def test_late_samples_carry_their_time_and_are_counted():
    with (
        serve(toy.ToyEmulator(), Fault("silence", at=80, duration=0.03)) as server,
        toy_rig(server.port) as rig,
    ):
        got = perform(rig, SHORT)
        facts = json.loads(rig.report())
    assert facts["late_samples"] >= 3
    assert facts["skipped_samples"] == 0
    assert facts["longest_gap_s"] > 0.03
    assert np.diff(got["time"]).max() == pytest.approx(facts["longest_gap_s"], abs=1e-5)


@pytest.mark.parametrize(
    ("fault", "message"),
    [
        (Fault("pull", at=100), "cable pulled"),
        (Fault("reset", at=100), "switched off: watchdog or reset"),
        (Fault("refuse", at=100), "refuses"),
        (Fault("silence", at=100, duration=0.5), "no valid reply"),
    ],
)
def test_run_ends_with_a_message_and_the_drive_off(fault, message):
    device = toy.ToyEmulator()
    got = []
    with serve(device, fault) as server:
        with pytest.raises(HardwareError, match=message), toy_rig(server.port) as rig:
            got.extend(rig.perform(SHORT))
        if fault.kind != "pull":
            wait_until(lambda: device.mode is None)
    assert sum(len(block["time"]) for block in got) > 20
    assert server.error is None


def test_silent_host_is_stopped_by_the_watchdog():
    device = toy.ToyEmulator()
    with serve(device) as server:
        rig = toy_rig(server.port, "serial.watchdog=0.1").__enter__()
        running = rig.perform(Task(SpeedProfile((0.0, 0.1, 5.0), (0.0, 4.0, 4.0))))
        next(running)
        assert device.mode == "velocity"
        rig.line.close()
        wait_until(lambda: device.mode is None)
        assert device.log[-1] == "watchdog"
        with pytest.raises((LineLost, HardwareError)):
            list(running)


def test_limit_that_is_passed_stops_the_drive_and_keeps_the_samples():
    device = toy.ToyEmulator()
    got = []
    with serve(device) as server, toy_rig(server.port, "serial.limits.speed=8") as rig:
        with pytest.raises(HardwareError, match="speed reached .* limit of 8 rad/s"):  # noqa: RUF043
            got.extend(rig.perform(Task(CurrentSteps((0.2,), 1.0))))
        assert device.mode is None
    assert 1 <= sum(len(block["time"]) for block in got) < 100


def test_interrupted_consumer_leaves_the_drive_off():
    device = toy.ToyEmulator()
    with serve(device) as server:
        with pytest.raises(KeyboardInterrupt), toy_rig(server.port) as rig:
            interrupt_at_first_block(rig)
        assert device.mode is None
        assert device.log[-1] == "limit 20.0"
        time.sleep(0.05)  # no thread goes on
        assert device.mode is None


def interrupt_at_first_block(rig):
    for _ in rig.perform(Task(SpeedProfile((0.0, 0.1, 5.0), (0.0, 4.0, 4.0)))):
        raise KeyboardInterrupt


def test_observing_is_refused_and_nothing_is_sent():
    device = toy.ToyEmulator()
    with serve(device) as server, toy_rig(server.port) as rig:
        before = len(device.log)
        assert "move the motor" in rig.lacks("observe")
        with pytest.raises(HardwareError, match="cannot be observed"):
            perform(rig, Task(Observe(0.1)))
        assert len(device.log) == before


def test_line_that_is_too_slow_for_the_loop_is_refused():
    class Slow(toy.ToyDrive):
        def read(self):
            self.line.pause(0.006)
            return super().read()

    make = lambda line, recipe: Slow(line)  # noqa: E731
    with (
        serve(toy.ToyEmulator()) as server,
        pytest.raises(RecipeError, match=r"rig.sample_time is 0.004 s, .* set it to 0\.0"),
    ):
        toy_rig(server.port, make_drive=make).__enter__()


def test_operator_is_asked_for_what_the_rig_cannot_do():
    person, asked, _ = operator("y", "", "", "")
    device = toy.ToyEmulator()
    with serve(device) as server, toy_rig(server.port, operator=person) as rig:
        perform(rig, BRIEF)
        perform(rig, Task(BRIEF.motion, load=Load(torque=0.014)))
        perform(rig, Task(BRIEF.motion, load=Load(torque=0.014)))
        perform(rig, BRIEF)
        rig.soak(35.0)
    assert asked[0] == "Move now? [y/N]"
    assert asked[1].startswith("Load the shaft with 14 mN m (weight on a cord)")
    assert asked[2].startswith("Remove all loads")
    assert asked[3].startswith("Bring the motor to 35 degC")


def test_what_somebody_has_to_do_is_refused_at_the_start_where_nobody_is():
    with serve(toy.ToyEmulator()) as server:
        with toy_rig(server.port, "serial.temperature.driver=operator") as rig:
            for need in ("load", "clamp", "soak", "power_cycle", "temperature"):
                assert "nobody is at the terminal: run the command in a terminal" in rig.lacks(need)
        somebody = operator()[0]
        with toy_rig(server.port, "serial.temperature.driver=operator", operator=somebody) as rig:
            for need in ("load", "clamp", "soak", "power_cycle", "temperature"):
                assert rig.lacks(need) is None
        with toy_rig(server.port, "serial.operator=false", operator=somebody) as rig:
            assert "serial.operator is false: nobody can hang a load" in rig.lacks("load")


@pytest.mark.parametrize(
    ("feedforward", "person", "radial_force", "reason"),
    [
        (False, True, 22, "it needs to add a torque that is computed from the set point"),
        (True, False, 22, "it needs to hang a load, or pull at the shaft"),
        (True, False, 0, None),
        (True, True, 22, None),
    ],
)
def test_stribeck_is_refused_before_it_measures(feedforward, person, radial_force, reason):
    class Drive(toy.ToyDrive):
        abilities = replace(toy.ToyDrive.abilities, feedforward=feedforward)

    someone = Operator(ask=lambda question: "", say=lambda text: None, present=person)
    recipe = serial_recipe("/dev/none", f"stribeck.radial_force={radial_force}", driver="odrive")
    plan = rehearse(STRIBECK, recipe, 0.045, {"kt": None})
    attendant = replace(someone, yes=True)
    make = lambda line, recipe: Drive(line)  # noqa: E731
    with (
        serve(toy.ToyEmulator()) as server,
        toy_rig(server.port, operator=attendant, make_drive=make) as rig,
    ):
        found = [need for need in plan.needs if need in NEED_DESCRIPTIONS and rig.lacks(need)]
        if reason is None:
            assert found == []
        else:
            with pytest.raises(HardwareError, match=f"stribeck cannot run on this rig: .*{reason}"):
                require_offered(rig, plan, "stribeck")


def test_power_cycle_brings_the_drive_back_and_its_settings_in_the_end():
    device = toy.ToyEmulator()
    person, _, _ = operator("y", "")

    def switch_off_and_on(question):
        if "Switch the amplifier off and on" in question:
            device.reset()
        return person.ask(question)

    attendant = Operator(ask=switch_off_and_on, say=person.say, present=True)
    with serve(device) as server, toy_rig(server.port, operator=attendant) as rig:
        perform(rig, BRIEF)
        rig.power_cycle()
        assert device.limit == 10.0
        perform(rig, BRIEF)
    assert device.limit == 20.0
    assert device.mode is None


def test_drive_that_does_not_know_where_it_is_never_moves():
    device = toy.ToyEmulator()
    with serve(device) as server, toy_rig(server.port) as rig:
        device.motor.position = float("nan")
        with pytest.raises(
            HardwareError, match="reports the position nan: calibrate or home it first"
        ):
            perform(rig, BRIEF)
        assert device.mode is None


def test_what_nobody_watches_is_said():
    person, _, said = operator("y")
    with (
        serve(toy.ToyEmulator()) as server,
        toy_rig(server.port, operator=person) as rig,
    ):
        perform(rig, BRIEF)
    assert "the drive has no limit of speed: the host alone watches it" in said[0]
    assert "temperature of the motor is not measured: its limit is not watched" in said[0]


def test_operator_reads_the_thermometer_once_a_motion():
    person, _, _ = operator("y", "24.5", "")
    more = ("serial.temperature.driver=operator", "serial.temperature.offset=0.5")
    with (
        serve(toy.ToyEmulator()) as server,
        toy_rig(server.port, *more, operator=person) as rig,
    ):
        assert rig.lacks("temperature") is None
        got = perform(rig, BRIEF)
    assert (got["temperature"] == 25.0).all()


def test_a_record_plays_back_with_the_same_signals(tmp_path):
    require_replayed(toy_rig, serve(toy.ToyEmulator()), BRIEF, tmp_path)
