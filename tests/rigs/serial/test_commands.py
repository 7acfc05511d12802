"""Whole commands with the shipped recipes, each on the emulator of its drive, as a user runs them.

`rigtool recipe`, port and gauge filled in, `devices`, `--dry-run`, then the run itself. The motions
are shorter than those of the recipe; line, loop, limits and instruments are the recipe's.
"""

import json
import math
from pathlib import Path

import pytest

from rigtool.experiments.learning.implementations import bare_motor
from rigtool.experiments.ripple import procedure as fft_ripple
from rigtool.recipe import load_recipe
from rigtool.rigs.serial.emulators.server import serve
from rigtool.runfile import open_run
from tests.cli.called import call
from tests.rigs.serial.bench import RADIUS, BenchMotor, Person
from tests.rigs.serial.emulators.can_drives import MoteusCanEmulator, ODriveCanEmulator
from tests.rigs.serial.emulators.canopen import CiA402Emulator, Epos4CanEmulator
from tests.rigs.serial.emulators.instruments import Mark10Emulator
from tests.rigs.serial.emulators.simplefoc import SimpleFocEmulator
from tests.rigs.serial.emulators.vesc import VescEmulator
from tests.thorough import thorough

ROOT = Path(__file__).parents[3]
SLCAN = "can:slcan:{}?bitrate=1000000"

SLOWLY = ("rig.sample_time=0.01", "rig.controller.lowpass_hz=45")
"""Of drives that close their loop by themselves: fewer samples, but in ramps."""

DRIVES = {
    "cia402": (CiA402Emulator, "cia402-drive", SLCAN, SLOWLY),
    "maxon-can": (Epos4CanEmulator, "maxon-epos4-can", SLCAN, SLOWLY),
    "odrive-can": (
        ODriveCanEmulator,
        "odrive-hobby-motor",
        "can:slcan:{}?bitrate=250000",
        (*SLOWLY, "serial.driver=odrive-can", "serial.drive_torque_constant=0.0306"),
    ),
    "moteus-can": (
        MoteusCanEmulator,
        "moteus-r4",
        SLCAN + "&fd=true",
        (
            *SLOWLY,
            "serial.driver=moteus-can",
            "rig.controller.crossover_hz=8",
            "ilc_learn.robustness_hz=7",
        ),
    ),
    "vesc": (VescEmulator, "vesc", "{}", ()),
    "simplefoc": (SimpleFocEmulator, "simplefoc", "{}", ("serial.emergency_stop=true",)),
}
"""Emulator, shipped recipe, port, and what else is filled in."""

SHORTER = {
    "calibrate-kt": (
        "calibrate_kt.temperatures_degc=[20, 40]",
        "calibrate_kt.rotor_positions=1",
        "calibrate_kt.steps=4",
        "calibrate_kt.staircases=1",
        "calibrate_kt.step_time=0.25",
        "calibrate_kt.settle_time=0.1",
    ),
    "stribeck": (
        "stribeck.speed_max=12",
        "stribeck.sweep_time=1",
        "stribeck.hold_speeds=[3, 7, 12]",
        "stribeck.hold_time=0.3",
        "stribeck.hold_revolutions=1",
        "stribeck.breakaway_positions=3",
        "stribeck.breakaway_rate=0.006",
        "stribeck.breakaway_limit=0.012",
        "stribeck.radial_force=0",
    ),
    "fft-ripple": (
        "fft_ripple.speeds=[4]",
        "fft_ripple.revolutions=2",
        "fft_ripple.torques=[]",
        "fft_ripple.power_cycles=0",
    ),
    "ilc-learn": (
        "ilc_learn.turning.speeds_rev_per_s=[0.5]",
        "ilc_learn.turning.low_speeds_rev_per_s=[]",
        "ilc_learn.turning.revolutions=3",
    ),
    "identify-plant": (
        "identify_plant.speeds=[8]",
        "identify_plant.realisations=2",
        "identify_plant.periods=4",
        "identify_plant.period=1",
        "identify_plant.lines=20",
        "identify_plant.frequency_min=2",
        "identify_plant.frequency_max=30",
    ),
    "measure-force": (
        "measure_force.forces=[0.5]",
        "measure_force.cycles=3",
        "measure_force.speed_rev_per_s=0.5",
    ),
}


@pytest.mark.parametrize("name", sorted({drive[1] for drive in DRIVES.values()} | {"maxon-epos4"}))
def test_each_shipped_recipe_says_what_its_commands_would_do(name, tmp_path, capsys):
    recipe, kt = ROOT / "recipes" / f"{name}.toml", ROOT / "tests" / "fixtures" / "kt.h5"
    gauge = ("--set", "serial.force.driver=mark10", "--set", "serial.force.port=/dev/ttyUSB1")
    for command in ("calibrate-kt", "stribeck", "fft-ripple", "identify-plant", "ilc-learn"):
        more = gauge if command == "calibrate-kt" else ("--kt", kt)
        arguments = [command, recipe, *more, "-o", tmp_path / "x.h5", "--dry-run"]
        code, _, err = call(capsys, *arguments)
        assert code == 0, (command, err)
    assert list(tmp_path.iterdir()) == []


class Bench:
    """A drive of DRIVES with its motor, tuned as its recipe states, and its person."""

    def __init__(self, name, tmp_path, capsys, monkeypatch):
        make, self.recipe_name, self._port, self._more = DRIVES[name]
        self.name, self._folder, self._capsys = name, tmp_path, capsys
        recipe = load_recipe(ROOT / "recipes" / f"{self.recipe_name}.toml", self._more)[0]
        constant, inertia = recipe.rig.torque_constant, recipe.rig.nominal_inertia
        self.motor = motor = BenchMotor(inertia=inertia, torque_constant=constant)
        motor.tune(recipe.rig.controller, inertia)
        self.device = make()
        drive = getattr(self.device, "device", self.device)
        drive.motor = motor
        if name == "moteus-can":
            for settings in (drive.config, drive.stored):
                settings["motor.Kv"] = 1.5 / math.sqrt(3) * 60 / (2 * math.pi) / constant
        self.person = Person(motor, self.device.reset)
        self.person.at_the_terminal(monkeypatch)

    def begin(self, port, gauge):
        """Copy the recipe out, fill in the ports, and look whether the drive answers."""
        self.recipe, self._gauge = self._folder / "motor.toml", gauge
        assert self.call("recipe", self.recipe_name, "-o", self.recipe)
        self._at = self._port.format(port)
        assert f"{self.name}: " in self.call("devices", self._at)

    def call(self, *arguments):
        """Run a command that has to succeed; return what it prints."""
        code, out, err = call(self._capsys, *arguments)
        assert code == 0, (arguments[0], err)
        return out + err

    def run(self, command, *more, shorter=SHORTER, inputs=(), refused=False):
        """Look at --dry-run, then measure; return the path of the run, or why it is `refused`."""
        output = self._folder / f"{command}.h5"
        settings = (
            f'serial.port="{self._at}"',
            "serial.force.driver=mark10",
            f'serial.force.port="{self._gauge}"',
            *shorter[command],
            *(part for part in self._more if command != "stribeck" or part not in SLOWLY),
            *more,
        )
        changes = [part for setting in settings for part in ("--set", setting)]
        arguments = (command, self.recipe, *inputs, "-o", output, *changes)
        self.call(*arguments, "--dry-run")
        if refused:
            code, _, err = call(self._capsys, *arguments, "--yes")
            assert code == 5
            return err
        self.call(*arguments, "--yes")
        return output


@pytest.fixture
def quick(monkeypatch, world):
    """Shorter times of motions that no recipe sets; a drive that nobody asks looks around less."""
    for module in (bare_motor, fft_ripple):
        monkeypatch.setattr(module, "ACCELERATION", 100.0)
        monkeypatch.setattr(module, "SETTLE_TIME", 0.3)
    world.tick = 0.02


LIKE_ANOTHER = ("maxon-can", "moteus-can")
"""Drives whose line and loop another one of DRIVES has too."""


@pytest.fixture(
    params=[*(name for name in DRIVES if name not in LIKE_ANOTHER), *thorough(*LIKE_ANOTHER)]
)
def bench(request, quick, tmp_path, capsys, monkeypatch):
    """Each drive with its recipe filled in, and a calibration that was measured on it."""
    found = Bench(request.param, tmp_path, capsys, monkeypatch)
    gauge = Mark10Emulator(lambda: found.motor.push, decimals=4)
    with serve(found.device) as server, serve(gauge) as beside:
        found.begin(server.port, beside.port)
        found.kt = found.run("calibrate-kt")
        found.motor.degc, found.motor.clamped = 25.0, False
        yield found
        assert server.error is None


def result(path, name):
    with open_run(path) as run:
        return run.result(name)


def assert_true(found, truth, most):
    """See that a result is within three times its uncertainty, which is a part of it at most."""
    assert found.value == pytest.approx(truth, abs=3 * found.u)
    assert found.u < most * truth


def test_constant_and_ripple_are_measured_on_each_drive(bench):
    motor = bench.motor
    assert_true(result(bench.kt, "torque_constant_mean"), motor.cold_constant, 0.05)
    path = bench.run("fft-ripple", inputs=("--kt", bench.kt))
    ripple = result(path, "repeatable_rms").value
    (_, amplitude, _) = motor.ripple[0]
    assert 0.5 * amplitude < ripple < 1.1 * amplitude  # the loop takes a part, friction adds one
    with open_run(path) as run:
        line = json.loads(run.provenance["line"])
    assert line["driver"] == bench.name
    assert line["late_samples"] == 0


@pytest.mark.thorough
def test_the_plant_is_identified_where_the_host_closes_the_loop(bench):
    """Loops of a drive change the current between two samples: they are refused at rest."""
    kt = ("--kt", bench.kt)
    if bench.name in ("vesc", "simplefoc"):
        path = bench.run("identify-plant", inputs=kt)
        assert_true(result(path, "inertia"), bench.motor.inertia, 0.04)
        return
    before = bench.motor.position
    err = bench.run("identify-plant", inputs=kt, refused=True)
    assert "needs to hold its current from one sample to the next: the loop of this" in err
    assert bench.motor.position == before


@pytest.mark.thorough
def test_friction_and_loads_are_measured_on_each_drive(bench):
    """stribeck, then ilc-learn, whose tables measure-force needs."""
    kt, motor = ("--kt", bench.kt), bench.motor
    friction = result(bench.run("stribeck", inputs=kt), "coulomb_friction")
    assert friction.value == pytest.approx(motor.coulomb, rel=0.2)  # of short holds, with ripple
    tables = bench.run("ilc-learn", inputs=kt)
    loads = bench.run("measure-force", inputs=(*kt, "--tables", tables))
    assert_true(result(loads, "mean_torque_load_001"), 0.5 * RADIUS, 0.1)
