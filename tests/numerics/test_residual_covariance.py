"""Long-run covariance against what is known of first-order processes."""

import numpy as np
import pytest
from scipy.fft import dct
from scipy.signal import lfilter

from rigtool.numerics.residual_covariance import (
    MIN_COEFFICIENTS,
    cosine_transform,
    independent_samples,
    kept_by_fit,
    long_run_covariance,
)

COUNT = 4000


def process(random, memory, count=COUNT):
    """A first-order process of variance 1 with correlation `memory` from sample to sample."""
    white = random.normal(size=count + 1000)
    return lfilter([np.sqrt(1 - memory**2)], [1, -memory], white)[1000:]


def regressors(random):
    return np.column_stack([np.ones(COUNT), process(random, 0.9)])


def test_white_residuals_have_the_covariance_of_ordinary_least_squares():
    random = np.random.default_rng(1)
    design = regressors(random)
    found = [
        long_run_covariance(design, random.normal(0, 0.3, COUNT), COUNT)[0] for _ in range(100)
    ]
    expected = 0.3**2 * np.linalg.inv(design.T @ design)
    np.testing.assert_allclose(np.diag(np.mean(found, axis=0)), np.diag(expected), rtol=0.05)


@pytest.mark.parametrize("memory", [0.5, 0.9, 0.98])
def test_the_mean_of_a_first_order_process(memory):
    """Its variance is (1 + r)/(1 - r)/n: Anderson, Statistical Analysis of Time Series, 1971."""
    random = np.random.default_rng(2)
    design = np.ones((COUNT, 1))
    used = np.ones(COUNT, dtype=bool)
    variance, worth = [], []
    for _ in range(60):
        residual = process(random, memory)
        residual -= residual.mean()
        worth.append(independent_samples(residual, used, 1))
        variance.append(long_run_covariance(design, residual, worth[-1])[0][0, 0])
    factor = (1 + memory) / (1 - memory)
    assert np.mean(worth) == pytest.approx(COUNT / factor, rel=0.1)
    assert np.mean(variance) == pytest.approx(factor / COUNT, rel=0.15)


def test_uncertainties_are_those_of_the_scatter_when_regressors_are_correlated_too():
    random = np.random.default_rng(3)
    design = regressors(random)
    inverse = np.linalg.pinv(design)
    errors, variances = [], []
    for _ in range(200):
        noise = process(random, 0.95)
        error = inverse @ noise
        residual = noise - design @ error
        independent = independent_samples(residual, np.ones(COUNT, dtype=bool), 1)
        errors.append(error)
        variances.append(np.diag(long_run_covariance(design, residual, independent)[0]))
    np.testing.assert_allclose(
        np.sqrt(np.mean(variances, axis=0)), np.std(errors, axis=0), rtol=0.1
    )


def test_degrees_of_freedom_are_the_coefficients():
    random = np.random.default_rng(4)
    design, residual = regressors(random), random.normal(size=COUNT)
    assert long_run_covariance(design, residual, 1000.0)[1] == 99  # 1000^(2/3), not quite 100
    assert long_run_covariance(design, residual, 1.0)[1] == MIN_COEFFICIENTS
    assert long_run_covariance(design[:5], residual[:5], 1000.0)[1] == 4


def test_samples_that_are_left_out_are_worth_nothing():
    random = np.random.default_rng(5)
    residual = process(random, 0.9)
    used = np.arange(COUNT) % 1000 < 500
    all_of_it = independent_samples(residual, np.ones(COUNT, dtype=bool), 10)
    assert independent_samples(residual, used, 10) == pytest.approx(all_of_it / 2, rel=0.2)
    assert independent_samples(residual, np.zeros(COUNT, dtype=bool), 10) == 0


def test_what_a_fit_of_slow_regressors_takes_from_slow_residuals():
    """The variance of slow regressors is too small without it, and right with it: n = 400, 15 %."""
    random, count, lowest = np.random.default_rng(5), 600, 10
    phase = 2 * np.pi * np.arange(count) / count
    design = np.column_stack([np.cos(2 * phase), np.sin(3 * phase + 1), np.ones(count)])
    basis, stated = np.linalg.qr(design)[0], []
    for _ in range(400):
        error = random.normal(size=count)
        residual = error - basis @ (basis.T @ error)
        covariance, dof = long_run_covariance(design, residual, lowest**1.5 + 0.1)
        stated.append(np.diag(covariance))
        assert dof == lowest
    truth = np.diag(np.linalg.inv(design.T @ design))
    lost = np.mean(stated, axis=0) / truth
    assert np.min(lost) < 0.85
    np.testing.assert_allclose(lost / kept_by_fit(design, lowest), 1, atol=0.15)


@pytest.mark.parametrize("count", [1, 2, 3, 8, 9])
def test_the_cosine_transform_is_scipys(count):
    values = np.random.default_rng(7).normal(size=(count, 2))
    expected = dct(values, type=2, axis=0) / 2
    np.testing.assert_allclose(cosine_transform(values), expected, rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize("count", [40, 41])
def test_what_a_fit_leaves_of_coefficients_is_that_of_the_projection_written_out(count):
    random = np.random.default_rng(8)
    design, more, lowest = random.normal(size=(count, 2)), np.ones((count, 1)), 7
    whole = np.column_stack([design, more])
    left = np.eye(count) - whole @ np.linalg.pinv(whole)
    time = np.arange(count) + 0.5
    waves = np.cos(np.pi * np.outer(np.arange(1, lowest + 1), time) / count)
    weighted = waves[:, :, None] * design  # (lowest, n, p)
    after = np.einsum("ts,jsp->jtp", left, weighted)
    expected = np.sum(after**2, axis=(0, 1)) / np.sum(weighted**2, axis=(0, 1))
    np.testing.assert_allclose(kept_by_fit(design, lowest, more), expected, rtol=1e-9)
