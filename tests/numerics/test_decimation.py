"""Decimation: what its filter passes and stops, and blocks against the whole."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from rigtool.errors import InsufficientDataError
from rigtool.numerics.decimation import Decimator


def decimated(signals, factor, sizes=()):
    collected = Decimator(factor, *signals.shape)
    start = 0
    for size in (*sizes, signals.shape[1]):
        collected.add(*signals[:, start : start + size])
        start += size
    return collected.finish()


@pytest.mark.parametrize("factor", [2, 3, 16, 100])
def test_the_band_passes_and_what_would_alias_does_not(factor):
    """Frequency in parts of the new sampling frequency; a point well inside knows no ends."""
    sample = np.arange(41 * factor) - 20 * factor
    frequency = np.linspace(0, 0.05, 101)
    tones = np.cos(2 * np.pi * np.outer(frequency, sample / factor))
    np.testing.assert_allclose(decimated(tones, factor)[:, 20], 1, rtol=4e-5, atol=0)
    stopped = np.linspace(0.95, factor / 2, 400)
    tones = np.cos(2 * np.pi * np.outer(stopped, sample / factor))
    np.testing.assert_allclose(decimated(tones, factor)[:, 20], 0, rtol=0, atol=4e-5)
    turned = np.sin(2 * np.pi * np.outer(frequency, sample / factor))
    np.testing.assert_allclose(decimated(turned, factor)[:, 20], 0, rtol=0, atol=1e-12)


@pytest.mark.parametrize("size", [600, 601, 607, 608])
def test_a_line_stays_one_up_to_its_ends(size):
    line = 3 + 0.25 * np.arange(float(size))[np.newaxis]
    np.testing.assert_allclose(decimated(line, 8), line[:, ::8], rtol=1e-4, atol=0)


@settings(max_examples=50, deadline=None)
@given(
    factor=st.integers(1, 12),
    sizes=st.lists(st.integers(0, 300), max_size=20),
    size=st.integers(200, 3000),
)
def test_blocks_of_any_size_give_the_same_as_the_whole(factor, sizes, size):
    signals = np.random.default_rng(size).normal(size=(2, size))
    whole = decimated(signals, factor)
    assert whole.shape == (2, -(-size // factor))
    np.testing.assert_allclose(decimated(signals, factor, sizes), whole, rtol=0, atol=1e-13)


@pytest.mark.parametrize("sizes", [[1] * 70, [32], [33], [5, 0, 26, 1, 1]])
def test_blocks_shorter_than_half_the_filter_give_the_same_as_the_whole(sizes):
    signals = np.random.default_rng(2).normal(size=(2, 200))
    whole = decimated(signals, 8)
    np.testing.assert_allclose(decimated(signals, 8, sizes), whole, rtol=0, atol=1e-13)


def test_every_sample_is_kept_as_it_is():
    signals = np.random.default_rng(1).normal(size=(3, 50))
    np.testing.assert_array_equal(decimated(signals, 1, [7, 0, 20]), signals)


def test_signals_shorter_than_the_filter_are_refused():
    with pytest.raises(InsufficientDataError, match="64 samples are too few, 65 are needed"):
        decimated(np.zeros((1, 64)), 16)
