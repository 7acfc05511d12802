"""Errors by a gauge's resolution, against the mean of noisy readings that are rounded."""

from types import SimpleNamespace

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.stats import norm

from rigtool.experiments.torque_constant.staircase_fit import GAUGE_PHASES, _rounding_errors

STEP = 2e-3


def mean_rounded(torque, noise):
    """The mean of round(torque + noise), level by level: a sum over the steps of the gauge."""
    steps = STEP * np.arange(-30, 31)[:, None]
    edges = (steps + STEP / 2 - torque) / noise
    share = norm.cdf(edges) - norm.cdf(edges - STEP / noise)
    return (steps * share).sum(axis=0)


@pytest.mark.parametrize("noise", [0.2 * STEP, 0.3 * STEP, 0.4 * STEP])
def test_slopes_take_the_mean_error_of_rounded_readings(noise):
    """Each level is a slope of its own here. The scatter of readings about their means is that of
    noise and rounding together, less that of the means; its inverse is right within 5 %."""
    torque = np.linspace(-0.011, 0.017, 23)
    phases = STEP * np.arange(GAUGE_PHASES)[:, None] / GAUGE_PHASES
    of_phase = np.array([mean_rounded(torque + phase, noise) - torque - phase for phase in phases])
    within = np.linspace(0, STEP, 1000, endpoint=False)
    of_means = np.mean((mean_rounded(within, noise) - within) ** 2)
    scattered = np.sqrt(noise**2 + STEP**2 / 12 - of_means)
    stairs = SimpleNamespace(
        resolution=STEP, noise=scattered, torque=torque[:, None], weight=np.ones((len(torque), 1))
    )
    fit = SimpleNamespace(residual=np.zeros((len(torque), 1)), solve=lambda values: (values,))
    largest = np.abs(of_phase).max()
    assert_allclose(_rounding_errors(stairs, fit), of_phase, rtol=0, atol=0.05 * largest)


def test_a_gauge_that_rounds_nothing_adds_nothing():
    stairs = SimpleNamespace(resolution=0.0, torque=np.zeros((4, 3)))
    assert not _rounding_errors(stairs, SimpleNamespace()).any()
