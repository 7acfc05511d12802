"""`rigtool info` on the run with everything."""

import json

import pytest
from click.testing import CliRunner

from rigtool.cli.info import command
from rigtool.errors import UsageError
from rigtool.quantity import Component, Quantity, scattered
from rigtool.runfile import open_run
from rigtool.runfile.summary import budget_lines, folded, result_lines
from tests.runfile.whole_run import SIZE, write


@pytest.fixture(scope="module")
def path(tmp_path_factory):
    folder = tmp_path_factory.mktemp("info")
    first = write(folder / "kt.h5", size=100)
    return write(folder / "friction.h5", inputs=(first,))


def test_a_reason_that_results_share_stands_once():
    without = {name: Quantity(1.0, "1", reason="no --kt") for name in ("first", "second")}
    lines = result_lines({**without, "third": Quantity(2.0, "1", reason="a count")})
    assert lines == [
        "first   1  (no uncertainty [1])",
        "second  1  (no uncertainty [1])",
        "third   2  (no uncertainty: a count)",
        "[1] no --kt",
    ]


def test_one_screen(path):
    found = CliRunner().invoke(command, [str(path)], catch_exceptions=False)
    assert found.exit_code == 0
    lines = found.output.splitlines()
    assert len(lines) <= 30
    with open_run(path) as run:
        assert lines[0] == f"{path}: stribeck on {run.rig}"
        assert f"made {run.provenance['date']} by rigtool" in lines[1]
        assert lines[1].endswith("seed 1")
    text = found.output
    assert "kt.h5 (stribeck, content " in text
    assert "  torque_constant  45.800(40) mN m/A" in text
    assert "  arm_length       0.54 m  (no uncertainty: from the drawing)" in text
    assert "  sweep at speed 3 rad/s, moves 20: 20000 samples, 1000 Hz, 20 s\n" in text
    assert "    with time [s], current [A], encoder [count], limit_switch [1]\n" in text
    assert "breakaway: positive [N m] over position (3)" in text
    assert "friction_model: torque [N m], u [N m], count [1] over speed (2), position (50)" in text
    assert "  the second position did not move" in text


def test_json(path):
    found = CliRunner().invoke(command, [str(path), "--json"], catch_exceptions=False)
    data = json.loads(found.output)
    assert set(data) >= {"results", "tables", "provenance", "notes"}
    assert data["results"]["torque_constant"] == {
        "value": 0.0458,
        "unit": "N m/A",
        "u": 4e-5,
        "dof": 12.0,
        "budget": [
            {
                "name": "arm length",
                "value": 0.54,
                "unit": "m",
                "u": 0.2e-3,
                "dof": None,
                "sensitivity": 0.0848,
            },
            {
                "name": "scatter",
                "value": 0.0,
                "unit": "N m/A",
                "u": 3.6e-5,
                "dof": 9.0,
                "sensitivity": 1.0,
            },
        ],
    }
    assert data["results"]["not_found"]["value"] is None
    assert data["tables"]["breakaway"]["axes"] == ["position"]
    assert data["tables"]["breakaway"]["columns"]["positive"]["values"] == [2.4e-3, None, 5e-3]
    assert data["provenance"]["inputs"][0]["command"] == "stribeck"
    assert data["provenance"]["seed"] == "1"
    sweep = data["recordings"]["sweep"]
    assert sweep["size"] == SIZE
    assert sweep["rate"] == pytest.approx(1000, rel=1e-9)
    assert sweep["conditions"]["speed"] == {"value": 3.0, "unit": "rad/s"}
    assert sweep["channels"]["encoder"] == "count"


def test_budget(path):
    def shown(*options):
        arguments = [str(path), "--budget", *options]
        return CliRunner().invoke(command, arguments, catch_exceptions=False).output

    head, titles, *lines = shown("torque_constant").splitlines()
    assert head == "torque_constant  45.800(40) mN m/A; contributions in N m/A"
    assert titles.split() == [
        "component",
        "value",
        "u",
        "sensitivity",
        "contribution",
        "dof",
        "share",
    ]
    # the largest share first: 3.6e-5 against 0.0848 N/A times 0.2 mm
    assert lines[0].split() == [
        "scatter",
        "0",
        "N",
        "m/A",
        "3.6e-05",
        "N",
        "m/A",
        "1",
        "3.6e-05",
        "9",
        "81.8",
        "%",
    ]
    assert lines[1].split()[-5:] == ["0.0848", "1.7e-05", "inf", "18.2", "%"]
    assert lines[2].split() == ["together", "0.0458", "4e-05", "12"]
    document = json.loads(shown("torque_constant", "--json"))
    assert document["results"]["torque_constant"]["dof"] == 12.0
    assert "no uncertainty: from the drawing" in shown("arm_length")


def test_a_terminal_s_width_folds_lines_and_loses_no_word():
    lines = ["Notes", "", "  " + "torque was learned up to 60 mN m; " * 5, "  short"]
    found = folded(lines, 80)
    assert max(map(len, found)) <= 80
    assert [*" ".join(found).split()] == " ".join(lines).split()
    assert found[3].startswith("      ")
    assert folded(lines, None) == lines


def test_a_wide_budget_fits_a_terminal_and_keeps_its_numbers():
    slope = Component(
        "friction and resolution in the slope", -5.3171e-05, "N m/(A K)", 9e-8, None, 7.4
    )
    arm = Component("arm length", 0.54, "m", 0.2e-3, 14.0, 0.0841)
    result = Quantity(0.045405, "N m/A", 2.2e-5, 8460.0, budget=(slope, arm))
    assert max(map(len, budget_lines("mean", result))) > 80
    _, titles, *lines = budget_lines("mean", result, 80)
    assert max(map(len, lines)) <= 80
    assert titles.split() == ["component", "value", "u", "unit", "adds", "dof", "share"]
    assert lines[0].split()[-7:] == ["0.54", "0.0002", "m", "1.7e-05", "14", "99.8", "%"]
    names = " ".join(line[: titles.index("value") - 6] for line in lines[1:-1]).split()
    assert "-5.3171e-05" in lines[1]
    assert [word for word in names if word.isalpha()] == slope.name.split()


def test_the_budget_of_what_does_not_scatter_has_no_shares():
    *_, line, together = budget_lines("mean", scattered(1.0, "N m", 0.0))
    assert line.endswith("0.0 %")
    assert together.split()[0] == "together"


def test_plot(path, tmp_path):
    output = tmp_path / "a.svg"
    found = CliRunner().invoke(command, [str(path), "--plot", str(output)], catch_exceptions=False)
    assert found.exit_code == 0
    text = output.read_text()
    assert "<svg" in text
    again = CliRunner().invoke(command, [str(path), "--plot", str(output)])
    assert isinstance(again.exception, UsageError)
    wrong = CliRunner().invoke(command, [str(path), "--plot", str(tmp_path / "a.docx")])
    assert isinstance(wrong.exception, UsageError)
    both = ["--plot", str(tmp_path / "b.svg"), "--budget", "torque_constant"]
    assert isinstance(CliRunner().invoke(command, [str(path), *both]).exception, UsageError)
    assert [item.name for item in tmp_path.iterdir()] == ["a.svg"]


@pytest.mark.parametrize(
    ("name", "remedy"),
    [("torque_constnt", "did you mean torque_constant?"), ("foo", "lists all results")],
)
def test_budget_of_an_unknown_result(path, name, remedy):
    done = CliRunner().invoke(command, [str(path), "--budget", name])
    assert isinstance(done.exception, UsageError)
    message = str(done.exception)
    assert f"has no result {name!r}; results with a budget are torque_constant" in message
    assert message.endswith(remedy)
