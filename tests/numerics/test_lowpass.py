"""The low-pass of readings: against scipy, and the gain that it must have."""

import numpy as np
import pytest
from scipy import signal

from rigtool.errors import InsufficientDataError
from rigtool.numerics.decimation import Decimator
from rigtool.numerics.lowpass import delayed, kept_factor, lowpass

RATE = 500.0


def test_lowpass_is_scipys_butterworth_run_both_ways():
    rng = np.random.default_rng(1)
    noise = rng.standard_normal(2000)
    expected = signal.sosfiltfilt(signal.butter(2, 5.0, fs=RATE, output="sos"), noise, padlen=100)
    np.testing.assert_allclose(lowpass(RATE, noise, 5.0), expected, rtol=0, atol=1e-12)


def test_any_length_rate_and_row_agrees_with_scipy():
    rng = np.random.default_rng(2)
    for count in (205, 256, 257, 1000):
        for cutoff in (10.0, 49.0, 240.0):
            rows = 3.0 + rng.standard_normal((2, count))
            sections = signal.butter(2, cutoff, fs=RATE, output="sos")
            expected = signal.sosfilt(sections, rows)
            np.testing.assert_allclose(delayed(RATE, rows, cutoff), expected, rtol=0, atol=1e-12)
            padlen = round(RATE / cutoff)
            expected = signal.sosfiltfilt(sections, rows, padlen=padlen)
            np.testing.assert_allclose(lowpass(RATE, rows, cutoff), expected, rtol=0, atol=1e-12)


@pytest.mark.parametrize(("frequency", "gain"), [(0.2, 1.0), (5.0, 0.5), (50.0, 1e-4)])
def test_lowpass_keeps_the_phase_and_halves_at_the_cutoff(frequency, gain):
    time = np.arange(10_000) / RATE
    sine = np.sin(2 * np.pi * frequency * time)
    filtered = lowpass(RATE, sine, 5.0)
    middle = slice(1000, -1000)
    np.testing.assert_allclose(
        filtered[middle], gain * sine[middle], rtol=0, atol=5e-5 + gain / 500
    )


@pytest.mark.parametrize(("highest", "tolerance"), [(5.0, 1e-4), (3990.0, 2e-4)])
def test_thinned_out_signals_give_what_all_samples_give(highest, tolerance):
    rate, cutoff = 8000.0, 5.0
    factor = kept_factor(rate, cutoff)
    assert factor == 12
    time = np.arange(32_000) / rate
    tones = np.sin(2 * np.pi * np.outer(np.linspace(0.2, highest, 60), time) + 0.4)
    whole = lowpass(rate, tones, cutoff)[:, ::factor]
    collected = Decimator(factor, *tones.shape)
    collected.add(*tones)
    thinned = lowpass(rate / factor, collected.finish(), cutoff)
    middle = slice(500, -500)  # a second: a tone that is cut is none at its ends
    np.testing.assert_allclose(thinned[:, middle], whole[:, middle], rtol=0, atol=tolerance)


@pytest.mark.parametrize(("rate", "factor"), [(500.0, 1), (1249.0, 1), (10.0, 1), (8000.0, 12)])
def test_enough_samples_for_each_period_of_the_cutoff_are_kept(rate, factor):
    assert kept_factor(rate, 5.0) == factor


@pytest.mark.parametrize(
    ("count", "cutoff", "message"),
    [(300, 5.0, "record for longer"), (1000, 250.0, "record more often"), (1, 5.0, "too few")],
)
def test_lowpass_refuses_what_it_cannot_filter(count, cutoff, message):
    with pytest.raises(InsufficientDataError, match=message):
        lowpass(RATE, np.zeros(count), cutoff)
