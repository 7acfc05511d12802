"""Loss of the torque constant by a current that lasts."""

import math
from types import SimpleNamespace

import numpy as np
import pytest

from rigtool.experiments.torque_constant.staircases.hypotheses import (
    LAW,
    Weighed,
    _untried,
    loss_by_heat,
)
from rigtool.experiments.torque_constant.staircases.model import HEATING_TIME, Common

BEST = Common(0.02, 1.0, 0.1, 30.0)


def weighed_from(loss, square, variance=0.0, independent=40.0):
    """Return hypotheses of which only the loss by heat is known."""
    own = np.column_stack(np.broadcast_arrays(loss, variance, square))
    unknown = np.full(len(loss), np.nan)
    return Weighed(BEST, *[unknown] * 3, independent, *[unknown] * 2, np.ones(len(loss)), own)


@pytest.mark.parametrize("time_constant", [5.0, 30.0, 150.0])
def test_between_two_time_constants_a_loss_is_as_uncertain_as_their_distance(time_constant):
    """Against drawn time constants, all of which have the same loss after a staircase."""
    tau = time_constant * np.exp(0.4 * np.linspace(-0.5, 0.5, 10_001))
    grown = np.expm1(-HEATING_TIME / tau) / np.expm1(-8.0 / tau)
    found = _untried(Common(None, 1.0, None, time_constant), 8.0, 0.4)
    assert found == pytest.approx(np.std(np.log(grown)), rel=0.02, abs=0)
    assert _untried(Common(None, 1.0, None, time_constant), HEATING_TIME, 0.4) == 0.0


def loss_of(found, friction, hidden=(0.0, math.inf)):
    """Return the loss by heat where friction is so large, and the staircase as long as a current
    whose loss is stated."""
    stairs = SimpleNamespace(begin=np.zeros((1, 2)), end=np.full((1, 2), HEATING_TIME))
    contacts = SimpleNamespace(level=friction)
    means = SimpleNamespace(
        plateaus=30.0,
        contacts=lambda common: contacts,
        stairs=stairs,
        winding=SimpleNamespace(low=0.0, high=1.0),
    )
    return loss_by_heat(SimpleNamespace(means=means, weighed=found), *hidden)


def test_what_friction_by_its_law_leaves_open_is_no_evidence():
    """Two hypotheses of which the better leaves less than friction is known to."""
    found = weighed_from([1e-3, 2e-3], [1e-10, 4e-10])
    one = loss_of(found, 0.0)
    assert (one.value, one.u) == pytest.approx((1e-3, 0.0), abs=1e-8)
    second = (4.4 / 4.1) ** -20.0
    other = loss_of(found, 4e-9**0.5 / LAW / 30**0.5)
    assert other.value == pytest.approx((1e-3 + second * 2e-3) / (1 + second), rel=1e-9)
    assert other.u**2 == pytest.approx(1e-6 * second / (1 + second) ** 2, rel=1e-9)


def test_a_loss_that_noise_makes_negative_is_stated_as_it_is():
    found = loss_of(weighed_from([-3e-3, 1e-3], [1e-10, 1e-10]), 0.0)
    assert (found.value, found.u) == pytest.approx((-1e-3, 2e-3), rel=1e-9)


def test_scatter_of_each_hypothesis_counts_beside_their_spread():
    found = loss_of(weighed_from([1e-3, 3e-3], [1e-10, 1e-10], [1e-8, 3e-8]), 0.0)
    scatter, spread = found.budget
    assert scatter.contribution == pytest.approx(2e-8**0.5, rel=1e-9)
    assert scatter.dof == 40.0
    assert spread.contribution == pytest.approx(1e-3, rel=1e-9)


def test_what_angles_hide_of_each_second_counts_for_as_long_as_heat_lasts():
    found = loss_of(weighed_from([1e-3, 1e-3], [1e-10, 1e-10]), 0.0, (1e-5, 3.0))
    warming = -BEST.time_constant * math.expm1(-HEATING_TIME / BEST.time_constant)
    assert (found.u, found.dof) == pytest.approx((1e-5 * warming, 3.0), rel=1e-9)
    unknown = loss_of(weighed_from([-1e-3, -1e-3], [1e-10, 1e-10]), 0.0, (math.inf, math.inf))
    assert unknown.u == pytest.approx(1e-3, rel=1e-9)
