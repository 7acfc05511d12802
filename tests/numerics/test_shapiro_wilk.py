"""Test of Shapiro and Wilk against scipy's."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import shapiro

from rigtool.numerics.shapiro_wilk import p_value


@given(
    st.integers(0, 2**32 - 1),
    st.integers(3, 60),
    st.sampled_from(["standard_normal", "standard_exponential", "standard_cauchy"]),
)
def test_probabilities_are_those_of_scipy(seed, count, distribution):
    values = np.sort(getattr(np.random.default_rng(seed), distribution)(count))
    expected = shapiro(values).pvalue
    assert p_value(values) == pytest.approx(expected, rel=1e-6, abs=1e-12)


@pytest.mark.parametrize("count", range(3, 13))
@pytest.mark.parametrize("power", [1, 3, 30])
def test_few_readings_with_or_without_an_outlier_are_scipys(count, power):
    values = np.sort(np.random.default_rng(count).standard_normal(count)) ** power
    values.sort()
    expected = shapiro(values).pvalue
    assert p_value(values) == pytest.approx(expected, rel=1e-6, abs=1e-12)


def test_two_readings_are_too_few():
    with pytest.raises(ValueError, match="needs 3"):
        p_value(np.array([0.0, 1.0]))
