"""Force over time on the virtual rig: learned, moved, observed, and read from stored runs."""

import math

import numpy as np
import pytest

from rigtool.errors import RecipeError, RunFileError, UsageError
from rigtool.experiments.force.procedure import PROCEDURE as MEASURE_FORCE
from rigtool.experiments.force.procedure_over_time import over_time
from rigtool.experiments.force_over_time.motion_states import State
from rigtool.experiments.learning.procedure import PROCEDURE as ILC_LEARN
from rigtool.runfile import open_run
from tests.experiments.virtual_runs import RECIPE, run

KT = RECIPE.parents[1] / "tests" / "fixtures" / "kt.h5"
D = (
    "ilc_learn.implementation=D",
    "ilc_learn.speeds_rev_per_s=[2]",
    "ilc_learn.low_speeds_rev_per_s=[]",
    "ilc_learn.moves=3",
    "ilc_learn.loads.forces=[0.5, 3]",
    "ilc_learn.loads.speeds_rev_per_s=[1, 2]",
    "ilc_learn.loads.cycles=6",
)
PULSE = '[[virtual.contact]]\nkind = "pulse"\nat = [2.0, 5.0]\nduration = 1.5\nforce = 2.0\n'
MOMENT = 2.0 * 0.020


@pytest.fixture(scope="module")
def rig(tmp_path_factory):
    """Learn the thesis's rig in short; return a function that reads force over time."""
    folder = tmp_path_factory.mktemp("rig")
    tables, touched = folder / "tables.h5", folder / "touched.toml"
    touched.write_text(RECIPE.read_text(encoding="utf-8") + "\n" + PULSE, encoding="utf-8")
    run(ILC_LEARN, RECIPE, tables, *D, kt=KT)

    def measured(seconds, *sets, observed=False, source=touched, name="force.h5", tables=tables):
        procedure = over_time(seconds, observed=observed)
        return run(procedure, source, folder / name, *sets, kt=KT, tables=tables)

    measured.folder, measured.tables, measured.touched = folder, tables, touched
    return measured


@pytest.fixture(scope="module")
def strokes(rig):
    """Eight seconds of strokes with two contacts of 40 mN m."""
    return rig(8.0, "measure_force.speed_rev_per_s=0.5", name="strokes.h5")


def test_a_contact_that_nothing_knows_of_is_read(strokes):
    table = strokes.tables["force"]
    time = table["time"] - table["time"][0]
    within = (time > 2.3) & (time < 3.2)
    without = (time > 3.8) & (time < 4.7)
    assert np.nanmedian(table["torque"][within]) == pytest.approx(MOMENT, rel=0.1)
    assert abs(np.nanmedian(table["torque"][without])) < 2e-3
    np.testing.assert_allclose(table["force"] * 0.020, table["torque"], rtol=1e-9)
    assert strokes.results["peak_torque"].value == pytest.approx(MOMENT, rel=0.2)


def test_the_reference_judges_each_form(strokes):
    results = strokes.results
    assert results["rmse"].value < 3e-3
    assert 0.7 < results["coverage_95"].value <= 1.0
    assert 0.7 < results["causal_coverage_95"].value <= 1.0
    accuracy = strokes.tables["force_accuracy"]
    assert np.nansum(accuracy["share"]) == pytest.approx(1.0)


def test_a_stored_run_gives_the_same_again(rig, strokes):
    again = run(
        MEASURE_FORCE, rig.folder / "strokes.h5", rig.folder / "again.h5", kt=KT, tables=rig.tables
    )
    for name in strokes.tables["force"].columns:
        np.testing.assert_array_equal(again.tables["force"][name], strokes.tables["force"][name])


def test_there_is_no_value_while_the_current_is_at_its_limit(rig, strokes):
    with open_run(rig.folder / "strokes.h5") as stored:
        current = np.abs(stored.recording("strokes_000").read("current_setpoint"))
    limit = f"rig.current_limit={np.quantile(current, 0.9)}"
    found = rig(8.0, "measure_force.speed_rev_per_s=0.5", limit, name="limited.h5")
    assert 0.2 < found.results["valid_share"].value < 0.9
    assert any("current at its limit" in note for note in found.notes)


def test_recordings_of_learning_are_read_too(rig):
    found = run(MEASURE_FORCE, rig.tables, rig.folder / "learned.h5", kt=KT, tables=rig.tables)
    table = found.tables["force"]
    with open_run(rig.tables) as stored:
        names = [r.name for r in stored.recordings.values() if r.has("temperature") and r.size]
        forces = [
            stored.recording(name).conditions["force"].value
            for name in names
            if "force" in stored.recording(name).conditions
        ]
    peaks = [np.nanmax(table["torque"][table["recording"] == n]) for n in set(table["recording"])]
    assert max(peaks) == pytest.approx(max(forces) * 0.020, rel=0.2)


def test_observing_reads_what_somebody_else_moves(rig):
    found = rig(8.0, observed=True, name="observed.h5")
    assert found.results["rmse"].value < 6e-3
    with open_run(rig.folder / "observed.h5") as stored:
        assert not stored.recording("observed_000").has("position_setpoint")


def test_motions_beyond_what_was_learned_are_refused_before_anything_moves(rig):
    fast = ("measure_force.motion.kind=sine", "measure_force.motion.frequency_hz=5")
    with pytest.raises(RecipeError, match=r"rad/s.*learned up to"):
        rig(4.0, *fast, name="fast.h5")
    assert not (rig.folder / "fast.h5").exists()
    with pytest.raises(UsageError, match="time_max = 60 s"):
        rig(61.0, "measure_force.motion.time_max=60", name="fast.h5")


def test_a_torque_beyond_the_learned_has_no_value(rig):
    heavy = rig.folder / "heavy.toml"
    heavy.write_text(rig.touched.read_text().replace("force = 2.0\n", "force = 5.0\n"))
    table = rig(5.0, source=heavy, name="heavy.h5").tables["force"]
    time = table["time"] - table["time"][0]
    within = (time > 2.4) & (time < 3.2)
    assert (table["state"][within] == State.OUTSIDE).all()
    assert np.isnan(table["torque"][within]).all()
    assert np.isfinite(table["torque"][time < 1.5]).all()


def test_tables_without_the_model_are_refused_with_the_remedy(rig, tmp_path):
    plain = tmp_path / "c.h5"
    run(ILC_LEARN, RECIPE, plain, *D[1:4], kt=KT)
    with pytest.raises(RunFileError, match="ilc-learn --implementation D"):
        rig(4.0, tables=plain, name="c.h5")


def test_a_hold_stands_still_and_says_so(rig):
    found = rig(5.0, "measure_force.motion.kind=hold", source=RECIPE, name="hold.h5")
    states = found.tables["force"]["state"]
    assert (states == State.STILL).mean() > 0.9
    assert not math.isnan(found.results["mean_torque"].value)
