"""Scatter of orders over few turns: intervals that hold, and orders that keep their own."""

import numpy as np
import pytest
from scipy import special, stats

from rigtool.experiments.ripple.shared_scatter import (
    BY_CHANCE,
    ENOUGH,
    _inverse_trigamma,
    shared_floor,
)

ORDER = np.arange(1.0, 101)


def drawn(rng, variance, turns):
    """Return the mean of complex coefficients, and their floor by scatter alone."""
    size = (2, turns, len(ORDER))
    real, imaginary = np.sqrt(variance) * rng.standard_normal(size)
    found = real + 1j * imaginary
    mean = found.mean(axis=0)
    scatter = np.sum(np.abs(found - mean) ** 2, axis=0) / (turns - 1)
    return mean, np.sqrt(scatter / turns)


@pytest.mark.parametrize("turns", [2, 5])
@pytest.mark.parametrize("corner", [1.0, 1e9])
def test_intervals_hold_and_none_is_far_off(turns, corner):
    rng = np.random.default_rng(turns)
    pulls, limits = [], []
    for _ in range(40):
        mean, own = drawn(rng, 1 / (1 + (ORDER / corner) ** 2), turns)
        floor, dof = shared_floor(ORDER, own, 2 * (turns - 1))
        pulls.append(mean.real / (floor / np.sqrt(2)))
        limits.append(stats.t.ppf(0.975, dof))
    ratio = np.abs(np.array(pulls) / np.array(limits))
    assert np.mean(ratio < 1) == pytest.approx(0.95, abs=0.015)
    assert np.mean(ratio[:, :5] < 1) == pytest.approx(0.95, abs=0.05)  # neighbours on one side
    # by their own scatter 85 and 3 in 10 000 of two and five turns
    assert np.mean(ratio > 5 / 1.96) < 1e-3


def test_a_scatter_counts_by_its_own_degrees_of_freedom():
    """Of the pooled ones, which are returned: the weight of two variances (Smyth, equation 2)."""
    own = drawn(np.random.default_rng(8), np.ones(len(ORDER)), 4)[1]
    floor, dof = shared_floor(ORDER, own, 6)
    for index in range(20, 80):
        more = own.copy()
        more[index] *= 1.001
        changed, _ = shared_floor(ORDER, more, 6)
        weight = (changed[index] ** 2 - floor[index] ** 2) / (more[index] ** 2 - own[index] ** 2)
        assert weight == pytest.approx(6 / dof[index], abs=0.05)


def test_an_order_that_differs_from_turn_to_turn_keeps_its_own():
    rng = np.random.default_rng(3)
    variance = np.ones(len(ORDER))
    variance[11] = 400.0
    _, own = drawn(rng, variance, 4)
    floor, dof = shared_floor(ORDER, own, 6)
    assert floor[11] == own[11]
    assert dof[11] == 6
    assert np.median(dof) > 12


def test_orders_whose_scatter_has_no_rule_share_little():
    rng = np.random.default_rng(4)
    _, own = drawn(rng, np.exp(3 * rng.standard_normal(len(ORDER))), 4)
    alike, dof_alike = shared_floor(ORDER, drawn(rng, np.ones(len(ORDER)), 4)[1], 6)
    floor, dof = shared_floor(ORDER, own, 6)
    assert np.median(dof) < 8 < np.median(dof_alike)
    assert np.std(np.log(alike)) < 0.1 < np.median(np.abs(np.log(floor / np.median(floor))))


def test_enough_turns_and_orders_without_neighbours_stand_alone():
    rng = np.random.default_rng(5)
    own = drawn(rng, np.ones(len(ORDER)), 11)[1]
    for order, given, dof in ((ORDER, own, ENOUGH), (ORDER[:5], own[:5], 2)):
        floor, free = shared_floor(order, given, dof)
        np.testing.assert_array_equal(floor, given)
        np.testing.assert_array_equal(free, dof)


def test_orders_that_are_not_resolved_or_do_not_scatter_are_left():
    own = drawn(np.random.default_rng(6), np.ones(len(ORDER)), 2)[1]
    own[60:], own[3] = np.nan, 0.0
    floor, dof = shared_floor(ORDER, own, 2)
    assert np.isnan(floor[60:]).all()
    assert floor[3] == 0
    assert np.isfinite(floor[:60]).all()
    assert dof[3] == 2


def test_degrees_of_freedom_have_the_variance_they_are_taken_from():
    value = np.geomspace(1e-4, 1e4, 30)
    np.testing.assert_allclose(special.polygamma(1, _inverse_trigamma(value)), value, rtol=1e-9)
    assert 0 < BY_CHANCE < 0.05
