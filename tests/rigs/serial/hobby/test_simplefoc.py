"""SimpleFOC by its Commander, over a line, followed by the host's own loop."""

import json

import numpy as np
import pytest

from rigtool.errors import HardwareError, RecipeError
from rigtool.rigs import Feedforward, Task
from rigtool.rigs.motion import CurrentSteps, SpeedProfile, Triangle
from rigtool.rigs.operator import Operator
from rigtool.rigs.serial.hobby import simplefoc
from rigtool.rigs.serial.hosted.rig import HostedRig
from rigtool.rigs.serial.line import Line, LineLost
from rigtool.rigs.serial.ports import find_devices
from tests.rigs.performed import perform, require_replayed
from tests.rigs.serial.emulators.faults import Fault, serve
from tests.rigs.serial.emulators.simplefoc import SimpleFocEmulator
from tests.rigs.serial.recipes import serial_recipe

PERIOD = 0.004
LOOP = (
    "serial.emergency_stop=true",
    "rig.attachment=pulley",
    "rig.controller.crossover_hz=5",
    "rig.controller.integrator_hz=0.4",
    "rig.controller.lowpass_hz=60",
)
QUIET = Operator(say=lambda text: None, present=False, yes=True)
BRIEF = Task(SpeedProfile((0.0, 0.1, 0.3, 0.4), (0.0, 4.0, 4.0, 0.0)), Feedforward(1.5e-5, 2.3e-3))
TO_AND_FRO = Task(Triangle(0.1, 2.1, 4.0, 0.5, cycles=1), Feedforward(1.5e-5, 2.3e-3, 5e-5))


def simplefoc_rig(port, *more, operator=QUIET):
    recipe = serial_recipe(port, *LOOP, *more, driver="simplefoc", sample_time=PERIOD)
    return HostedRig(recipe, 0.045, "test", operator, simplefoc.DRIVER)


def test_devices_finds_it_and_asks_only():
    device = SimpleFocEmulator()
    with serve(device) as server:
        (found,) = find_devices([server.port], ["simplefoc"])
    assert found.identity == "SimpleFOC, commands T (target angle), M (motor)"
    assert (device.verbose, device.target, device.enabled, device.log) == (2, 0.0, 1, [])


def test_a_motion_is_followed_by_currents_of_the_host_and_all_settings_come_back():
    device = SimpleFocEmulator()
    with serve(device) as server, simplefoc_rig(server.port, "serial.limits.current=1.5") as rig:
        assert device.limits["C"] == 1.5
        assert all(rig.lacks(need) is None for need in ("closed_loop", "table", "signal"))
        got = perform(rig, TO_AND_FRO)
        assert device.motion == 0
        facts = json.loads(rig.report())
    assert np.abs(got["encoder"] * 2 * np.pi / 4000 - got["position_setpoint"]).max() < 0.2
    assert facts["retries"] == facts["late_samples"] == 0
    assert (device.mode, device.motion, device.variables) == (None, 1, "1100011")
    assert device.limits["C"] == 2.0
    assert server.error is None


def test_current_is_stepped_and_measured():
    with serve(SimpleFocEmulator()) as server, simplefoc_rig(server.port) as rig:
        got = perform(rig, Task(CurrentSteps((0.0, 0.02, 0.04), 0.1)))
    levels = np.unique(got["current_setpoint"].round(4))
    assert set(levels) == {0.0, 0.02, 0.04}
    assert np.abs(got["current"] - got["current_setpoint"]).max() < 1e-4 + 0.02  # a step between


@pytest.mark.parametrize(
    ("device", "message"),
    [
        (SimpleFocEmulator(torque=0), "torque control is 'volt', and its current is not measured"),
        (SimpleFocEmulator(torque=3), "torque control is 'est. curr'"),
        (SimpleFocEmulator(labels=(("T", "target angle"),)), "lists 0 motor commands"),
        (SimpleFocEmulator(verbose=0), "no valid reply"),
    ],
)
def test_what_cannot_be_driven_is_refused_before_anything_moves(device, message):
    with (
        serve(device) as server,
        pytest.raises(HardwareError, match=message),
        simplefoc_rig(server.port),
    ):
        pass
    assert device.log == []
    assert device.target == 0.0


def test_without_an_emergency_stop_it_is_not_driven():
    with (
        serve(SimpleFocEmulator()) as server,
        pytest.raises(RecipeError, match="SimpleFOC has no watchdog"),
        simplefoc_rig(server.port, "serial.emergency_stop=false"),
    ):
        pass


def test_a_loop_that_a_host_cannot_close_is_refused():
    more = ("rig.controller.crossover_hz=50", "rig.controller.lowpass_hz=100")
    with (
        serve(SimpleFocEmulator()) as server,
        pytest.raises(RecipeError, match=r"50 Hz of crossover, is not stable .* every 0.004 s"),
        simplefoc_rig(server.port, *more),
    ):
        pass


def test_the_plan_states_that_nothing_but_the_host_watches():
    said = []
    operator = Operator(say=said.append, present=False, yes=True)
    with (
        serve(SimpleFocEmulator()) as server,
        simplefoc_rig(server.port, operator=operator) as rig,
    ):
        perform(rig, Task(SpeedProfile((0.0, 0.1, 0.2), (0.0, 1.0, 0.0))))
    plan = "".join(said)
    assert "has no watchdog" in plan
    assert "has no limit of speed while it follows currents" in plan


SURVIVED = {
    "lost bytes": [Fault("lose", at=70), Fault("lose", at=90, towards="device")],
    "cut": [Fault("cut", at=70), Fault("cut", at=90, towards="device")],
    "silence": [Fault("silence", at=70, duration=0.06)],
    "an older answer": [Fault("late", at=80)],
}


@pytest.mark.parametrize("name", SURVIVED)
def test_a_run_is_complete_after_retries(name):
    device = SimpleFocEmulator()
    with (
        serve(device, *SURVIVED[name]) as server,
        simplefoc_rig(server.port) as rig,
    ):
        got = perform(rig, BRIEF)
        facts = json.loads(rig.report())
    assert facts["retries"] >= 1
    assert np.isfinite(got["current"]).all()
    assert device.mode is None


@pytest.mark.parametrize("fault", ["pull", "reset", "silence", "refuse"])
def test_a_run_that_fails_ends_with_a_message(fault):
    device = SimpleFocEmulator()
    many = 1 if fault in ("pull", "reset") else 5000
    with (
        serve(device, Fault(fault, at=70, count=many)) as server,
        pytest.raises(HardwareError) as caught,
        simplefoc_rig(server.port, "serial.watchdog=0.5") as rig,
    ):
        perform(rig, BRIEF)
    assert isinstance(caught.value, LineLost)
    notes = "".join(getattr(caught.value, "__notes__", ()))
    if fault != "reset":
        assert "no watchdog and may continue: switch its supply off" in notes


def test_the_process_beside_switches_it_off():
    device = SimpleFocEmulator()
    device.target = 0.3
    with serve(device) as server, Line(server.port, timeout=0.1) as line:
        simplefoc.switch_off(line, 0)
        assert (device.enabled, device.target) == (0, 0.0)


def test_the_guard_is_reported_when_it_is_on_alive_and_off():
    reported = []
    note = type("Guard", (), {"__getattr__": lambda self, word: lambda: reported.append(word)})()
    with serve(SimpleFocEmulator()) as server, simplefoc_rig(server.port) as rig:
        rig.drive._guard = note
        perform(rig, Task(SpeedProfile((0.0, 0.1, 0.2), (0.0, 1.0, 0.0))))
    assert reported.index("watch") < reported.index("beat") < reported.index("rest")
    assert reported[-1] == "close"


def test_a_record_plays_back_with_the_same_signals(tmp_path):
    require_replayed(simplefoc_rig, serve(SimpleFocEmulator()), BRIEF, tmp_path)
