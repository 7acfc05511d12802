"""Coefficients from some recordings beside ridge regression written out; factors of levels."""

from types import SimpleNamespace

import numpy as np
import pytest
from scipy import stats

from rigtool.experiments.imported_load.basis import SPLINE_COUNT, splines
from rigtool.experiments.imported_load.side import (
    COVERAGE_FACTOR,
    INTERVAL_COVERAGE,
    Fit,
    Rows,
    Sums,
)


def sums(seed=1, recordings=5):
    random = np.random.default_rng(seed)
    columns, effort = random.standard_normal((60, 3)), random.standard_normal(60)
    weight, recording = random.uniform(0.5, 2, 60), np.arange(60) % recordings
    half = random.standard_normal((3, 3))
    penalty, centre = 0.01 * half @ half.T, random.standard_normal(3)
    return columns, effort, weight, recording, penalty, centre


@pytest.mark.parametrize("keep", [[0, 1, 2, 3, 4], [0, 3]])
def test_it_is_weighted_ridge_regression_of_the_recordings_kept(keep):
    columns, effort, weight, recording, penalty, centre = sums()
    found = Sums.of(columns, effort, weight, recording, penalty, centre)
    assert found.all.tolist() == [0, 1, 2, 3, 4]
    own = np.isin(recording, keep)
    x, y, w = columns[own], effort[own], weight[own]
    held = w.sum() * penalty
    matrix = x.T @ (w[:, None] * x) + held
    expected = np.linalg.solve(matrix, x.T @ (w * y) + held @ centre)
    coefficients = found.solve(np.array(keep))
    np.testing.assert_allclose(coefficients, expected, rtol=1e-9)
    # the sandwich of what recordings disagree by, n - 1 of which are free
    left = w * (y - x @ coefficients)
    scores = np.array([x[recording[own] == k].T @ left[recording[own] == k] for k in keep])
    inverse = np.linalg.inv(matrix)
    sandwich = inverse @ scores.T @ scores @ inverse * len(keep) / (len(keep) - 1)
    np.testing.assert_allclose(found.covariance(np.array(keep), coefficients), sandwich, rtol=1e-9)


def test_a_level_asks_for_the_interval_that_holds_the_rows_left_out():
    """Of normal ratios each level asks for as much as they scatter, and for Student's t."""
    random = np.random.default_rng(2)
    level = np.repeat([0, 1, 2, 3], 50_000)
    size = np.array([1.0, 2.0, 3.0, 4.0])
    by_load = np.abs(random.standard_normal(200_000)) * size[level]
    by_turn = 0.5 * by_load
    by_load[::7] = np.nan  # not resolved
    rows = SimpleNamespace(recording=np.arange(200_000) % 6, torque=0.1 * level + 0.05)
    made = SimpleNamespace(folds=[level, level % 2], level=level, rows=rows)
    levels, factors = Fit._factors(made, [by_load, by_turn])
    np.testing.assert_allclose(levels, [0.05, 0.05, 0.15, 0.25, 0.35, 0.35], rtol=1e-12)
    wider = stats.t(5).ppf((1 + INTERVAL_COVERAGE) / 2) / COVERAGE_FACTOR
    quantile = stats.norm.ppf((1 + INTERVAL_COVERAGE) / 2) / COVERAGE_FACTOR
    # the ends: outermost as they were left out, then by the other ways alone
    expected = np.array([1.0, 0.5, 2.0, 3.0, 2.0, 4.0]) * wider * quantile
    np.testing.assert_allclose(factors, expected, rtol=0.02)
    # ways that leave out no whole load count alike
    made.folds = [level % 2, level // 2]
    _, factors = Fit._factors(made, [by_load, by_turn])
    expected = np.array([1.0, 1.0, 2.0, 3.0, 4.0, 4.0]) * wider * quantile
    np.testing.assert_allclose(factors, expected, rtol=0.02)
    # a level that no other way leaves out asks for what leaving it out itself shows
    made.folds = [level, np.where(level % 3 > 0, level, -1)]
    by_turn[level % 3 == 0] = np.nan
    _, factors = Fit._factors(made, [by_load, by_turn])
    expected = np.array([1.0, 1.0, 2.0, 3.0, 4.0, 4.0]) * wider * quantile
    np.testing.assert_allclose(factors, expected, rtol=0.02)


@pytest.mark.parametrize(("apart", "bent"), [(0.2, 0.0), (0.0, 0.2)])
def test_the_middle_of_three_loads_counts_as_it_was_left_out_where_less_was_left(apart, bent):
    """By its neighbours where runs of it differ by `apart`, by its other run where effort bends."""
    random = np.random.default_rng(3)
    recording, level = np.repeat(np.arange(6), 200), np.repeat([0, 0, 1, 1, 2, 2], 200)
    torque, place = 0.5 * level, np.tile(np.linspace(0, 1, 200), 6)
    effort = torque + np.array([0, 0, -apart, apart, 0, 0])[recording] / 2 + bent * (level == 1)
    rows = Rows(
        functions={name: splines(place, SPLINE_COUNT[name]) for name in ("offset", "load")},
        effort=effort + random.normal(0, 0.01, effort.size),
        torque=torque,
        speed=np.ones(effort.size),
        place=place,
        recording=recording,
    )
    turns = np.array([0, 1, 1, 0, 0, 1])[recording]
    never = np.full(effort.size, -1)
    _, held = Fit.of(rows, ("offset", "load"), level, [level, turns], None).model(never, never)
    middle = level == 1
    assert not np.allclose(held.within[~middle], held.error[~middle], atol=1e-3)
    as_left_out = np.allclose(held.within[middle], held.error[middle])
    assert as_left_out == (bent == 0)
    assert np.sum(held.within[middle] ** 2) <= np.sum(held.error[middle] ** 2)
