"""Recursive filters against scipy.signal."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.signal import butter, lfilter, sosfilt, sosfiltfilt

from rigtool.numerics.recursion import (
    BLOCK,
    PIECE,
    Biquad,
    butterworth,
    filtered,
    filtered_both_ways,
)


@given(st.integers(0, 2**32 - 1), st.floats(1e-3, 0.45), st.integers(1, 5 * BLOCK))
def test_filters_are_those_of_scipy(seed, cutoff, size):
    values = np.random.default_rng(seed).normal(size=(2, size))
    sections = butter(2, cutoff, fs=1.0, output="sos")
    section = butterworth(1.0, cutoff)
    np.testing.assert_allclose(
        filtered(section, values), sosfilt(sections, values), rtol=0, atol=1e-9
    )
    if size > 1:
        margin = (size - 1) // 2
        expected = sosfiltfilt(sections, values, padlen=margin)
        found = filtered_both_ways(section, values, margin)
        np.testing.assert_allclose(found, expected, rtol=0, atol=1e-9 * np.abs(expected).max())


@pytest.mark.parametrize("size", [PIECE - 1, PIECE, PIECE + 1, 2 * PIECE + 33])
def test_pieces_join(size):
    values = np.random.default_rng(size).normal(size=size)
    expected = lfilter([0.01], [1, -0.99], values)
    found = filtered(Biquad(0.01, 0.0, 0.0, -0.99, 0.0), values)
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-13)


def test_a_steady_value_stays():
    found = filtered(butterworth(1000.0, 5.0), np.full((2, 70), [[3.0], [-1.0]]), np.array([3, -1]))
    np.testing.assert_allclose(found, [[3.0] * 70, [-1.0] * 70], rtol=1e-12)
