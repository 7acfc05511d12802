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
from tests.thorough import first_of
from tests.unchanged import require_unchanged

PULLEY = "rig.attachment=pulley"
STEADY = (
    *QUIET,
    "virtual.instrument.stroke_noise=0",
    "virtual.instrument.load_stroke_noise=0",
    "virtual.instrument.drift=0",
    "rig.controller.integrator_hz=2",  # stable with 5 N on any spring
)
FREE = ("virtual.instrument.load_friction=0", "virtual.instrument.tip_friction=0")
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
    """Learn and measure with these recipe values, once; return the outcome.

    Learning does not look at what is only `stated`.
    """
    folder = tmp_path_factory.mktemp("force")
    kt = write_kt(folder)

    @functools.cache
    def learned(*sets, seed):
        tables = folder / f"tables-{learned.cache_info().misses}.h5"
        run(ILC_LEARN, RECIPE, tables, *SHORT, *sets, seed=seed, kt=kt)
        return tables

    @functools.cache
    def measured(*sets, stated=(), seed=None):
        tables, output = learned(*sets, seed=seed), folder / "force.h5"
        every = (*SHORT, *sets, *stated)
        return run(MEASURE_FORCE, RECIPE, output, *every, seed=seed, kt=kt, tables=tables)

    def again(*sets, setting):
        """Analyse the last measurement again."""
        stored, inputs = folder / "force.h5", {"kt": kt, "tables": learned(*sets, seed=None)}
        return run(MEASURE_FORCE, stored, folder / "again.h5", setting, **inputs)

    measured.again = again
    return measured


def test_a_quiet_pulley_shows_what_hangs_on_it(force):
    loads = force(PULLEY, *STEADY).tables["loads"]
    np.testing.assert_allclose(loads["mean_torque"][1:], [3.5e-3, 35e-3], rtol=5e-3, atol=0)
    assert abs(loads["mean_torque"][0]) < 0.05e-3


@pytest.mark.parametrize("seed", first_of([1, 2]))
def test_the_thesis_rig_reads_the_pulley_within_the_tolerance_of_table_9(force, seed):
    outcome = force(PULLEY, seed=seed)
    if seed == 1:
        require_unchanged("pulley", outcome)
    loads = outcome.tables["loads"]
    assert (np.abs(loads["error_percent"][1:]) < 8).all()
    assert (np.abs(loads["error_torque"][1:]) < 4 * loads["mean_torque_u"][1:]).all()


@pytest.mark.parametrize(
    ("sets", "stiffness"), first_of([((), 0.2), (("virtual.instrument.stiffness=0.4",), 0.4)])
)
def test_stiffness_comes_back_from_the_shift(force, sets, stiffness):
    results = force(*STEADY, *sets).results
    assert results["stiffness"].value == pytest.approx(stiffness, rel=0.06)
    assert results["lifting_torque"].value > 60e-3 > results["lowering_torque"].value


def test_load_friction_is_distinguished_from_the_rest(force):
    outcome = force(*STEADY, *FREE)
    require_unchanged("instrument", outcome)
    results = outcome.results
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


@pytest.mark.parametrize("draw", first_of([1, 2]))
def test_weights_and_a_radius_that_are_off_are_in_the_error_of_a_load(force, draw):
    """Both drawn from what the recipe states; the torque is right, what it is held against not."""
    stated = {"weights": 0.01, "radius": 0.02}
    weights, radius = np.random.default_rng(draw).standard_normal(2) * list(stated.values())
    outcome = force(
        PULLEY,
        *STEADY,
        stated=(
            f"rig.weights_relative_u={stated['weights']}",
            f"rig.pulley_radius_u={stated['radius'] * 0.014}",
            f"virtual.misstated.weights={weights}",
            f"virtual.misstated.pulley_radius={radius}",
        ),
    )
    loads, largest = outcome.tables["loads"], outcome.results["mean_torque_load_002"]
    off = (1 + weights) * (1 + radius)
    assert largest.value == pytest.approx(35e-3 * off, rel=5e-3)
    assert largest.value == loads["mean_torque"][2]
    assert {"weights", "length to the load"}.isdisjoint(x.name for x in largest.budget)
    np.testing.assert_allclose(loads["applied_torque"][1:], [3.5e-3, 35e-3], rtol=1e-12, atol=0)
    relative = math.hypot(*stated.values())
    np.testing.assert_allclose(
        loads["applied_torque_u"], relative * loads["applied_torque"], rtol=1e-9, atol=0
    )
    both = np.hypot(loads["applied_torque_u"], loads["mean_torque_u"])
    np.testing.assert_allclose(loads["error_torque_u"], both, rtol=1e-9, atol=0)
    assert (np.abs(loads["error_torque"][1:]) < 2.5 * loads["error_torque_u"][1:]).all()
    assert abs(off - 1) > 5e-3


@pytest.mark.parametrize(
    ("line", "setting", "u", "off", "sets"),
    [
        ("weights", "weights_relative_u", 0.01, "weights", (PULLEY, *STEADY)),
        ("length to the load", "pulley_radius_u", 0.14e-3, "pulley_radius", (PULLEY, *STEADY)),
        (
            "length to the load",
            "instrument.grasper_length_u",
            0.2e-3,
            "grasper_length",
            (*STEADY, *FREE),
        ),
        (
            "angle ratio",
            "instrument.angle_ratio_relative_u",
            0.01,
            "angle_ratio",
            (*STEADY, *FREE),
        ),
    ],
)
def test_an_interval_holds_with_the_line_of_what_is_off_and_not_without(
    force, line, setting, u, off, sets
):
    stated = (f"rig.{setting}={u}", f"virtual.misstated.{off}=0.015")
    error = force(*sets, stated=stated).results["error_torque_load_002"]
    assert abs(error.value) < 2 * error.u
    (own,) = (one for one in error.budget if one.name == line)
    assert own.contribution > 0.7 * error.u
    without = force.again(*sets, setting=f"rig.{setting}=0").results["error_torque_load_002"]
    assert without.value == pytest.approx(error.value, rel=1e-9)
    assert abs(without.value) > 4 * without.u
    assert line not in {one.name for one in without.budget}


def test_an_angle_ratio_that_is_off_is_in_the_torque_at_the_output(force):
    stated = ("rig.instrument.angle_ratio_relative_u=0.02",)
    # a small load: a large one stretches the tendon, which moves the angle of the reading
    right = force(*STEADY, stated=stated).results["mean_torque_load_001"]
    wrong = force(*STEADY, "virtual.misstated.angle_ratio=0.02", stated=stated)
    found = wrong.results["mean_torque_load_001"]
    assert found.value / right.value == pytest.approx(1.02, abs=8e-3)
    (line,) = (line for line in found.budget if line.name == "angle ratio")
    assert line.contribution == pytest.approx(0.02 * found.value, rel=1e-9)
    assert abs(found.value - right.value) < 2 * found.u
    lengths = force(*STEADY, stated=("rig.instrument.grasper_length_u=1e-3",)).tables["loads"]
    np.testing.assert_allclose(
        lengths["applied_torque_u"], 0.05 * lengths["applied_torque"], rtol=1e-9, atol=0
    )
