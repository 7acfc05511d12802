"""Figures of imported runs, in the unit that their tables have."""

from types import SimpleNamespace

import numpy as np
import pytest

from rigtool.quantity import Quantity
from rigtool.report.figures.plots import PLOTS, other_unit_drawn
from rigtool.runfile import Column, Table


def run(command, name, axes, signal, columns, **results):
    """A run with one table, of columns with their units."""
    table = Table(axes, {k: Column(np.array(v), u) for k, (v, u) in columns.items()}, signal, "")
    found = {key: Quantity(value, "1", reason="for a test") for key, value in results.items()}
    return SimpleNamespace(
        command=command, recipe=None, results=found, tables={name: table}, table=lambda _: table
    )


def drawn(made):
    """The one figure that a run has."""
    (plot,) = [plot for plot in PLOTS.values() if plot.fits(made)]
    assert other_unit_drawn(made) is None
    return plot.draw(made)


@pytest.mark.parametrize(("unit", "shown", "factor"), [("A", "A", 1), ("N m", "mN m", 1e3)])
def test_both_shares_that_a_map_removes(unit, shown, factor):
    amplitude = np.linspace(0.5, 0.01, 20)
    figure = drawn(
        run(
            "ilc-check",
            "held_out",
            ("order",),
            "remaining",
            {
                "order": (np.arange(1, 21), "1"),
                "amplitude": (amplitude, unit),
                "remaining": (amplitude / 4, unit),
                "remaining_noise_floor": (amplitude / 9, unit),
            },
            removed=0.8,
            record_variance_removed=0.15,
        )
    )
    (axes,) = figure.axes
    assert axes.get_ylabel() == f"amplitude [{shown}]"
    assert "96.0 % of what repeats, 15.0 % of the raw record" in axes.get_xlabel()
    before, after = (np.array([bar.get_height() for bar in bars]) for bars in axes.containers)
    np.testing.assert_allclose(before, factor * amplitude[:12])
    np.testing.assert_allclose(after, factor * amplitude[:12] / 4)


def test_the_change_between_two_runs_over_time_and_position():
    time = np.arange(9.0)
    columns = {
        "time": (time, "s"),
        "position": (np.sin(time), "m"),
        "difference": (np.where(time == 4, np.nan, time * 1e-3), "N"),
        "model": (time * 1e-3, "N"),
    }
    figure = drawn(run("stribeck", "paired_difference", ("time",), "difference", columns))
    left, right = figure.axes
    assert (left.get_ylabel(), right.get_xlabel()) == ("difference [mN]", "position [m]")
    np.testing.assert_allclose(left.lines[0].get_ydata(), columns["difference"][0] * 1e3)


def test_the_map_of_a_turn():
    columns = {
        "speed": ([2.0], "rad/s"),
        "position": (np.radians([0, 90, 180, 270]), "rad"),
        "current": ([[1, 2, 3, 4]], "A"),
    }
    figure = drawn(run("ilc-learn", "lookup", ("speed", "position"), "current", columns))
    (line,) = figure.axes[0].lines
    np.testing.assert_allclose(line.get_xydata(), [[0, 1], [90, 2], [180, 3], [270, 4]])
