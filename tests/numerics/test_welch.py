"""Spectra block by block, beside scipy's of the whole signal."""

import numpy as np
import pytest
from scipy import signal

from rigtool.errors import InsufficientDataError
from rigtool.numerics.welch import Welch


@pytest.mark.parametrize("segment", [64, 65])
@pytest.mark.parametrize("blocks", [[], [10, 20, 30], [700], [640, 641, 1300]])
def test_blocks_of_any_length_have_the_spectrum_of_the_whole(segment, blocks):
    values = 3.0 + np.random.default_rng(1).normal(size=1500).cumsum()
    welch = Welch(segment)
    for block in np.split(values, blocks):
        welch.add(block)
    found = welch.spectrum(2e-3)
    overlap = segment // 2
    frequency, psd = signal.welch(values, 500.0, "hann", segment, overlap, detrend="constant")
    np.testing.assert_allclose(found.frequency, frequency, rtol=1e-12)
    np.testing.assert_allclose(found.psd, psd, rtol=1e-9)


def test_less_than_a_segment_has_no_spectrum():
    welch = Welch(64)
    for block in (40, 23):
        welch.add(np.ones(block))
    with pytest.raises(InsufficientDataError, match="63 samples are too few, 64 are needed"):
        welch.spectrum(1.0)
    welch.add(np.ones(1))
    assert welch.spectrum(1.0).psd.max() < 1e-20
