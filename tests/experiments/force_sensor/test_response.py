"""The bandwidth of a torque is where its amplitude falls below that of the reference."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from rigtool.experiments.force_sensor.response import RIGHT_AMPLITUDE, Spectra, amplitude_bandwidth
from rigtool.numerics.lowpass import delayed, lowpass
from rigtool.recipe.commands import ForceMotion

RATE = 1000.0


def spectra(torque, reference, valid=None):
    valid = np.ones(len(torque), dtype=bool) if valid is None else valid
    return Spectra.of(torque, reference, valid, RATE)


@given(st.integers(0, 2**32 - 1), st.floats(8.0, 60.0))
def test_that_of_a_low_pass_is_where_its_gain_is(seed, cutoff_hz):
    rng = np.random.default_rng(seed)
    reference = rng.standard_normal(60_000)
    torque = lowpass(RATE, reference, cutoff_hz) + 1e-3 * rng.standard_normal(60_000)
    value, u = amplitude_bandwidth([spectra(torque[:30_000], reference[:30_000])] * 2)
    exact = cutoff_hz * (1 / RIGHT_AMPLITUDE - 1) ** 0.25  # 1 / (1 + (f / fc)^4)
    assert value == pytest.approx(exact, abs=3 * u)
    assert u < 1.0


@pytest.mark.parametrize("bandwidth_hz", [3.0, 10.0, 15.0])
def test_the_low_pass_leaves_amplitudes_up_to_the_bandwidth(bandwidth_hz):
    corner_hz = ForceMotion(bandwidth_hz=bandwidth_hz).corner_hz
    sine = np.sin(2 * np.pi * bandwidth_hz * np.arange(10_000) / RATE)
    for found in (lowpass(RATE, sine, corner_hz), delayed(RATE, sine, corner_hz)):
        assert 0.985 < np.abs(found[2000:-2000]).max() < 1.0


def test_a_sine_alone_shows_its_frequency():
    time = np.arange(40_000) / RATE
    sine = np.sin(2 * np.pi * 10.0 * time)
    noise = 0.02 * np.random.default_rng(5).standard_normal(40_000)
    assert amplitude_bandwidth([spectra(0.97 * sine + noise, sine)])[0] == pytest.approx(
        10.0, abs=2.5
    )
    assert np.isnan(amplitude_bandwidth([spectra(0.9 * sine + noise, sine)])[0])


def test_what_has_no_value_does_not_count():
    rng = np.random.default_rng(3)
    reference = rng.standard_normal(40_000)
    torque, valid = reference.copy(), np.ones(40_000, dtype=bool)
    torque[10_000:20_000], valid[10_000:20_000] = 0.0, False
    assert amplitude_bandwidth([spectra(torque, reference, valid)])[0] == pytest.approx(100.0)
    assert np.isnan(amplitude_bandwidth([spectra(torque, reference, ~valid)])[0])


def test_what_is_no_part_of_the_reference_changes_no_amplitude():
    reference, noise = np.random.default_rng(6).standard_normal((2, 60_000))
    ratio, u = spectra(0.97 * reference + 0.3 * noise, reference).amplitude()
    assert ratio[1:].mean() == pytest.approx(0.97, abs=0.01)
    # error over u, of 100 frequencies of which neighbours share the window
    assert np.sqrt(np.mean(((ratio[1:] - 0.97) / u[1:]) ** 2)) == pytest.approx(1.0, abs=0.35)


@pytest.mark.parametrize("segments", [1, 2, 4, 6])
def test_noise_shows_no_amplitude_however_short_it_is(segments):
    for seed in range(50):
        size = 500 * (segments + 1)
        reference, noise = np.random.default_rng(seed).standard_normal((2, size))
        assert np.isnan(amplitude_bandwidth([spectra(noise, reference)])[0])


def test_of_few_segments_u_is_as_large_as_the_error():
    """Of n segments apart the ratio takes one: by n instead, u is 0.82 of the error here."""
    n, size, rng = 3, 40_000, np.random.default_rng(8)
    reference = np.exp(2j * np.pi * rng.random((n, size)))
    noise = (rng.standard_normal((n, size)) + 1j * rng.standard_normal((n, size))) * 0.02
    torque = 0.9 * reference + noise
    squares = (np.sum(np.abs(one) ** 2, axis=0) for one in (reference, torque))
    cross = np.sum(np.conj(reference) * torque, axis=0)
    ratio, u = Spectra(np.arange(float(size)), *squares, cross, 2 * n).amplitude()
    assert np.mean((ratio - 0.9) ** 2) == pytest.approx(np.mean(u**2), rel=0.05)
