"""What repeats and what is chance, against scipy and by Monte Carlo."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.signal import lfilter
from scipy.stats import f

from rigtool.experiments.learning.repeatable import (
    MAX_CHANCE_PART,
    Repeatability,
    only_kept,
    repeatability,
)

ANGLE = np.arange(256) * (2 * np.pi / 256)


def noise(rng, cycles, memory=0.0):
    white = rng.standard_normal(cycles * 256)
    return lfilter([1.0], [1.0, -memory], white).reshape(cycles, 256)


@pytest.mark.parametrize(("memory", "cycles"), [(0.0, 20), (0.0, 4), (0.98, 20)])
def test_noise_alone_is_rarely_called_repeatable(memory, cycles):
    rng = np.random.default_rng(7)
    found = [repeatability(noise(rng, cycles, memory)) for _ in range(200)]
    # At the stated level of 1 %, more than 8 of 200 has a probability below 1e-3.
    assert sum(item.kept().any() for item in found) <= 8
    assert sum(item.ratio() > item.limit() for item in found) <= 8


@settings(max_examples=40, deadline=None)
@given(
    order=st.integers(1, 100),
    phase=st.floats(0, 6.3),
    cycles=st.integers(4, 20),
    seed=st.integers(0, 1000),
)
def test_what_stands_out_of_the_noise_is_kept(order, phase, cycles, seed):
    rng = np.random.default_rng(seed)
    # 256 samples and four cycles make noise of 0.04 in an order.
    wave = 3 * np.cos(order * ANGLE + phase)
    found = repeatability(noise(rng, cycles) + wave)
    kept = found.kept()
    assert kept[order]
    assert found.ratio() > found.limit()
    clean = only_kept(noise(rng, cycles) * 0 + wave + 2.0, kept)
    np.testing.assert_allclose(clean.mean(axis=1), 2.0 * kept[0], rtol=0, atol=1e-12)
    np.testing.assert_allclose(clean - clean.mean(), wave + 0 * clean, rtol=0, atol=1e-12)


def test_the_ratio_is_that_of_fisher():
    """Orders of equal noise: the limit is the quantile of F, by scipy."""
    chance = np.full(101, 2.0)
    chance[0] = 0.0
    found = Repeatability(np.zeros(101), chance, 12)
    assert found.limit() == pytest.approx(f.isf(MAX_CHANCE_PART, 200, 200 * 11), rel=1e-9)
    assert found.ratio() == 0.0


def test_orders_are_kept_as_benjamini_and_hochberg_do():
    """Against the procedure written out, with scipy's F."""
    rng = np.random.default_rng(3)
    cycles = noise(rng, 10) + 0.25 * np.cos(np.outer([5, 9, 14], ANGLE)).sum(axis=0)
    found = repeatability(cycles)
    power = found.mean / found.chance
    p = f.sf(power, 2, 18)
    p[0] = f.sf(power[0], 1, 9)
    ranks = np.argsort(np.argsort(p)) + 1
    passed = p <= MAX_CHANCE_PART * ranks / p.size
    expected = p <= p[passed].max()
    np.testing.assert_array_equal(found.kept(), expected)
    assert expected.sum() == 3


@pytest.mark.parametrize("cycles", [2, 3, 20])
@pytest.mark.parametrize(("order", "real"), [(0, 1), (2, 2)])
def test_an_order_alone_is_kept_beyond_its_quantile_of_f(order, real, cycles):
    """Few cycles estimate their own noise from few numbers: two real ones an order and cycle."""
    quantile = f.isf(MAX_CHANCE_PART, real, real * (cycles - 1))
    for part, kept in ((0.999, []), (1.001, [order])):
        mean, chance = np.zeros(5), np.full(5, 2.0)
        mean[order] = part * quantile * chance[order]
        assert np.flatnonzero(Repeatability(mean, chance, cycles).kept()).tolist() == kept


def test_what_is_zero_or_exact_needs_no_chance():
    nothing = repeatability(np.zeros((3, 64)))
    assert not nothing.kept().any()
    assert nothing.limit() == 1.0
    exact = repeatability(np.tile(np.cos(3 * ANGLE), (3, 1)))
    assert np.flatnonzero(exact.kept()).tolist() == [3]
    with pytest.raises(ValueError, match="at least 2"):
        repeatability(np.zeros((1, 64)))


def test_a_mean_that_carries_more_noise_is_judged_more_gently():
    rng = np.random.default_rng(5)
    cycles = noise(rng, 8)
    assert repeatability(cycles, 2.0).ratio() == pytest.approx(
        repeatability(cycles).ratio() / 2, rel=1e-9
    )


@pytest.mark.parametrize("scale", [1.0, 1e-3])
def test_chance_counts_that_cycles_are_like_those_before(scale):
    """Amplitudes with a memory of half a cycle: the variance of their mean is three times more."""
    rng = np.random.default_rng(11)
    drift = lfilter([1.0], [1.0, -0.5], rng.standard_normal((100, 30, 2)), axis=1)
    waves = np.stack([np.cos(3 * ANGLE), np.sin(3 * ANGLE)])
    found = [repeatability(scale * item @ waves) for item in drift]
    shown = np.mean([item.mean[3] for item in found])
    stated = np.mean([item.chance[3] for item in found])
    assert 0.8 * shown < stated < 1.6 * shown  # a negative correlation is not credited


@given(offset=st.floats(-5, 5), cycles=st.integers(2, 10), seed=st.integers(0, 1000))
def test_the_orders_hold_the_power_of_the_mean_cycle(offset, cycles, seed):
    # Parseval; an odd count has no order at half the sampling rate.
    found = np.random.default_rng(seed).standard_normal((cycles, 255)) + offset
    mean = found.mean(axis=0)
    np.testing.assert_allclose(repeatability(found).mean.sum(), np.mean(mean**2), rtol=1e-9)
