"""Loads of closing strokes, against statistics of the strokes themselves."""

from types import SimpleNamespace

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.stats import chi, f_oneway

from rigtool.experiments.force.imported_strokes import (
    STROKE_CELLS,
    Strokes,
    read_strokes,
    scatter_results,
    stroke_loads,
)


def test_a_load_is_the_mean_of_all_strokes_and_its_u_that_of_runs():
    luck = np.random.default_rng(5)
    place, middle = np.linspace(0, 1, 51), 25
    runs = [
        Strokes(place, 0.05 + 1e-3 * luck.standard_normal((count, 51)), np.full((count, 51), 0.049))
        for count in (3, 4)
    ]
    found = stroke_loads(runs, [0, 0])
    torque = np.concatenate([one.torque[:, middle] for one in runs])
    errors = [np.mean(one.torque[:, middle] - 0.049) for one in runs]
    assert_allclose(found["mean_torque"], [torque.mean()], rtol=1e-12)
    assert_allclose(found["std_torque"], [np.std(torque, ddof=1)], rtol=1e-12)
    assert_allclose(found["mean_torque_u"], [np.std(errors, ddof=1) / np.sqrt(2)], rtol=1e-12)
    assert_allclose(found["applied_torque"], [0.049], rtol=1e-12)
    # S of seven normal readings is distributed as chi
    assert_allclose(found["std_torque_u"] / found["std_torque"], chi.std(6) / 6**0.5, rtol=0.05)
    assert (found["cycles"][0], found["effective_cycles"][0]) == (7, 2)
    assert found["mean_torque_dof"][0] == 1


@pytest.mark.parametrize("direction", [1, -1])
def test_a_single_stroke_has_no_scatter(direction):
    place = np.linspace(0, 1, 51)
    one = Strokes(place, np.full((1, 51), 0.05 * direction), np.full((1, 51), 0.049 * direction))
    found = stroke_loads([one], [0])
    assert_allclose(found["mean_torque"], [0.05], rtol=1e-12)
    assert np.isnan(found["std_torque"]).all()


def test_scatter_within_and_between_runs_is_that_of_an_analysis_of_variance():
    """At one position: F = s_b^2 / s_w^2 for s_b^2 of means of m strokes times m."""
    luck = np.random.default_rng(7)
    errors = [2e-3 * luck.standard_normal() + 1e-3 * luck.standard_normal((5, 1)) for _ in range(4)]
    runs = [Strokes(np.zeros(1), 0.05 + own, np.full((5, 1), 0.05)) for own in errors]
    found, notes = scatter_results(runs)
    within = found["scatter_between_strokes"].value
    between = found["scatter_between_runs"].value
    assert_allclose(within**2, np.mean([own.var(ddof=1) for own in errors]), rtol=1e-12)
    ratio = f_oneway(*(own[:, 0] for own in errors)).statistic
    assert_allclose(5 * (between / within) ** 2, ratio, rtol=1e-9)
    assert_allclose(found["repeatability"].value ** 2, within**2 + between**2, rtol=1e-12)
    assert f"{found['repeatability'].value * 1e3:.3g} mN m together" in notes[0]


def test_strokes_that_miss_a_position_count_where_they_are():
    """Positions have means of their own; those of one stroke show no scatter."""
    error = np.array([[0.0, 10.0, np.nan], [2.0, 14.0, np.nan], [4.0, np.nan, 7.0]]) * 1e-3
    error = np.column_stack([error, np.full(3, np.nan)])  # where those of another run are
    found, notes = scatter_results([Strokes(np.arange(4.0), 1 + error, np.ones((3, 4)))])
    # squares of 4 + 0 + 4 and 4 + 4 (mN m)^2, with two and one degrees of freedom
    assert_allclose(found["scatter_between_strokes"].value, 1e-3 * np.sqrt(16 / 3), rtol=1e-9)
    assert set(found) == {"scatter_between_strokes"}
    assert not notes
    alone = [Strokes(np.zeros(1), np.full((1, 1), value), np.ones((1, 1))) for value in (1.0, 1.2)]
    found, notes = scatter_results(alone)
    assert_allclose(found["scatter_between_runs"].value, 0.2 / np.sqrt(2), rtol=1e-12)
    assert set(found) == {"scatter_between_runs"}
    assert not notes


def test_strokes_of_all_runs_are_read_at_common_positions():
    """From the least to the farthest place of any stroke; NaN where a stroke is not. Fewer than
    three samples are no stroke."""

    def run(low, high, offset):
        place = np.concatenate([np.linspace(low, high, 40), np.linspace(high, low, 30)])
        fast = np.zeros(70, dtype=bool)
        fast[:40] = fast[42:45] = fast[50:52] = True
        signals = SimpleNamespace(place=place, sensor=3 * place)
        return signals, 2 * place + offset, fast

    found = read_strokes([run(0.1, 0.8, 0.0), run(0.2, 1.1, 5.0)])
    grid = np.linspace(0.1, 1.1, 2 * STROKE_CELLS + 1)
    for item, (low, high), offset in zip(found, ((0.1, 0.8), (0.2, 1.1)), (0.0, 5.0), strict=True):
        assert_allclose(item.place, grid)
        assert item.torque.shape == item.sensor.shape == (2, len(grid))
        inside = (grid >= low - 1e-12) & (grid <= high + 1e-12)
        assert_allclose(item.torque[0], np.where(inside, 2 * grid + offset, np.nan), atol=1e-9)
        assert_allclose(item.sensor[0], np.where(inside, 3 * grid, np.nan), atol=1e-9)
        short = np.isfinite(item.torque[1])
        step = (high - low) / 29
        assert np.ptp(grid[short]) <= 2 * step
        assert_allclose(item.torque[1][short], 2 * grid[short] + offset, atol=1e-9)
        assert short.any()
    nothing = run(0.1, 0.8, 0.0)
    nothing[2][:] = False
    assert read_strokes([nothing]) == []


def test_loads_are_those_of_each_level_against_closing():
    """The sign is that of all sensors; a level that no stroke passes the middle of has no row."""
    place = np.linspace(0, 1, 51)

    def strokes(torque, sensor, count=2):
        return Strokes(place, np.full((count, 51), torque), np.full((count, 51), sensor))

    missing = strokes(np.nan, -0.02)
    given = [strokes(-0.05, -0.049), strokes(-0.021, -0.02), strokes(-0.053, -0.049), missing]
    found = stroke_loads(given, [1, 0, 1, 2])
    assert_allclose(found["applied_torque"], [0.02, 0.049])
    assert_allclose(found["mean_torque"], [0.021, 0.0515])
    assert_allclose(found["error_torque"], [0.001, 0.0025])
    assert_allclose(found["mean_torque_u"][1], np.std([0.05, 0.053], ddof=1) / np.sqrt(2))
    assert np.isnan(found["mean_torque_u"][0])
    assert_allclose(found["cycles"], [2, 4])
    assert "at 0.5 rad" in found.description
    assert stroke_loads([missing], [0]) is None
    assert stroke_loads([], []) is None
