"""What is written is read back, whatever it is."""

import itertools
import time
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from rigtool.quantity import Component, Quantity
from rigtool.runfile import Channel, Column, RecordingSpec, RunWriter, Table, open_run
from tests.runfile.whole_run import NOTES, RESULTS, SIZE, SPECS, TABLES, samples, write

names = st.from_regex(r"[A-Za-z_][A-Za-z0-9_]{0,12}", fullmatch=True)
finite = st.floats(allow_nan=False, allow_infinity=False, width=64)
texts = st.text(st.characters(exclude_characters="\0", exclude_categories=["Cs"]), max_size=20)


def equal_tables(left: Table, right: Table) -> bool:
    return (
        (left.axes, left.signal, left.description) == (right.axes, right.signal, right.description)
        and list(left.columns) == list(right.columns)
        and all(
            np.array_equal(left[name], right[name], equal_nan=left[name].dtype.kind == "f")
            and left[name].dtype == right[name].dtype
            and left.columns[name].unit == right.columns[name].unit
            and left.columns[name].description == right.columns[name].description
            for name in left.columns
        )
    )


def test_everything_comes_back(run_path):
    with open_run(run_path) as run:
        assert run.command == "stribeck"
        assert run.notes == NOTES
        assert list(run.results) == list(RESULTS)
        for name, quantity in RESULTS.items():
            if name != "not_found":
                assert run.result(name) == quantity
        assert np.isnan(run.result("not_found").value)
        assert list(run.tables) == list(TABLES)
        for name, table in TABLES.items():
            assert equal_tables(run.table(name), table)
        assert list(run.recordings) == ["sweep", "holds"]
        for spec in SPECS:
            recording = run.recording(spec.name)
            assert recording.channels == spec.channels
            assert recording.size == SIZE
            for channel, expected in samples()[spec.name].items():
                values = recording.read(channel)
                assert values.dtype == np.float64
                np.testing.assert_array_equal(values, expected)
        assert run.recording("sweep").condition("speed") == 3.0
        assert run.recording("sweep").conditions["speed"].unit == "rad/s"
        assert run.recipe is not None
        assert run.recipe.rig.name == run.rig


def test_a_slice_is_that_slice(run_path):
    with open_run(run_path) as run:
        part = run.recording("sweep").read("current", 8000, 8500)
    np.testing.assert_array_equal(part, samples()["sweep"]["current"][8000:8500])


@settings(deadline=None, max_examples=25)
@given(cuts=st.lists(st.integers(0, SIZE), max_size=6))
def test_blocks_of_any_length_make_the_same_run(tmp_path_factory, cuts):
    path = tmp_path_factory.mktemp("cuts") / "run.h5"
    edges = [0, *sorted(cuts), SIZE]
    signals = samples()["holds"]
    with RunWriter(path, command="x", recordings=SPECS[1:]) as writer:
        for start, stop in itertools.pairwise(edges):
            writer.append("holds", {name: v[start:stop] for name, v in signals.items()})
        np.testing.assert_array_equal(writer.recording("holds").read("torque"), signals["torque"])
        np.testing.assert_array_equal(
            writer.recorded().recording("holds").read("torque"), signals["torque"]
        )
        writer.finish({}, {})
    with open_run(path) as run:
        np.testing.assert_array_equal(run.recording("holds").read("torque"), signals["torque"])
        assert run.content_sha256 == _whole_hash(tmp_path_factory)


def _whole_hash(factory, known: list[str] = []) -> str:  # noqa: B006 - computed once
    if not known:
        path = factory.mktemp("whole") / "run.h5"
        with RunWriter(path, command="x", recordings=SPECS[1:]) as writer:
            writer.append("holds", samples()["holds"])
            writer.finish({}, {})
        with open_run(path) as run:
            known.append(run.content_sha256)
    return known[0]


@st.composite
def tables(draw: st.DrawFn) -> Table:
    axes = tuple(draw(st.lists(names, min_size=1, max_size=3, unique=True)))
    shape = tuple(draw(st.integers(0, 5)) for _ in axes)
    kinds = st.sampled_from(["<f8", "<f4", "<i4", "|u1"])
    columns = {
        axis: Column(draw(hnp.arrays(draw(kinds), (length,))), draw(texts))
        for axis, length in zip(axes, shape, strict=True)
    }
    others = draw(st.lists(names, min_size=1, max_size=3, unique=True))
    others = [name for name in others if name not in axes] or ["signal_" + "_".join(axes)]
    for index, name in enumerate(others):
        depth = len(axes) if index == 0 else draw(st.integers(1, len(axes)))
        values = draw(hnp.arrays(draw(kinds), shape[:depth]))
        columns[name] = Column(values, draw(texts), draw(texts))
    return Table(axes, columns, others[0], draw(texts))


@st.composite
def quantities(draw: st.DrawFn) -> Quantity:
    u = draw(st.none() | st.floats(0, 1e300))
    dof = draw(st.none() | st.floats(1, 1e6))
    reason = draw(texts) if u is None else draw(st.none() | texts)
    line = st.builds(Component, texts, finite, texts, finite, st.none() | st.floats(1, 1e6), finite)
    budget = tuple(draw(st.lists(line, max_size=3)))
    return Quantity(draw(finite), draw(texts), u, dof, reason, budget)


@settings(deadline=None, max_examples=40)
@given(
    st.dictionaries(names, quantities(), max_size=4),
    st.dictionaries(names, tables(), max_size=3),
    st.lists(texts, max_size=3),
)
def test_any_results_and_tables(tmp_path_factory, results, found, notes):
    path = tmp_path_factory.mktemp("any") / "run.h5"
    with RunWriter(path, command="x") as writer:
        writer.finish(results, found, notes)
    with open_run(path) as run:
        assert dict(run.results) == results
        assert list(run.results) == list(results)
        assert run.notes == tuple(" ".join(note.splitlines()) for note in notes)
        assert list(run.tables) == list(found)
        assert all(equal_tables(run.tables[name], table) for name, table in found.items())


@pytest.mark.parametrize(
    ("values", "dtype"),
    [
        (np.array([True, False]), "|u1"),
        (np.array([1, 2], dtype="i8"), "<i4"),
        (np.array([1, 2**40], dtype="i8"), "<f8"),
        (np.array([1.5], dtype="f2"), "<f8"),
        (np.array([1.5], dtype=">f8"), "<f8"),
        ([1, 2.5], "<f8"),
    ],
)
def test_columns_take_a_type_that_every_reader_knows(values, dtype):
    column = Column(values, "1")
    assert column.values.dtype.str == dtype
    np.testing.assert_array_equal(column.values, values)


@pytest.mark.parametrize(
    ("axes", "signal", "columns", "message"),
    [
        (("x",), "y", {"x": [1.0]}, "no column 'y'"),
        (("x", "x"), "y", {"x": [1.0], "y": [1.0]}, "different columns"),
        (("x",), "x", {"x": [1.0]}, "cannot be one of its axes"),
        (("x",), "y", {"x": [[1.0]], "y": [1.0]}, "one-dimensional"),
        (("x",), "y", {"x": [1.0, 2.0], "y": [1.0]}, "ask for"),
        (("x", "z"), "y", {"x": [1.0], "z": [1.0], "y": [1.0]}, "all axes"),
        (("x",), "y z", {"x": [1.0], "y z": [1.0]}, "letters"),
    ],
)
def test_a_table_that_makes_no_sense_is_refused(axes, signal, columns, message):
    with pytest.raises(ValueError, match=message):
        Table(axes, {name: Column(np.array(v), "1") for name, v in columns.items()}, signal, "")


def test_text_is_no_column():
    with pytest.raises(ValueError, match="holds numbers"):
        Column(np.array(["a"]), "1")


@pytest.mark.parametrize(
    ("name", "channels", "message"),
    [
        ("a", ["current"], "no channel `time`"),
        ("a", ["time"], "nothing besides"),
        ("a", ["time", "x", "x"], "twice"),
        ("../a", ["time", "x"], "letters"),
        ("a", ["time", "x/y"], "letters"),
        ("a", ["time", "conditions"], "conditions"),
    ],
)
def test_a_recording_that_makes_no_sense_is_refused(name, channels, message):
    with pytest.raises(ValueError, match=message):
        RecordingSpec(name, tuple(Channel(item, "1", "f8", "") for item in channels))


def test_a_type_that_crashes_readers_is_refused():
    with pytest.raises(ValueError, match="f2"):
        Channel("x", "1", "f2", "")


def test_same_recipe_and_seed_give_the_same_bytes(tmp_path: Path, monkeypatch):
    monkeypatch.setenv("SOURCE_DATE_EPOCH", "1136073600")
    first = write(tmp_path / "a.h5")
    time.sleep(1.1)  # HDF5 would store times in whole seconds
    second = write(tmp_path / "b.h5")
    with open_run(first) as one, open_run(second) as other:
        assert one.provenance["date"] == "2006-01-01T00:00:00+00:00"
        assert one.provenance == other.provenance
    assert first.read_bytes() == second.read_bytes()
