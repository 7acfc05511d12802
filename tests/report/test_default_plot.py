"""Plots show what is in the file."""

import numpy as np
import pytest

from rigtool.errors import RunFileError, UsageError
from rigtool.report.default_plot import chosen_name, draw_plot, plot_names
from rigtool.runfile import Column, RunWriter, Table, open_run
from tests.runfile.whole_run import SPECS, TABLES, samples


def drawn(path, signals, tables, name=None):
    with RunWriter(path, command="stribeck", recordings=SPECS) as out:
        for recording, block in signals.items():
            out.append(recording, block)
        out.finish({}, tables)
    with open_run(path) as run:
        return draw_plot(run, chosen_name(run, name)).axes[0]


def test_a_table_with_two_axes(tmp_path):
    axes = drawn(tmp_path / "a.h5", {}, TABLES)
    table = TABLES["friction_model"]
    assert axes.get_title() == "stribeck: friction_model"
    assert axes.get_xlabel() == "position [deg]"
    assert axes.get_ylabel() == "torque [mN m]"
    assert [line.get_label() for line in axes.lines] == ["speed 1 rad/s", "speed 2 rad/s"]
    for line, torque in zip(axes.lines, table["torque"], strict=True):
        np.testing.assert_array_equal(line.get_xdata(), np.degrees(table["position"]))
        np.testing.assert_allclose(line.get_ydata(), torque * 1e3, rtol=1e-12, atol=0)


def test_a_table_with_one_axis(tmp_path):
    axes = drawn(tmp_path / "a.h5", {}, {"breakaway": TABLES["breakaway"]})
    (line,) = axes.lines
    np.testing.assert_array_equal(line.get_ydata(), [2.4, np.nan, 5.0])


def test_a_recording_loses_no_peak(tmp_path):
    signals = samples(20_000)
    signals["sweep"]["current"][12_345] = 50.0
    axes = drawn(tmp_path / "a.h5", {"sweep": signals["sweep"]}, {})
    assert axes.get_xlabel() == "time [s]"
    assert axes.get_ylabel() == "current [A]"
    (area,) = axes.collections
    corners = area.get_paths()[0].vertices
    assert corners[:, 1].max() == 50.0
    assert abs(corners[corners[:, 1].argmax(), 0] - 12.345) < 0.011


def test_nothing_to_draw(tmp_path):
    with pytest.raises(RunFileError, match="neither tables nor signals"):
        drawn(tmp_path / "a.h5", {}, {})


def test_a_part_by_its_name(tmp_path):
    signals = samples(200)
    recording = {"sweep": signals["sweep"]}
    axes = drawn(tmp_path / "a.h5", recording, TABLES, "recordings/sweep/encoder")
    assert axes.get_title() == "stribeck: sweep/encoder"
    assert axes.get_ylabel() == "encoder [count]"
    assert drawn(tmp_path / "b.h5", recording, TABLES, "sweep").get_ylabel() == "current [A]"
    axes = drawn(tmp_path / "c.h5", recording, TABLES, "breakaway")
    assert axes.get_title() == "stribeck: breakaway"
    with open_run(tmp_path / "a.h5") as run:
        assert plot_names(run)[0] == f"tables/{next(iter(run.tables))}"
    with pytest.raises(UsageError, match=r"has no part 'sweeps' to draw.* did you mean sweep"):
        drawn(tmp_path / "d.h5", recording, TABLES, "sweeps")


def test_no_line_passes_zero_speed(tmp_path):
    columns = {
        "speed": Column(np.array([-1.0, 1.0, -2.0, 2.0]), "rad/s"),
        "torque": Column(np.array([-3e-3, 3e-3, -4e-3, 4e-3]), "N m"),
    }
    axes = drawn(tmp_path / "a.h5", {}, {"friction": Table(("speed",), columns, "torque", "")})
    (line,) = axes.lines
    np.testing.assert_allclose(line.get_ydata(), [-4, -3, np.nan, 3, 4], rtol=1e-12)


def test_numbered_values_are_points_at_whole_numbers(tmp_path):
    columns = {"load": Column(np.arange(3), "1"), "torque": Column(np.arange(3.0), "N m")}
    axes = drawn(tmp_path / "a.h5", {}, {"loads": Table(("load",), columns, "torque", "")})
    (line,) = axes.lines
    assert line.get_linewidth() == 0
    np.testing.assert_array_equal(axes.get_xticks(), np.round(axes.get_xticks()))


def test_nothing_is_drawn_where_nothing_was_recorded(tmp_path):
    signals = samples(200)["sweep"]
    signals["time"][100:] += 10.0
    axes = drawn(tmp_path / "a.h5", {"sweep": signals}, {})
    (area,) = axes.collections
    assert len(area.get_paths()) == 2


def test_rows_with_a_time_are_drawn_over_it(tmp_path):
    columns = {
        "row": Column(np.arange(5), "1"),
        "recording": Column(np.array([0, 0, 0, 1, 1]), "1"),
        "time": Column(np.array([7.0, 7.5, 8.0, 2.0, 2.5]), "s"),
        "torque": Column(np.array([1e-3, np.nan, 3e-3, 4e-3, 5e-3]), "N m"),
    }
    axes = drawn(tmp_path / "a.h5", {}, {"force": Table(("row",), columns, "torque", "")})
    assert axes.get_xlabel() == "time [s]"
    first, second = axes.lines
    np.testing.assert_array_equal(first.get_xdata(), [7.0, 7.5, 8.0])
    np.testing.assert_allclose(first.get_ydata(), [1, np.nan, 3], rtol=1e-12)
    np.testing.assert_array_equal(second.get_xdata(), [2.0, 2.5])
    np.testing.assert_allclose(second.get_ydata(), [4, 5], rtol=1e-12)
