"""Loads of closing strokes, against statistics of the strokes themselves."""

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.stats import chi, f_oneway

from rigtool.experiments.force.imported_strokes import Strokes, scatter_results, stroke_loads


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
    found, notes = scatter_results([Strokes(np.arange(3.0), 1 + error, np.ones((3, 3)))])
    # squares of 4 + 0 + 4 and 4 + 4 (mN m)^2, with two and one degrees of freedom
    assert_allclose(found["scatter_between_strokes"].value, 1e-3 * np.sqrt(16 / 3), rtol=1e-9)
    assert set(found) == {"scatter_between_strokes"}
    assert not notes
    alone = [Strokes(np.zeros(1), np.full((1, 1), value), np.ones((1, 1))) for value in (1.0, 1.2)]
    found, notes = scatter_results(alone)
    assert_allclose(found["scatter_between_runs"].value, 0.2 / np.sqrt(2), rtol=1e-12)
    assert set(found) == {"scatter_between_runs"}
    assert not notes
