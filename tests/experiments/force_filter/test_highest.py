"""Highest values within a span, against scipy."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from scipy.ndimage import maximum_filter1d

from rigtool.experiments.force_filter.highest import highest


@given(st.lists(st.integers(-9, 9), max_size=40), st.integers(0, 20), st.integers(0, 20))
def test_it_is_that_of_scipy(values, before, after):
    values, size = np.array(values, dtype=float), before + after + 1
    found = highest(values, before, after)
    if len(values):
        expected = maximum_filter1d(values, size, mode="nearest", origin=before - size // 2)
        np.testing.assert_array_equal(found, expected)
    else:
        assert found.shape == (0,)
