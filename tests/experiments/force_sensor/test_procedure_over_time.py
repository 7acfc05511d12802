"""Force over time on the virtual rig: learned, moved, observed, and read from stored runs."""

import math
import re
import subprocess
import sys
from contextlib import ExitStack
from itertools import pairwise

import numpy as np
import pytest

from rigtool.errors import InsufficientDataError, RecipeError, RunFileError, UsageError
from rigtool.experiments.force.procedure import PROCEDURE as MEASURE_FORCE
from rigtool.experiments.force_filter.motion_states import LIMIT_TIME, State
from rigtool.experiments.force_sensor import procedure_reading
from rigtool.experiments.force_sensor.commanded_inertia import CommandedTurns
from rigtool.experiments.force_sensor.procedure_live import LiveForce
from rigtool.experiments.force_sensor.procedure_over_time import (
    analyse_over_time,
    model_and_reach,
    over_time,
)
from rigtool.experiments.learning.procedure import PROCEDURE as ILC_LEARN
from rigtool.recipe import load_recipe
from rigtool.runfile import RecordingSpec, RunWriter, open_run
from tests.experiments.learned_loads import KT, RIG, D, learned_loads
from tests.experiments.virtual_runs import RECIPE, run
from tests.unchanged import require_unchanged

PULSE = '[[virtual.contact]]\nkind = "pulse"\nat = [2.0, 5.0]\nduration = 1.5\nforce = 2.0\n'
MOMENT = 2.0 * 0.020


@pytest.fixture(scope="module")
def rig(tmp_path_factory):
    """Learn the rig; return a function that reads force over time."""
    folder = tmp_path_factory.mktemp("rig")
    tables, touched = learned_loads(tmp_path_factory, folder / "tables.h5"), folder / "touched.toml"
    touched.write_text(RECIPE.read_text(encoding="utf-8") + "\n" + PULSE, encoding="utf-8")

    def measured(seconds, *sets, observed=False, source=touched, name="force.h5", tables=tables):
        procedure = over_time(seconds, observed=observed)
        return run(procedure, source, folder / name, *RIG, *sets, kt=KT, tables=tables)

    measured.folder, measured.tables, measured.touched = folder, tables, touched
    return measured


@pytest.fixture(scope="module")
def strokes(rig):
    """Eight seconds of strokes with two contacts of 40 mN m."""
    return rig(8.0, "measure_force.speed_rev_per_s=0.5", name="strokes.h5")


def widened(u, notes):
    """Return u (n,), N m, with torques that notes add, and how exactly the notes state them."""
    stated = r"u is wider by ([\d.e-]+) mN m|a torque of ([\d.e-]+) mN m goes with the acceleration"
    added = [1e-3 * float(a or b) for a, b in re.findall(stated, " ".join(notes))]
    return np.sqrt(u**2 + sum(a**2 for a in added)), 1e-2 if added else 1e-12


def test_a_contact_that_nothing_knows_of_is_read(strokes):
    table = strokes.tables["force"]
    time = table["time"] - table["time"][0]
    within = (time > 2.3) & (time < 3.2)
    without = (time > 3.8) & (time < 4.7)
    assert np.nanmedian(table["torque"][within]) == pytest.approx(MOMENT, rel=0.1)
    assert abs(np.nanmedian(table["torque"][without])) < 2e-3
    np.testing.assert_allclose(table["force"] * 0.020, table["torque"], rtol=1e-9)
    assert strokes.results["peak_torque"].value == pytest.approx(MOMENT, rel=0.2)


def test_no_other_number_has_changed(strokes):
    require_unchanged("over-time", strokes)


def test_the_reference_judges_each_form(strokes):
    results = strokes.results
    assert results["rmse"].value < 3e-3
    assert 0.7 < results["coverage_95"].value <= 1.0
    assert 0.7 < results["causal_coverage_95"].value <= 1.0
    accuracy = strokes.tables["force_accuracy"]
    assert np.nansum(accuracy["share"]) == pytest.approx(1.0)


def test_a_stored_run_gives_the_same_again(rig, strokes, monkeypatch):
    """Inertia that nobody learned is sought in the rows of the table, by their set points."""
    sought, of = [], CommandedTurns.of
    monkeypatch.setattr(CommandedTurns, "of", lambda *rows: sought.append(rows) or of(*rows))
    again = run(
        MEASURE_FORCE, rig.folder / "strokes.h5", rig.folder / "again.h5", kt=KT, tables=rig.tables
    )
    for name in strokes.tables["force"].columns:
        np.testing.assert_array_equal(again.tables["force"][name], strokes.tables["force"][name])
    ((step_time, setpoint, known, torque, u),) = sought
    force = again.tables["force"]
    with open_run(rig.folder / "strokes.h5") as stored:
        moved = stored.recording("strokes_000")
        time, wanted = moved.read("time"), moved.read("position_setpoint")
    wanted = np.interp(force["time"], time, wanted)
    np.testing.assert_allclose(setpoint * 0.85, wanted, atol=2e-3 * np.ptp(wanted))
    np.testing.assert_allclose(np.diff(force["time"]), step_time, rtol=1e-6)
    np.testing.assert_array_equal(known, np.isfinite(force["torque"]))
    np.testing.assert_allclose(torque[known], force["torque"][known], rtol=1e-12)
    whole, exact = widened(u[known], again.notes)
    np.testing.assert_allclose(whole, force["u"][known], rtol=exact)


def test_there_is_no_value_while_the_current_is_at_its_limit(rig, strokes):
    with open_run(rig.folder / "strokes.h5") as stored:
        current = np.abs(stored.recording("strokes_000").read("current_setpoint"))
    limit = f"rig.current_limit={np.quantile(current, 0.9)}"
    found = rig(8.0, "measure_force.speed_rev_per_s=0.5", limit, name="limited.h5")
    assert 0.2 < found.results["valid_share"].value < 0.9
    assert any("current at its limit" in note for note in found.notes)


def test_recordings_of_learning_are_read_too(rig):
    found = run(MEASURE_FORCE, rig.tables, rig.folder / "learned.h5", kt=KT, tables=rig.tables)
    require_unchanged("over-time-learning", found)
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
    require_unchanged("observed", found)
    with open_run(rig.folder / "observed.h5") as stored:
        assert not stored.recording("observed_000").has("position_setpoint")


def test_a_hand_at_the_output_may_hold_whatever_friction_does(rig):
    hand = ("virtual.hand.moves=output", "virtual.hand.pause_share=0.6")
    found = rig(20.0, *hand, observed=True, source=RECIPE, name="hand.h5")
    require_unchanged("hand", found)
    table = found.tables["force"]
    rests = table["state"] == State.STILL
    error = np.abs(table["torque"] - table["reference"])
    assert rests.mean() > 0.2
    assert (error < 1.96 * table["u"])[rests].mean() > 0.95
    assert (error < 1.96 * table["u"])[table["state"] == State.REVERSED].mean() > 0.95


def test_motions_beyond_what_was_learned_are_refused_before_anything_moves(rig):
    fast = ("measure_force.motion.kind=sine", "measure_force.motion.frequency_hz=5")
    with pytest.raises(RecipeError, match=r"rad/s.*learned up to"):
        rig(4.0, *fast, name="fast.h5")
    assert not (rig.folder / "fast.h5").exists()
    with pytest.raises(UsageError, match="time_max = 60 s"):
        rig(61.0, "measure_force.motion.time_max=60", name="fast.h5")
    for seconds, setting in ((1.9, "kind=hold"), (9.0, "bandwidth_hz=0.05")):
        with pytest.raises(RecipeError, match="the filter needs"):
            rig(seconds, f"measure_force.motion.{setting}", name="fast.h5")
    with pytest.raises(RecipeError, match=r"each 12\.5 ms .* lower"):
        rig(9.0, "measure_force.motion.record_every=100", name="fast.h5")
    assert not list(rig.folder.glob("fast.h5*"))


def test_a_torque_beyond_the_learned_has_no_value(rig):
    heavy = rig.folder / "heavy.toml"
    heavy.write_text(rig.touched.read_text().replace("force = 2.0\n", "force = 5.0\n"))
    table = rig(5.0, source=heavy, name="heavy.h5").tables["force"]
    time = table["time"] - table["time"][0]
    within = (time > 2.4) & (time < 3.2)
    assert (table["state"][within] == State.OUTSIDE).all()
    assert np.isnan(table["torque"][within]).all()
    assert np.isfinite(table["torque"][(time > LIMIT_TIME + 0.02) & (time < 1.5)]).all()


def test_at_the_largest_torque_no_value_is_beyond_it(rig):
    edge = rig.folder / "edge.toml"
    edge.write_text(rig.touched.read_text().replace("force = 2.0\n", "force = 3.3\n"))
    torque = rig(5.0, source=edge, name="edge.h5").tables["force"]["torque"]
    assert 60e-3 < np.nanmax(np.abs(torque)) <= 1.1 * 60e-3


def test_tables_without_the_model_are_refused_with_the_remedy(rig, tmp_path):
    plain = tmp_path / "c.h5"
    run(ILC_LEARN, RECIPE, plain, *RIG, *D[1:4], kt=KT)
    with pytest.raises(RunFileError, match="ilc-learn --implementation D"):
        rig(4.0, tables=plain, name="c.h5")


def test_a_motor_warmer_than_calibrated_is_refused_with_the_remedy(rig):
    with pytest.raises(InsufficientDataError, match=r"to 70\.1 degC.*from 20 to 50.*calibrate"):
        rig(3.0, "virtual.thermal.ambient_degc=70", name="warm.h5")


def test_the_model_rests_on_the_recipe_that_it_was_learned_with(rig):
    """A longer tip changes nothing of what was learned; what it is in terms of must be the same."""
    with open_run(KT) as kt, open_run(rig.tables) as tables:
        (model, reach), (other, same) = (
            model_and_reach(tables, kt, load_recipe(RECIPE, [*RIG, *sets])[0])
            for sets in ([], ["rig.instrument.grasper_length=0.03"])
        )
        assert reach == same
        assert model.plant(1.0).inertia == other.plant(1.0).inertia
        for setting, message in (
            ("rig.instrument.torque_factor=1.0", r"learned with torque factor 1\.18"),
            ("rig.inertia.rotor=3e-5", r"learned with nominal inertia, kg m2, 1\.8.*has 3\.7"),
        ):
            recipe = load_recipe(RECIPE, [*RIG, setting])[0]
            with pytest.raises(RunFileError, match=message):
                model_and_reach(tables, kt, recipe)


def test_a_force_at_a_longer_tip_is_said_to_be_there(rig, strokes):
    longer = load_recipe(RECIPE, [*RIG, "rig.instrument.grasper_length=0.03"])[0]
    paths = rig.folder / "strokes.h5", rig.tables, KT
    with ExitStack() as stack:
        own, tables, kt = (stack.enter_context(open_run(path)) for path in paths)
        found = analyse_over_time([own], longer, kt=kt, tables=tables)
    assert any("that at 30 mm" in note and "hung at 20 mm" in note for note in found.notes)
    assert not any("from the axis" in note for note in strokes.notes)
    force, torque = (found.tables["force"].columns[n].values for n in ("force", "torque"))
    np.testing.assert_allclose(force * 0.03, torque)


def test_a_zero_of_the_current_that_moved_is_said_to_look_like_a_load(rig, strokes, tmp_path):
    """0.1 A of 45 mN m/A and 1.18 are 5.3 mN m."""
    source, _ = changed(
        rig, tmp_path, lambda own: {**own, "current_setpoint": own["current_setpoint"] - 0.1}
    )
    found = run(MEASURE_FORCE, source, tmp_path / "moved.h5", kt=KT, tables=rig.tables)
    (said,) = [note for note in found.notes if "zero has moved" in note]
    milliamperes = float(re.search(r"moved by (-?[\d.]+) mA", said).group(1))
    assert milliamperes == pytest.approx(100, abs=15)
    assert not any("zero has moved" in note for note in strokes.notes)


def test_a_hold_stands_still_and_says_so(rig):
    found = rig(5.0, "measure_force.motion.kind=hold", source=RECIPE, name="hold.h5")
    states = found.tables["force"]["state"]
    assert (states == State.STILL).mean() > 0.9
    assert not math.isnan(found.results["mean_torque"].value)


# -- as it comes


def signals_of(path):
    with open_run(path) as stored:
        recording = next(iter(stored.recordings.values()))
        return {name: recording.read_stored(name) for name in recording.units}


@pytest.fixture
def live(rig):
    """Return what makes rows of every fifth estimate, as the table has them."""
    recipe, _ = load_recipe(RECIPE)
    with open_run(KT) as kt, open_run(rig.tables) as tables:
        yield lambda every=5: LiveForce(recipe, kt=kt, tables=tables, every=every)


def rows_of(follow, signals, edges):
    blocks = [
        follow({name: values[first:last] for name, values in signals.items()})
        for first, last in pairwise([0, *edges, len(signals["time"])])
    ]
    return {name: np.concatenate([block[name] for block in blocks]) for name in blocks[0]}


@pytest.mark.parametrize("edges", [[], [1, 2, 9, 4000, 4001, 30000], list(range(97, 60000, 97))])
def test_rows_as_they_come_are_those_of_the_stored_run(rig, strokes, live, edges):
    found = rows_of(live(), signals_of(rig.folder / "strokes.h5"), edges)
    table = strokes.tables["force"]
    for name, column in (
        ("time", "time"),
        ("torque", "causal_torque"),
        ("state", "causal_state"),
    ):
        size = len(found[name])  # the last 8 ms may wait for more
        assert 0 <= len(table[column]) - size <= 2
        np.testing.assert_array_equal(found[name], table[column][:size])
    known = np.isfinite(table["causal_u"][:size])
    whole, exact = widened(found["u"][known], strokes.notes)
    np.testing.assert_allclose(table["causal_u"][:size][known], whole, rtol=exact)
    np.testing.assert_allclose(found["high"] - found["low"], 3.92 * found["u"], rtol=1e-9)


FIRST_BLOCK = """
import sys, numpy
from rigtool.experiments.force_filter import kalman
from rigtool.experiments.force_model import drive
from rigtool.experiments.force_sensor.power_up import power_up
from rigtool.experiments.force_sensor.procedure_live import LiveForce
from rigtool.recipe import load_recipe
from rigtool.runfile import open_run
recipe, _ = load_recipe(sys.argv[1])
with open_run(sys.argv[2]) as kt, open_run(sys.argv[3]) as tables:
    follow = LiveForce(recipe, kt=kt, tables=tables)
def known():
    loops = (drive._drive, kalman.run, power_up._follow)
    return set(sys.modules), [loop._dispatcher and loop._dispatcher.signatures for loop in loops]
before, time = known(), numpy.arange(2000) * 125e-6
rows = follow({"time": time, "temperature": 25 + 0 * time, "current_setpoint": 0 * time,
               "encoder": 100 + numpy.floor(4000 * time)})
print(len(rows["time"]), known() == before)
"""


def test_a_watchdog_does_not_wait_for_numba(rig):
    line = [sys.executable, "-c", FIRST_BLOCK, RECIPE, KT, rig.tables]
    found = subprocess.run([str(part) for part in line], capture_output=True, text=True, check=True)
    rows, same = found.stdout.split()
    assert (int(rows) > 200, same) == (True, "True")


def test_a_loop_of_1_khz_gives_force_as_it_comes(rig):
    slow = "rig.sample_time=0.001"
    stored = rig(5.0, "measure_force.speed_rev_per_s=0.5", slow, name="slow.h5")
    recipe, _ = load_recipe(RECIPE, [slow])
    with open_run(KT) as kt, open_run(rig.tables) as tables:
        follow = LiveForce(recipe, kt=kt, tables=tables, every=5)
        found = rows_of(follow, signals_of(rig.folder / "slow.h5"), range(13, 5000, 13))
    table, size = stored.tables["force"], len(found["time"])
    assert 0 <= len(table["time"]) - size <= 2
    assert np.isfinite(found["torque"]).mean() > 0.9
    for name in ("time", "torque", "state"):
        column = table[name if name == "time" else f"causal_{name}"]
        np.testing.assert_array_equal(found[name], column[:size])


def changed(rig, tmp_path, change, name="strokes.h5"):
    """Store the strokes with other signals; return path and signals."""
    with open_run(rig.folder / name) as stored:
        recording = next(iter(stored.recordings.values()))
        spec = RecordingSpec("strokes_000", recording.channels, {})
        signals = change(signals_of(rig.folder / name))
        path = tmp_path / "broken.h5"
        with RunWriter(
            path,
            command="measure-force",
            recipe=stored.recipe,
            recipe_text=None,
            recordings=[spec],
        ) as writer:
            writer.append("strokes_000", signals)
            writer.finish({}, {})
    return path, signals


def broken(signals):
    """Without samples 20000 to 24000, and with NaN from 44000 to 44400."""
    signals["current_setpoint"] = signals["current_setpoint"].copy()
    signals["current_setpoint"][44000:44400] = np.nan
    signals["reference_torque"][30000:30400] = np.nan
    return {n: np.concatenate([v[:20000], v[24000:]]) for n, v in signals.items()}


def dead(first, last):
    """An encoder that does not count, and a loop that drives against it."""

    def change(signals):
        signals = {name: values.copy() for name, values in signals.items()}
        signals["encoder"][first:last] = signals["encoder"][first]
        driven = signals["current_setpoint"][first:last]
        driven[:] = np.linspace(0, 8, len(driven))
        return signals

    return change


def test_a_dead_encoder_is_no_rest(rig, strokes, tmp_path):
    path, signals = changed(rig, tmp_path, dead(20000, 32000))
    found = run(MEASURE_FORCE, path, tmp_path / "again.h5", kt=KT, tables=rig.tables)
    table = found.tables["force"]
    time = table["time"] - signals["time"][0]
    assert np.isnan(table["torque"][(time > 2.52) & (time < 5.0)]).all()
    assert np.isnan(table["causal_torque"][(time > 2.52) & (time < 5.0)]).all()
    before, known = np.flatnonzero(time < 1.4), strokes.tables["force"]["state"]
    outside = table["state"] == State.OUTSIDE
    np.testing.assert_array_equal(outside[before], known[before] == State.OUTSIDE)
    assert any("does not count" in note and "mN m" in note for note in found.notes)


def test_an_encoder_that_never_counts_is_refused(rig, strokes, tmp_path):
    path, _ = changed(rig, tmp_path, dead(0, None))
    with pytest.raises(InsufficientDataError, match=r"does not count.*record again"):
        run(MEASURE_FORCE, path, tmp_path / "again.h5", kt=KT, tables=rig.tables)


def test_a_current_of_the_other_sign_is_refused(rig, strokes, tmp_path):
    path, _ = changed(
        rig, tmp_path, lambda own: {**own, "current_setpoint": -own["current_setpoint"]}
    )
    with pytest.raises(InsufficientDataError, match="opposite signs"):
        run(MEASURE_FORCE, path, tmp_path / "again.h5", kt=KT, tables=rig.tables)


def test_a_stream_puts_back_counts_that_leap(rig, strokes, live, tmp_path):
    _, signals = changed(rig, tmp_path, lambda own: own)
    parts = range(1000, len(signals["time"]), 1000)
    plain = rows_of(live(), signals, parts)
    moves = 20000 + int(np.argmax(np.abs(np.diff(signals["encoder"][20000:])) > 0)) + 4
    lost = {**signals, "encoder": signals["encoder"] + 300 * (np.arange(parts.stop) >= moves)}
    found = rows_of(live(), lost, parts)
    known = np.isfinite(plain["torque"]) & np.isfinite(found["torque"])
    assert known.mean() > 0.9
    assert (np.abs(found["torque"] - plain["torque"]) < plain["u"])[known].all()


def test_gaps_and_samples_without_value_begin_anew(rig, strokes, live, tmp_path):
    path, signals = changed(rig, tmp_path, broken)
    found = run(MEASURE_FORCE, path, tmp_path / "again.h5", kt=KT, tables=rig.tables)
    table, rate = found.tables["force"], 8000
    assert len(strokes.tables["force"]["time"]) > len(table["time"])
    time = table["time"] - signals["time"][0]
    lost = ((time > 20000 / rate) & (time < 24000 / rate)) | (
        (time > 44000 / rate) & (time < 44400 / rate)
    )
    assert not lost.any()
    without = 4400 / rate + 3 * LIMIT_TIME  # behind each of three begins
    assert found.results["valid_share"].value == pytest.approx(
        1 - without / (signals["time"][-1] - signals["time"][0]), abs=2e-3
    )
    unjudged = (time > 30000 / rate) & (time < 30400 / rate)
    assert unjudged.sum() > 5
    assert np.isfinite(table["torque"][unjudged]).all()
    assert np.isnan(table["reference"][unjudged]).all()
    assert found.results["coverage_95"].value > 0.9
    assert any("missing or NaN: 0.55" in note and "samples: 2" in note for note in found.notes)
    rows = rows_of(live(), signals, range(1000, len(signals["time"]), 1000))
    size = len(rows["time"])
    assert 0 <= len(table["time"]) - size <= 2
    np.testing.assert_array_equal(rows["torque"], table["causal_torque"][:size])
    np.testing.assert_array_equal(rows["time"], table["time"][:size])


def test_the_ripple_that_a_stretch_too_short_shows_counts_behind_it(rig, strokes, live, tmp_path):
    def twice(signals):
        kept = [slice(18000), slice(18080, 30000), slice(30080, None)]
        return {n: np.concatenate([v[part] for part in kept]) for n, v in signals.items()}

    path, signals = changed(rig, tmp_path, twice)
    found = run(MEASURE_FORCE, path, tmp_path / "again.h5", kt=KT, tables=rig.tables)
    table, rows = found.tables["force"], rows_of(live(), signals, [])
    there = np.isin(rows["time"], table["time"])
    assert 0 <= len(table["time"]) - there.sum() <= 2
    assert 250 < (~there).sum() < 300  # of the stretch that the table does not have
    np.testing.assert_array_equal(rows["torque"][there], table["causal_torque"][: there.sum()])


def test_a_stream_begins_anew_where_counts_leap_after_a_rest(rig, strokes, live):
    signals = signals_of(rig.folder / "strokes.h5")
    signals["encoder"][20000:20400] = signals["encoder"][20000]
    signals["encoder"][20400:] += 300
    leap = signals["time"][20400]
    whole = rows_of(live(), signals, [])
    behind = (whole["time"] > leap) & (whole["time"] < leap + LIMIT_TIME)
    assert behind.sum() >= 19
    assert np.isnan(whole["torque"][behind]).all()
    for edges in ([20400], [20399, 20401], range(7, 64000, 517)):
        rows = rows_of(live(), signals, edges)
        np.testing.assert_array_equal(rows["torque"], whole["torque"][: len(rows["torque"])])


def test_a_clock_that_is_off_loses_no_sample(rig, strokes, tmp_path):
    def drifting(signals):
        time = signals["time"]
        return {**signals, "time": time + 1e-3 * np.maximum(time - time[8192], 0.0)}

    path, signals = changed(rig, tmp_path, drifting)
    found = run(MEASURE_FORCE, path, tmp_path / "again.h5", kt=KT, tables=rig.tables)
    begin = LIMIT_TIME / np.ptp(signals["time"])
    assert found.results["valid_share"].value == pytest.approx(1 - begin, abs=2e-3)
    assert not any("missing" in note for note in found.notes)


def test_what_is_too_short_for_a_row_between_gaps_begins_no_filter(
    rig, strokes, tmp_path, monkeypatch
):
    def riddled(signals):
        signals["current_setpoint"] = signals["current_setpoint"].copy()
        for first in range(9):  # longer than a current holds
            signals["current_setpoint"][first::80] = np.nan
        return signals

    begun = []

    class Counted(procedure_reading.Stretch):
        def __init__(self, *args, **options):
            begun.append(args)
            super().__init__(*args, **options)

    monkeypatch.setattr(procedure_reading, "Stretch", Counted)
    path, signals = changed(rig, tmp_path, riddled)
    with pytest.raises(InsufficientDataError, match=r"NaN, or .* is in current_setpoint"):
        run(MEASURE_FORCE, path, tmp_path / "again.h5", kt=KT, tables=rig.tables)
    assert len(begun) <= 1 + len(signals["time"]) // procedure_reading.BLOCK  # at ends of blocks


def test_contacts_are_listed_with_their_times(strokes):
    events = strokes.tables["events"]
    first = strokes.tables["force"]["time"][0]
    begins = events["start"] - first
    for at in (2.0, 5.0):
        near = np.flatnonzero(np.abs(begins - at) < 0.15)
        assert len(near) == 1
        (event,) = near
        assert at < events["found"][event] - first < at + 0.1
        assert abs(events["mean"][event] - MOMENT) < 0.1 * MOMENT
        assert events["end"][event] - events["start"][event] == pytest.approx(1.45, abs=0.1)
    assert strokes.results["contacts"].value == len(begins)


@pytest.mark.parametrize("change", ["measure_force.motion.record_every=2", "rig.sample_time=0.002"])
def test_samples_that_are_too_coarse_give_no_force_as_it_comes(rig, change):
    recipe, _ = load_recipe(RECIPE, [change])
    with (
        open_run(KT) as kt,
        open_run(rig.tables) as tables,
        pytest.raises(RecipeError, match="a loop above 667 Hz"),
    ):
        LiveForce(recipe, kt=kt, tables=tables)


@pytest.mark.parametrize("counts", [0, 300])
def test_an_encoder_that_was_zeroed_elsewhere_is_found_and_corrected(rig, tmp_path, counts):
    own = rig(8.0, "measure_force.speed_rev_per_s=0.5", source=RECIPE, name="alone.h5")
    source, _ = changed(
        rig, tmp_path, lambda own: {**own, "encoder": own["encoder"] + counts}, "alone.h5"
    )
    found = run(MEASURE_FORCE, source, tmp_path / "moved.h5", kt=KT, tables=rig.tables)
    said = [note for note in found.notes if "the encoder shows" in note]
    assert bool(said) == bool(counts)
    if said:
        degrees = float(re.search(r"shows (-?[\d.]+)\(", said[0]).group(1))
        assert degrees == pytest.approx(counts * 360 / 4000, abs=6)
    own, table = own.tables["force"], found.tables["force"]
    there = np.isfinite(own["torque"]) & np.isfinite(table["torque"])
    assert there.mean() > 0.9
    assert np.sqrt(np.mean((table["torque"] - own["torque"])[there] ** 2)) < 0.35e-3


def test_a_zero_that_other_friction_explains_as_well_is_in_doubt(rig, strokes, tmp_path):
    """Something touches in a third of these few passes."""
    source, _ = changed(rig, tmp_path, lambda own: {**own, "encoder": own["encoder"] + 300})
    found = run(MEASURE_FORCE, source, tmp_path / "moved.h5", kt=KT, tables=rig.tables)
    assert [note for note in found.notes if "friction along the angle is not what" in note]
    own, table = strokes.tables["force"], found.tables["force"]
    there = np.isfinite(own["u"]) & np.isfinite(table["u"])
    assert np.median((table["u"] / own["u"])[there]) > 2


def test_tables_of_another_instrument_are_refused(rig):
    other = ("measure_force.speed_rev_per_s=0.5", "virtual.instrument.tip_friction=6e-3")
    with pytest.raises(
        InsufficientDataError, match=r"another instrument or mounting.* learn again"
    ):
        rig(8.0, *other, name="other.h5")
