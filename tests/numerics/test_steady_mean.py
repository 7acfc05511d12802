"""Mean of readings that pay back, and its uncertainty, against what many series scatter."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import t as student

from rigtool.errors import InsufficientDataError
from rigtool.numerics.steady_mean import steady_mean, steady_us, weights


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


@pytest.mark.parametrize("part", [0.0, 0.5, 0.9])
@pytest.mark.parametrize("count", [8, 39])
def test_u_is_the_scatter_of_the_means_of_many_series(part, count):
    """Seven recordings of one motion show together how much is paid back."""
    values = payback(part, 2100, count)
    values += 0.3 * np.random.default_rng(3).standard_normal(values.shape)
    found = [steady_us(list(some)) for some in np.split(values.T, 300)]
    u, dof = np.array([pair for some in found for pair in some]).T
    means = steady_mean(values)
    assert 0.95 < np.sqrt(np.mean(u**2)) / np.std(means) < (1.1 if count == 39 else 1.5)
    within = np.abs(means) < student.ppf(0.975, dof) * u
    assert 0.93 < within.mean() < (0.97 if count == 39 else 1.0)


@pytest.mark.parametrize("part", [0.0, 0.9])
def test_no_number_of_readings_makes_u_jump(part):
    """u over the scatter of means comes down towards 1 by small steps, and never below."""
    ratios = []
    for count in range(3, 13):
        values = payback(part, 700, count, seed=count)
        values += 0.5 * np.random.default_rng(40 + count).standard_normal(values.shape)
        us = [u for some in np.split(values.T, 100) for u, _ in steady_us(list(some))]
        ratios.append(np.sqrt(np.mean(np.square(us))) / np.std(steady_mean(values)))
    assert min(ratios) > 0.93
    assert max(ratios) < 2.3
    steps = np.divide(ratios[1:], ratios[:-1])
    assert 0.75 < steps.min() < steps.max() < 1.2


def test_a_series_that_is_given_again_tells_no_more_of_the_payback():
    first, *others = payback(0.6, 3, 12, seed=4).T
    once = steady_us([first, *others])
    again = steady_us([first] * 5 + others, [1 / 5] * 5 + [1, 1])
    np.testing.assert_allclose(again[4:], once, rtol=1e-9)
    assert steady_us([first] * 5 + others)[4][1] != pytest.approx(once[0][1], rel=0.05)


@pytest.mark.parametrize("part", [1.0, 0.0, -0.9])
def test_u_is_that_of_the_covariance_of_readings(part):
    """Also where all is paid back, and where neighbours are alike."""
    count, series = 200, 40
    values = payback(part, series, count, seed=9)
    covariance = (1 + part**2) * np.eye(count)
    covariance -= part * (np.eye(count, k=1) + np.eye(count, k=-1))
    expected = np.sqrt(weights(count) @ covariance @ weights(count))
    found = steady_us(list(values.T))
    assert np.sqrt(np.mean([u**2 for u, _ in found])) == pytest.approx(expected, rel=0.1)
    if part == 0:  # p is common and known: only the size is each series' own
        np.testing.assert_allclose([dof for _, dof in found], count - 1, rtol=0.1)


def test_payback_makes_the_mean_better_than_one_of_equal_weights():
    values = payback(0.9, 4000, 40)
    assert np.std(steady_mean(values)) < 0.6 * np.std(values.mean(axis=0))


def test_drift_counts():
    steps = np.random.default_rng(2).standard_normal((40, 300)).cumsum(axis=0)
    us = [steady_us([each])[0][0] for each in steps.T]
    assert np.mean(us) > 2 * np.mean(steps.std(axis=0)) / np.sqrt(40)


def test_each_series_has_a_scatter_of_its_own():
    rng = np.random.default_rng(5)
    small, large = rng.standard_normal(40), 10 * rng.standard_normal(40)
    (first, _), (second, _) = steady_us([small, large])
    assert second / first == pytest.approx(large.std() / small.std(), rel=0.1)


def test_readings_without_scatter_have_no_u():
    assert steady_us([np.ones(5)])[0][0] == pytest.approx(0, abs=1e-12)


def test_two_readings_show_no_scatter():
    with pytest.raises(InsufficientDataError, match="2 cycles show no scatter"):
        steady_us([np.array([1.0, 2.0])])
