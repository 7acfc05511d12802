"""Smoothing against scipy, and derivatives against what they are of."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.ndimage import gaussian_filter1d

from rigtool.errors import InsufficientDataError
from rigtool.numerics.smoothing import (
    KernelSmoother,
    noise_of_derivatives,
    position_noise,
    resample,
)

STEP = 1e-3


@pytest.mark.parametrize(("derivative", "tolerance"), [(0, 1e-7), (1, 1e-5), (2, 1e-4)])
def test_scipy_smooths_the_same(derivative, tolerance):
    values = np.cumsum(np.random.default_rng(0).normal(size=3000))
    smoother = KernelSmoother(STEP, 20 * STEP)
    places = smoother.places(len(values))
    expected = (
        gaussian_filter1d(values, 20, order=derivative, truncate=8)[places] / STEP**derivative
    )
    scale = np.max(np.abs(expected))
    np.testing.assert_allclose(smoother(values, derivative), expected, atol=tolerance * scale)


@settings(deadline=None, max_examples=25)
@given(st.floats(0.5, 20), st.floats(2e-3, 30e-3), st.floats(-1e6, 1e6))
def test_derivatives_of_a_sine_have_the_response_that_is_stated(frequency, width, level):
    """exp(-(2 pi f s)^2 / 2), without delay and without a trace of what is constant."""
    time = np.arange(0, 2, STEP)
    omega = 2 * np.pi * frequency
    smoother = KernelSmoother(STEP, width)
    at = time[smoother.places(len(time))]
    gain = np.exp(-((omega * width) ** 2) / 2)
    values = level + np.sin(omega * time)
    atol = 1e-5 + 1e-15 * abs(level) / (omega * width) ** 2
    np.testing.assert_allclose(
        smoother(values, 1) / omega, gain * np.cos(omega * at), rtol=0, atol=atol
    )
    np.testing.assert_allclose(
        smoother(values, 2) / omega**2, -gain * np.sin(omega * at), rtol=0, atol=10 * atol
    )


def test_the_cutoff_is_at_3_db():
    smoother = KernelSmoother(STEP, 0.01)
    gain = np.exp(-((2 * np.pi * smoother.cutoff * smoother.width) ** 2) / 2)
    assert gain == pytest.approx(np.sqrt(0.5), rel=1e-12)


def test_noise_of_derivatives_is_what_white_noise_leaves():
    noise = np.random.default_rng(1).normal(0, 1e-4, 400_000)
    smoother = KernelSmoother(STEP, 15e-3)
    for derivative, expected in zip((1, 2), noise_of_derivatives(1e-8 * STEP, 15e-3), strict=True):
        assert np.std(smoother(noise, derivative)) == pytest.approx(expected, rel=0.03)


def test_noise_of_a_position_is_found_beside_its_motion():
    time = np.arange(0, 20, STEP)
    motion = 5 * np.sin(2 * np.pi * time)
    noisy = motion + np.random.default_rng(2).normal(0, 1e-3, len(time))
    assert position_noise(noisy, STEP) == pytest.approx(1e-6 * STEP, rel=0.05)
    # Counts of an encoder that pass one by one: q^2/12 for as long as a count lasts
    count = 0.01
    counted = np.round(motion / count) * count
    lasts = count / (4 * 5)  # mean speed of a sine of amplitude 5 and 1 Hz
    assert position_noise(counted, STEP) == pytest.approx(
        count**2 / 12 * max(STEP, lasts), rel=0.05
    )


def test_an_even_time_axis_stays_as_it_is():
    time, values = np.arange(1000) * STEP, np.random.default_rng(3).normal(size=1000)
    step, known, (found,) = resample(time, values)
    assert step == pytest.approx(STEP, rel=1e-12)
    assert known.all()
    np.testing.assert_array_equal(found, values)


def test_an_uneven_one_is_made_even_and_a_gap_stays_unknown():
    random = np.random.default_rng(4)
    time = np.cumsum(random.uniform(0.5, 1.5, 2000)) * STEP
    time[1000:] += 0.5
    step, known, (line, sine) = resample(time, 3 * time, np.sin(time))
    assert step == pytest.approx(np.median(np.diff(time)), rel=1e-12)
    even = time[0] + step * np.arange(len(line))
    np.testing.assert_allclose(line, 3 * even, rtol=1e-12)
    np.testing.assert_allclose(sine[known], np.sin(even[known]), atol=1e-5)
    assert np.sum(~known) * step == pytest.approx(0.5, abs=0.005)
    assert resample(time, time, gap=0.6)[1].all()
    short = resample(time, time, gap=1.2 * STEP)[1]
    assert 0.1 < np.mean(~short) < 0.6  # a third of the samples, and more of the time


def test_time_that_is_mostly_gaps_is_refused():
    time = np.concatenate([np.arange(100) * STEP, 1000 + np.arange(100) * STEP])
    with pytest.raises(InsufficientDataError, match=r"gaps up to 1e\+03 s"):
        resample(time, time)


@pytest.mark.parametrize(("part", "counted"), [(0.005, True), (0.02, False)])
def test_steps_are_counts_where_all_but_a_hundredth_are_whole(part, counted):
    steps = np.full(20000, 0.01)
    steps[:: round(1 / part)] *= 1.5
    position = np.cumsum(steps)
    white = np.mean(np.diff(position, 4) ** 2) / 70 * STEP
    expected = 0.01**2 / 12 * STEP if counted else white
    assert white < 0.01**2 / 12 * STEP / 10
    assert position_noise(position, STEP) == pytest.approx(expected, rel=0.02)
