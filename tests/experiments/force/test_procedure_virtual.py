"""measure-force on the virtual rig, from recipe to force."""

import functools
import math
import shutil

import numpy as np
import pytest

from rigtool.cli import main
from rigtool.experiments.force.procedure import PROCEDURE as MEASURE_FORCE
from rigtool.experiments.learning.procedure import PROCEDURE as ILC_LEARN
from tests.experiments.virtual_runs import QUIET, RECIPE, run, write_kt

PULLEY = "rig.attachment=pulley"
STEADY = (
    *QUIET,
    "virtual.instrument.stroke_noise=0",
    "virtual.instrument.load_stroke_noise=0",
    "virtual.instrument.drift=0",
    "rig.controller.integrator_hz=2",  # stable with 5 N on any spring
)
SHORT = (
    "ilc_learn.speeds_rev_per_s=[0.2]",
    "ilc_learn.low_speeds_rev_per_s=[0.1]",
    "ilc_learn.low_speed_moves=1",
    "ilc_learn.moves=3",
    "measure_force.forces=[0.25, 2.5]",
    "measure_force.cycles=3",
    "measure_force.extra_cycles=2",
)


@pytest.fixture(scope="module")
def force(tmp_path_factory):
    """Learn and measure with these recipe values, once; return the outcome."""
    folder = tmp_path_factory.mktemp("force")
    kt = write_kt(folder)

    @functools.cache
    def measured(*sets, seed=None):
        tables, output = folder / "tables.h5", folder / "force.h5"
        run(ILC_LEARN, RECIPE, tables, *SHORT, *sets, seed=seed, kt=kt)
        return run(MEASURE_FORCE, RECIPE, output, *SHORT, *sets, seed=seed, kt=kt, tables=tables)

    return measured


def test_a_quiet_pulley_shows_what_hangs_on_it(force):
    loads = force(PULLEY, *STEADY).tables["loads"]
    np.testing.assert_allclose(loads["mean_torque"][1:], [3.5e-3, 35e-3], rtol=5e-3, atol=0)
    assert abs(loads["mean_torque"][0]) < 0.05e-3


@pytest.mark.parametrize("seed", [1, 2])
def test_the_thesis_rig_reads_the_pulley_within_the_tolerance_of_table_9(force, seed):
    loads = force(PULLEY, seed=seed).tables["loads"]
    assert (np.abs(loads["error_percent"][1:]) < 8).all()
    assert (np.abs(loads["error_torque"][1:]) < 4 * loads["mean_torque_u"][1:]).all()


@pytest.mark.parametrize("stiffness", [0.2, 0.4])
def test_stiffness_comes_back_from_the_shift(force, stiffness):
    results = force(*STEADY, f"virtual.instrument.stiffness={stiffness}").results
    assert results["stiffness"].value == pytest.approx(stiffness, rel=0.06)
    assert results["lifting_torque"].value > 60e-3 > results["lowering_torque"].value


def test_load_friction_is_told_from_the_rest(force):
    free = ("virtual.instrument.load_friction=0", "virtual.instrument.tip_friction=0")
    results = force(*STEADY, *free).results
    assert results["load_friction"].value == pytest.approx(0, abs=0.6e-3)
    assert results["lifting_torque"].value == pytest.approx(60e-3, rel=0.02)
    assert force(*STEADY).results["load_friction"].value > 5e-3


@pytest.mark.parametrize(
    ("arguments", "code", "message"),
    [
        (["--kt", "kt.h5"], 2, "--tables"),
        (["--kt", "kt.h5", "--tables", "kt.h5"], 3, "was written by calibrate-kt"),
        (["--kt", "tables.h5", "--tables", "tables.h5"], 3, "was written by ilc-learn"),
        (["--kt", "kt.h5", "--tables", "tables.h5", "--set", PULLEY], 3, "attachment instrument"),
        (
            ["--kt", "kt.h5", "--tables", "tables.h5", "--set", "measure_force.cycles=2"],
            3,
            "measure_force.cycles",
        ),
    ],
)
def test_refusals(tmp_path, monkeypatch, capsys, arguments, code, message):
    for name in ("kt.h5", "tables.h5"):
        shutil.copy(RECIPE.parents[1] / "tests" / "fixtures" / name, tmp_path)
    monkeypatch.chdir(tmp_path)
    with pytest.raises(SystemExit) as caught:
        main(["measure-force", str(RECIPE), *arguments, "-o", "o.h5"])
    out, err = capsys.readouterr()
    assert caught.value.code == code, err
    assert message in err
    assert out == ""
    assert {path.name for path in tmp_path.iterdir()} == {"kt.h5", "tables.h5"}


def test_radians_and_counts_of_the_shift_agree(force):
    results = force(*STEADY).results
    counts = results["peak_angle_shift"].value * 0.85 * 4000 / (2 * math.pi)
    assert results["peak_shift_counts"].value == pytest.approx(counts, rel=1e-9)
