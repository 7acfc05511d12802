"""Values that depend on the rotor's angle: what few angles can and cannot show."""

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy import stats

from rigtool.numerics.angle_effects import _quantiles, fit_angle_effects
from tests.thorough import thorough


def test_orders_that_the_angles_resolve_are_found():
    angle = 2 * np.pi * np.arange(24) / 24
    value = 5.0 + 0.3 * np.cos(angle + 1) + 0.4 * np.sin(4 * angle)
    found = fit_angle_effects(np.ones((24, 1)), value, np.full(24, 1e-3), angle)
    assert_allclose(found.parameters, [5.0], atol=1e-3, rtol=0)
    assert_allclose(found.effect, value - 5.0, atol=5e-3, rtol=0)
    assert_allclose(found.deviation, np.sqrt((0.3**2 + 0.4**2) / 2), rtol=0.01)


def test_an_order_that_passes_for_the_slope_is_in_its_uncertainty():
    # Four angles, turned on by a third of their distance: order 4 is one value at each x.
    x = np.repeat([-1.0, 0.0, 1.0], 4)
    angle = np.pi / 2 * np.tile(np.arange(4), 3) + np.pi / 6 * (x + 1)
    value = 1.0 + 0.1 * np.cos(2 * angle) + 0.1 * np.sin(4 * angle)
    design = np.column_stack([np.ones(12), x])
    found = fit_angle_effects(design, value, np.full(12, 1e-3), angle)
    u = np.sqrt(found.covariance[1, 1])
    assert abs(found.parameters[1]) < u * stats.t.ppf(0.975, found.dof[1])
    assert u > 0.01


def test_unknown_angles_are_scatter():
    rng = np.random.default_rng(3)
    value = 2.0 + 0.1 * rng.standard_normal(40)
    found = fit_angle_effects(np.ones((40, 1)), value, np.full(40, 1e-3), np.full(40, np.nan))
    assert_allclose(found.parameters, [value.mean()], rtol=1e-9)
    assert_allclose(np.sqrt(found.covariance[0, 0]), stats.sem(value), rtol=0.25)


@pytest.mark.parametrize("count", [8, 20, *thorough(12)])
def test_intervals_hold_the_mean_over_the_turn(count):
    rng = np.random.default_rng(7)
    angle = 2 * np.pi * np.arange(count) / count
    held = 0
    for _ in range(40):
        size, phase = 0.01 * rng.uniform(0, 1, 4), rng.uniform(0, 7, 4)
        effect = sum(size[k] * np.cos((k + 1) * angle + phase[k]) for k in range(4))
        value = 1.0 + effect + 1e-4 * rng.standard_normal(count)
        found = fit_angle_effects(np.ones((count, 1)), value, np.full(count, 1e-4), angle)
        u = np.sqrt(found.covariance[0, 0])
        held += abs(found.parameters[0] - 1.0) < u * stats.t.ppf(0.975, found.dof[0])
    assert held >= stats.binom.ppf(1e-3, 40, 0.95)


def test_the_deviation_is_as_uncertain_as_its_amplitude():
    # N values with noise s: an amplitude has u = s sqrt(2 / N), the deviation s / sqrt(N).
    angle = 2 * np.pi * np.arange(24) / 24
    noise = 0.01 * np.random.default_rng(2).standard_normal(24)
    value = 5.0 + 0.3 * np.cos(angle + 1) + noise
    found = fit_angle_effects(np.ones((24, 1)), value, np.full(24, 0.01), angle)
    assert_allclose(found.deviation_u, 0.01 / np.sqrt(24), rtol=0.5)


@pytest.mark.parametrize("spread", [0.0, 0.5, 30.0])  # thirty: where there is next to no density
def test_so_much_of_a_mixture_is_below_its_quantiles(spread):
    rng = np.random.default_rng(4)
    probable = rng.dirichlet(np.full(200, 0.3))
    mean = spread * np.repeat([-1.0, 2.0], 100) + 0.01 * rng.normal(size=200)
    std = 10 ** rng.uniform(-2, 0, 200)
    parts = (1e-9, 0.025, 0.5, 0.84, 1 - 1e-9)
    found = _quantiles(probable, mean, std, parts)
    below = probable @ stats.norm.cdf(found, mean[:, None], std[:, None])
    assert_allclose(below, parts, rtol=1e-12, atol=1e-15)
