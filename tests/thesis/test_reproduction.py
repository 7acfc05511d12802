"""The page beside the thesis: nothing missing, every number within what is stated for it."""

import json
import math
import re
import shlex
from contextlib import ExitStack
from pathlib import Path

import click
import h5py
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from rigtool import cli
from rigtool.errors import RunFileError, UsageError
from rigtool.runfile import open_run
from thesis import reproduction
from thesis.values import evaluate, published_entry

ROOT = Path(__file__).parents[2]
DOCS = ROOT / "docs"
FIXTURES = ROOT / "tests" / "fixtures"

FIGURES = [20, *range(22, 29), 30, 32, 34, 35, 39, 40, 41, *range(43, 49), 50, 51, 52, 54, 56]
FIGURES += [*range(58, 64), 68, 70, 75, 76]
"""With data, in chapters 7 and 8 and the appendices."""
TABLES = [5, 6, 7, 8, 9]

STORED = {
    "kt": "kt",
    "friction": "friction",
    "ripple": "ripple",
    "plant": "plant",
    "b": "turning",
    "tables-instrument": "tables",
    "force-instrument": "force",
}
"""Runs of the page that there is a fixture for."""


@pytest.fixture(scope="module")
def runs():
    with ExitStack() as stack:
        yield {
            name: stack.enter_context(open_run(FIXTURES / f"{file}.h5"))
            for name, file in STORED.items()
        }


@pytest.fixture(scope="module")
def committed():
    return json.loads((DOCS / "reproduction" / "numbers.json").read_text("utf-8"))


@pytest.fixture(scope="module")
def page():
    return (DOCS / "reproduction.md").read_text("utf-8")


def row(name):
    (found,) = (one for one in reproduction.reference_rows() if reproduction.row_name(one) == name)
    return found


# -- the committed page


def test_every_figure_and_table_has_its_row(committed, page):
    wanted = {f"figure-{n}" for n in FIGURES} | {f"table-{n}" for n in TABLES}
    assert set(committed) == wanted
    assert {reproduction.row_name(one) for one in reproduction.reference_rows()} == wanted
    headings = re.findall(r"^## (?:Fig\.|Table) (\d+)\. ", page, re.MULTILINE)
    assert sorted(map(int, headings)) == sorted([*FIGURES, *TABLES])


@pytest.mark.parametrize("one", reproduction.reference_rows(), ids=reproduction.row_name)
def test_numbers_are_within_what_is_stated(one, committed):
    stored = committed[reproduction.row_name(one)]["numbers"]
    assert list(stored) == [number["name"] for number in one["numbers"]]
    for number in one["numbers"]:
        value, u, reason = (stored[number["name"]][key] for key in ("value", "u", "reason"))
        assert (u is None) == bool(reason)
        assert math.isfinite(value)
        assert reproduction.holds(number, value) is not False, f"{number['name']}: {value}"


@pytest.mark.parametrize("one", reproduction.reference_rows(), ids=reproduction.row_name)
def test_the_page_says_what_the_rows_say(one, committed, page):
    stored = committed[reproduction.row_name(one)]
    section = page.split(f"## {reproduction.title(one)}\n")[1].split("\n## ")[0]
    assert stored["command"] in section
    assert one.get("differs", "") in section
    for number in one["numbers"]:
        assert number["name"] in section.replace("\\|", "|")
    if "figure" in one:
        assert f"(reproduction/{stored['picture']})" in section


def test_pictures_are_there_and_small(committed):
    pictures = {stored["picture"] for stored in committed.values()} - {None}
    assert {path.name for path in (DOCS / "reproduction").iterdir()} == pictures | {"numbers.json"}
    sizes = [(DOCS / "reproduction" / name).stat().st_size for name in pictures]
    assert len(sizes) == len(FIGURES)
    assert max(sizes) <= reproduction.LARGEST_SVG
    assert sum(sizes) < 3_000_000


def test_commands_are_lines_that_the_command_line_takes(page):
    lines = set(re.findall(r"^rigtool .*$", page, re.MULTILINE))
    assert len(lines) > 10
    for line in lines:
        _, name, *words = shlex.split(line)
        context = click.Context(cli.rigtool)
        command = cli.rigtool.get_command(context, name)
        assert command is not None, line
        command.make_parser(click.Context(command)).parse_args(words)


def test_every_number_has_one_way_to_be_judged():
    for one in reproduction.reference_rows():
        for number in one["numbers"]:
            ways = {"tolerance", "within", "rule"} & set(number)
            published, section = reproduction.published_of(number)
            assert len(ways) == (published is not None), number["name"]
            assert bool(section) == ("published" in number)


# -- judging


@given(
    published=st.sampled_from(["results.stribeck.coulomb_friction", "stated.spring_constant"]),
    tolerance=st.floats(0.001, 0.5),
    off=st.floats(-1, 1),
)
def test_a_number_holds_inside_its_tolerance_only(published, tolerance, off):
    number = {"published": published, "tolerance": tolerance}
    value = published_entry(published)["value"] * (1 + off)
    if abs(abs(off) - tolerance) > 1e-9:
        assert reproduction.holds(number, value) is (abs(off) < tolerance)


@pytest.mark.parametrize(
    ("rule", "met", "value", "holds"),
    [
        ("below", True, 1.6e-3, True),
        ("below", True, 1.8e-3, False),
        ("below", False, 1.8e-3, True),  # neither rig meets it
        ("above", True, 1.8e-3, True),
        ("above", True, math.nan, False),
    ],
)
def test_requirements(rule, met, value, holds):
    number = {"published": "requirements.coulomb_friction", "rule": rule, "met": met}
    assert reproduction.holds(number, value) is holds


def test_what_the_thesis_leaves_open_is_not_judged():
    assert reproduction.holds({"says": "words"}, 1.0) is None


def test_loads_have_a_number_each():
    numbers = row("table-9")["numbers"]
    assert len(numbers) == 15
    assert reproduction.published_of(numbers[3]) == (pytest.approx(26.8e-3, rel=1e-9), "8.2")
    assert reproduction.published_of(numbers[10]) == (pytest.approx(0.07, rel=1e-9), "8.2")


# -- values by name


def test_values_are_those_of_the_file(runs):
    with h5py.File(FIXTURES / "turning.h5") as file:
        swept = file["entry/tables/sweep/on"][:]
        lookup = file["entry/tables/lookup"]
        place = np.argmin(np.abs(lookup["speed"][:] - 31.4))
        torque = lookup["torque"][place].mean()
    assert evaluate("rms sweep.on", runs, "b").value == pytest.approx(np.std(swept), rel=0.02)
    assert evaluate("peak b:sweep.on", runs, "kt").value == pytest.approx(
        np.abs(swept).max(), rel=1e-9
    )
    found = evaluate("mean lookup.torque[speed=31.4]", runs, "b")
    assert found.value == pytest.approx(torque, rel=1e-9)
    assert found.unit == "N m"


def test_a_value_of_a_table_brings_its_uncertainty(runs):
    found = evaluate("torque_constant.torque_constant[temperature=35]", runs, "kt")
    table = runs["kt"].table("torque_constant")
    assert (found.value, found.u) == (table["torque_constant"][1], table["u"][1])


@pytest.mark.parametrize(
    ("ends", "points"),
    [((0, -1), slice(None)), ((2, 5), slice(2, 6)), ((2.5, 5.5), slice(3, 6)), ((1.9, 2.1), [2])],
)
def test_a_range_holds_the_points_between_its_ends_and_no_other(runs, ends, points):
    table = runs["force-instrument"].table("feedforward")
    position, residual = table["position"], table["residual"]
    ends = [position[-1] if end < 0 else np.interp(end, range(9), position[:9]) for end in ends]
    where = f"{ends[0]!r}..{ends[1]!r}".replace("np.float64(", "").replace(")", "")
    for reduce, function in (("peak", lambda v: np.abs(v).max()), ("mean", np.mean)):
        found = evaluate(
            f"{reduce} feedforward.residual[position={where}]", runs, "force-instrument"
        )
        assert found.value == pytest.approx(function(residual[points]), rel=1e-12)


def test_values_are_combined_from_left_to_right(runs):
    constant, mean = (runs["kt"].result(n) for n in ("torque_constant", "torque_constant_mean"))
    found = evaluate("torque_constant - torque_constant_mean / 2", runs, "kt")
    assert found.value == pytest.approx((constant.value - mean.value) / 2, rel=1e-12)
    assert found.u == pytest.approx(math.hypot(constant.u, mean.u) / 2, rel=1e-12)
    assert found.unit == "N m/A"
    ratio = evaluate("torque_constant / torque_constant_mean", runs, "kt")
    assert ratio.unit == "1"
    relative = math.hypot(constant.u / constant.value, mean.u / mean.value)
    assert ratio.u == pytest.approx(ratio.value * relative, rel=1e-12)


def test_settings_and_plain_numbers(runs):
    found = evaluate("3 * recipe.rig.current_limit", runs, "kt")
    assert (found.value, found.unit, found.u) == (30.0, "A", None)
    assert found.reason == "as set in the recipe"


@pytest.mark.parametrize(
    ("expression", "error"),
    [
        ("no_such_result", RunFileError),
        ("no_such.table[speed=1]", RunFileError),
        ("rms of everything", UsageError),
        ("sweep.on", UsageError),  # which one?
    ],
)
def test_what_is_not_there_is_said(runs, expression, error):
    with pytest.raises(error):
        evaluate(expression, runs, "b")


def test_a_healthy_amplifier_is_not_refused(runs):
    assert evaluate("special.low_current_exit", runs, "friction").value == 0


# -- the generator


@pytest.fixture(scope="module")
def made(runs):
    over_the_sweep = {"name": "over the sweep", "value": "sweep_rms_on"}
    compared = row("table-7") | {"run": "b", "also": [], "numbers": [over_the_sweep]}
    wanted = [row("figure-20"), row("figure-40"), row("figure-51"), compared]
    return [reproduction.make_row(one, runs) for one in wanted]


def test_rows_are_made_of_runs(made):
    shown, numbers = made[0]
    assert shown.heading.startswith("Fig. 20. ")
    assert shown.lines == ("rigtool calibrate-kt ../../recipes/briaire-2006.toml -o kt.h5 " + TAIL,)
    constant = shown.numbers[0]
    assert (constant.published, constant.unit, constant.verdict) == ("45.8", "mN\u00a0m/A", "yes")
    assert numbers[constant.name]["value"] == pytest.approx(45.8e-3, rel=0.01)
    name, data = shown.picture
    assert (name, data[:5]) == ("figure-20.svg", b"<?xml")


TAIL = (
    "--set 'calibrate_kt.temperatures_degc=[20, 35, 50]' --set calibrate_kt.record_every=160 --json"
)


def test_the_page_is_whole_in_one_file_or_with_its_folder(made, tmp_path):
    shown = [one for one, _ in made]
    stored = {one.name: {"numbers": numbers} for one, numbers in made}
    reproduction.write(shown, stored, tmp_path, tmp_path / "page.html")
    text = (tmp_path / "page.html").read_text("utf-8")
    addresses = re.findall(r'(?:src|href)="([^"]*)"', text)
    assert len(addresses) == 3
    assert all(address.startswith("data:image/") for address in addresses)
    assert text.count("<h2") == 4
    assert "Yes, function of position" in text
    markdown = (tmp_path / "reproduction.md").read_text("utf-8")
    for name in re.findall(r"\(reproduction/(.*?)\)", markdown):
        assert (tmp_path / "reproduction" / name).stat().st_size > 1000
    assert set(json.loads((tmp_path / "reproduction" / "numbers.json").read_text())) == set(stored)


def test_a_number_outside_its_tolerance_is_said_aloud(runs):
    narrow = {"name": "Kt", "value": "torque_constant", "unit": "mA"}
    narrow |= {"published": "results.stribeck.coulomb_friction", "tolerance": 0.1}
    shown, _ = reproduction.make_row(row("figure-20") | {"numbers": [narrow]}, runs)
    assert shown.numbers[0].verdict == "NO"


@pytest.mark.parametrize(("part", "lines"), [(0.04, 0), (0.06, 1)])
def test_a_single_sweep_is_another_draw_of_noise_on_another_computer(committed, part, lines):
    made = json.loads(json.dumps(committed))
    made["table-7"]["numbers"]["B relative to A"]["value"] *= 1 + part
    assert len(reproduction.changed(made, committed)) == lines


def test_runs_that_are_missing_are_named(tmp_path, capsys):
    code = reproduction.main([str(FIXTURES / "kt.h5"), "--to", str(tmp_path)])
    assert code == UsageError.exit_code
    assert "suspension" in capsys.readouterr().err
    assert not list(tmp_path.iterdir())


def test_numbers_are_held_against_the_committed_ones(committed):
    assert reproduction.changed(committed, committed) == []
    made = json.loads(json.dumps(committed))
    numbers = made["figure-20"]["numbers"]
    name, number = next((n, v) for n, v in numbers.items() if v["u"])
    number["value"] += 0.4 * number["u"]
    assert reproduction.changed(made, committed) == []
    number["value"] += max(number["u"], 2e-3 * abs(number["value"]))
    (line,) = reproduction.changed(made, committed)
    assert line.startswith(f"figure-20: {name}: is ")
    number["value"] = math.nan
    assert len(reproduction.changed(made, committed)) == 1
    del numbers[name]
    assert reproduction.changed(made, committed) == [
        f"figure-20: {name}: is committed, but not made: make pages"
    ]
