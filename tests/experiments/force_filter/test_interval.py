"""Moments of a truncated normal against scipy's."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import quad
from scipy.stats import truncnorm

from rigtool.experiments.force_filter.interval import truncated


@settings(deadline=None, max_examples=200)
@given(alpha=st.floats(-8, 6), width=st.floats(0.01, 12))
def test_moments_are_those_of_scipy(alpha, width):
    mean, variance = truncated(alpha, alpha + width)
    expected_mean, expected_variance = truncnorm.stats(alpha, alpha + width, moments="mv")
    assert mean == pytest.approx(float(expected_mean), rel=1e-6, abs=1e-9)
    assert variance == pytest.approx(float(expected_variance), rel=1e-3, abs=1e-6)


def quadrature(alpha, width):
    """Return mean, from alpha on, and variance of a standard normal above zero."""
    reach = min(width, 40 / max(alpha, 1))  # beyond, nothing of the density is left

    def moment(power, centre=0.0):  # of the density relative to that at the edge
        def integrand(x):
            return (x - centre) ** power * math.exp(-alpha * x - x * x / 2)

        return quad(integrand, 0, reach, epsabs=0, epsrel=1e-12)[0]

    whole = moment(0)
    mean = moment(1) / whole
    return mean, moment(2, mean) / whole


@settings(deadline=None, max_examples=200)
@given(alpha=st.floats(0, 60), logarithm=st.floats(-4, 1))
def test_tails_and_narrow_counts_against_quadrature(alpha, logarithm):
    width = 10.0**logarithm
    mean, variance = quadrature(alpha, width)
    found, own = truncated(alpha, alpha + width)
    assert found - alpha == pytest.approx(mean, rel=1e-4)
    assert own == pytest.approx(variance, rel=1e-4)


@settings(deadline=None, max_examples=200)
@given(alpha=st.floats(0, 60), width=st.floats(0.3, 10))
def test_moments_of_tails_have_all_digits_that_the_filter_needs(alpha, width):
    """In the tail the variance is the difference of numbers that are alpha^4 as large."""
    mean, variance = quadrature(alpha, width)
    found, own = truncated(alpha, alpha + width)
    assert found == pytest.approx(alpha + mean, rel=1e-13, abs=1e-12)
    assert own == pytest.approx(variance, rel=1e-10)


@settings(deadline=None, max_examples=200)
@given(alpha=st.floats(-1e3, 1e3), width=st.floats(1e-9, 1e3))
def test_mean_lies_between_the_edges_and_variance_shrinks(alpha, width):
    beta = alpha + width
    mean, variance = truncated(alpha, beta)
    slack = 1e-9 * (1 + abs(alpha))
    assert alpha - slack <= mean <= beta + slack
    assert -1e-9 <= variance <= min(1.0, width**2 / 4) + 1e-9
    mirrored, same = truncated(-beta, -alpha)
    assert mirrored == pytest.approx(-mean, rel=1e-12, abs=1e-12)
    assert same == pytest.approx(variance, rel=1e-9, abs=1e-12)
    assert np.isfinite([mean, variance]).all()
