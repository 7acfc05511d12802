"""No command writes over what it reads, whatever --overwrite permits."""

import shutil
from pathlib import Path

import pytest

from rigtool.cli import main

ROOT = Path(__file__).parents[2]
TABLES = ROOT / "tests" / "fixtures" / "tables.h5"
KT = ROOT / "tests" / "fixtures" / "kt.h5"

LINES = {
    "measuring": "calibrate-kt my.toml -o my.toml --overwrite",
    "imported": "import i.csv --map map.toml -o i.csv --overwrite",
    "imported over its mapping": "import i.csv --map map.toml -o map.toml --overwrite",
    "imported by a link": "import i.csv --map map.toml -o link --overwrite",
    "plotted": "info kt.png --plot kt.png --overwrite",
    "exported": "export tables.csv -o tables.csv --overwrite",
    "analysed": "calibrate-kt kt.h5 -o kt.h5 --overwrite",
    "a line over its recipe": "calibrate-kt line.toml -o o.h5 --spy line.toml --overwrite",
    "a line over a run": "stribeck line.toml --kt kt.h5 -o o.h5 --spy kt.h5 --overwrite",
    "a line over a stored table": "deploy kt.h5 --rig line.toml --spy kt.h5 --overwrite",
    "recovered": "recover kt.h5.part -o kt.h5.part --overwrite",
}


@pytest.fixture
def files(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    shutil.copy(ROOT / "recipes" / "briaire-2006.toml", "my.toml")
    shutil.copy(ROOT / "recipes" / "own-target.toml", "line.toml")
    for name in ("kt.h5", "kt.png", "kt.csv", "kt.h5.part"):
        shutil.copy(KT, name)
    shutil.copy(TABLES, "tables.csv")
    Path("i.csv").write_text("time,current\n0,1\n1,2\n2,3\n")
    Path("map.toml").write_text(
        'mapping = 1\n[rig]\nname = "x"\n[signals.time]\ncolumn = "time"\nunit = "s"\n'
        '[signals.current]\ncolumn = "current"\nunit = "A"\n'
    )
    Path("link").symlink_to("i.csv")
    return tmp_path


@pytest.mark.parametrize("case", LINES)
def test_an_input_is_no_output(files, capsys, case):
    before = {path.name: path.read_bytes() for path in files.iterdir()}
    with pytest.raises(SystemExit) as caught:
        main(LINES[case].split())
    assert (caught.value.code, "is an input" in capsys.readouterr().err) == (2, True)
    assert {path.name: path.read_bytes() for path in files.iterdir()} == before


def test_a_report_does_not_replace_a_folder_with_its_inputs(tmp_path, capsys):
    inside = tmp_path / "report" / "tables" / "kt.h5"
    inside.parent.mkdir(parents=True)
    shutil.copy(KT, inside)
    with pytest.raises(SystemExit) as caught:
        main(["report", str(inside), "-o", str(tmp_path / "report"), "--overwrite"])
    assert (caught.value.code, "an input of this report" in capsys.readouterr().err) == (2, True)
    assert inside.read_bytes() == KT.read_bytes()


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--spy", "known.txt"], "exists already"),
        (["--spy", "o.h5"], "is the output of this run"),
        (["--spy", "/dev/null", "--overwrite"], "device or a pipe"),
    ],
)
def test_the_record_of_a_line_is_an_output_as_any_other(files, capsys, options, message):
    Path("known.txt").write_text("notes")
    with pytest.raises(SystemExit) as caught:
        main(["calibrate-kt", "line.toml", "-o", "o.h5", *options])
    assert (caught.value.code, message in capsys.readouterr().err) == (2, True)
    assert Path("known.txt").read_text() == "notes"
    assert not Path("o.h5").exists()
