"""Values that depend on the rotor's angle: what few angles can and cannot show."""

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy import stats

from rigtool.numerics.angle_effects import (
    ERROR_FACTORS,
    _as_student,
    _effect,
    _given,
    _quantiles,
    fit_angle_effects,
)
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


@pytest.mark.parametrize("order", [13, 16])
def test_the_deviation_has_what_orders_above_the_highest_may_add(order):
    """They are scatter, which either is an error or belongs to the deviation."""
    for seed in range(3):
        rng = np.random.default_rng(seed)
        angle = 2 * np.pi * (np.arange(32) + rng.random(32)) / 32
        value = 5.0 + 0.3 * np.cos(2 * angle + 1) + 0.003 * rng.standard_normal(32)
        value += 0.3 * np.cos(order * angle + rng.uniform(0, 6))
        found = fit_angle_effects(np.ones((32, 1)), value, np.full(32, 0.003), angle)
        assert abs(found.deviation - 0.3) < found.deviation_u
        assert found.deviation_u < 0.4 * 0.3


def drawn(count, orders, seed=5):
    rng = np.random.default_rng(seed)
    x = np.column_stack([np.ones(count), rng.standard_normal(count)])
    return x, 2 + rng.standard_normal(count), rng.standard_normal((count, 2 * orders))


@pytest.mark.parametrize("count", [5, 14])  # fewer and more values than columns
def test_a_hypothesis_is_as_probable_as_its_normal_distribution_without_the_mean(count):
    """Restricted likelihood (D. A. Harville, Biometrika 61, 383, 1974), from whole covariances."""
    x, y, z = drawn(count, 2)
    amplitude = np.array([0.3, 2.0])
    weight, mean, within = _given(x, y, z, amplitude)
    expected = []
    for size in amplitude:
        for factor in ERROR_FACTORS:
            v = size**2 * z @ z.T + factor**2 * np.eye(count)
            inverse = np.linalg.inv(v)
            covariance = np.linalg.inv(x.T @ inverse @ x)
            beta = covariance @ x.T @ inverse @ y
            rest = y - x @ beta
            log = -0.5 * (np.linalg.slogdet(v)[1] - np.linalg.slogdet(covariance)[1])
            log -= 0.5 * rest @ inverse @ rest
            expected.append((log - np.log(factor), beta, covariance))  # an even prior, and 1/factor
    logs, betas, covariances = zip(*expected, strict=True)
    assert_allclose(weight - weight[0], np.array(logs) - logs[0], rtol=1e-7, atol=1e-9)
    assert_allclose(mean, betas, rtol=1e-7, atol=1e-12)
    assert_allclose(within, covariances, rtol=1e-7, atol=1e-12)


def test_amplitudes_and_deviation_are_those_of_all_hypotheses():
    x, y, z = drawn(9, 3)
    amplitude, highest = np.array([0.3, 2.0]), (0, 2, 3)
    rng = np.random.default_rng(6)
    probable = rng.dirichlet(np.ones(len(highest) * len(amplitude) * len(ERROR_FACTORS)))
    probable[:3] = [2e-5, 5e-5, 1e-5]  # too little to count
    effect, power, scatter, kept = np.zeros(6), np.zeros(6), 0.0, probable > 1e-4
    means, stds, beyond, beyond_stds = [], [], [], []
    weight = probable[kept] / probable[kept].sum()
    grid = [(k, a, f) for k in highest for a in amplitude for f in ERROR_FACTORS]
    for (order, size, factor), share in zip(
        (one for one, use in zip(grid, kept, strict=True) if use), weight, strict=True
    ):
        own = z[:, : 2 * order]
        v = factor**2 * np.eye(9) + size**2 * own @ own.T
        projected = np.linalg.inv(v)
        projected -= projected @ x @ np.linalg.inv(x.T @ projected @ x) @ x.T @ projected
        mean = size**2 * own.T @ projected @ y
        covariance = size**2 * np.eye(2 * order) - size**4 * own.T @ projected @ own
        effect[: 2 * order] += share * mean
        power[: 2 * order] += share * (mean**2 + np.diag(covariance))
        scatter += share * 0.09 * (factor**2 - 1)
        square = (mean @ mean + np.trace(covariance)) / 2
        variance = (np.sum(covariance**2) + 2 * mean @ covariance @ mean) / 2  # of half a square
        means.append(np.sqrt(square))
        stds.append(np.sqrt(variance / square) / 2 if square else 0.0)
        # what scatters beyond a variance of 0.09 is ripple, too, in half of the cases
        beyond.append(np.sqrt(square + 0.09 * (factor**2 - 1)))
        beyond_stds.append(np.sqrt(variance) / beyond[-1] / 2 if square else 0.0)
    found, unknown, more, deviation = _effect(x, y, z, probable, amplitude, highest, 0.09)
    assert_allclose(found, effect, rtol=1e-7, atol=1e-12)
    assert_allclose(unknown, (power - effect**2).reshape(3, 2).sum(axis=1), rtol=1e-7)
    assert_allclose(more, scatter, rtol=1e-7)
    floor = 1e-9 * max(beyond)
    stds = np.maximum(stds + beyond_stds, floor)
    expected = _as_student(np.tile(weight / 2, 2), np.array(means + beyond), stds)
    assert_allclose(deviation, expected, rtol=1e-6)


@pytest.mark.parametrize("dof", [5.0, 30.0])
def test_a_mixture_like_student_has_his_degrees_of_freedom(dof):
    """A normal distribution whose variance is drawn (W. S. Gosset, Biometrika 6, 1, 1908)."""
    part = (np.arange(4000) + 0.5) / 4000
    std = 0.2 * np.sqrt(dof / stats.chi2(dof).ppf(part))
    value, u, found = _as_student(np.full(4000, 1 / 4000), np.full(4000, 3.0), std)
    assert_allclose([value, u], [3.0, 0.2], rtol=2e-3)
    assert_allclose(found, dof, rtol=0.03)


@pytest.mark.parametrize("turn", [0.0, 0.7])
def test_units_angles_and_what_the_design_explains_change_nothing(turn):
    rng = np.random.default_rng(8)
    angle = 2 * np.pi * np.arange(10) / 10
    x = np.column_stack([np.ones(10), np.arange(10.0)])
    value = 5 + 0.1 * np.cos(angle) + 0.01 * rng.standard_normal(10)
    one = fit_angle_effects(x, value, np.full(10, 0.01), angle)
    more = np.array([2.0, -3.0])
    moved = 1000 * (value + x @ more)
    other = fit_angle_effects(x, moved, np.full(10, 10.0), angle + turn)
    assert_allclose(other.parameters, 1000 * (one.parameters + more), rtol=1e-6)
    assert_allclose(other.covariance, 1e6 * one.covariance, rtol=1e-5)
    assert_allclose(other.dof, one.dof, rtol=1e-4)
    assert_allclose(other.effect, 1000 * one.effect, atol=1e-4)
    for name in ("deviation", "deviation_u"):
        assert_allclose(getattr(other, name), 1000 * getattr(one, name), rtol=1e-4)
    assert_allclose(other.deviation_dof, one.deviation_dof, rtol=1e-3)


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
    # a hypothesis without weight widens no bounds, however far away it is
    more = (np.append(values, other) for values, other in ((probable, 0.0), (mean, 1e30), (std, 1)))
    assert_allclose(_quantiles(*more, parts), found, rtol=1e-9)
