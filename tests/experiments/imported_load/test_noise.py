"""How an effort was recorded: noise, steps and a low-pass that were not learned."""

import itertools

import numpy as np
import pytest
from scipy.signal import welch

from rigtool.experiments.imported_load.learning import learn_load_model
from rigtool.experiments.imported_load.noise import (
    SEGMENT_PERIODS,
    EffortNoise,
    _lag,
    learned_noise,
    noise_of,
)
from rigtool.numerics.lowpass import delayed, lowpass
from tests.experiments.imported_load.loaded_drive import (
    RATE,
    observations,
    record,
    signals,
)

OTHERWISE = {
    "noise": lambda effort, random: effort + random.normal(0, 0.03, len(effort)),
    "steps": lambda effort, random: 0.02 * np.round(effort / 0.02),
    "low-pass": lambda effort, random: delayed(RATE, effort, 10.0),
}


@pytest.fixture(scope="module")
def model():
    return learn_load_model(observations(frequencies=(0.15, 0.2, 0.3))).model


@pytest.mark.parametrize("how", OTHERWISE)
def test_intervals_hold_where_the_current_is_recorded_otherwise(model, how):
    random, held, wider = np.random.default_rng(31), [], []
    for load in (0.03, 0.05, 0.07):
        for frequency in (0.15, 0.3):
            time, position, effort, torque = record(
                load, frequency, seed=random.integers(1 << 31), drift=random.normal(0, 1e-3)
            )
            own = model.read(signals(time, position, effort, torque))
            other = signals(time, position, OTHERWISE[how](effort, random), torque)
            found = model.read(other)
            inside = found.inside
            held.append((np.abs(found.torque - other.sensor) <= 1.96 * found.u)[inside])
            wider.append(np.median(found.u[inside]) / np.median(own.u[own.inside]))
            assert own.noisier == pytest.approx(1, abs=0.1)
            assert inside.sum() > 0.8 * own.inside.sum()
    assert np.mean(np.concatenate(held)) > 0.93
    assert min(wider) > 1.05


def test_white_noise_in_the_band_is_what_the_low_pass_lets_through():
    random = np.random.default_rng(3)
    quiet, loud = random.normal(0, [[0.1], [2.0]], (2, 200_000))
    learned = learned_noise([noise_of(quiet, 1000.0, 5.0)])
    variance, lag = learned.beyond(noise_of(loud, 1000.0, 5.0), 5.0)
    assert variance == pytest.approx(np.var(lowpass(1000.0, loud, 5.0)), rel=0.1)
    assert lag == 0
    assert learned.beyond(noise_of(quiet, 1000.0, 5.0), 5.0) == (0, 0)


@pytest.mark.parametrize("where", ["learned", "read"])
def test_an_effort_without_noise_tells_no_lag(where):
    """In one of both recordings nothing is left of an octave."""
    noise = noise_of(np.random.default_rng(3).normal(size=20_000), 1000.0, 5.0)
    none = EffortNoise(np.zeros_like(noise.density), 0.0, noise.rate)
    learned, read = (none, noise) if where == "learned" else (noise, none)
    variance, lag = learned_noise([learned]).beyond(read, 5.0)
    assert np.isfinite(variance)
    assert lag == 0


def test_a_short_recording_is_one_part():
    """Of less than four segments, by scipy; with twice as many it is the mean of two parts."""
    rate, bandwidth = 1000.0, 5.0
    segment = round(SEGMENT_PERIODS * rate / bandwidth)
    effort = np.random.default_rng(6).normal(0, 0.1, 4 * segment)

    def first_octaves(own):
        frequency, density = welch(own, rate, "hann", segment, detrend="constant")
        edges = bandwidth * 2.0 ** np.arange(1, 5)
        return [
            density[(frequency >= low) & (frequency < high)].mean()
            for low, high in itertools.pairwise(edges)
        ]

    whole = noise_of(effort[:-1], rate, bandwidth).density[:3]
    np.testing.assert_allclose(whole, first_octaves(effort[:-1]), rtol=1e-9)
    halves = np.mean([first_octaves(half) for half in np.split(effort, 2)], axis=0)
    np.testing.assert_allclose(noise_of(effort, rate, bandwidth).density[:3], halves, rtol=1e-9)


def test_a_transient_is_no_noise_of_the_whole_recording():
    noise = np.random.default_rng(5).normal(0, 0.1, 20_000)
    homing = noise + np.where(np.arange(20_000) < 3000, 5 * np.sign(np.sin(np.arange(20_000))), 0)
    found, expected = (noise_of(one, 1000.0, 5.0).density for one in (homing, noise))
    np.testing.assert_allclose(found[:6], expected[:6], rtol=0.3)


@pytest.mark.parametrize("pole_hz", [4.0, 20.0, 60.0])
def test_the_lag_of_a_low_pass_is_found_by_its_noise(pole_hz):
    frequency = 5.0 * 2.0 ** (np.arange(8) + 1.5)
    power = 1 / (1 + (frequency / pole_hz) ** 2)
    learned = learned_noise([EffortNoise(np.full(8, c), 0.0, RATE) for c in (1.0, 1.3)])
    _, lag = learned.beyond(EffortNoise(power, 0.0, RATE), 5.0)
    assert lag == pytest.approx(1 / (2 * np.pi * pole_hz), rel=0.05)
    assert learned.beyond(EffortNoise(np.full(8, 0.01), 0.0, RATE), 5.0) == (
        0,
        0,
    )  # less noise alone
    filtered = learned_noise([EffortNoise(power, 0.0, RATE)])
    assert filtered.beyond(EffortNoise(np.ones(8), 0.0, RATE), 5.0)[1] == pytest.approx(
        lag, rel=0.3
    )


def test_a_pole_makes_all_ratios_tell_one_lag():
    """r = 1 + (f / f_p)^2 in the middles of octaves, those from 2 on."""
    frequency = 5.0 * 2.0 ** (np.arange(8) + 1.5)
    for pole_hz in (6.0, 30.0, 400.0):
        ratio = 1 + (frequency / pole_hz) ** 2
        expected = 1 / (2 * np.pi * pole_hz)
        assert _lag(ratio, 5.0) == pytest.approx(expected, rel=1e-9)
        ratio[5:] = np.nan  # beyond half the sampling frequency
        assert _lag(ratio, 5.0) == pytest.approx(expected if pole_hz < 100 else 0, rel=1e-9)
    assert _lag(np.r_[1.0, 30.0, [np.nan] * 6], 5.0) > 0
    assert _lag(np.r_[30.0, [np.nan] * 7], 5.0) == 0


def test_rounding_counts_where_noise_does_not_spread_it():
    random, ramp = np.random.default_rng(4), np.linspace(0, 40.3, 100_000)
    for scatter, left in ((0.0, 1.0), (0.5, 0.0)):
        steps = np.round(ramp + random.normal(0, scatter, len(ramp)))
        for step in (1.0, 0.01, 30.0):
            found = noise_of(step * steps, 1000.0, 5.0)
            assert found.rounding / step**2 == pytest.approx(left / 12, abs=0.01)
    assert noise_of(ramp, 1000.0, 5.0).rounding < 1e-6


@pytest.mark.parametrize("fewer", [5, 20, 50])
def test_noise_that_fewer_samples_fold_into_the_band_is_counted(fewer):
    """Picked samples have all noise below half their rate: of white noise, as much as before."""
    random = np.random.default_rng(7)
    noise = random.normal(0, 1.0, 400_000)
    rate = 1000.0
    learned = learned_noise([noise_of(noise, rate, 5.0)])
    picked, filtered = noise[::fewer], noise.reshape(-1, fewer).mean(axis=1)
    variance = np.var(lowpass(rate / fewer, picked, 5.0)) - np.var(lowpass(rate, noise, 5.0))
    found, _ = learned.beyond(noise_of(picked, rate / fewer, 5.0), 5.0)
    # the octaves that are looked at end before half the rate does
    assert 0.6 * variance < found < 1.1 * variance
    if fewer < 50:  # where nothing above the band is seen, folding cannot be told from a filter
        found, _ = learned.beyond(noise_of(filtered, rate / fewer, 5.0), 5.0)
        assert found < 0.3 * variance
