"""Loss by heat at each angle, and what few angles hide of it."""

import math
from types import SimpleNamespace

import numpy as np
import pytest
from scipy import stats

from rigtool.experiments.torque_constant.staircases.angle_losses import heat_loss, hidden_loss
from rigtool.experiments.torque_constant.staircases.least_squares import LeastSquares
from rigtool.numerics.residual_covariance import independent_samples, long_run_covariance

M, P = 4, 12
CURRENT = np.tile(np.r_[0:7, 5:0:-1] / 2.0, (M, 1)) * np.linspace(0.9, 1.1, M)[:, None]
ONES = np.ones((M, P))
LOSS, NOISE = 2e-4, 1e-6
QUARTERS = np.arange(4) * math.pi / 2


def warmed(loss, common=0.0):
    """Return a fit with a relative loss (M,) of its constants, and a common residual."""
    own = np.column_stack([np.full(M, 0.05), -0.05 * np.asarray(loss), np.zeros(M)])
    design = np.column_stack([CURRENT[0], CURRENT[0] ** 2, np.ones(P)])
    return SimpleNamespace(own=own, residual=common * ONES, design=design)


def angled(*angle):
    return SimpleNamespace(rotor_angle=np.array(angle), weight=ONES)


def test_heat_takes_what_the_mean_over_the_angles_shows():
    each = np.array([0.01, 0.012, 0.014, 0.012])
    loss, u, dof = heat_loss(angled(*QUARTERS), warmed(each))
    assert loss == pytest.approx(each.mean(), rel=1e-9)
    # four angles show the first order: one degree of freedom is left
    assert dof == 1
    assert u > 0
    # heat only takes: what it would add is uncertainty
    loss, negative_u, _ = heat_loss(angled(*QUARTERS), warmed(-each))
    assert loss == 0
    assert negative_u == pytest.approx(math.hypot(u, each.mean()), rel=1e-9)
    loss, u, dof = heat_loss(angled(1.0, 1.0, 1.0, 1.0), warmed(each))
    assert (loss, u) == pytest.approx((each.mean(), each.mean()), rel=1e-9)
    assert dof == math.inf


def test_lack_of_fit_makes_the_loss_by_heat_uncertain():
    wave = 1e-3 * np.cos(np.arange(P))
    fit = warmed(np.full(M, 0.01), wave)
    _, u, dof = heat_loss(angled(*QUARTERS), fit)
    independent = independent_samples(wave, np.ones(P, dtype=bool), 1)
    covariance, expected_dof = long_run_covariance(fit.design, wave, independent)
    assert u == pytest.approx(math.sqrt(covariance[1, 1]) / 0.05, rel=1e-9)
    assert dof == expected_dof


def test_the_mean_over_the_angles_is_that_of_student():
    """Of few angles without order: repeats."""
    each = np.array([0.01, 0.012, 0.014, 0.012])
    _, u, dof = heat_loss(angled(*[np.nan] * 4), warmed(each))
    assert (u, dof) == pytest.approx((stats.sem(each), 3), rel=1e-9)


def rippled(angles, random):
    """Return staircases at these angles, twice, with drawn ripple of orders up to one of 4 to 12
    that grows with the current, and their fit."""
    angle = np.tile(np.arange(angles) * 2 * math.pi / angles, 2)
    order = np.arange(1, random.integers(4, 13) + 1)
    cosine, sine = 1.5e-3 * random.standard_normal((2, len(order)))
    bend = np.cos(np.outer(angle, order)) @ cosine + np.sin(np.outer(angle, order)) @ sine
    current = np.tile(CURRENT[0], (2 * angles, 1))
    heat = np.cumsum(current**2, axis=1) * current
    torque = 0.05 * (current + bend[:, None] * current**2 - LOSS * heat)
    torque += NOISE * random.standard_normal(current.shape)
    fit = LeastSquares(torque, [current, heat], [np.ones(current.shape)])
    return SimpleNamespace(rotor_angle=angle, weight=np.ones(current.shape)), fit


@pytest.mark.parametrize("angles", [3, 4])
def test_intervals_hold_what_few_angles_hide_of_a_loss(angles):
    random = np.random.default_rng(5)
    errors, stated, dof = [], [], []
    for _ in range(60):
        stairs, fit = rippled(angles, random)
        errors.append(np.mean(-fit.own[:, 1] / fit.own[:, 0]) - LOSS)
        u, free = hidden_loss(stairs, fit, NOISE)
        stated.append(u)
        dof.append(free)
    held = np.abs(errors) < stats.t.ppf(0.95, dof) * stated
    assert np.mean(held) > 0.85
    assert np.median(stated) < 2 * np.std(errors)


def test_many_angles_hide_no_loss():
    stairs, fit = rippled(25, np.random.default_rng(5))
    each = np.std(fit.own[:, 1] / fit.own[:, 0])
    assert hidden_loss(stairs, fit, NOISE)[0] < 0.02 * each


def test_a_loss_at_one_angle_is_unknown():
    one = angled(1.0, 1.0, 1.0, 1.0)
    assert hidden_loss(one, warmed(np.full(M, 0.01)), NOISE) == (math.inf, math.inf)
