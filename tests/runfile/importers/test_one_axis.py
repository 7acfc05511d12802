"""Channels with samples of their own: blanks between them, or times of their own."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from rigtool.errors import RunFileError
from rigtool.runfile import open_run
from tests.runfile.importers.mappings import mapping, take

MAP = """mapping = 1
[rig]
name = "bus"
[signals]
time = { column = "t", unit = "s" }
encoder = { column = "q", unit = "count", wraps_at = 64 }
current = { column = "i", unit = "A" }
speed_setpoint = { column = "w", unit = "rad/s" }
[[conditions]]
name = "compensation"
column = "c"
"""
RATE = 7.0


def signals_at(time):
    """Counter, current and set point at times: straight lines, and one step."""
    return RATE * time, 0.1 - 0.02 * time, np.where(time < 30, 1.0, 2.0)


def written(folder, known, binary):
    """Write columns in which each signal is blank outside its lines `known`."""
    time = np.arange(100.0)
    columns = dict(zip("qiw", signals_at(time), strict=True))
    columns["q"] = np.mod(columns["q"], 64)
    columns["c"] = np.where(time < 50, 0.0, 1.0)
    for name, lines in known.items():
        columns[name][np.setdiff1d(np.arange(100), lines)] = np.nan
    if binary:
        np.savez(folder / "a.npz", t=time, **columns)
        return folder / "a.npz"
    rows = zip(*(values.astype(str) for values in columns.values()), strict=True)
    lines = [
        f"{t:g}," + ",".join(row).replace("nan", "") for t, row in zip(time, rows, strict=True)
    ]
    (folder / "a.csv").write_text("t,q,i,w,c\n" + "\n".join(lines) + "\n")
    return folder / "a.csv"


@settings(deadline=None, max_examples=25)
@given(every=st.integers(2, 4), late=st.integers(0, 3), phase=st.integers(0, 1), binary=...)
def test_each_signal_where_it_was_sampled(
    tmp_path_factory, every: int, late: int, phase: int, binary: bool
):
    """What moves on straight lines comes in exactly, on the lines of the current."""
    folder = tmp_path_factory.mktemp("own")
    known = {
        "q": np.arange(phase, 100, 2),
        "i": np.arange(late, 100, every),
        "w": np.array([0, 30]),
        "c": np.array([0, 50]),
    }
    done = take(written(folder, known, binary), folder / "a.h5", MAP).done[0]
    assert f"encoder 50, current {len(known['i'])}" in "".join(done.notes)
    with open_run(folder / "a.h5") as run:
        parts = run.recordings_named("imported_")
        time = np.concatenate([part.read("time") for part in parts])
        np.testing.assert_array_equal(time, known["i"])
        assert [part.condition("compensation") for part in parts] == [0, 1]
        inside = (time >= phase) & (time <= 98 + phase)
        for name, values in zip(
            ("encoder", "current", "speed_setpoint"), signals_at(time), strict=True
        ):
            found = np.concatenate([part.read(name) for part in parts])
            first = found[inside][0] - values[inside][0] if name == "encoder" else 0
            np.testing.assert_allclose(found[inside] - first, values[inside], atol=1e-12)


def test_a_column_with_times_of_its_own(tmp_path):
    """A slower channel beside its own times, shorter than the others."""
    rows = [f"{n},{n},{5 * n + 0.5},{10 * n}" if n < 20 else f"{n},{n},," for n in range(100)]
    (tmp_path / "a.csv").write_text("t,p,ti,i\n" + "\n".join(rows) + "\n")
    text = MAP.partition("encoder")[0] + (
        'position = { column = "p", unit = "rad" }\n'
        'current = { column = "i", unit = "A", time = "ti" }\n'
    )
    take(tmp_path / "a.csv", tmp_path / "a.h5", text)
    with open_run(tmp_path / "a.h5") as run:
        found = run.recording("imported")
        for name, values in (("time", 5), ("position", 5), ("current", 10)):
            start = 0 if name == "current" else 0.5
            np.testing.assert_array_equal(found.read(name), np.arange(20) * values + start)


@pytest.mark.parametrize(
    ("cell", "message"),
    [
        (lambda n: "" if n != 5 else "1", "'i' has 1 values"),
        (lambda n: "" if n == 5 else "1", "column 2 holds '', no number"),
    ],
)
def test_too_few_values_or_blanks(tmp_path, cell, message):
    """One blank is damage; one value is no signal."""
    (tmp_path / "a.csv").write_text("t,i\n" + "".join(f"{n},{cell(n)}\n" for n in range(100)))
    text = MAP.partition("encoder")[0] + 'current = { column = "i", unit = "A" }\n'
    with pytest.raises(RunFileError, match=message):
        take(tmp_path / "a.csv", tmp_path / "a.h5", text)
    assert not (tmp_path / "a.h5").exists()


def test_times_that_fall_are_named(tmp_path):
    lines = [f"{n % 50},1,\n{n % 50},,2\n" for n in range(100)]
    (tmp_path / "a.csv").write_text("t,p,i\n" + "".join(lines))
    text = MAP.partition("encoder")[0] + (
        'position = { column = "p", unit = "rad" }\ncurrent = { column = "i", unit = "A" }\n'
    )
    with pytest.raises(RunFileError, match="line 102: the time of column 'p' does not rise"):
        take(tmp_path / "a.csv", tmp_path / "a.h5", text)
    assert mapping(text)[0].own_times == []
