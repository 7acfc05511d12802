"""The mean over a turn against a least-squares fit by scipy, and orders that angles average out."""

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.optimize import curve_fit

from rigtool.numerics.turn_mean import mean_over_turn

TURN = 2 * np.pi


@pytest.mark.parametrize("count", [5, 9, 13])
def test_mean_and_uncertainty_are_those_of_a_fit_with_low_orders(count):
    rng = np.random.default_rng(count)
    angle = TURN * (np.arange(count) + rng.uniform(0, 0.5, count)) / count
    value = 45 + np.cos(angle) + 0.1 * rng.standard_normal(count)

    def model(at, mean, *waves):
        orders = np.arange(1, count // 4 + 1)[:, None]
        return mean + waves[::2] @ np.cos(orders * at) + waves[1::2] @ np.sin(orders * at)

    size = 1 + 2 * (count // 4)
    fitted, covariance = curve_fit(model, angle, value, np.zeros(size))
    found = mean_over_turn(angle, value)
    assert_allclose(found.value, fitted[0], rtol=1e-6)
    assert_allclose(found.u, np.sqrt(covariance[0, 0]), rtol=1e-5)
    assert found.dof == count - size


@pytest.mark.parametrize("order", [1, 2, 3, 4])
def test_orders_up_to_a_quarter_of_the_angles_leave_no_scatter(order):
    """The angles are not spread evenly: the orders are fitted, not averaged out."""
    angle = (TURN * np.arange(16) / 16 + 0.15 * np.sin(np.arange(16))) % TURN
    found = mean_over_turn(angle, 3 + 0.5 * np.sin(order * angle + 0.3))
    assert_allclose([found.value, found.u], [3, 0], rtol=0, atol=1e-12)


def test_values_at_one_angle_are_averaged_first():
    angle = np.array([1.0, 1.001, 3.0, TURN - 1e-3, 1e-3])
    found = mean_over_turn(angle, np.array([2.0, 4.0, 6.0, 8.0, 10.0]))
    assert_allclose([found.value, found.dof], [(3 + 6 + 9) / 3, 2])
    assert_allclose(found.u, np.std([3, 6, 9], ddof=1) / np.sqrt(3))


def test_one_value_has_no_scatter_and_none_no_mean():
    one, none = (mean_over_turn(np.full(n, 2.0), np.full(n, 7.0)) for n in (1, 0))
    assert (one.value, one.dof) == (7.0, 0)
    assert none.dof == 0
    assert np.isnan([one.u, one.scatter, none.value, none.u, none.scatter]).all()


def test_values_without_angles_are_repeats():
    values = np.array([1.0, 2.0, 4.0])
    found = mean_over_turn(np.full(3, np.nan), values)
    assert_allclose([found.value, found.dof, found.u], [7 / 3, 2, np.std(values, ddof=1) / 3**0.5])
