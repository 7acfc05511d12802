"""The thesis's chain with the virtual rig behind a serial line: the very same run files."""

from pathlib import Path

import pytest

from rigtool.errors import HardwareError
from rigtool.procedures import (
    calibrate_kt,
    fft_ripple,
    identify_plant,
    ilc_learn,
    measure_force,
    stribeck,
    suspension,
)
from rigtool.procedures.options import CommonOptions
from rigtool.procedures.rehearsal import rehearse, require_offered
from rigtool.procedures.session import run_command
from rigtool.recipe import load_recipe
from rigtool.rigs.serial.emulators.server import serve
from rigtool.rigs.serial.emulators.target import TargetEmulator
from rigtool.runfile import open_run
from tests.procedures.virtual_runs import RECIPE
from tests.rigs.serial.recipes import overrides

FIXTURES = Path(__file__).parents[1] / "fixtures"

SHORT = {
    calibrate_kt: (
        "calibrate_kt.temperatures_degc=[20, 35]",
        "calibrate_kt.rotor_positions=3",
        "calibrate_kt.record_every=160",
    ),
    stribeck: (
        "stribeck.sweep_time=8",
        "stribeck.hold_speeds=[3, 8, 16, 30]",
        "stribeck.hold_time=1",
        "stribeck.breakaway_positions=4",
        "stribeck.record_every=32",
    ),
    fft_ripple: (
        "fft_ripple.speeds=[15, 30]",
        "fft_ripple.revolutions=4",
        "fft_ripple.torques=[14e-3]",
        "fft_ripple.record_every=16",
    ),
    ilc_learn: (
        "ilc_learn.speeds_rev_per_s=[2, 5]",
        "ilc_learn.low_speeds_rev_per_s=[1]",
        "ilc_learn.moves=3",
    ),
    measure_force: (
        "measure_force.forces=[2.5]",
        "measure_force.speed_rev_per_s=0.5",
        "measure_force.cycles=6",
        "measure_force.extra_cycles=2",
        "measure_force.record_every=40",
    ),
    identify_plant: (
        "identify_plant.speeds=[8, 16]",
        "identify_plant.realisations=2",
        "identify_plant.periods=4",
    ),
    suspension: (),
}


@pytest.fixture
def port(world):
    with serve(TargetEmulator(load_recipe(RECIPE)[0])) as server:
        yield server.port
        assert server.error is None


@pytest.mark.parametrize("module", SHORT, ids=lambda module: module.COMMAND)
def test_same_content_over_the_line(module, port, tmp_path):
    inputs = {}
    if module not in (calibrate_kt, suspension):
        inputs["kt"] = open_run(FIXTURES / "kt.h5")
    if module is measure_force:
        inputs["tables"] = open_run(FIXTURES / "tables.h5")
    over_line = overrides(port, "serial.watchdog=10")
    content = {}
    for name, more in (("direct", ()), ("line", over_line)):
        options = CommonOptions(overrides=(*SHORT[module], *more), yes=True)
        path = tmp_path / f"{name}.h5"
        run_command(module, [str(RECIPE)], str(path), options=options, inputs=inputs)
        with open_run(path) as run:
            content[name] = run.content_sha256
            line = run.provenance["line"]
    assert content["line"] == content["direct"]
    assert '"retries": 0' in line
    for run in inputs.values():
        run.close()


@pytest.mark.parametrize(("letter", "need"), [("C", "table"), ("standard", "signal")])
def test_learning_needs_a_rig_that_takes_what_is_learned(letter, need):
    recipe = load_recipe(RECIPE, [f"ilc_learn.implementation={letter}"])[0]
    with open_run(FIXTURES / "kt.h5") as kt:
        plan = rehearse(ilc_learn, recipe, 0.045, {"kt": kt})

    class Rig:
        def lacks(self, asked):
            return "this drive takes no torque" if asked == need else None

    assert not plan.complete
    with pytest.raises(HardwareError, match=r"ilc-learn cannot run .*: this drive takes no torque"):
        require_offered(Rig(), plan, "ilc-learn")
