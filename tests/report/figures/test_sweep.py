"""Figures of learning run by run and of sweeps: drawn of which run, and what they show."""

from pathlib import Path

import numpy as np
import pytest

from rigtool.recipe import load_recipe
from rigtool.report.figures import PLOTS, style, sweep
from rigtool.runfile import Column, RunWriter, Table, open_run

ROOT = Path(__file__).parents[3]
TURNING = ROOT / "tests" / "fixtures" / "turning.h5"
SPEED = np.linspace(-30, 30, 9000)
ITERATIONS = np.arange(4.0)


def column(values, unit):
    return Column(np.asarray(values), unit)


def tables_of_a():
    """Tables as implementation A writes them, made up: ripple that each step halves."""
    ripple = 1e-3 * np.cos(np.linspace(0, 900, SPEED.size))
    swept = {"off": ripple, "plain": ripple / 2, "on": ripple / 4, "table": 2 * ripple}
    speeds = np.array([-6.0, -1, 1, 6])
    return {
        "tuning": Table(
            ("speed",),
            {
                "speed": column(speeds, "rad/s"),
                "amplitude": column([0.5, 1, 1, 0.5], "1"),
                "amplitude_u": column([0.1] * 4, "1"),
                "shift": column([0.4, 0.1, 0, -0.3], "rad"),
                "shift_u": column([0.01] * 4, "rad"),
            },
            "amplitude",
            "",
        ),
        "iterations": Table(
            ("iteration",),
            {
                "iteration": column(ITERATIONS, "1"),
                "rms": column(1e-3 / 2**ITERATIONS, "N m"),
                "rms_u": column(1e-5 + 0 * ITERATIONS, "N m"),
                "non_repeatable_rms": column(1e-4 + 0 * ITERATIONS, "N m"),
            },
            "rms",
            "",
        ),
        "sweep": Table(
            ("time",),
            {
                "time": column(np.arange(float(SPEED.size)), "s"),
                "speed": column(SPEED, "rad/s"),
                **{name: column(values, "N m") for name, values in swept.items()},
            },
            "on",
            "",
        ),
    }


@pytest.fixture(scope="module")
def of_a(tmp_path_factory):
    path = tmp_path_factory.mktemp("figures") / "a.h5"
    settings = ["ilc_learn.implementation=A", "rig.attachment=pulley"]
    recipe, text = load_recipe(ROOT / "recipes" / "briaire-2006.toml", settings)
    with RunWriter(path, command="ilc-learn", recipe=recipe, recipe_text=text) as writer:
        writer.finish({}, tables_of_a())
    with open_run(path) as run:
        yield run


@pytest.fixture(scope="module")
def of_b():
    with open_run(TURNING) as run:
        yield run


def test_each_way_of_learning_has_its_figures(of_a, of_b):
    drawn = [[n for n, plot in sorted(PLOTS.items()) if plot.fits(run)] for run in (of_a, of_b)]
    assert drawn == [[42, 44, 46, 47, 48], [40, 41, 50, 51, 52, 54, 112]]


def test_figures_of_a_run_are_drawn_to_the_end(of_a, of_b):
    for run in (of_a, of_b):
        for plot in PLOTS.values():
            if plot.fits(run) and plot.number >= 42:
                with style.styled():
                    svg, png = style.render_figure(plot.draw(run))
                assert svg.startswith("<?xml")
                assert png.startswith(b"\x89PNG")


def test_a_sweep_shows_every_extreme(of_a):
    """Thousands of samples become fewer points, the peaks stay."""
    for number, peak in ((46, 1.0), (47, 0.5), (48, 0.25)):
        (axes,) = PLOTS[number].draw(of_a).axes
        (line,) = axes.lines
        assert np.abs(line.get_ydata()).max() == pytest.approx(peak, rel=1e-3)
        assert len(line.get_xdata()) <= 2 * sweep.MAX_POINTS
        assert line.get_xdata()[0] == pytest.approx(-30 / (2 * np.pi), rel=1e-9)
        low, high = axes.get_ylim()
        assert low < -1 < 1 < high  # one scale for all


def test_the_table_is_drawn_beside_what_remains(of_b):
    (axes,) = PLOTS[54].draw(of_b).axes
    remaining, fed = (np.abs(line.get_ydata()).max() for line in axes.lines)
    table = of_b.table("sweep")
    assert fed == pytest.approx(1e3 * np.abs(table["table"]).max(), rel=1e-6)
    assert remaining == pytest.approx(1e3 * np.abs(table["on"]).max(), rel=1e-6)


def test_the_amplitude_falls_run_by_run(of_a):
    (axes,) = PLOTS[44].draw(of_a).axes
    assert axes.get_ylabel() == "rms [mN m]"
    line = axes.lines[0]
    np.testing.assert_allclose(line.get_ydata(), 1 / 2**ITERATIONS, rtol=1e-9, atol=0)
