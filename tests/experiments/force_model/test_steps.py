"""From recorded samples to those of the filter: grids, counts, gaps."""

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from rigtool.experiments.force_model.steps import (
    SAMPLE_TIME,
    STEP_TIME,
    FilterSteps,
    Sampler,
    Stepper,
    unbroken,
)


@given(st.floats(1e-5, 4e-3))
def test_the_filter_keeps_its_pace_at_any_rate_of_recording(interval):
    grid = FilterSteps.of(interval, interval)
    assert grid.sample_time <= SAMPLE_TIME * (1 + 1e-5)
    assert grid.averaged == 1 or grid.divided == 1
    span = grid.step_samples * grid.sample_time
    assert STEP_TIME / 2 < span < 2 * STEP_TIME


@pytest.mark.parametrize(("interval", "expected"), [(125e-6, (4, 1, 2)), (2e-3, (1, 4, 2))])
def test_grids_of_the_rates_in_use(interval, expected):
    grid = FilterSteps.of(interval, interval)
    assert (grid.averaged, grid.divided, grid.step_samples) == expected


@pytest.mark.parametrize("averaged", [1, 4, 16])
def test_counts_come_back_from_means(averaged):
    dt = 125e-6
    time = np.arange(1.6e4) * dt
    angle = 40 * np.sin(2 * np.pi * 0.4 * time)  # counts, up to 100 counts/s
    exact = np.floor(angle)
    encoder = exact.reshape(-1, averaged).mean(axis=1)
    grid = FilterSteps.of(averaged * dt, dt)
    found = grid.counts(encoder)
    middle = (np.arange(len(found)) + 0.5) * grid.sample_time / dt
    truth = exact[np.round(middle).astype(int)]
    assert np.abs(found - truth).max() <= (0 if averaged == 1 else 1)
    assert np.mean(found != truth) < 0.02


@pytest.mark.parametrize("averaged", [2, 16])
@pytest.mark.parametrize("speed", [-2718.3, 403.7, 4669.2])
def test_angles_belong_to_the_middle_of_a_sample_of_a_slow_loop(averaged, speed):
    """The loop reads the encoder at the begin of its samples, of 1 ms."""
    dt = 1e-3
    encoder = np.floor(speed * np.arange(1600) * dt).reshape(-1, averaged).mean(axis=1)
    grid = FilterSteps.of(averaged * dt, dt)
    truth = speed * (np.arange(1600 * grid.divided // averaged) + 0.5) * grid.sample_time
    late = (grid.counts(encoder) + 0.5 - truth)[100:-100]
    assert abs(late.mean()) < 0.1
    assert np.abs(late).max() <= 1


def test_means_keep_the_sum_of_what_they_average():
    grid = FilterSteps.of(250e-6, 125e-6)
    np.testing.assert_allclose(grid.means(np.array([1.0, 3.0, 5.0, 9.0, 7.0])), [2.0, 7.0], rtol=0)


def test_a_slow_sample_is_each_of_the_filter_s_within_it():
    grid = FilterSteps.of(2e-3, 125e-6)
    assert (grid.divided, grid.earlier) == (4, False)
    np.testing.assert_array_equal(grid.means(np.array([1.0, 3.0])), [1.0] * 4 + [3.0] * 4)


def test_a_gap_and_bad_samples_divide_a_recording():
    time = np.arange(20) * 0.1
    time[8:] += 0.5
    good = np.ones(20, dtype=bool)
    good[15] = False
    assert unbroken(np.diff(time), good, 0.1) == [slice(0, 8), slice(8, 15), slice(16, 20)]


class Plain:
    """A drive whose torque is the current times the constant."""

    def torque(self, angle, current, constant, sample_time, ripple):
        return current * constant, np.zeros(len(angle))


@pytest.mark.parametrize("averaged", [1, 2, 16])
def test_blocks_give_the_same_samples_as_a_whole_recording(averaged):
    """Whatever the blocks' lengths: what waits is context for what comes, and counts once."""
    rng = np.random.default_rng(4)
    dt = 125e-6 * averaged
    time = np.arange(4000) * dt
    angle = 300 * np.sin(4 * np.pi * time / time[-1])
    encoder = np.floor(angle[:, None] + np.zeros(averaged)).mean(axis=1)
    samples = np.stack([encoder, rng.standard_normal(4000), np.full(4000, 0.05), np.arange(4000.0)])

    def sampled(*edges):
        sampler = Sampler(FilterSteps.of(dt, 125e-6), 0.1, Plain(), context=256)
        cuts = pairwise([0, *edges, 4000])
        found = [sampler.add(samples[:, a:b], last=b == 4000) for a, b in cuts]
        return [
            np.concatenate(parts, axis=-1)
            for parts in zip(*((s.drive_torque, s.low, others) for s, others in found), strict=True)
        ]

    whole, parts = sampled(), sampled(700, 1400, 1401, 2900)
    for one, other in zip(whole, parts, strict=True):
        np.testing.assert_allclose(other, one, rtol=1e-12, atol=1e-12)
    assert whole[1].size >= 4000 // 4


@pytest.mark.parametrize("rate", [20e3, 10e3, 8e3, 6e3, 5e3, 4e3, 3e3, 2e3, 1.5e3, 1e3])
@pytest.mark.parametrize("speed", [-2718.3, 4669.2])
def test_angles_belong_to_the_middle_of_what_acts_at_any_rate_of_a_loop(rate, speed):
    """A sample's current acts until the next one; blocks of any length give the same."""
    number = np.arange(1600)
    encoder, middle = np.floor(speed * number / rate), (number + 0.5) / rate
    samples = np.stack([encoder, np.zeros(1600), np.zeros(1600), middle])
    grid = FilterSteps.of(1 / rate, 1 / rate)
    sampler = Sampler(grid, 1.0, Plain(), context=0)
    found = [sampler.add(samples[:, a:b]) for a, b in pairwise([0, 0, 1, 700, 701, 1600])]
    low = np.concatenate([signals.low for signals, _ in found])
    acts = np.concatenate([others[2] for _, others in found])
    late = (low + 0.5 - speed * acts)[grid.step_samples :: grid.step_samples]
    assert abs(late.mean()) < 0.1
    assert np.abs(late).max() <= 0.5 + 1e-6


@pytest.mark.parametrize("interval", [2e-3, 4e-3])
@pytest.mark.parametrize("rate", [0.3, 0.8, 1.2, 1.7, -1.95, -2.5])
def test_counts_between_samples_are_known_to_a_third_of_a_count(interval, rate):
    """Rounding alone leaves 0.29; the rotor passes `rate` counts from one sample to the next."""
    encoder = np.floor(0.37 + rate * np.arange(2000))
    grid = FilterSteps.of(interval, interval)
    middle = (np.arange(2000 * grid.divided) + 0.5) / grid.divided
    off = (grid.counts(encoder) + 0.5 - (0.37 + rate * middle))[100:-100]
    assert abs(off.mean()) < 0.15
    assert off.std() < 0.4


class ByAngle(Plain):
    """A drive whose torque is the angle at which it is asked."""

    def torque(self, angle, current, constant, sample_time, ripple):
        return angle.copy(), np.zeros(len(angle))


def test_a_drive_is_asked_at_the_middle_of_the_count_and_idles_below_a_milliampere():
    encoder = np.floor(0.3 * np.arange(400))
    current = np.where(np.arange(400) < 200, 0.9e-3, -1.1e-3)
    samples = np.stack([encoder, current, np.full(400, 0.05)])
    sampler = Sampler(FilterSteps.of(0.5e-3, 0.5e-3), 0.1, ByAngle(), context=0)
    found, _ = sampler.add(samples, last=True)
    np.testing.assert_allclose(found.drive_torque, found.low + 0.05)
    np.testing.assert_allclose(np.unique(found.low / 0.1 % 1).round(9) % 1, 0)
    assert found.width == 0.1
    assert found.idle[:195].all()
    assert not found.idle[205:].any()


@pytest.mark.parametrize("size", [1, 2, 5])
def test_signals_at_the_end_of_a_step_are_means_of_both_sides(size):
    samples = np.random.default_rng(6).standard_normal((2, 43))
    stepper, found = Stepper(size), []
    for first, last in pairwise([0, 1, 3, 4, 20, 43]):
        found.append(stepper.add(samples[:, first:last]))
    ends = range(size, 43, size)
    expected = [(samples[:, k - 1] + samples[:, k]) / 2 for k in ends]
    np.testing.assert_allclose(np.hstack(found), np.transpose(expected))
