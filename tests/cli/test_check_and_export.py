"""`ilc-learn --check` and `export` of learned tables as a user types them."""

import json
import shutil
import signal
from pathlib import Path
from typing import NamedTuple

import pytest

import rigtool.cli as cli
from tests.fixtures.make import SHORT

ROOT = Path(__file__).parents[2]
RECIPE = str(ROOT / "recipes" / "briaire-2006.toml")
SETTINGS = [word for setting in SHORT["tables"] for word in ("--set", setting)]


class Done(NamedTuple):
    """What a command left behind."""

    returncode: int
    stdout: str
    stderr: str


@pytest.fixture
def rigtool(folder, monkeypatch, capsys):
    """Return a function that runs a command line in the folder, within this process."""
    monkeypatch.chdir(folder)

    def run(*arguments):
        before = signal.getsignal(signal.SIGTERM)
        try:
            with pytest.raises(SystemExit) as caught:
                cli.main(arguments)
        finally:
            signal.signal(signal.SIGTERM, before)
        return Done(caught.value.code, *capsys.readouterr())

    return run


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    found = tmp_path_factory.mktemp("check")
    for name in ("kt", "tables"):
        shutil.copy(ROOT / "tests" / "fixtures" / f"{name}.h5", found)
    return found


def test_a_table_that_does_not_fit_is_reported_written_and_exits_with_4(rigtool):
    check = ["ilc-learn", RECIPE, "--kt", "kt.h5", "--check", "tables.h5", "-o", "check.h5"]
    done = rigtool(*check, *SETTINGS, "--set", "virtual.power_cycle=1", "--json")
    assert done.returncode == 4, done.stderr
    assert json.loads(done.stdout)["results"]["table_fits"]["value"] == 0
    assert done.stderr.startswith("Error: the table does not fit")
    assert "Traceback" not in done.stderr
    reported = rigtool("info", "check.h5", "--json")
    stored = json.loads(reported.stdout)
    assert stored["results"]["table_fits"]["value"] == 0
    assert stored["notes"][0] in done.stderr
    again = rigtool(
        "ilc-learn", "check.h5", "--kt", "kt.h5", "--check", "tables.h5", "-o", "again.h5"
    )
    assert again.returncode == 4
    assert again.stderr.count("does not fit") == 1  # the reason is reported once
    assert "table_fits" in again.stdout
    refused = rigtool(*check, *SETTINGS)
    assert refused.returncode == 2
    assert "--overwrite" in refused.stderr


@pytest.mark.parametrize(
    ("arguments", "code", "message"),
    [
        (["--check", "kt.h5", "--kt", "kt.h5"], 3, "was written by calibrate-kt"),
        (["--check", "tables.h5"], 2, "--kt is missing"),
        (["--check", "none.h5", "--kt", "kt.h5"], 3, "no such file"),
        (["--check", "tables.h5", "--kt", "kt.h5", "--friction", "kt.h5"], 2, "--friction"),
        (["--check", "tables.h5", "--kt", "kt.h5", "--validate"], 2, "--validate"),
        (
            ["--check", "tables.h5", "--kt", "kt.h5", "--set", "rig.attachment=pulley"],
            3,
            "learned with attachment instrument",
        ),
    ],
)
def test_checks_that_are_refused(folder, rigtool, arguments, code, message):
    done = rigtool("ilc-learn", RECIPE, *arguments, "-o", "no.h5")
    assert done.returncode == code, done.stderr
    assert message in done.stderr
    assert "Traceback" not in done.stderr
    assert not list(folder.glob("no.h5*"))


@pytest.mark.parametrize(
    ("arguments", "code", "message"),
    [
        (["-o", "t.h"], 0, "lost by rounding to float, largest"),
        (["-o", "t16.h", "--format", "c-int16"], 0, "lost by rounding to int16, largest"),
        (["-o", "t.json"], 0, "lost nothing"),
        (["-o", "t.csv"], 0, "lost nothing"),
        (["-o", "no.cfg", "--kt", "kt.h5"], 2, "not a whole turn"),
        (["-o", "no.csv", "--format", "odrive"], 2, "not a whole turn"),
        (["-o", "no.txt", "--format", "moteus"], 2, "is written as .cfg"),
        (["-o", "no.mat", "--speed", "3"], 2, "--speed and --kt are for learned tables"),
        (["-o", "no.h", "--speed", "3"], 2, "--speed is for moteus"),
        (["-o", "no.h", "--format", "fortran"], 2, "'fortran' is not one of"),
    ],
)
def test_exports(folder, rigtool, arguments, code, message):
    done = rigtool("export", "tables.h5", *arguments)
    assert done.returncode == code, done.stderr
    assert message in done.stderr
    assert done.stdout == ""
    assert "Traceback" not in done.stderr
    assert (folder / arguments[1]).exists() == (code == 0)
