"""Conditions by columns that split a file, by names, and stated for all files."""

import numpy as np
import pytest

from rigtool.errors import RecipeError, RunFileError
from rigtool.recipe.mapping import parse_mapping
from rigtool.runfile import open_run
from tests.runfile.importers.mappings import take

TEXT = """mapping = 1
[rig]
name = "bench"
[signals]
time = { column = "t", unit = "s" }
current = { column = "i", unit = "mA" }
[[conditions]]
name = "compensation"
column = "mode"
values = { on = 1, off = 0 }
[[conditions]]
name = "constant_speed"
value = 60
unit = "rpm"
"""


def write(path, modes, delimiter=",", decimal="."):
    rows = [["t", "i", "mode"], *([f"{n / 10}", f"{n}", mode] for n, mode in enumerate(modes))]
    lines = [delimiter.join(field.replace(".", decimal) for field in row) for row in rows]
    path.write_text("\n".join(lines) + "\n")
    return path


def recordings(path):
    with open_run(path) as run:
        return [
            (recording.read("current") * 1e3, recording.condition("compensation"))
            for recording in run.recordings.values()
        ]


@pytest.mark.parametrize(("delimiter", "decimal"), [(",", "."), (";", ","), ("\t", ",")])
def test_a_text_column_splits_a_file_where_it_changes(tmp_path, delimiter, decimal):
    source = write(tmp_path / "a.csv", ["off"] * 5 + ["on"] * 4 + ["off"] * 3, delimiter, decimal)
    (done,) = take(source, tmp_path / "a.h5", TEXT).done
    assert any("3 recordings, under 2 conditions" in note for note in done.notes)
    found = recordings(tmp_path / "a.h5")
    assert [value for _, value in found] == [0, 1, 0]
    samples = np.concatenate([values for values, _ in found])
    np.testing.assert_allclose(samples, np.arange(12), rtol=1e-12, atol=1e-15)
    with open_run(tmp_path / "a.h5") as run:
        assert run.recording("imported_001").condition("constant_speed") == pytest.approx(
            2 * np.pi, rel=1e-12
        )


def test_a_file_under_one_condition_is_one_recording(tmp_path):
    take(write(tmp_path / "a.csv", ["on"] * 9), tmp_path / "a.h5", TEXT)
    with open_run(tmp_path / "a.h5") as run:
        assert list(run.recordings) == ["imported"]
        assert run.recording("imported").condition("compensation") == 1


def test_text_that_the_mapping_does_not_know_names_its_line(tmp_path):
    source = write(tmp_path / "a.csv", ["on"] * 4 + ["perhaps"] + ["off"] * 4)
    with pytest.raises(RunFileError, match="line 6: column 3 holds 'perhaps', none of on, off"):
        take(source, tmp_path / "a.h5", TEXT)
    take(source, tmp_path / "a.h5", TEXT, skip_bad=True)
    assert [value for _, value in recordings(tmp_path / "a.h5")] == [1, 0]


def test_numbers_of_a_binary_file_split_it_too(tmp_path):
    text = TEXT.replace("{ on = 1, off = 0 }", '{ "2" = 1, "3" = 0 }')
    arrays = {"t": np.arange(8.0), "i": np.arange(8.0), "mode": np.repeat([2.0, 3.0], 4)}
    np.savez(tmp_path / "a.npz", **arrays)
    take(tmp_path / "a.npz", tmp_path / "a.h5", text)
    assert [value for _, value in recordings(tmp_path / "a.h5")] == [1, 0]
    np.savez(tmp_path / "b.npz", **(arrays | {"mode": np.repeat([2.0, 4.0], 4)}))
    with pytest.raises(RunFileError, match=r"`values` of the condition 'compensation'"):
        take(tmp_path / "b.npz", tmp_path / "b.h5", text)


def test_a_column_that_is_a_signal_is_no_condition(tmp_path):
    text = TEXT.replace("values = { on = 1, off = 0 }\n", "")
    source = write(tmp_path / "a.csv", [f"{n}" for n in range(2000)])
    with pytest.raises(RunFileError, match="changes 1999 times, a condition holds for a while"):
        take(source, tmp_path / "a.h5", text)
    assert not (tmp_path / "a.h5").exists()


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('column = "mode"', 'column = "mode"\npattern = "(a)"', "give one of `pattern`"),
        ('column = "mode"\n', "", "give one of `pattern`"),
        ('unit = "rpm"', 'unit = "A"', "constant_speed is a speed"),
    ],
)
def test_conditions_without_sense_are_refused(old, new, message):
    with pytest.raises(RecipeError, match=message):
        parse_mapping(TEXT.replace(old, new))
