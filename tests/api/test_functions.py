"""`import rigtool` offers what the commands do."""

import ast
import functools
import html
import json
import math
import subprocess
import sys
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

import rigtool
from rigtool.errors import RunFileError, UsageError

FIXTURES = Path(__file__).parents[1] / "fixtures"
REFERENCES = json.loads((FIXTURES / "references.json").read_text())
RECIPE = Path(__file__).parents[2] / "recipes" / "briaire-2006.toml"

CALLS = {
    "kt": (rigtool.calibrate_kt, ()),
    "friction": (rigtool.stribeck, ("kt",)),
    "ripple": (rigtool.fft_ripple, ("kt",)),
    "plant": (rigtool.identify_plant, ("kt",)),
    "tables": (rigtool.ilc_learn, ("kt",)),
    "force": (rigtool.measure_force, ("kt", "tables")),
}


def path_of(name):
    return FIXTURES / f"{name}.h5"


@pytest.fixture
def kt():
    with rigtool.open(path_of("kt")) as run:
        yield run


@pytest.fixture
def staircase(kt):
    return kt.recordings["staircase"].to_pandas()


def call(name, *sources, **options):
    function, inputs = CALLS[name]
    return function(*sources, **{key: path_of(key) for key in inputs}, **options)


def test_import_costs_no_numerics():
    code = (
        "import sys, rigtool\n"
        "assert set(rigtool.__all__) <= set(dir(rigtool))\n"
        "print(sorted({'numpy', 'h5py', 'pandas', 'click', 'rigtool.api'} & set(sys.modules)))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


def test_every_name_is_there_and_type_checkers_see_it():
    tree = ast.parse(Path(rigtool.__file__).read_text())
    (seen,) = (node for node in tree.body if isinstance(node, ast.If))
    (imported,) = seen.body
    assert {name.name for name in imported.names} == set(rigtool.__all__) - {"__version__"}
    for name in rigtool.__all__:
        assert getattr(rigtool, name)
    with pytest.raises(AttributeError, match="no_such"):
        rigtool.no_such  # noqa: B018
    assert (Path(rigtool.__file__).parent / "py.typed").exists()


@functools.cache
def expected_of(name):
    return call(name, path_of(name))


@pytest.mark.parametrize("name", CALLS)
def test_a_run_gives_what_its_command_finds(name):
    found = expected_of(name).results
    assert set(found) == set(REFERENCES[name])
    for result, reference in REFERENCES[name].items():
        slack = 0.01 * (reference["u"] or 0.0)  # rounding of another processor
        value = found[result].value
        assert math.isclose(value, reference["value"], rel_tol=1e-6, abs_tol=slack), result
        assert found[result].unit == reference["unit"]


@pytest.mark.parametrize("name", CALLS)
def test_arrays_give_what_their_run_gives(name, tmp_path):
    """Signals out of a stored run, and into the same analysis by the recipe of that run."""
    with rigtool.open(path_of(name)) as run:
        arrays = {key: item.to_pandas() for key, item in run.recordings.items()}
        found = call(name, arrays, recipe=run.recipe, output=tmp_path / "found.h5")
    expected = expected_of(name)
    assert found.results == expected.results
    assert found.notes == (
        "the signals were given as arrays, not recorded by rigtool",
        *expected.notes,
    )
    for key, table in expected.tables.items():
        for column in table.columns:
            np.testing.assert_array_equal(found.tables[key][column], table[column])
    with rigtool.open(tmp_path / "found.h5") as stored:
        assert dict(stored.results) == dict(found.results)
        # What was given is what is stored: an analysis of it is that of the arrays.
        assert stored.recordings.keys() == arrays.keys()
        for key, recording in stored.recordings.items():
            whole = recording.to_pandas()
            pd.testing.assert_frame_equal(whole, arrays[key], check_dtype=False, check_exact=True)


def test_a_recipe_is_measured_by(tmp_path):
    short = ["calibrate_kt.temperatures_degc=[20, 40]", "calibrate_kt.rotor_positions=3"]
    options = {"settings": [*short, "calibrate_kt.staircases=1"], "seed": 3}
    with pytest.raises(UsageError, match="output is missing"):
        rigtool.calibrate_kt(RECIPE, **options)
    found = rigtool.calibrate_kt(RECIPE, output=tmp_path / "kt.h5", **options)
    with rigtool.open(tmp_path / "kt.h5") as run:
        assert dict(run.results) == dict(found.results)
        assert run.provenance["seed"] == "3"
    with pytest.raises(UsageError, match="exists already"):
        rigtool.calibrate_kt(RECIPE, output=tmp_path / "kt.h5", **options)


def test_implementations_are_chosen_by_letter():
    found = rigtool.ilc_learn(path_of("turning"), kt=path_of("kt"), implementation="B")
    assert found.results["lookup_period"].value == pytest.approx(2 * math.pi, rel=1e-9)
    with pytest.raises(UsageError, match="implementation E: there are A, B, C, D, standard"):
        rigtool.ilc_learn(path_of("turning"), kt=path_of("kt"), implementation="E")


def test_an_outcome_shows_results_and_notes_escaped(kt):
    page = rigtool.calibrate_kt(kt)._repr_html_()
    shown = html.unescape(page)
    assert "torque_constant_mean " in shown
    assert "Note: standard uncertainty of torque_constant_mean" in shown
    quantity = rigtool.Quantity(1.0, "<b>", 0.1)
    assert "<b>" not in rigtool.Outcome({"x": quantity}, notes=("a < b",))._repr_html_()


def test_sources_that_do_not_go_together(kt, staircase):
    arrays = {"staircase": staircase}
    with pytest.raises(UsageError, match="0 sources"):
        rigtool.calibrate_kt()
    with pytest.raises(UsageError, match="arrays need the recipe"):
        rigtool.calibrate_kt(arrays)
    with pytest.raises(UsageError, match="run files hold their own"):
        rigtool.calibrate_kt(kt, recipe=RECIPE)
    with pytest.raises(UsageError, match="2 sources, 1 of them arrays"):
        rigtool.calibrate_kt(kt, arrays, recipe=RECIPE)
    with pytest.raises(UsageError, match="a source is a DataFrame"):
        rigtool.calibrate_kt(staircase, recipe=RECIPE)
    with pytest.raises(UsageError, match="kt is missing"):
        rigtool.stribeck({"holds": staircase}, recipe=RECIPE)
    with pytest.raises(TypeError, match="unexpected keyword argument 'ouput'"):
        rigtool.calibrate_kt(kt, ouput="kt.h5")


def masked(frame):
    return np.ma.array(frame.force, mask=np.arange(len(frame)) == 7)


def stating(frame, units):
    frame.attrs["units"] = units
    return frame


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (
            lambda frame: {"stairs": frame},
            "stairs is given, recordings of this recipe are staircase",
        ),
        (lambda frame: {}, "nothing is given"),
        (lambda frame: dict(frame), "time.* is given, recordings of this recipe are staircase"),
        (lambda frame: {"staircase": frame.assign(weight=1.0)}, "no signal 'weight'; .* force .N."),
        (lambda frame: {"staircase": frame.drop(columns="time")}, "needs time"),
        (lambda frame: {"staircase": frame[["time"]]}, "needs time and a measured signal"),
        (lambda frame: {"staircase": frame[::-1]}, "time must rise"),
        (lambda frame: {"staircase": frame[:1]}, "2 or more samples"),
        (lambda frame: {"staircase": frame[::2]}, r"are 0.04 s apart, by the recipe 0\.02 s"),
        (lambda frame: {"staircase": frame.assign(force="heavy")}, "force: is no array of numbers"),
        (
            lambda frame: {"staircase": {**frame, "force": frame.force[1:]}},
            "differ in their number of samples",
        ),
        (
            lambda frame: {"staircase": {**frame, "force": frame[["force"]]}},
            r"has shape \(31200, 1\)",
        ),
        (
            lambda frame: {"staircase": {**frame, "force": masked(frame)}},
            "force: 1 samples are masked",
        ),
        (lambda frame: {"staircase": {**frame, "force": frame.force + 1j}}, "type is complex"),
        (
            lambda frame: {"staircase": frame.assign(time=pd.to_timedelta(frame.time, "s"))},
            "type is timedelta64",
        ),
        (lambda frame: {"staircase": frame.to_records(index=False)}, "is a recarray: give a"),
        (lambda frame: {"staircase": None}, "is a NoneType: give a DataFrame"),
        (lambda frame: {1: frame}, "1 is given, recordings of this recipe are staircase"),
        (lambda frame: {"staircase": stating(frame, "mN")}, r"attrs\['units'\] is 'mN'"),
    ],
)
def test_arrays_that_are_no_recording_are_refused(staircase, change, message):
    with pytest.raises(UsageError, match=message):
        rigtool.calibrate_kt(
            change(staircase), recipe=RECIPE, settings=["calibrate_kt.record_every=160"]
        )


def test_units_that_a_frame_states_are_compared(staircase):
    staircase.attrs["units"] = staircase.attrs["units"] | {"force": "mN"}
    with pytest.raises(UsageError, match="force is in mN, but must be in N"):
        rigtool.calibrate_kt({"staircase": staircase}, recipe=RECIPE)


def test_arrays_are_not_drawn_and_outputs_have_names(staircase):
    with pytest.raises(UsageError, match="nothing is drawn"):
        rigtool.calibrate_kt({"staircase": staircase}, recipe=RECIPE, seed=3)
    with pytest.raises(UsageError, match="holds a NUL"):
        rigtool.calibrate_kt(path_of("kt"), output="a\0b")


@pytest.mark.parametrize("value", [math.nan, -math.inf, 2e30])
def test_arrays_that_fail_leave_nothing_behind(kt, staircase, tmp_path, value):
    staircase.loc[5, "force"] = value
    output = tmp_path / "kt.h5"
    with pytest.raises(RunFileError, match=r"'force'.*NaN") as caught:
        rigtool.calibrate_kt({"staircase": staircase}, recipe=kt.recipe, output=output)
    assert "the first at sample 5" in str(caught.value)
    assert not getattr(caught.value, "__notes__", [])
    assert list(tmp_path.iterdir()) == []


def test_a_shorter_series_is_analysed_as_given(kt, staircase):
    cold = staircase[staircase.temperature < 30]
    assert isinstance(cold, pd.DataFrame)
    found = rigtool.calibrate_kt({"staircase": cold}, recipe=kt.recipe).results
    whole = kt.results["torque_constant_mean"]
    assert "torque_constant_temperature_coefficient" not in found
    # 20 degC alone, against the mean over the reference range: more by the known slope only.
    at_20 = kt.results["torque_constant"]
    assert abs(found["torque_constant_mean"].value - at_20.value) < 3 * (at_20.u + whole.u)
