"""`rigtool plot`: any part of a run as a picture, and names that complete."""

import json

import pytest
from click.shell_completion import ShellComplete

from rigtool.cli import main, rigtool
from tests.runfile.whole_run import write


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    return write(tmp_path_factory.mktemp("plot") / "a.h5", size=100)


def plotted(capsys, *arguments):
    with pytest.raises(SystemExit) as caught:
        main(["plot", *map(str, arguments)])
    return caught.value.code, *capsys.readouterr()


def test_a_part_gets_its_own_file(run, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert plotted(capsys, run, "breakaway") == (
        0,
        "",
        "Written: a-breakaway.svg: plot of tables/breakaway\n",
    )
    assert "<svg" in (tmp_path / "a-breakaway.svg").read_text()
    code, _, err = plotted(capsys, run, "breakaway")
    assert (code, "exists already" in err) == (2, True)
    code, out, _ = plotted(capsys, run, "recordings/sweep/encoder", "-o", "e.png", "--json")
    document = json.loads(out)
    assert (code, document["output"], document["command"]) == (0, "e.png", "plot")
    assert document["shown"] == "recordings/sweep/encoder"


def test_a_name_that_is_not_there_lists_those_that_are(run, capsys):
    code, out, err = plotted(capsys, run, "figure-999")
    assert (code, out) == (2, "")
    assert "choose one of tables/friction_model, tables/breakaway, " in err
    assert "recordings/NAME/SIGNAL (`rigtool info " in err


@pytest.mark.parametrize(
    ("arguments", "begun", "found"),
    [
        (["plot", "RUN"], "tables/b", ["tables/breakaway"]),
        (["export", "RUN", "--part"], "tables/b", ["tables/breakaway"]),
        (["recipe"], "briaire", ["briaire-2006"]),
        (["stribeck", "--set"], "rig.atta", ["rig.attachment="]),
        (["stribeck", "--set"], "stribeck.speed_m", ["stribeck.speed_max="]),
        (["stribeck", "--set"], "measure_f", ["measure_force."]),
        (["ver"], "ver", ["verify"]),
    ],
)
def test_a_shell_completes_what_a_command_takes(run, arguments, begun, found):
    words = [str(run) if word == "RUN" else word for word in arguments]
    if words == ["ver"]:
        words = []
    completion = ShellComplete(rigtool, {}, "rigtool", "_RIGTOOL_COMPLETE")
    assert [item.value for item in completion.get_completions(words, begun)] == found
