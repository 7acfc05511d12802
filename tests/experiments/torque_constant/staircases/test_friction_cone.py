"""What is possible for friction and heat, against sums and drawn values of it."""

import math

import numpy as np
import pytest

from rigtool.experiments.torque_constant.staircases import friction_cone
from rigtool.experiments.torque_constant.staircases.friction_cone import (
    begins_with,
    positive,
    possible,
)

CASES = [
    ((1.0, 0.2), ((1.0, 0.3), (0.3, 0.5)), 9.0),
    ((-1.0, 0.5), ((1.0, -0.3), (-0.3, 0.5)), 9.0),
    ((0.5, 2.0), ((1.0, 0.3), (0.3, 0.5)), 9.0),
    ((1.5, -0.2), ((2.0, 0.3), (0.3, 0.5)), 2.0),
]


@pytest.mark.parametrize(("mean", "covariance", "largest"), CASES)
def test_probability_mean_and_covariance_are_sums_over_what_is_possible(mean, covariance, largest):
    f = (np.arange(800) + 0.5) / 800 * min(largest, max(mean[0], 0.0) + 8.0)
    h = (np.arange(-400, 400)[:, None] + 0.5) / 400 * f  # (h, f), each row a part of f
    off = np.stack([f - mean[0] + 0 * h, h - mean[1]])
    inverse = np.linalg.inv(covariance)
    density = np.exp(-np.einsum("i...,ij,j...->...", off, inverse, off) / 2) * f / 400
    density *= (f[1] - f[0]) / (2 * np.pi * np.sqrt(np.linalg.det(covariance)))
    found = possible(np.array([mean]), np.array([covariance]), largest)
    total = density.sum()
    assert np.exp(found.logarithm[0]) == pytest.approx(total, rel=3e-3)
    shift = np.sum(density * off, axis=(1, 2)) / total
    np.testing.assert_allclose(found.shift[0], shift, atol=2e-3)
    second = np.einsum("ab,iab,jab->ij", density, off, off) / total
    np.testing.assert_allclose(found.covariance[0], second - np.outer(shift, shift), atol=2e-3)


def test_friction_that_is_known_well_stays_as_it_is():
    covariance = 1e-6 * np.array([[1.0, 0.3], [0.3, 0.5]])
    found = possible(np.array([0.01, 0.002]), covariance, 0.05)
    assert found.logarithm == pytest.approx(0.0, abs=1e-6)
    np.testing.assert_allclose(found.shift, 0, atol=1e-9)
    np.testing.assert_allclose(found.covariance, covariance, rtol=1e-3)


def test_edges_far_from_what_is_found_change_nothing(monkeypatch):
    """From edges within a standard deviation to edges beyond twenty, on one side or on both."""
    mean = np.stack([np.ones(81), np.linspace(-1.2, 1.2, 81)], axis=1)
    own = np.array([[1.0, 0.3], [0.3, 0.5]]) * np.array([1e-3, 1e-2, 0.1])[:, None, None, None]
    covariance = np.broadcast_to(own, (3, 81, 2, 2))
    mean = np.broadcast_to(mean, (3, 81, 2))
    found = possible(mean, covariance, 9.0)
    monkeypatch.setattr(friction_cone, "FAR_EDGE", math.inf)
    for name, value in vars(possible(mean, covariance, 9.0)).items():
        np.testing.assert_allclose(getattr(found, name), value, rtol=1e-12, atol=1e-15)


@pytest.mark.parametrize("mean", [(-30.0, 0.0), (0.5, 30.0), (60.0, 0.0)])
def test_what_is_impossible_is_finite_and_improbable(mean):
    found = possible(np.array(mean), np.eye(2), 9.0)
    assert np.isfinite(found.logarithm)
    assert found.logarithm < -100
    f, h = mean + found.shift
    assert 0 <= f <= 9.0
    assert abs(h) <= f


@pytest.mark.parametrize("mean", [-2.0, 0.0, 1.5, 6.0])
def test_the_positive_part_is_that_of_drawn_values(mean):
    drawn = mean + 0.5 * np.random.default_rng(2).standard_normal(4_000_000)
    kept = drawn[drawn > 0]
    logarithm, shift = positive(np.array(mean), np.array(0.5))
    assert np.exp(logarithm) == pytest.approx(len(kept) / len(drawn), rel=0.1)
    assert shift == pytest.approx(kept.mean() - mean, abs=0.01)


def test_what_is_far_below_zero_ends_just_above_it():
    logarithm, shift = positive(np.array(-1e3), np.array(1.0))
    assert -6e5 < logarithm < -4e5
    assert 0 < -1e3 + shift < 2e-3


def test_what_scatters_is_no_friction_with_which_a_staircase_begins():
    """By drawn values: the estimate is closer to what is true than what least squares find."""
    rng = np.random.default_rng(3)
    true, u = 0.2 + 0.05 * rng.standard_normal(4000), np.full(4000, 0.05)
    found = begins_with(4e-3 * (true + u * rng.standard_normal(4000)), 4e-3 * u, 4e-3)
    assert np.sqrt(np.mean((found - true) ** 2)) == pytest.approx(0.05 / np.sqrt(2), rel=0.05)
    alone = begins_with(np.array([1e-3, 1.1e-3, 0.9e-3]), np.full(3, 1e-3), 4e-3)
    np.testing.assert_allclose(alone, 0.25)
    exact = begins_with(np.array([-9e-3, 1e-3, 9e-3]), np.zeros(3), 4e-3)
    np.testing.assert_allclose(exact, [-1.0, 0.25, 1.0])
