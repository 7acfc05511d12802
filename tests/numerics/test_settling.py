"""Where a signal has settled, beside a search from the end."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from rigtool.numerics.settling import settled_from


@given(st.integers(0, 40), st.sampled_from([0.0, 0.1, 3.0]), st.integers(0, 2**32 - 1))
def test_it_is_the_first_sample_from_which_on_none_is_outside(last_part, resolution, seed):
    random = np.random.default_rng(seed)
    signal = random.standard_normal(50) * np.exp(-np.arange(50) / 10) + 0.1 * random.random(50)
    last = signal[last_part:]
    margin = max(np.ptp(last) / 4, resolution)
    first = 50
    while first and last.min() - margin <= signal[first - 1] <= last.max() + margin:
        first -= 1
    assert settled_from(signal, last_part, resolution) == first


@pytest.mark.parametrize(("off", "first"), [(0.24, 0), (0.26, 3), (-1.24, 0), (-1.26, 3)])
def test_the_band_is_wider_than_the_last_part_by_a_quarter_of_its_range(off, first):
    signal = np.array([0.0, 0.0, off, 0.0, -1.0, -0.5])
    assert settled_from(signal, 3) == first
