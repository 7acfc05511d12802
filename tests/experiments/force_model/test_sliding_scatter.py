"""The covariance of least squares on noise that lasts is that which its correlation makes."""

from types import SimpleNamespace

import numpy as np
import pytest
from scipy.linalg import matmul_toeplitz

from rigtool.experiments.force_model.records import ROWS_HZ
from rigtool.experiments.force_model.sliding_scatter import _correlation, moments

ROWS, MEMORY, POWER = 6000, 0.15, 3.0


class Sums:
    """What `moments` asks of a problem: noise of first order and two functions of the time."""

    shape_spread = np.ones(1)

    def __init__(self, seed, passes=1, gaps=False):
        rng = np.random.default_rng(seed)
        used = np.ones(ROWS, dtype=bool)
        if gaps:
            used[1000:1400] = used[::500] = False
        self.records = [SimpleNamespace(count=ROWS, used=used, passes=passes, periodic=False)] * 4
        self.variance = np.array([1.0, 1.0, 2.0, 1.0])
        kept = np.exp(-1 / (MEMORY * ROWS_HZ))
        noise = rng.standard_normal((4, ROWS)) * np.sqrt(POWER * (1 - kept**2))
        for n in range(1, ROWS):
            noise[:, n] += kept * noise[:, n - 1]
        self.noise = noise
        time = np.arange(ROWS) / ROWS_HZ
        self.columns = np.stack([np.ones(ROWS), np.sin(2 * np.pi * 5 * time)])

    def remaining(self, number, shape, coefficient):
        return self.noise[number, self.records[number].used]

    def influence(self, number, shape, coefficient):
        rows = self.columns[:, self.records[number].used] / self.variance[number]
        return rows, np.zeros((len(rows), len(rows)))


def expected(sums):
    kept = np.exp(-1 / (MEMORY * ROWS_HZ))
    columns = sums.columns * sums.records[0].used
    return POWER * columns @ matmul_toeplitz(kept ** np.arange(ROWS), columns.T)


@pytest.mark.parametrize("gaps", [False, True])
def test_moments_are_those_of_noise_of_first_order(gaps):
    found = np.mean(
        [moments(Sums(seed, gaps=gaps), None, np.zeros(1), 1.0) for seed in range(4)], axis=0
    )
    first = found[[0, 1, 3]].mean(axis=0)
    # noise that lasts is far larger in a mean than in a swing of 5 Hz
    mean, swing = np.diag(expected(Sums(0)))
    assert mean > 20 * swing
    np.testing.assert_allclose(np.diag(first), np.diag(expected(Sums(0, gaps=gaps))), rtol=0.25)
    assert np.diag(found[2]) == pytest.approx(np.diag(first) / 4, rel=0.25)


def test_what_a_model_misses_comes_back_in_each_pass():
    once, thrice = (moments(Sums(0, passes), None, np.zeros(1), 1.0) for passes in (1, 3))
    np.testing.assert_allclose(thrice, 3 * once)


def test_moments_are_sums_over_lags_of_the_correlation():
    """Also of functions so fast that noise which lasts hardly reaches them."""
    own = Sums(5)
    time = np.arange(ROWS) / ROWS_HZ
    own.columns = np.stack([np.ones(ROWS), np.sin(2 * np.pi * 40 * time)])
    found = moments(own, None, np.zeros(1), 1.0)
    correlation, expected = _correlation(own.records, list(own.noise)), np.zeros(2)
    for lag, part in enumerate(correlation):
        products = np.sum(own.columns[:, : ROWS - lag] * own.columns[:, lag:], axis=1)
        expected += part * products * (2 if lag else 1)
    assert expected[1] < 0.03 * expected[0]
    for one, noise, variance in zip(found, own.noise, own.variance, strict=True):
        power = np.mean(noise**2) / variance**2
        np.testing.assert_allclose(np.diag(one), power * expected, rtol=0.02)
