"""Implementation D on the virtual rig: what it learns, and Table 8 read with it."""

import math
import re
from dataclasses import replace

import numpy as np
import pytest

from rigtool.errors import InsufficientDataError, RecipeError, RunFileError
from rigtool.experiments.force import procedure as measure_force
from rigtool.experiments.force.procedure import PROCEDURE as MEASURE_FORCE
from rigtool.experiments.force.results import ONE_ANGLE, LoadRow
from rigtool.experiments.force.results_corrected import load_outcome
from rigtool.experiments.force_model.stored import model_from, model_results
from rigtool.experiments.learning.implementations.d_known_loads import KnownLoads
from rigtool.experiments.learning.procedure import PROCEDURE as ILC_LEARN
from rigtool.experiments.load_disturbance.stored import disturbance_from, rising_load
from rigtool.recipe import load_recipe
from rigtool.runfile import open_run
from tests.experiments.learned_loads import KT, RIG, D, learned_loads
from tests.experiments.virtual_runs import RECIPE, run
from tests.unchanged import require_unchanged

FORCE = (
    "measure_force.forces=[0.25, 2.5]",
    "measure_force.cycles=16",
    "measure_force.extra_cycles=3",
)
FULL = "measure_force.correction=full"
LOAD = "measure_force.correction=load"


def at(speed):
    return f"measure_force.speed_rev_per_s={speed}"


@pytest.fixture(scope="module")
def rig(tmp_path_factory):
    """Learn the rig; return a function that measures forces with it."""
    folder = tmp_path_factory.mktemp("rig")
    tables = learned_loads(tmp_path_factory, folder / "tables.h5")

    def measured(*more, source=RECIPE, tables=tables, output="force.h5"):
        own = (*RIG, *FORCE) if source == RECIPE else ()
        return run(MEASURE_FORCE, source, folder / output, *own, *more, kt=KT, tables=tables)

    measured.folder, measured.tables = folder, tables
    with open_run(tables) as measured.learned:
        yield measured


@pytest.fixture(scope="module")
def thesis(rig):
    """Measure loads at 1 rev/s by the thesis's way; the run is stored as `thesis.h5`."""
    return rig(at(1), output="thesis.h5")


def test_no_other_number_has_changed(rig, thesis):
    require_unchanged("D", rig.learned)
    require_unchanged("D-thesis", thesis)


def test_the_rig_gives_its_tendon_and_load_friction_back(rig):
    results = rig.learned.results
    assert results["tendon_stiffness"].value == pytest.approx(0.13, rel=0.02)
    assert all(results[name].budget for name in results if name.startswith(("tendon", "load_f")))
    for name in ("tendon_stiffness_shift", "tendon_stiffness_resonance"):
        found = results[name]
        assert found.value == pytest.approx(0.13, abs=max(0.008, 3 * found.u))
    friction = results["load_friction_coefficient"]
    assert friction.value == pytest.approx(0.2, abs=max(0.02, 3 * friction.u))
    assert results["learned_torque"].value == pytest.approx(0.06, rel=1e-9)


def test_the_model_of_force_over_time_gives_tendon_and_load_friction_back(rig):
    results = rig.learned.results
    for name, true in (("stiffness", 0.13), ("damping", 8e-4), ("tip_friction", 1e-3)):
        found = results[f"model_{name}"]
        assert found.value == pytest.approx(true, abs=max(0.1 * true, 3 * found.u))
    with open_run(rig.tables) as stored:
        plant = model_from(stored, stored.recipe).plant(125e-6)
    carried = np.array([10e-3, 50e-3])
    grown = np.hypot(carried, plant.load_friction_onset) - plant.load_friction_onset
    expected = 0.2 * (np.hypot(carried, 1.8e-3) - 1.8e-3)
    np.testing.assert_allclose(plant.load_friction * grown, expected, rtol=0.1)


def test_a_stored_model_is_the_learned_one(rig):
    with open_run(rig.tables) as stored:
        model = model_from(stored, stored.recipe)
        assert model_results(model).keys() <= stored.results.keys()
        for name, result in model_results(model).items():
            assert result.value == pytest.approx(stored.result(name).value, rel=1e-12)
        covariance = stored.table("force_covariance")["covariance"]
    np.testing.assert_array_equal(model.learned.covariance, covariance)


def test_a_run_without_the_model_is_refused(rig):
    with open_run(KT) as other, pytest.raises(RunFileError, match="learn again"):
        model_from(other, other.recipe)


def test_loads_left_out_are_read(rig):
    left_out = rig.learned.table("left_out")
    assert left_out["error_percent"].shape == (2, 3)
    assert np.abs(left_out["error_percent"][:, 1]).max() < 3


def test_the_grid_has_an_uncertainty_at_each_point_and_the_shape_of_friction(rig):
    table = rig.learned.table("disturbance")
    assert table["torque"].shape == (4, 29, 13)
    assert (np.diff(table["speed"]) > 0).all()
    middle = table["torque"][:, 14, -1]
    # Lifting adds, lowering takes off: about a fifth of 60 mN m
    np.testing.assert_allclose(np.abs(middle), 12e-3, atol=2e-3)
    assert (np.sign(middle) == np.sign(table["speed"])).all()
    assert (table["u"][:, :, 1:] > 0).all()
    assert table["u"].max() < 4e-3  # where the stroke begins and ends, at the largest load


@pytest.mark.parametrize("speed", [1.4, 2])
def test_full_reads_loads_within_5_percent_where_none_does_not(rig, speed):
    outcome = rig(FULL, at(speed))
    loads = outcome.tables["loads"]
    assert np.abs(loads["error_percent"][1:]).max() < 5
    assert np.abs(outcome.tables["loads_uncorrected"]["error_percent"][1:]).max() > 10
    assert (np.abs(loads["error_torque"][1:]) < 4 * loads["mean_torque_u"][1:] + 0.02e-3).all()
    assert outcome.results["loads_outside"].value == 0
    require_unchanged(f"full-{speed}", outcome)


def test_a_motor_15_k_warmer_reads_the_same(rig):
    outcome = rig(FULL, at(1), "virtual.thermal.ambient_degc=42")
    require_unchanged("full-warm", outcome)
    assert np.abs(outcome.tables["loads"]["error_percent"][2]) < 0.7
    notes = outcome.notes
    assert any(re.search(r"its constant is corrected by -1\.[6-8] %", note) for note in notes), (
        notes
    )


def test_a_stored_run_is_corrected_afterwards(rig, thesis):
    stored = rig.folder / "thesis.h5"
    again = rig(source=stored, output="again.h5")
    np.testing.assert_array_equal(
        again.tables["loads"]["mean_torque"], thesis.tables["loads"]["mean_torque"]
    )
    full = rig(FULL, source=stored, output="again.h5")
    assert np.abs(full.tables["loads"]["error_percent"][2]) < 2
    corrected = rig(LOAD, source=stored, output="again.h5")
    require_unchanged("load-corrected", corrected)
    load = corrected.tables
    uncorrected = thesis.tables["loads"]["error_percent"]
    np.testing.assert_allclose(load["loads_uncorrected"]["error_percent"], uncorrected, rtol=1e-9)
    assert (np.abs(load["loads"]["error_percent"][1:]) < uncorrected[1:] / 2).all()
    # Ripple is not corrected: the calibration's line of it stays.
    lines = [
        {line.name for line in outcome.results["mean_torque_load_002"].budget}
        for outcome in (again, corrected)
    ]
    assert [ONE_ANGLE in names for names in lines] == [True, True]
    # The constant is that at the motor's temperature, which is known.
    assert ["temperature of the motor" in names for names in lines] == [True, False]
    assert any("constant at the motor's 27 degC" in note for note in corrected.notes)
    off = load["loads"]["error_torque"][1:] / load["loads"]["mean_torque_u"][1:]
    assert (np.abs(off) < 2.5).all()


def test_a_warmer_motor_has_less_torque_for_a_current(rig, thesis, monkeypatch):
    source, read = rig.folder / "thesis.h5", []
    for degc in (27.0, 42.0):
        monkeypatch.setattr(measure_force, "mean_temperature", lambda _, degc=degc: degc)
        loads = rig(LOAD, source=source, output="again.h5").tables["loads"]
        read.append(loads["mean_torque"][2:])
    # By 0.116 %/K of the constant at 20 degC; learned friction, a fifth of it, stays as it is.
    expected = (1 - 0.00116 * 22) / (1 - 0.00116 * 7)
    np.testing.assert_allclose(read[1] / read[0], expected, atol=0.3 * (1 - expected))


def test_each_load_is_read_by_the_constant_of_the_winding_that_it_warms(rig, thesis, monkeypatch):
    source, read, squares = rig.folder / "thesis.h5", [], []
    for loss in (0.0, 0.02):

        def cooler(constant, kt, square, least, loss=loss):
            squares.append(square)
            return replace(constant, value=constant.value * (1 - loss * square))

        monkeypatch.setattr(measure_force, "warmed", cooler)
        read.append(rig(LOAD, source=source, output="again.h5").tables["loads"]["mean_torque"])
    with open_run(source) as stored:
        names = [name for name in stored.recordings if name.startswith("load_")]
        asked = [stored.recordings[name].read("current_setpoint") for name in names]
    own = np.array([np.mean(current.astype(np.float64) ** 2) for current in asked])
    np.testing.assert_allclose(squares[: len(own)], own, rtol=0.15)
    # The motor's friction, read without load, is in each reading as well: warmer, it seems less.
    lower = 1 - 0.02 * own[2]
    assert read[1][2] / read[0][2] == pytest.approx(lower, abs=0.3 * (1 - lower))


@pytest.mark.parametrize("correction", ["none", "load", "full"])
def test_what_samples_lack_is_in_every_uncertainty(rig, thesis, monkeypatch, correction):
    """As a drive that is sent steps of position makes it: known from its line, taken on trust."""
    settings = {"source": rig.folder / "thesis.h5", "output": "again.h5"}
    way = f"measure_force.correction={correction}"
    before = rig(way, **settings).tables["loads"]["mean_torque_u"][1:]
    lacking = 1.3e-3
    monkeypatch.setattr(measure_force, "lacking_torque", lambda *given: (lacking, ()))
    loads = rig(way, **settings).tables["loads"]
    # The thesis's way takes a zero off, which lacks as much.
    least = lacking if correction == "full" else math.sqrt(2) * lacking
    expected = np.hypot(before, least)
    np.testing.assert_allclose(loads["mean_torque_u"][1:], expected, rtol=1e-6)


def test_a_load_beyond_the_learned_ones_has_no_value(rig):
    outcome = rig(FULL, at(1), "measure_force.forces=[0.25, 4]")
    assert np.isnan(outcome.tables["loads"]["mean_torque"][2])
    assert np.isfinite(outcome.tables["loads"]["mean_torque"][1])
    assert outcome.results["loads_outside"].value == 1
    require_unchanged("full-beyond", outcome)
    assert any("learn with larger loads" in note for note in outcome.notes)
    with pytest.raises(InsufficientDataError, match="no load can be read"):
        rig(FULL, at(1), "measure_force.forces=[4]")


def test_a_reading_beyond_the_friction_that_was_learned_has_no_value(thesis):
    torque = thesis.results["mean_torque_load_001"]
    row = LoadRow(0.5, torque, torque, 1e-4, 1e-5, 10.0, 10.0)
    rows = [row, row, row]
    found = load_outcome(thesis, rows, np.array([0.0, 1e-4, math.nan]), rows)
    loads = found.tables["loads"]
    assert np.isfinite(loads["mean_torque"]).tolist() == [True, True, False]
    assert np.isfinite(loads["applied_torque"]).all()
    assert found.results["loads_outside"].value == 1
    with pytest.raises(InsufficientDataError, match="beyond those that friction was learned with"):
        load_outcome(thesis, rows, np.array([0.0, math.nan, math.nan]), rows)


def test_a_speed_beyond_the_learned_ones_is_refused_before_it_moves(rig):
    with pytest.raises((InsufficientDataError, RunFileError), match="learned up"):
        rig(FULL, at(2.2), output="never.h5")
    assert not (rig.folder / "never.h5").exists()


def test_closer_to_standstill_than_learned_there_is_a_dead_band_and_no_value(rig):
    outcome = rig(FULL, at(0.6), "measure_force.cycles=6")
    loads = outcome.tables["loads"]
    assert np.isnan(loads["mean_torque"][1:]).all()
    assert outcome.results["loads_outside"].value == 2
    inside = np.abs(loads["applied_torque"] - loads["dead_band_middle"]) < loads["dead_band"]
    assert inside[1:].all()
    assert any("closer to standstill friction may hold" in note for note in outcome.notes)
    with pytest.raises(InsufficientDataError, match="closer to standstill"):
        rig(LOAD, at(0.6))


def test_tables_without_known_loads_correct_nothing(rig, tmp_path):
    plain = tmp_path / "plain.h5"
    sets = (*D, "ilc_learn.implementation=C")
    run(ILC_LEARN, RECIPE, plain, *sets, kt=KT)
    with pytest.raises(RunFileError, match="learn with --implementation D"):
        rig(FULL, at(1), tables=plain)


def test_known_loads_need_an_instrument(tmp_path, rig):
    with pytest.raises(RecipeError, match="attach the instrument"):
        run(ILC_LEARN, RECIPE, tmp_path / "d.h5", *D, "rig.attachment=pulley", kt=KT)


def test_what_a_rising_reading_holds_besides_a_load(rig):
    with open_run(rig.tables) as stored:
        disturbance = disturbance_from(stored, stored.recipe)
        assert disturbance.torque == pytest.approx(0.06, rel=1e-9)
        ratio = 2 * math.pi * 0.85
        assert disturbance.speeds == pytest.approx((ratio, 2 * ratio), rel=1e-9)
        load = np.array([0.0, 0.03, 0.06])
        slow = stored.recipe.model_copy(
            update={
                "measure_force": stored.recipe.measure_force.model_copy(
                    update={"speed_rev_per_s": 1.0}
                )
            }
        )
        found = rising_load(stored, slow, disturbance.model, load)
    friction = found.friction
    assert friction[0] == pytest.approx(0, abs=0.1e-3)
    assert 2 * friction[1] == pytest.approx(friction[2], rel=0.15)
    assert (found.u[1:] < 0.1 * friction[1:]).all()
    # The tendon's stretch turns the grasper by 61 / 130 rad: it carries the tip's friction, too.
    # At 6.3 rad/s, against a swing of 33 rad/s, the load adds 2 % as the tendon shortens.
    stiff = 1 + 0.06 * math.tan(0.061 / 0.13) / 0.13
    swung = 1 + (2 * math.pi / 33) ** 2 / stiff**3
    expected = 0.06 / math.cos(0.061 / 0.13) / swung
    np.testing.assert_allclose(found.torque[2], expected, rtol=0.01)
    assert np.abs(found.remains).max() < 1.5e-3


def test_a_recording_that_explores_is_needed(rig):
    with open_run(rig.tables) as stored, open_run(KT) as kt:
        kept = {n: r for n, r in stored.recordings.items() if n != "explore_000"}
        stored.recordings = kept
        with pytest.raises(RunFileError, match="0 recordings that explore"):
            ILC_LEARN.analyse([stored], stored.recipe, kt=kt)


def test_the_checks_move_without_load_with_a_middle_one_and_the_largest():
    specs = {spec.name: spec for spec in KnownLoads.recordings(load_recipe(RECIPE, D)[0])}
    forces = [specs[f"check_{n:03d}"].conditions["force"] for n in range(3)]
    assert forces == [(0.0, "N"), (0.7, "N"), (3.0, "N")]
    assert specs["explore_000"].conditions["force"] == (0.0, "N")
