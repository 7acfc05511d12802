"""Implementation D on imported runs: a synthetic instrument, bad input, and real instruments."""

import io
import json
import math
from contextlib import redirect_stderr, redirect_stdout
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from rigtool.cli import main
from rigtool.experiments.force_filter.motion_states import State
from rigtool.experiments.imported_load.imported_signals import at_limit
from rigtool.experiments.imported_load.stored import load_model_from
from rigtool.recipe.mapping import parse_mapping
from rigtool.runfile import open_run
from rigtool.runfile.importers import import_files
from tests.experiments.imported_load.loaded_drive import record
from tests.unchanged import require_unchanged

ROOT = Path(__file__).parents[3]
DATA = ROOT.parent / "shared" / "data" / "mis-tool" / "Tool_4_Maryland_L_4"

MAPPING = """mapping = 1
[rig]
name = "loaded drive"
encoder_counts = 4000
[signals]
time = { column = "t", unit = "s" }
encoder = { column = "q", unit = "count" }
current = { column = "i", unit = "A" }
"""
SENSOR = 'reference_torque = { column = "r", unit = "N m" }\n'


class Ran(NamedTuple):
    exit_code: int
    stdout: str
    stderr: str


def rigtool(*arguments):
    stdout, stderr = io.StringIO(), io.StringIO()
    with redirect_stdout(stdout), redirect_stderr(stderr), pytest.raises(SystemExit) as end:
        main([str(argument) for argument in arguments])
    return Ran(int(end.value.code or 0), stdout.getvalue(), stderr.getvalue())


def instrument(folder, loads, mapping=MAPPING + SENSOR, limit=math.inf, **more):
    """Import recordings of a synthetic drive at some loads and two speeds; return the paths.

    Its amplifier gives `limit` A at most."""
    (folder / "raw").mkdir(parents=True)
    for level, load in enumerate(loads):
        for speed, frequency in enumerate((0.15, 0.3)):
            time, position, effort, torque = record(
                load, frequency, seed=10 * level + speed, **more
            )
            counts = np.round(position * 4000 / (2 * np.pi))
            effort = np.clip(effort, -limit, limit)
            np.savez(folder / "raw" / f"{speed}{level}.npz", t=time, q=counts, i=effort, r=torque)
    import_files([str(folder / "raw")], str(folder / "runs"), (parse_mapping(mapping), mapping))
    return sorted((folder / "runs").glob("*.h5"))


@pytest.fixture(scope="module")
def learned(tmp_path_factory):
    folder = tmp_path_factory.mktemp("learned")
    runs = instrument(folder, (0.02, 0.04, 0.06))
    found = rigtool("ilc-learn", *runs, "--implementation", "D", "-o", folder / "tables.h5", "-q")
    assert found.exit_code == 0, found.stderr
    return folder / "tables.h5"


@pytest.fixture(scope="module")
def measured(learned, tmp_path_factory):
    folder = tmp_path_factory.mktemp("measured")
    runs = instrument(folder, (0.03, 0.05), seconds=20.0)
    output = folder / "force.h5"
    found = rigtool("measure-force", *runs, "--tables", learned, "-o", output, "--json", "-q")
    assert found.exit_code == 0, found.stderr
    return output, json.loads(found.stdout)


def test_no_other_number_has_changed(learned, measured):
    with open_run(str(learned)) as model, open_run(str(measured[0])) as read:
        require_unchanged("imported-load-model", model)
        require_unchanged("imported-load", read)


def test_loads_that_were_not_learned_are_measured(measured):
    results, tables = measured[1]["results"], measured[1]["tables"]
    assert results["rmse_closing"]["value"] < 1.5e-3
    assert results["rmse_closing"]["unit"] == "N m"
    assert set(results) >= {"rmse_opening", "rmse_moving", "coverage_95"}
    assert "loads" in tables


def test_the_table_of_force_over_time(measured):
    with open_run(str(measured[0])) as run:
        force, accuracy = run.table("force"), run.table("force_accuracy")
        assert set(force.columns) >= {"time", "torque", "u", "low", "high", "state", "reference"}
        assert "force" not in force.columns  # no arm is known
        moving = np.isin(force["state"], (State.AGAINST, State.WITH))
        half, u = (force["high"] - force["low"]) / 2, force["u"]
        np.testing.assert_allclose(half[moving], 1.96 * u[moving], rtol=1e-9)
        hidden = np.isin(force["state"], (State.REVERSED, State.STILL))  # dead bands
        np.testing.assert_allclose(half[hidden], np.sqrt(3) * u[hidden], rtol=1e-9)
        error = force["torque"] - force["reference"]
        known = np.isfinite(error)
        covered = np.mean(np.abs(error) <= half, where=known)
        assert run.result("coverage_95").value == pytest.approx(covered)
        rmse = np.sqrt(np.mean(error[moving] ** 2))
        assert run.result("rmse_moving").value == pytest.approx(rmse)
        assert (force["speed"][force["state"] == State.AGAINST] > 0).all()
        assert accuracy["coverage_95"].shape == (4, 4)
        assert run.result("valid_share").value > 0.8
        for name in ("peak_torque", "mean_torque", "rmse"):
            assert run.result(name).unit == "N m"


def test_a_table_8_of_its_own(measured):
    with open_run(str(measured[0])) as run:
        levels = run.table("loads")
        assert levels["applied_torque"] == pytest.approx([0.03, 0.05], rel=0.05)
        assert np.abs(levels["error_percent"]).max() < 5
        assert (levels["cycles"] >= 4).all()
        error = levels["mean_torque"] - levels["applied_torque"]
        assert levels["error_torque"] == pytest.approx(error, rel=1e-9)
        assert (levels["std_torque"] >= 0).all()


def test_the_sensor_is_for_judging_only(learned, measured, tmp_path):
    runs = instrument(tmp_path, (0.03, 0.05), mapping=MAPPING, seconds=20.0)
    found = rigtool("measure-force", *runs, "--tables", learned, "-o", tmp_path / "f.h5", "--json")
    assert found.exit_code == 0, found.stderr
    assert "rmse_closing" not in json.loads(found.stdout)["results"]
    with open_run(str(tmp_path / "f.h5")) as without, open_run(str(measured[0])) as judged:
        np.testing.assert_array_equal(
            without.table("force")["torque"], judged.table("force")["torque"]
        )
        assert any("not judged" in note for note in without.notes)


def test_one_file_may_hold_all_loads(learned, measured, tmp_path):
    mapping = MAPPING + SENSOR + '[[conditions]]\nname = "number"\ncolumn = "n"\n'
    parts = []
    for path in sorted(measured[0].parent.glob("raw/*.npz")):
        own = np.load(path)
        shift = {"t": own["t"] + 30 * len(parts), "n": np.full(len(own["t"]), len(parts))}
        parts.append({**own, **shift})
    whole = {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}
    np.savez(tmp_path / "all.npz", **whole)
    run = tmp_path / "run.h5"
    import_files([str(tmp_path / "all.npz")], str(run), (parse_mapping(mapping), mapping))
    found = rigtool("measure-force", run, "--tables", learned, "-o", tmp_path / "f.h5", "-q")
    assert found.exit_code == 0, found.stderr
    with open_run(str(tmp_path / "f.h5")) as one, open_run(str(measured[0])) as many:
        for number in range(4):  # rounded times move the ends by a row
            here, there = (
                np.nanmean(run.table("force")["torque"][run.table("force")["recording"] == number])
                for run in (one, many)
            )
            assert here == pytest.approx(there, rel=1e-3)


def test_a_model_comes_back_from_its_file(learned, tmp_path):
    with open_run(str(learned)) as run:
        model, unit = load_model_from(run)
        assert unit == "A"
        assert model.bandwidth_hz == 5.0
        assert model.region.highest.shape == (2, 20)
        assert model.loop.recordings == 6
        assert np.isfinite(model.loop.mean).any()
        for side in model.sides:
            assert side.levels.shape == side.factors.shape == (5,)  # both ends twice
            assert side.covariance.shape == (len(side.weights), len(side.weights))


def test_the_report_shows_it(measured, tmp_path):
    found = rigtool("report", measured[0], "-o", tmp_path / "report")
    assert found.exit_code == 0, found.stderr
    assert "Measured against applied torque" in found.stdout
    assert "Error against the sensor" in found.stdout
    assert "Force " not in found.stdout  # nothing hangs there
    # The loads, hysteresis and errors by load, and what force over time shows of any run
    assert len(list((tmp_path / "report" / "figures").glob("*.svg"))) == 6


def test_learning_needs_a_sensor(tmp_path):
    runs = instrument(tmp_path, (0.02, 0.04), mapping=MAPPING)
    found = rigtool("ilc-learn", *runs, "--implementation", "D", "-o", tmp_path / "t.h5")
    assert found.exit_code == 3
    assert "reference_torque" in found.stderr
    assert not (tmp_path / "t.h5").exists()


def test_a_recording_unlike_all_others_is_named(tmp_path):
    runs = instrument(tmp_path / "a", (0.02, 0.04, 0.06))
    odd = instrument(tmp_path / "b", (0.05,), drift=0.5)[:1]
    found = rigtool("ilc-learn", *runs, *odd, "--implementation", "D", "-o", tmp_path / "t.h5")
    assert found.exit_code == 4
    assert f"{odd[0]}: is off" in found.stderr
    assert "or learn without it" in found.stderr
    assert not (tmp_path / "t.h5").exists()


def test_learning_needs_two_loads(tmp_path):
    runs = instrument(tmp_path, (0.04,))
    found = rigtool("ilc-learn", *runs, "--implementation", "D", "-o", tmp_path / "t.h5")
    assert found.exit_code == 4
    assert "at one load" in found.stderr


@pytest.mark.parametrize(
    ("setting", "message"),
    [
        ("measure_force.lowpass_hz=fast", "must be a number above 0"),
        ("measure_force.lowpass_hz=-1", "must be a number above 0"),
        ("measure_force.cycles=3", "imported runs have no recipe"),
    ],
)
def test_only_the_bandwidth_can_be_set(tmp_path, setting, message):
    run = instrument(tmp_path, (0.04,))[0]
    options = ("--implementation", "D", "--set", setting, "-o", tmp_path / "t.h5")
    found = rigtool("ilc-learn", run, *options)
    assert found.exit_code == 2
    assert message in found.stderr


def test_tables_of_another_rig_are_refused(learned, tmp_path):
    mapping = MAPPING.replace("loaded drive", "another drive") + SENSOR
    runs = instrument(tmp_path, (0.03,), mapping=mapping)
    found = rigtool("measure-force", *runs, "--tables", learned, "-o", tmp_path / "f.h5")
    assert found.exit_code == 2
    assert "another drive" in found.stderr


@pytest.mark.parametrize(
    ("other", "message"),
    [
        ({"drift": 0.03}, "strokes to and fro disagree"),  # A of friction
        ({"zero": 15.0}, "beyond the stroke"),  # rad
    ],
)
def test_tables_of_another_mounting_are_refused(learned, tmp_path, other, message):
    runs = instrument(tmp_path, (0.03, 0.05), **other)  # of a rig of the same name
    found = rigtool("measure-force", *runs, "--tables", learned, "-o", tmp_path / "f.h5")
    assert found.exit_code == 4
    assert message in found.stderr
    assert "another instrument or mounting" in found.stderr
    assert not (tmp_path / "f.h5").exists()


def test_two_loads_learn_another_mounting_with_a_prior(learned, tmp_path):
    new, tables = tmp_path / "new", tmp_path / "t.h5"
    runs = instrument(new, (0.02, 0.06), drift=0.03)
    options = ("--implementation", "D", "--prior", learned, "-o", tables, "-q")
    found = rigtool("ilc-learn", *runs, *options)
    assert found.exit_code == 0, found.stderr
    between = instrument(tmp_path / "between", (0.04,), drift=0.03, seconds=20.0)
    found = rigtool(
        "measure-force", *between, "--tables", tables, "-o", tmp_path / "f.h5", "--json"
    )
    assert found.exit_code == 0, found.stderr
    results = json.loads(found.stdout)["results"]
    assert results["rmse_moving"]["value"] < 2e-3
    assert results["valid_share"]["value"] > 0.5


def test_a_prior_is_for_imported_runs(learned, tmp_path):
    recipe = ROOT / "recipes" / "briaire-2006.toml"
    found = rigtool("ilc-learn", recipe, "--prior", learned, "-o", tmp_path / "t.h5")
    assert found.exit_code == 2
    assert "imported runs" in found.stderr
    found = rigtool(
        "ilc-learn", recipe, "--prior", learned, "--check", learned, "-o", tmp_path / "t"
    )
    assert found.exit_code == 2


def test_a_prior_of_another_bandwidth_is_refused(learned, tmp_path):
    runs = instrument(tmp_path, (0.02, 0.06))
    setting = ("--set", "measure_force.lowpass_hz=4")
    options = ("--implementation", "D", "--prior", learned, *setting, "-o", tmp_path / "t.h5")
    found = rigtool("ilc-learn", *runs, *options)
    assert found.exit_code == 2
    assert "lowpass_hz" in found.stderr


def test_loads_outside_what_was_learned_have_no_value(learned, tmp_path):
    runs = instrument(tmp_path, (0.05, 0.5))
    found = rigtool("measure-force", *runs, "--tables", learned, "-o", tmp_path / "f.h5", "--json")
    assert found.exit_code == 0, found.stderr
    share = json.loads(found.stdout)["results"]["valid_share"]["value"]
    with open_run(str(tmp_path / "f.h5")) as run:
        force = run.table("force")
        closing = (force["speed"] > 1) & (np.abs(force["reference"]) > 0.3)
        assert closing.sum() > 100
        assert np.isnan(force["torque"][closing]).all()
        assert (force["state"][closing] == State.OUTSIDE).all()
        assert share == pytest.approx(np.mean(np.isfinite(force["torque"])))


def test_a_current_at_its_limit_has_no_value(learned, tmp_path):
    runs = instrument(tmp_path, (0.05,), limit=0.115)
    found = rigtool("measure-force", *runs, "--tables", learned, "-o", tmp_path / "f.h5", "--json")
    assert found.exit_code == 0, found.stderr
    assert "at its limit" in found.stdout
    results = json.loads(found.stdout)["results"]
    assert 0.2 < results["valid_share"]["value"] < 0.9
    assert results["coverage_95"]["value"] > 0.9


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 1000), st.floats(-1.0, 2.0), st.floats(0.0, 1.0))
def test_where_an_effort_is_cut_off_is_found(seed, high, noise):
    random = np.random.default_rng(seed)
    effort = np.sin(np.arange(2000) / 100) + random.normal(0, 1e-3 + 0.1 * noise, 2000)
    cut = np.minimum(effort, high * 0.8)
    most = np.diff(np.flatnonzero(np.diff(cut, prepend=np.nan, append=np.nan) != 0)).max()
    expected = effort >= high * 0.8 if most >= 10 else np.zeros(2000, dtype=bool)
    np.testing.assert_array_equal(at_limit(cut), expected)
    assert not at_limit(np.round(effort, 1)).any()
    assert not at_limit(np.full(50, 0.3)).any()


def test_where_everything_is_outside_nothing_is_written(learned, tmp_path):
    runs = instrument(tmp_path, (0.8,))
    found = rigtool("measure-force", *runs, "--tables", learned, "-o", tmp_path / "f.h5")
    assert found.exit_code == 4
    assert "outside" in found.stderr
    assert not (tmp_path / "f.h5").exists()


def test_runs_that_were_learned_from_are_reported(learned, tmp_path):
    runs = instrument(tmp_path, (0.02, 0.04, 0.06))
    found = rigtool("measure-force", *runs, "--tables", learned, "-o", tmp_path / "f.h5")
    assert found.exit_code == 0, found.stderr
    assert "also" in found.stderr or "learned from" in found.stderr


# -- real instruments


@pytest.fixture(scope="module")
def real(tmp_path_factory):
    if not DATA.is_dir():
        pytest.skip(f"{DATA} is not there: measured data are not part of the project")
    folder = tmp_path_factory.mktemp("real")
    text = (ROOT / "recipes" / "import" / "mis-tool.toml").read_text()
    # Two frequencies and eight loads, to be quick: 16 of the 50 runs
    files = [str(path) for path in sorted(DATA.glob("[02][0-7].TXT.gz"))]
    import_files(files, str(folder / "runs"), (parse_mapping(text), text))
    runs = sorted((folder / "runs").glob("*.h5"))
    even = [path for path in runs if int(path.stem[1]) % 2 == 0]
    odd = [path for path in runs if int(path.stem[1]) % 2]
    tables, force = folder / "tables.h5", folder / "force.h5"
    found = rigtool("ilc-learn", *even, "--implementation", "D", "-o", tables, "-q")
    assert found.exit_code == 0, found.stderr
    found = rigtool("measure-force", *odd, "--tables", tables, "-o", force, "--json", "-q")
    assert found.exit_code == 0, found.stderr
    return force, json.loads(found.stdout)["results"]


def test_a_real_instrument_is_measured_at_loads_that_were_not_learned(real):
    results = real[1]
    assert results["rmse_closing"]["value"] < 3.6e-3  # what plain least squares reached
    assert results["rmse_opening"]["value"] < 7e-3
    assert 0.90 <= results["coverage_95"]["value"] <= 0.99


def test_a_real_instruments_table_8(real):
    with open_run(str(real[0])) as run:
        levels = run.table("loads")
        loads = levels["applied_torque"] > 25e-3
        assert loads.sum() == 4
        assert np.abs(levels["error_percent"][loads]).max() < 8  # of two runs a load only
        assert any("homing" in note for note in run.notes)
