"""What the recipe alone decides is decided before anything moves, and by --dry-run."""

from pathlib import Path

import pytest

from rigtool.errors import RecipeError
from rigtool.experiments.force.procedure import PROCEDURE as MEASURE_FORCE
from rigtool.experiments.friction.procedure import PROCEDURE as STRIBECK
from rigtool.experiments.ripple.procedure import PROCEDURE as FFT_RIPPLE
from rigtool.experiments.running.options import CommonOptions
from rigtool.experiments.running.session import run_command
from rigtool.experiments.torque_constant.procedure import PROCEDURE as CALIBRATE_KT
from rigtool.recipe import override_recipe
from rigtool.rigs.virtual import VirtualRig
from rigtool.runfile import open_run
from tests.experiments.virtual_runs import RECIPE

FIXTURES = Path(__file__).parents[2] / "fixtures"
KT, TABLES = FIXTURES / "kt.h5", FIXTURES / "tables.h5"


@pytest.fixture
def refused(tmp_path, monkeypatch):
    """Return a function that gives the message with which a command is refused unmoved."""

    def moved(self, task):
        raise AssertionError("the rig moved")

    monkeypatch.setattr(VirtualRig, "perform", moved)

    def message(procedure, *overrides, dry_run):
        options = CommonOptions(overrides=overrides, dry_run=dry_run)
        names = {"calibrate-kt": (), "measure-force": ("kt", "tables")}
        paths = {"kt": KT, "tables": TABLES}
        inputs = {n: open_run(paths[n]) for n in names.get(procedure.command, ("kt",))}
        with pytest.raises(RecipeError) as caught:
            run_command(
                procedure, [str(RECIPE)], str(tmp_path / "o.h5"), options=options, inputs=inputs
            )
        assert list(tmp_path.iterdir()) == []
        return str(caught.value)

    return message


@pytest.mark.parametrize("dry_run", [False, True])
@pytest.mark.parametrize(
    ("procedure", "override", "text"),
    [
        (MEASURE_FORCE, "measure_force.forces=[60, 250]", "60 N at the output takes 22"),
        (MEASURE_FORCE, "measure_force.measure_angle=900", "not between 20 and 160 deg"),
        (FFT_RIPPLE, "fft_ripple.torques=[14, 37]", "14 N m takes 3"),
        (STRIBECK, "stribeck.breakaway_limit=12", "limit of current leaves 0.45 N m"),
        (CALIBRATE_KT, "calibrate_kt.current_max=40", "rig.current_limit"),
        (FFT_RIPPLE, "fft_ripple.revolutions=100000", "longer than 24 h"),
        (STRIBECK, "rig.attachment=pully", "'pulley' or 'instrument'"),
        (CALIBRATE_KT, "virtual.arm.stiffness=1e8", "beyond what can be simulated"),
    ],
)
def test_refused_before_anything_moves(refused, procedure, override, text, dry_run):
    assert text in refused(procedure, override, dry_run=dry_run)


def test_a_constant_far_from_that_of_the_data_sheet_is_remarked():
    with open_run(KT) as run:
        notes = {
            constant: " ".join(CALIBRATE_KT.analyse([run], changed(run.recipe, constant)).notes)
            for constant in (0.045, 0.01)
        }
    assert "times the data sheet's" not in notes[0.045]
    assert "4.54 times the data sheet's, rig.torque_constant = 0.01 N m/A" in notes[0.01]


def changed(recipe, constant):
    return override_recipe(recipe, [f"rig.torque_constant={constant}"])
