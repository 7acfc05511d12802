"""Figures of force over time, drawn of made-up tables."""

from pathlib import Path

import numpy as np
import pytest

from rigtool.recipe import load_recipe
from rigtool.report import build
from rigtool.report.figures import PLOTS, style
from rigtool.report.figures.over_time import MAX_POINTS
from rigtool.report.tables import force_tables
from rigtool.runfile import Column, RunWriter, Table, open_run

ROOT = Path(__file__).parents[3]
TIME = np.arange(0, 20, 0.005)
REFERENCE = np.where((TIME > 12) & (TIME < 13), 20e-3, 0.0)
ERROR = 1e-3 * np.sin(7 * TIME)
NUMBERS = (104, 105, 106)


def tables(*, judged):
    torque = np.where(TIME < 1, np.nan, REFERENCE + ERROR)
    columns = {
        "row": Column(np.arange(len(TIME)), "1"),
        "recording": Column(np.zeros(len(TIME), dtype=int), "1"),
        "time": Column(100 + TIME, "s"),
        "torque": Column(torque, "N m"),
        "low": Column(torque - 2e-3, "N m"),
        "high": Column(torque + 2e-3, "N m"),
    }
    if not judged:
        return {"force": Table(("row",), columns, "torque", "")}
    columns["reference"] = Column(REFERENCE, "N m")
    rmse = np.full((3, 2), 0.4e-3)
    rmse[1] = np.nan
    accuracy = {
        "band": Column(np.array([0.0, 1e-3, 5e-3]), "N m"),
        "state": Column(np.array([1, 4]), "1"),
        "rmse": Column(rmse, "N m"),
        "coverage_95": Column(np.where(np.isnan(rmse), np.nan, 0.96), "1"),
    }
    return {
        "force": Table(("row",), columns, "torque", ""),
        "force_accuracy": Table(("band", "state"), accuracy, "rmse", ""),
    }


def stored(path, *, judged, inputs=()):
    recipe, text = load_recipe(ROOT / "recipes" / "briaire-2006.toml", [])
    with RunWriter(
        path, command="measure-force", recipe=recipe, recipe_text=text, inputs=inputs
    ) as writer:
        writer.finish({}, tables(judged=judged))
    return open_run(path)


@pytest.fixture(scope="module")
def judged(tmp_path_factory):
    with stored(tmp_path_factory.mktemp("figures") / "f.h5", judged=True) as run:
        yield run


def lines(axes):
    return {line.get_label(): line for line in axes.lines}


def test_a_run_without_reference_has_torque_and_interval_only(tmp_path, judged):
    with stored(tmp_path / "f.h5", judged=False) as run:
        assert [n for n in NUMBERS if PLOTS[n].fits(run)] == [104, 105]
        (axes,) = PLOTS[104].draw(run).axes
        assert list(lines(axes)) == ["from motor current"]
    assert [n for n in NUMBERS if PLOTS[n].fits(judged)] == [104, 105, 106]


def test_the_error_is_torque_less_reference_about_its_interval(judged):
    torque, error = PLOTS[104].draw(judged).axes
    assert set(lines(torque)) == {"reference", "from motor current"}
    drawn = error.lines[0].get_ydata()
    np.testing.assert_allclose(drawn[TIME > 1], 1e3 * ERROR[TIME > 1], rtol=0, atol=1e-9)
    assert np.isnan(drawn[TIME < 1]).all()
    assert torque.get_xlim() == pytest.approx((0, TIME[-1]), rel=1e-6)


def test_the_peak_is_in_the_middle_of_its_figure(judged):
    torque, _ = PLOTS[105].draw(judged).axes
    left, right = torque.get_xlim()
    peak = TIME[np.nanargmax(REFERENCE + ERROR)]
    assert (left, right) == pytest.approx((peak - 3, peak + 3), abs=0.01)


def test_bands_without_samples_are_left_out(judged):
    rmse, coverage = PLOTS[106].draw(judged).axes
    assert [label.get_text() for label in coverage.get_xticklabels()] == ["0 to 1", "above 5"]
    heights = [bar.get_height() for bar in rmse.patches]
    np.testing.assert_allclose(heights, 0.4, rtol=1e-9, atol=0)


def test_all_are_drawn_to_the_end(judged):
    for number in NUMBERS:
        with style.styled():
            svg, png = style.render_figure(PLOTS[number].draw(judged))
        assert svg.startswith("<?xml")
        assert png.startswith(b"\x89PNG")


def test_a_run_that_was_analysed_again_is_not_called_foreign(tmp_path, judged):
    with stored(tmp_path / "again.h5", judged=True, inputs=[judged]) as again:
        assert build.build_report([again]).warnings == ()


def test_the_table_shows_the_largest_torque_of_each_section(judged):
    (table,) = force_tables(judged, "f")
    assert len(table.rows) == 10
    columns = [column.key for column in table.columns]
    rows = [dict(zip(columns, (cell.value for cell in row), strict=True)) for row in table.rows]
    shown = max(rows, key=lambda row: row["torque"])
    torque = judged.table("force")["torque"]
    assert shown["torque"] == pytest.approx(np.nanmax(torque), rel=1e-12)
    assert 112 <= shown["time"] <= 113
    assert (shown["torque"] - shown["low"], shown["force"]) == (pytest.approx(2e-3, rel=1e-9), None)


def force_table(time, torque, half):
    columns = {
        "row": Column(np.arange(len(time)), "1"),
        "recording": Column(np.zeros(len(time), dtype=int), "1"),
        "time": Column(time, "s"),
        "torque": Column(torque, "N m"),
        "low": Column(torque - half, "N m"),
        "high": Column(torque + half, "N m"),
    }
    return Table(("row",), columns, "torque", "")


def test_no_curve_or_band_joins_the_sides_of_a_gap(judged):
    kept = (TIME < 8) | (TIME > 9)
    table = force_table(TIME[kept], np.full(kept.sum(), 1e-3), 1e-3)
    for number in (104, 105):
        (axes,) = PLOTS[number].function(judged, table).axes
        time, torque = axes.lines[0].get_data()
        between = np.flatnonzero(np.diff(time) > 0.5)
        assert between.size <= 1
        assert all(np.isnan(torque[k]) or np.isnan(torque[k + 1]) for k in between)
        assert np.isnan(torque).sum() == (number == 104)


@pytest.mark.parametrize("count", [1, 2, 7 * MAX_POINTS + 3])
def test_a_short_contact_shows_among_any_number_of_rows(judged, count):
    torque = np.zeros(count)
    torque[count // 2] = 5e-3
    half = np.full(count, 1e-3)
    half[: count // 4] = 20e-3
    table = force_table(0.005 * np.arange(count), torque, half)
    (axes,) = PLOTS[104].function(judged, table).axes
    time, drawn = axes.lines[0].get_data()
    assert len(time) <= MAX_POINTS
    assert drawn.max() == pytest.approx(5.0)
    assert time[drawn.argmax()] == pytest.approx(0.005 * (count // 2), rel=1e-9)


def test_a_torque_of_a_wide_interval_is_not_the_largest(tmp_path):
    torque = np.where((TIME > 12) & (TIME < 13), 2e-3, 0.0)
    half = np.full(TIME.size, 0.5e-3)
    wide = np.abs(TIME - 12.5) < 0.1
    torque[wide], half[wide] = -3e-3, 6e-3
    recipe, text = load_recipe(ROOT / "recipes" / "briaire-2006.toml", [])
    path = tmp_path / "f.h5"
    with RunWriter(path, command="measure-force", recipe=recipe, recipe_text=text) as writer:
        writer.finish({}, {"force": force_table(TIME, torque, half)})
    with open_run(path) as run:
        (table,) = force_tables(run, "f")
        torques = [row[1].value for row in table.rows]
        assert (min(torques), max(torques)) == pytest.approx((0.0, 2e-3))
        left, right = PLOTS[105].draw(run).axes[0].get_xlim()
        assert (left + right) / 2 == pytest.approx(12.0, abs=0.02)
