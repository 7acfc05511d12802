"""Mean of readings that pay back, and its uncertainty, against what many series scatter."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from rigtool.errors import InsufficientDataError
from rigtool.numerics.steady_mean import steady_mean, steady_u, weights


def payback(part, series, count, seed=1):
    fresh = np.random.default_rng(seed).standard_normal((count + 1, series))
    return fresh[1:] - part * fresh[:-1]


@given(st.integers(3, 200))
def test_weights_add_up_to_one_and_fade_to_both_ends(count):
    found = weights(count)
    assert found.sum() == pytest.approx(1, rel=1e-9)
    np.testing.assert_allclose(found, found[::-1], rtol=1e-9)
    assert (np.diff(found[: (count + 1) // 2]) > 0).all()


def test_weights_are_those_of_least_variance_where_all_is_paid_back():
    count = 12
    covariance = 2 * np.eye(count) - np.eye(count, k=1) - np.eye(count, k=-1)
    best = np.linalg.solve(covariance, np.ones(count))
    np.testing.assert_allclose(weights(count), best / best.sum(), rtol=1e-9)


@pytest.mark.parametrize(("part", "low", "high"), [(0.0, 0.95, 1.05), (0.9, 1.0, 1.5)])
def test_u_is_the_scatter_of_the_means_of_many_series(part, low, high):
    values = payback(part, 4000, 40) + 0.5 * np.random.default_rng(3).standard_normal((40, 4000))
    u, dof = steady_u(values)
    assert dof == 6
    assert low < np.sqrt(np.mean(u**2)) / np.std(steady_mean(values)) < high


def test_payback_makes_the_mean_better_than_one_of_equal_weights():
    values = payback(0.9, 4000, 40)
    assert np.std(steady_mean(values)) < 0.6 * np.std(values.mean(axis=0))


def test_drift_counts():
    steps = np.random.default_rng(2).standard_normal((40, 2000)).cumsum(axis=0)
    assert np.mean(steady_u(steps)[0]) > 2 * np.mean(steps.std(axis=0)) / np.sqrt(40)


def test_two_readings_show_no_scatter():
    with pytest.raises(InsufficientDataError, match="2 cycles show no scatter"):
        steady_u(np.array([1.0, 2.0]))
