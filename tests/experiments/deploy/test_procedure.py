"""A learned table goes into the drive, on its encoder, and comes back out of it."""

import json
import math
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from rigtool.errors import HardwareError, InsufficientDataError, UsageError
from rigtool.experiments.deploy.position_map import position_map
from rigtool.experiments.deploy.procedure import _ripple_remark, deploy
from rigtool.experiments.deploy.stored_export import in_unit
from rigtool.experiments.learning.implementations import bare_motor
from rigtool.experiments.learning.stored_table import learned_table_from
from rigtool.experiments.ripple import procedure as fft_ripple
from rigtool.rigs.operator import Operator
from rigtool.rigs.serial.emulators.motor import EmulatedMotor
from rigtool.rigs.serial.moteus.frames import text_to_drive
from rigtool.rigs.serial.moteus.link import Link
from rigtool.rigs.serial.moteus.table import MoteusTable
from rigtool.runfile import open_run
from tests.cli.called import call
from tests.rigs.serial.emulators import moteus
from tests.rigs.serial.emulators.faults import Fault, serve
from tests.rigs.serial.emulators.moteus import TABLE, MoteusEmulator
from tests.rigs.serial.recipes import RECIPE, overrides, serial_recipe

pytestmark = pytest.mark.usefixtures("world")
FIXTURES = Path(__file__).parents[2] / "fixtures"
SPEED = 4 * math.pi
SERIAL = "000030000000004200005a17"
QUIET = Operator(say=lambda text: None, present=False)


@pytest.fixture
def tables():
    with open_run(FIXTURES / "turning.h5") as run:
        yield run


@pytest.fixture
def kt():
    with open_run(FIXTURES / "kt.h5") as run:
        yield run


@pytest.fixture
def short_table(monkeypatch):
    """A drive with a table of 128 codes: what stores them takes an eighth of the requests."""
    monkeypatch.setattr(MoteusTable, "size", 128)
    monkeypatch.setattr(moteus, "CODES", 128)


short = pytest.mark.usefixtures("short_table")


def run_deploy(port, tables, kt, *more, driver="moteus", yes=True, operator=QUIET, **options):
    recipe = serial_recipe(port, *more, driver=driver)
    operator = replace(operator, yes=yes)
    given = {"speed": SPEED, "dry_run": False, **options}
    return deploy(tables, recipe, kt=kt, operator=operator, **given)


def codes(settings):
    return [settings[f"{TABLE}{i}"] for i in range(moteus.CODES)]


def old_table(**more):
    """Return a drive that holds another table already."""
    values = {f"{TABLE}{i}".replace(".", "__"): (i % 255) - 127 for i in range(moteus.CODES)}
    return MoteusEmulator(motor__cogging_dq_scale=0.001, **values, **more)


@pytest.mark.parametrize(("encoder", "sign"), [(0.3137, 1), (0.8021, -1)])
def test_the_drive_adds_what_was_learned_where_it_was_learned(tables, kt, encoder, sign):
    learned = learned_table_from(tables)
    turn = in_unit(position_map(learned.table, learned.u, SPEED), learned, "moteus", kt)
    device = MoteusEmulator(encoder=encoder, sign=sign)
    device.motor.position = 5.0
    with serve(device) as server:
        done = run_deploy(server.port, tables, kt)
    assert server.error is None
    angle = np.linspace(-10, 10, 3001)
    added = np.array([device.compensation(position) for position in angle])
    # half a code, and what interpolation between 1024 positions loses
    scale = device.config["motor.cogging_dq_scale"]
    assert np.abs(added - turn.at(angle)).max() < 3 * scale
    assert np.corrcoef(added, turn.at(angle))[0, 1] > 0.9999
    assert device.stored == device.config
    assert device.mode == 0
    assert device.log.count("write") == 1
    assert any("stored and read back" in line for line in done.lines)


@short
def test_nobody_agrees_and_nothing_is_stored(tables, kt):
    device = MoteusEmulator()
    asked = Operator(ask=lambda text: "n", say=lambda text: None, present=True)
    with serve(device) as server, pytest.raises(UsageError, match="not agreed to: nothing was"):
        run_deploy(server.port, tables, kt, yes=False, operator=asked)
    assert device.log == []


@short
def test_damaged_lines_are_repeated(tables, kt):
    device = MoteusEmulator()
    faults = [Fault("flip", at=n, towards=to) for n in (360, 660) for to in ("host", "device")]
    with serve(device, *faults, Fault("cut", at=410)) as server:
        done = run_deploy(server.port, tables, kt)
    assert any("requests on the line were repeated" in remark for remark in done.remarks)
    assert device.stored == device.config
    assert np.abs(codes(device.stored)).max() > 100


@short
def test_a_refusal_in_the_middle_brings_the_old_table_back(tables, kt):
    device = old_table()
    before = dict(device.stored)
    with (
        serve(device, Fault("refuse", at=435)) as server,
        pytest.raises(HardwareError, match="refuses 'conf set") as caught,
    ):
        run_deploy(server.port, tables, kt)
    assert "the old table is restored" in caught.value.__notes__
    assert device.config == device.stored == before
    assert "motor.cogging_dq_scale 0" in device.log  # it was off meanwhile


@short
def test_flash_that_keeps_nothing_is_noticed(tables, kt):
    device = old_table()
    device.loses_writes = True
    before = dict(device.stored)
    with serve(device) as server, pytest.raises(HardwareError, match=r"read back, .* codes differ"):
        run_deploy(server.port, tables, kt)
    assert device.config == device.stored == before


@short
def test_ctrl_c_in_the_middle_brings_the_old_table_back(tables, kt, monkeypatch):
    device, sets = old_table(), []
    before = dict(device.stored)
    set_one = Link.set

    def interrupted(link, name, value):
        sets.append(name)
        if len(sets) == 60:
            link._exchange(text_to_drive(f"conf set {name} {value}\n".encode()))
            raise KeyboardInterrupt  # the answer was not read yet
        set_one(link, name, value)

    monkeypatch.setattr(Link, "set", interrupted)
    with serve(device) as server, pytest.raises(KeyboardInterrupt) as caught:
        run_deploy(server.port, tables, kt)
    assert caught.value.__notes__ == ["the old table is restored"]
    assert device.config == device.stored == before


@short
def test_a_pulled_cable_leaves_the_stored_table_as_it_was(tables, kt):
    device = old_table()
    before = dict(device.stored)
    with (
        serve(device, Fault("pull", at=435)) as server,
        pytest.raises(HardwareError, match="the line is lost") as caught,
    ):
        run_deploy(server.port, tables, kt)
    assert "could not be restored" in caught.value.__notes__[0]
    assert device.stored == before
    assert device.config["motor.cogging_dq_scale"] == 0.0


# -- refusals


def line_of(driver="moteus", identity=f"moteus 1, serial {SERIAL}, UART"):
    return json.dumps({"driver": driver, "identity": identity})


@pytest.mark.parametrize(
    ("line", "message"),
    [
        (line_of(driver="odrive"), "was learned through odrive"),
        (line_of(identity="moteus 1, serial 77, UART"), "serial number 77, on the line is 0000300"),
        (
            line_of(identity="moteus 1; its cogging table is on"),
            "own table was on, and",
        ),
    ],
)
def test_a_table_of_another_drive_is_refused(tables, kt, line, message):
    tables.provenance["line"] = line
    device = MoteusEmulator()
    with serve(device) as server, pytest.raises(UsageError, match=message):
        run_deploy(server.port, tables, kt)
    assert device.log == []


@short
def test_a_table_of_this_drive_is_taken_without_a_remark(tables, kt):
    tables.provenance["line"] = line_of()
    with serve(MoteusEmulator()) as server:
        done = run_deploy(server.port, tables, kt, dry_run=True)
    assert not any("which drive" in remark for remark in done.remarks)


def test_what_does_not_fit_is_refused_before_the_line_is_opened(tables, kt):
    port = "/dev/there-is-none"
    with pytest.raises(UsageError, match="was measured on the rig briaire-2006, the recipe is of"):
        run_deploy(port, tables, kt, "rig.name=other")
    with pytest.raises(UsageError, match="choose by --speed"):
        run_deploy(port, tables, kt, speed=None)
    with pytest.raises(UsageError, match="--kt is missing"):
        run_deploy(port, tables, None)
    with pytest.raises(UsageError, match=r"beyond serial.limits.current = 1e-05 A"):
        run_deploy(port, tables, kt, "serial.limits.current=1e-5")
    with pytest.raises(HardwareError, match="target keeps no table"):
        run_deploy(port, tables, kt, driver="target")
    with pytest.raises(UsageError, match="a record has no memory"):
        run_deploy(port, tables, kt, driver="replay")
    with (
        open_run(FIXTURES / "tables.h5") as limited,
        pytest.raises(UsageError, match="not a whole turn"),
    ):
        run_deploy(port, limited, kt)
    with pytest.raises(HardwareError, match="there is no such port"):
        run_deploy(port, tables, kt)


@pytest.mark.parametrize(
    ("device", "message"),
    [
        (MoteusEmulator(home=0), "not referenced to the rotor"),
        (MoteusEmulator(motor__Kv=0.0, motor__poles=0), "no calibrated motor"),
    ],
)
def test_a_drive_that_cannot_hold_it_is_refused(tables, kt, device, message):
    with serve(device) as server, pytest.raises(HardwareError, match=message):
        run_deploy(server.port, tables, kt)
    assert device.log == []


def test_a_drive_that_runs_is_left_alone(tables, kt):
    device = MoteusEmulator()
    device.mode, device.command[0x27] = 10, math.nan
    with serve(device) as server, pytest.raises(HardwareError, match="is switched on, mode 10"):
        run_deploy(server.port, tables, kt)
    assert device.log == []


@short
def test_dry_run_of_the_command_asks_and_changes_nothing(capsys):
    device = old_table()
    before = dict(device.stored)
    arguments = [FIXTURES / "turning.h5", "--rig", RECIPE, "--kt", FIXTURES / "kt.h5"]
    with serve(device) as server:
        settings = [p for v in overrides(server.port, driver="moteus") for p in ("--set", v)]
        code, out, err = call(
            capsys, "deploy", *arguments, "--speed", SPEED, *settings, "--dry-run"
        )
    assert code == 0, err
    assert device.config == device.stored == before
    assert device.log == []
    lines = out.splitlines()
    assert lines[0].startswith("moteus 1, model 0x220, firmware 1.3.5, serial 0000300")
    assert "scale 0.001 A" in lines[-2]
    assert lines[-1] == "nothing was changed"
    assert "does not state with which drive it was learned" in err


@short
def test_without_a_terminal_and_without_yes_nothing_is_stored(tables, kt):
    device = MoteusEmulator()
    with serve(device) as server, pytest.raises(UsageError, match="then add --yes"):
        run_deploy(server.port, tables, kt, yes=False)
    assert device.log == []


def test_a_virtual_rig_has_no_drive(capsys):
    code, _, err = call(capsys, "deploy", FIXTURES / "turning.h5", "--rig", RECIPE)
    assert code == 2
    assert "the rig briaire-2006 is virtual" in err


def test_a_table_that_made_it_worse_is_refused(tables, kt):
    waveforms = tables.tables["residual_waveforms"].columns
    before = waveforms["before"].values
    np.copyto(waveforms["residual"].values, 1.2 * before)
    device = MoteusEmulator()
    with (
        serve(device) as server,
        pytest.raises(InsufficientDataError, match="it would make the motor run worse"),
    ):
        run_deploy(server.port, tables, kt)
    assert device.log == []


@short
def test_a_table_that_was_never_tried_is_said_to_be(tables, kt, monkeypatch):
    untried = {k: v for k, v in tables.tables.items() if k != "residual_waveforms"}
    monkeypatch.setattr(tables, "_tables", untried)
    with serve(MoteusEmulator()) as server:
        done = run_deploy(server.port, tables, kt, dry_run=True)
    assert any("was not tried while it was learned" in remark for remark in done.remarks)


# -- learned on a drive, stored in it, and measured again

TURNS_PER_S = 2.0
OWN_LOOP = (
    "rig.sample_time=0.004",
    # as the drive is tuned: kd/J = 180 rad/s, kp/kd = 60 rad/s
    "rig.controller.crossover_hz=28",
    "rig.controller.integrator_hz=0",
    "rig.controller.lowpass_hz=120",
)
TURNING = (
    "ilc_learn.robustness_hz=20",
    f"ilc_learn.turning.speeds_rev_per_s=[{TURNS_PER_S}]",
    "ilc_learn.turning.low_speeds_rev_per_s=[]",
    "ilc_learn.turning.revolutions=3",
    "ilc_learn.turning.record_every=1",
)
RIPPLE = (
    f"fft_ripple.speeds=[{2 * math.pi * TURNS_PER_S}]",
    "fft_ripple.torques=[]",
    "fft_ripple.power_cycles=0",
    "fft_ripple.revolutions=3",
    "fft_ripple.record_every=1",
)


class Cogging(EmulatedMotor):
    """A motor with torque that depends on where its shaft is."""

    def _step(self, dt, *what):
        torque = 1.5e-3 * math.sin(2 * self.position + 0.4) + 1e-3 * math.cos(6 * self.position - 1)
        self.speed -= dt * torque / self.inertia
        super()._step(dt, *what)


def ripple_of(path):
    """Return ripple of the controller's torque, N m, and of the position, rad; rms of a steady run.

    The second is of the encoder alone, whatever the drive says of its torques.
    """
    with open_run(path) as run:
        recording = run.recording("speed_000")
        time = recording.read("time")
        steady = (time > recording.condition("steady_from")) & (
            time < recording.condition("steady_until")
        )
        angle = recording.read("encoder")[steady] * (2 * math.pi / 4000)
        evenly = np.polynomial.Polynomial.fit(time[steady], angle, 1)
        return run.result("repeatable_rms").value, float(np.std(angle - evenly(time[steady])))


@short
def test_a_table_learned_on_the_drive_makes_it_run_evenly(tmp_path, capsys, monkeypatch):
    for module in (bare_motor, fft_ripple):
        monkeypatch.setattr(module, "ACCELERATION", 100.0)
        monkeypatch.setattr(module, "SETTLE_TIME", 0.1)
    device = MoteusEmulator(encoder=0.31, sign=-1)
    device.motor = Cogging()
    kt = ("--kt", FIXTURES / "kt.h5")
    before, tables, after = (tmp_path / f"{name}.h5" for name in ("before", "tables", "after"))

    def run(command, *more, settings=()):
        on_line = overrides(
            server.port, "rig.attachment=pulley", *OWN_LOOP, *settings, driver="moteus"
        )
        changes = [part for value in on_line for part in ("--set", value)]
        code, out, err = call(capsys, command, *more, *kt, *changes, "--yes")
        assert code == 0, err
        return out + err

    with serve(device) as server:
        run("fft-ripple", RECIPE, "-o", before, settings=RIPPLE)
        run("ilc-learn", RECIPE, "--implementation", "B", "-o", tables, settings=TURNING)
        reported = run("deploy", tables, "--rig", RECIPE)
        run("fft-ripple", RECIPE, "-o", after, settings=RIPPLE)
    assert server.error is None
    assert "stored and read back" in reported
    assert "ripple went from" in reported
    assert device.stored["motor.cogging_dq_scale"] > 0
    with open_run(after) as run_with_it:
        assert "cogging table is on" in run_with_it.provenance["line"]
    (torque, unevenness), (torque_left, unevenness_left) = ripple_of(before), ripple_of(after)
    assert torque_left < torque / 3
    assert unevenness_left < unevenness / 3


@pytest.mark.parametrize(
    ("speed", "reported"), [(11.0, "2 to 1"), (-13.0, "2 to 1"), (4.0, "5 to 4")]
)
def test_ripple_is_reported_of_the_learned_speed_next_to_this(speed, reported):
    """Rms of the mean of both directions, and without what friction adds."""
    wave = 1e-3 * math.sqrt(2) * np.sin(2 * np.pi * np.arange(100) / 100)
    columns = {
        "speed": np.array([-12.0, -3.0, 3.0, 12.0]),
        "before": np.array([[1.0], [5.0], [5.0], [3.0]]) * wave + 0.1,
        "residual": np.array([[2.0], [4.0], [4.0], [0.0]]) * wave - 0.2,
    }
    tables = {"residual_waveforms": columns}
    run = SimpleNamespace(tables=tables, table=lambda name, **units: tables[name])
    assert f"ripple went from {reported} mN m" in _ripple_remark(run, speed)
