"""The thesis's chain with the virtual rig behind a serial line: the very same run files."""

from pathlib import Path

import pytest

from rigtool.errors import HardwareError
from rigtool.experiments.force.procedure import PROCEDURE as MEASURE_FORCE
from rigtool.experiments.friction.procedure import PROCEDURE as STRIBECK
from rigtool.experiments.learning.procedure import PROCEDURE as ILC_LEARN
from rigtool.experiments.plant.procedure import PROCEDURE as IDENTIFY_PLANT
from rigtool.experiments.ripple.procedure import PROCEDURE as FFT_RIPPLE
from rigtool.experiments.running.dry_run import rehearse, require_offered
from rigtool.experiments.running.options import CommonOptions
from rigtool.experiments.running.session import run_command
from rigtool.experiments.suspension.procedure import PROCEDURE as SUSPENSION
from rigtool.experiments.torque_constant.procedure import PROCEDURE as CALIBRATE_KT
from rigtool.recipe import load_recipe
from rigtool.rigs.serial.emulators.server import serve
from rigtool.rigs.serial.emulators.target import TargetEmulator
from rigtool.runfile import open_run
from tests.experiments.virtual_runs import RECIPE
from tests.rigs.serial.recipes import overrides

FIXTURES = Path(__file__).parents[1] / "fixtures"

SHORT = {
    CALIBRATE_KT: (
        "calibrate_kt.temperatures_degc=[20, 35]",
        "calibrate_kt.rotor_positions=2",
        "calibrate_kt.steps=6",
        "calibrate_kt.staircases=1",
        "calibrate_kt.record_every=160",
    ),
    STRIBECK: (
        "stribeck.sweep_time=4",
        "stribeck.hold_speeds=[8, 16, 30]",
        "stribeck.hold_time=0.5",
        "stribeck.breakaway_positions=3",
        "stribeck.record_every=32",
    ),
    FFT_RIPPLE: (
        "fft_ripple.speeds=[30]",
        "fft_ripple.revolutions=4",
        "fft_ripple.torques=[14e-3]",
        "fft_ripple.record_every=16",
    ),
    ILC_LEARN: (
        "ilc_learn.speeds_rev_per_s=[5]",
        "ilc_learn.low_speeds_rev_per_s=[1]",
        "ilc_learn.moves=3",
    ),
    MEASURE_FORCE: (
        "measure_force.forces=[2.5]",
        "measure_force.speed_rev_per_s=0.5",
        "measure_force.cycles=3",
        "measure_force.extra_cycles=2",
        "measure_force.record_every=40",
    ),
    IDENTIFY_PLANT: (
        "rig.attachment=pulley",
        "identify_plant.speeds=[16]",
        "identify_plant.realisations=2",
        "identify_plant.periods=4",
    ),
    SUSPENSION: (),
}


@pytest.fixture
def port(world):
    with serve(TargetEmulator(load_recipe(RECIPE)[0])) as server:
        yield server.port
        assert server.error is None


@pytest.mark.parametrize("procedure", SHORT, ids=lambda procedure: procedure.command)
def test_same_content_over_the_line(procedure, port, tmp_path):
    inputs = {}
    if procedure not in (CALIBRATE_KT, SUSPENSION):
        inputs["kt"] = open_run(FIXTURES / "kt.h5")
    if procedure is MEASURE_FORCE:
        inputs["tables"] = open_run(FIXTURES / "tables.h5")
    over_line = overrides(port, "serial.watchdog=10")
    content = {}
    for name, more in (("direct", ()), ("line", over_line)):
        options = CommonOptions(overrides=(*SHORT[procedure], *more), yes=True)
        path = tmp_path / f"{name}.h5"
        run_command(procedure, [str(RECIPE)], str(path), options=options, inputs=inputs)
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
        plan = rehearse(ILC_LEARN, recipe, 0.045, {"kt": kt})

    class Rig:
        def lacks(self, asked):
            return "this drive takes no torque" if asked == need else None

    assert not plan.complete
    with pytest.raises(HardwareError, match=r"ilc-learn cannot run .*: this drive takes no torque"):
        require_offered(Rig(), plan, "ilc-learn")
