"""`rigtool import`, as a user types it; the public data sets where they are at hand."""

import os
from pathlib import Path

import numpy as np
import pytest

from rigtool.runfile import importers, open_run
from rigtool.runfile.importers.plan import Plan
from tests.cli.called import call
from tests.runfile.importers.mappings import TEXT, lines

ROOT = Path(__file__).parents[2]
DATA = ROOT / ".." / "shared" / "data"
MAPPINGS = ROOT / "recipes" / "import"
needs_data = pytest.mark.skipif(
    not DATA.is_dir(), reason="the public data sets are not beside the repository"
)


@pytest.fixture
def folder(tmp_path):
    (tmp_path / "map.toml").write_text(TEXT)
    (tmp_path / "in").mkdir()
    for name in ("a.csv", "b.txt", "README.md"):
        (tmp_path / "in" / name).write_text("\n".join(lines()) + "\n")
    return tmp_path


def test_one_file(folder, capsys):
    source, output = folder / "in" / "a.csv", folder / "a.h5"
    arguments = ("import", source, "--map", folder / "map.toml", "-o", output)
    assert call(capsys, *arguments) == (
        0,
        "",
        f"Written: {output}: run of import, 50 samples\n",
    )
    assert call(capsys, *arguments)[0] == 2
    assert call(capsys, *arguments, "--overwrite")[0] == 0
    assert call(capsys, "verify", output) == (
        0,
        f"{output}: ok: import\n  {source}: ok: source\n",
        "",
    )
    assert f"imported from {source}" in call(capsys, "info", output)[1]
    source.write_text("1,2,3\n")
    assert call(capsys, "verify", output)[0] == 3
    source.unlink()
    assert "is not there any more" in call(capsys, "verify", output)[1]


def test_a_folder_becomes_a_folder(folder, capsys):
    output = folder / "new" / "out"
    arguments = ("import", folder / "in", "--map", folder / "map.toml", "-o", output)
    assert call(capsys, *arguments)[0] == 0
    assert sorted(os.listdir(output)) == ["a.h5", "b.h5"]
    code, _, err = call(capsys, *arguments)
    assert code == 2
    assert "exists already" in err


def test_names_that_are_one_name_on_the_disk_are_refused(folder, capsys, monkeypatch):
    # A.csv and a.csv, where capitals do not count: the disk knows, not the list of names.
    names = {folder / "in" / name: Path("a.h5") for name in ("a.csv", "b.txt")}
    monkeypatch.setattr(importers, "plan", lambda *_: Plan(names, True, []))
    arguments = ("import", folder / "in", "--map", folder / "map.toml", "-o", folder / "out")
    code, _, err = call(capsys, *arguments, "--overwrite")
    assert (code, "b.txt: its run" in err, "one name on this disk" in err) == (2, True, True)
    assert not (folder / "out").exists()


def test_several_folders_keep_their_names(folder, capsys):
    (folder / "more").mkdir()
    (folder / "in" / "a.csv").rename(folder / "more" / "b.csv")
    arguments = ("import", folder / "in", folder / "more", "--map", folder / "map.toml")
    assert call(capsys, *arguments, "-o", folder / "out")[0] == 0
    found = sorted(str(path.relative_to(folder / "out")) for path in folder.glob("out/*/*"))
    assert found == ["in/b.h5", "more/b.h5"]


@pytest.mark.parametrize("there", [False, True])
def test_one_bad_file_of_a_folder_and_nothing_is_written(folder, capsys, there):
    (folder / "in" / "b.txt").write_text("1,2,3\n1,2\n")
    output = folder / "new" / "out"
    if there:
        output.mkdir(parents=True)
    arguments = ("import", folder / "in", "--map", folder / "map.toml", "-o", output)
    code, out, err = call(capsys, *arguments)
    assert (code, out) == (3, "")
    assert f"{folder / 'in' / 'b.txt'}, line 2: has 2 fields" in err
    assert output.parent.is_dir() == there
    assert not there or not os.listdir(output)


@pytest.mark.parametrize(
    ("arguments", "code", "message"),
    [
        (["in/a.csv", "-o", "a.h5"], 3, "does not state the meaning of its columns"),
        (["in/c.csv", "-o", "a.h5"], 3, "no such file or folder"),
        (["in", "-o", "a.h5", "--map", "map.toml"], 2, "give a folder for them"),
        (["in/a.csv", "-o", "in", "--map", "map.toml"], 2, "is a folder"),
        (["in/a.csv", "-o", "a.h5", "--map", "no.toml"], 3, "no such mapping"),
        (["in/a.csv", "in/a.csv", "-o", "out", "--map", "map.toml"], 2, "would both become"),
        ([".", "-o", "out", "--map", "map.toml"], 3, "holds no file that ends in"),
    ],
)
def test_what_a_user_may_get_wrong(folder, capsys, monkeypatch, arguments, code, message):
    monkeypatch.chdir(folder)
    found, out, err = call(capsys, "import", *arguments)
    assert (found, out) == (code, "")
    assert message in err


def test_conditions_are_taken_from_the_name(folder, capsys):
    text = TEXT + '[[conditions]]\nname = "load"\nunit = "N"\npattern = "load(\\\\d+)"\n'
    (folder / "map.toml").write_text(text)
    source = folder / "in" / "a.csv"
    arguments = ("import", source, "--map", folder / "map.toml", "-o", folder / "a.h5")
    code, _, err = call(capsys, *arguments)
    assert code == 0
    assert "its name does not state the condition 'load'" in err
    source = source.rename(folder / "load12.csv")
    assert call(capsys, "import", source, *arguments[2:], "--overwrite")[0] == 0
    with open_run(folder / "a.h5") as run:
        assert run.recording("imported").condition("load") == 12.0


def test_a_mapping_states_which_files_it_is_for(folder, capsys):
    (folder / "in" / "SerialLog.txt").write_text("Please press s:\n")
    text = TEXT.replace("mapping = 1\n", 'mapping = 1\nfiles = "?.*"\n')
    (folder / "map.toml").write_text(text)
    arguments = ("import", folder / "in", "--map", folder / "map.toml", "-o", folder / "out")
    code, _, err = call(capsys, *arguments)
    assert code == 0
    assert "the mapping is not for 1 file: SerialLog.txt" in err
    assert sorted(os.listdir(folder / "out")) == ["a.h5", "b.h5"]
    (folder / "map.toml").write_text(text.replace("?.*", "*.dat"))
    code, _, err = call(capsys, *arguments, "--overwrite")
    assert code == 3
    assert "files = '*.dat'" in err


def test_all_bad_files_at_once_or_the_good_ones(folder, capsys):
    for name in ("c.csv", "d.csv"):
        (folder / "in" / name).write_text("1,2,3\n1,2\n")
    arguments = ("import", folder / "in", "--map", folder / "map.toml", "-o", folder / "out")
    code, out, err = call(capsys, *arguments)
    assert (code, out) == (3, "")
    assert "2 of 4 files cannot be imported" in err
    assert f"{folder / 'in' / 'c.csv'}, line 2" in err
    assert f"{folder / 'in' / 'd.csv'}, line 2" in err
    code, _, err = call(capsys, *arguments, "--skip-bad-files")
    assert code == 0
    assert sorted(os.listdir(folder / "out")) == ["a.h5", "b.h5"]
    assert err.count("left out") == 2
    (folder / "bad").mkdir()
    (folder / "in" / "d.csv").rename(folder / "bad" / "d.csv")
    arguments = ("import", folder / "bad", "--map", folder / "map.toml", "-o", folder / "none")
    assert call(capsys, *arguments, "--skip-bad-files")[0] == 3
    assert not (folder / "none").exists()


def test_equal_notes_of_many_files_are_one(folder, capsys):
    text = TEXT + '[[conditions]]\nname = "load"\npattern = "load(\\\\d+)"\n'
    (folder / "map.toml").write_text(text)
    arguments = ("import", folder / "in", "--map", folder / "map.toml", "-o", folder / "out")
    code, _, err = call(capsys, *arguments)
    assert code == 0
    assert next(line for line in err.splitlines() if "'load'" in line).startswith(
        "Note: a.h5 and 1 more"
    )
    assert err.count("'load'") == 1


def test_preview_shows_what_would_be_read(folder, capsys):
    source = folder / "in" / "a.csv"
    code, out, _ = call(capsys, "import", source, "--map", folder / "map.toml", "--preview")
    assert code == 0
    assert "time [s]  encoder [count]  current [A]" in out
    assert "50 samples over 0.098 s, 500 Hz, no gaps" in out
    rows = [line for number, line in enumerate(lines()) if number not in (20, 21)]
    source.write_text("a;b;c\n" + "\n".join(row.replace(",", ";") for row in rows) + "\n")
    assert (
        "1 gap, the longest 0.006 s at 0.038 s"
        in call(capsys, "import", source, "--map", _with_head(folder), "--preview")[1]
    )
    code, out, _ = call(capsys, "import", source, "--preview")
    assert code == 0
    assert "numbers from line 2 on; delimiter = ';', decimal = '.'" in out
    assert [line.split() for line in out.splitlines()[2:4]] == [["1", "2", "3"], ["a", "b", "c"]]
    source.write_text("names;only\n\n")
    assert "1 line, none of numbers" in call(capsys, "import", source, "--preview")[1]
    source.write_text("".join(f"pos={n} cur=0.{n}\n" for n in range(5)))
    assert 'NAME2 = { column = "cur", unit' in call(capsys, "import", source, "--preview")[1]
    assert call(capsys, "import", source)[0] == 2
    assert not list(folder.glob("**/*.h5"))


def test_the_proposed_mapping_needs_names_and_units_only(folder, capsys):
    source = folder / "in" / "a.csv"
    out = call(capsys, "import", source, "--preview")[1]
    text = out.partition("\nmapping = 1")[2].partition("\n\n")[0]
    text = text.replace('"UNIT"', '"s"', 1)
    for change in (('"UNIT"', '"count"'), ("NAME2", "encoder"), ("NAME3", "index")):
        assert change[0] in text
        text = text.replace(*change)
    (folder / "own.toml").write_text(f"mapping = 1{text}")
    code, _, err = call(
        capsys, "import", source, "--map", folder / "own.toml", "-o", folder / "own.h5"
    )
    assert code == 0, err
    with open_run(folder / "own.h5") as run:
        assert set(run.recording("imported").units) == {"time", "encoder", "index"}


def test_a_run_file_needs_no_import(folder, capsys):
    (folder / "run.h5").write_bytes(b"")
    code, _, err = call(capsys, "import", folder / "run.h5", "-o", folder / "out.h5")
    assert code == 3
    assert "need no import" in err


def _with_head(folder):
    path = folder / "head.toml"
    path.write_text(TEXT.replace("[file]", "[file]\nheader_lines = 1"))
    return path


def test_a_condition_is_taken_from_the_folder(folder, capsys):
    text = TEXT + '[[conditions]]\nname = "on"\nof = "folder"\npattern = "^(on|off)"\n'
    (folder / "map.toml").write_text(text + "values = { on = 1, off = 0 }\n")
    source = (folder / "in").rename(folder / "off-cold") / "a.csv"
    arguments = ("import", source, "--map", folder / "map.toml", "-o", folder / "a.h5")
    assert call(capsys, *arguments)[0] == 0
    with open_run(folder / "a.h5") as run:
        assert run.recording("imported").condition("on") == 0


@needs_data
def test_instruments_of_the_mis_tool_set(tmp_path, capsys):
    tool = DATA / "mis-tool" / "Tool_4_Maryland_L_4"
    source = [tool / f"{name}.TXT.gz" for name in ("00", "27", "49")]  # of 50, to be quick
    arguments = ("import", *source, "--map", MAPPINGS / "mis-tool.toml", "-o", tmp_path / "tool4")
    assert call(capsys, *arguments)[0] == 0
    assert sorted(os.listdir(tmp_path / "tool4")) == ["00.h5", "27.h5", "49.h5"]
    with open_run(tmp_path / "tool4" / "49.h5") as run:
        recording = run.recording("imported")
        assert recording.condition("load_number") == 9
        assert recording.size == 20_000
        np.testing.assert_array_equal(recording.read("current", 0, 2), [-0.039, -0.043])
        expected = np.array([-202, -1914]) * 3.9811e-5
        torque = recording.read("reference_torque", 0, 2)
        np.testing.assert_allclose(torque, expected, rtol=1e-14, atol=0)


@needs_data
def test_every_file_of_the_other_sets(tmp_path, capsys):
    cogging = DATA / "odrive-cogging" / "analysis" / "cogging_torque"
    drive = DATA / "epos-stribeck" / "experiments" / "driveNo1" / "steady_state" / "0.096kg"
    for source, name, count in (
        (cogging / "slow2", "odrive-slow", 6),
        (cogging / "slow2_slower", "odrive-slow", 4),
        (cogging / "coggingmap_0", "odrive-map", 12),
        (drive, "epos-stribeck", 32),
    ):
        output = tmp_path / source.name
        arguments = ("import", source, "--map", MAPPINGS / f"{name}.toml", "-o", output, "-q")
        assert call(capsys, *arguments)[0] == 0
        assert len(os.listdir(output)) == count
    # Without a mapping the export of EPOS Studio says all but the rig.
    assert call(capsys, "import", drive, "-o", tmp_path / "bare", "-q")[0] == 0
    with open_run(tmp_path / "bare" / "n10.h5") as run:
        assert set(run.recording("imported").units) == {"time", "speed", "relative_torque"}
