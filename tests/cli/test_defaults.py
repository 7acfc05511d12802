"""Defaults of `rigtool.toml`, the options that every command has, and errors as JSON."""

import json
import shutil
from pathlib import Path

import pytest

import rigtool.cli as cli
from rigtool.cli.output import JSON_VERSION

ROOT = Path(__file__).parents[2]
FIXTURES = ROOT / "tests" / "fixtures"
KEYS = {"schema", "version", "command", "rig", "output", "results", "tables", "notes"}


def called(capsys, *arguments):
    with pytest.raises(SystemExit) as caught:
        cli.main(list(map(str, arguments)))
    return caught.value.code, *capsys.readouterr()


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "runs").mkdir()
    shutil.copy(ROOT / "recipes" / "briaire-2006.toml", "rig.toml")
    Path("rigtool.toml").write_text(
        f'recipe = "rig.toml"\nkt = "{(FIXTURES / "kt.h5").as_posix()}"\noutput = "runs"\n'
    )
    return tmp_path


def test_defaults_stand_for_what_is_left_out(folder, capsys):
    code, out, err = called(capsys, "stribeck", "--dry-run")
    kt = (FIXTURES / "kt.h5").as_posix()
    assert code == 0
    assert err == (
        f"From rigtool.toml: SOURCE rig.toml, --output {Path('runs/stribeck.h5')}, --kt {kt}\n"
    )
    assert "rad/s" in out
    again = called(capsys, "stribeck", FIXTURES / "friction.h5", "--json", "--no-tables")
    document = json.loads(again[1])
    assert (again[0], document["output"]) == (0, str(Path("runs/stribeck.h5")))
    assert (document["tables"], "coulomb_friction" in document["results"]) == ({}, True)
    assert isinstance(document["provenance"]["recipe_resolved"], dict)


def test_defaults_behind_a_link_that_leads_nowhere_are_not_there(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    Path("rigtool.toml").symlink_to("rigtool.toml")
    code, _, err = called(capsys, "config")
    assert (code, "rigtool.toml: no such file: 0 defaults" in err) == (0, True)


def test_the_command_line_comes_first_and_help_needs_no_defaults(folder, capsys):
    err = called(capsys, "stribeck", "--kt", "other.h5", "--dry-run")[2]
    assert "other.h5: no such file" in err
    Path("rigtool.toml").write_text("recipe = 3\n")
    assert called(capsys, "stribeck", "--help")[0] == 0
    code, _, err = called(capsys, "stribeck", "--dry-run")
    assert (code, "recipe: must be a text" in err) == (3, True)
    Path("rigtool.toml").write_text("recpie = 'rig.toml'\n")
    code, _, err = called(capsys, "config")
    assert (code, "'recpie' is no default: use one of recipe, kt" in err) == (3, True)


def test_config_shows_what_holds(folder, capsys):
    code, out, err = called(capsys, "config")
    assert (code, "rigtool.toml: 3 defaults" in err) == (0, True)
    assert out.splitlines()[0].split()[:2] == ["recipe", "rig.toml"]
    document = json.loads(called(capsys, "config", "--json")[1])
    assert document["defaults"] == {
        "recipe": "rig.toml",
        "kt": (FIXTURES / "kt.h5").as_posix(),
        "output": "runs",
    }


@pytest.mark.parametrize("name", list(cli.COMMANDS))
def test_every_command_has_the_options_of_output(name, capsys):
    code, out, _ = called(capsys, name, "--help")
    assert code == 0
    for option in ("--json", "--no-tables", "--quiet", "--verbose", "--debug"):
        assert option in out
    code, out, err = called(capsys, name, "--no-such", "--json", "--overwrite", "-q", "-v")
    document = json.loads(out)
    assert (code, document["error"]["exit_code"]) == (2, 2)
    assert "No such option" in document["error"]["message"]
    assert set(document) == KEYS | {"error"}
    assert (document["schema"], document["command"]) == (JSON_VERSION, name)
    assert "No such option" in err


@pytest.mark.parametrize(
    "line",
    [
        "info RUN",
        "verify RUN",
        "diff RUN RUN",
        "recipe",
        "export RUN -o a.mat",
        "plot RUN",
        "config",
        "calibrate-kt RUN -o k.h5",
        "report RUN -o r",
    ],
)
def test_one_schema(line, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    run = str(FIXTURES / "kt.h5")
    code, out, err = called(capsys, *line.replace("RUN", run).split(), "--json")
    assert (code, err) == (0, "")
    document = json.loads(out)
    assert set(document) >= KEYS
    assert document["schema"] == JSON_VERSION
    if "-o" in line:
        assert document["output"] == line.split()[-1]


def test_info_prints_the_document_of_the_command_that_wrote_the_run(tmp_path, capsys):
    output = tmp_path / "k.h5"
    out = called(capsys, "calibrate-kt", FIXTURES / "kt.h5", "-o", output, "--json")[1]
    written = json.loads(out)
    shown = json.loads(called(capsys, "info", output, "--json")[1])
    assert shown == {**written, "output": None}


def test_options_stand_under_headings(capsys):
    out = called(capsys, "stribeck", "--help")[1]
    parts = ["Options:", "--kt", "How it measures and analyses:", "--seed"]
    parts += ["Rigs on a serial line only:", "--yes", "Output:", "--overwrite"]
    assert parts == sorted(parts, key=out.index)
    assert "--overwrite" not in called(capsys, "diff", "--help")[1]
