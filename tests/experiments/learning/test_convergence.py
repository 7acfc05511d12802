"""Learning run after run in a loop that is only noise and a disturbance."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from rigtool.control.position_loop import TransferFunction
from rigtool.experiments.learning.convergence import Cycles, carried_noise, learning_run
from rigtool.experiments.learning.filters import Learning, zpetc

POINTS, CYCLES = 256, 12
EVERYTHING = np.ones(POINTS, dtype=np.bool_)
DISTURBANCE = np.cos(3 * np.arange(POINTS) * (2 * np.pi / POINTS))


def identity(factor):
    one = TransferFunction(np.array([1.0]), np.array([1.0]), 125e-6)
    return Learning(one, zpetc(one, 0.999), 3000.0, 4, factor)


def learn(factor, runs, noise, seed=0, disturbance=DISTURBANCE):
    """Return what each run was judged to be: q = d - f + noise."""
    rng = np.random.default_rng(seed)
    learning, fed, found = identity(factor), np.zeros(POINTS), []
    for updates in range(runs):
        signal = disturbance - fed + noise * rng.standard_normal((CYCLES, POINTS))
        cycles = Cycles(0.256, signal, fed, EVERYTHING)
        found.append(learning_run([cycles], learning, updates))
        fed = learning.updated(signal, 0.256, fed).mean(axis=0)
    return found


@settings(max_examples=50, deadline=None)
@given(factor=st.floats(0.05, 1.9), updates=st.integers(0, 12))
def test_carried_noise_is_that_of_the_recursion_summed_up(factor, updates):
    expected = sum((factor * (1 - factor) ** k) ** 2 for k in range(updates))
    assert carried_noise(updates, factor) == pytest.approx(expected, rel=1e-9, abs=1e-15)


def test_deadbeat_learning_is_finished_after_one_update():
    first, second = learn(1.0, 2, 0.1)
    assert not first.finished
    assert second.finished
    assert first.rms == pytest.approx(np.sqrt(0.5), rel=0.02)
    assert second.rms < 0.06  # two runs of noise, 0.1/sqrt(12) each
    assert first.scatter == pytest.approx(0.1, rel=0.1)


def test_a_small_factor_takes_the_disturbance_away_bit_by_bit():
    found = learn(0.3, 24, 0.02)
    rms = np.array([run.rms for run in found])
    expected = np.sqrt(0.5) * 0.7 ** np.arange(24)
    np.testing.assert_allclose(rms[:6], expected[:6], rtol=0.05, atol=0)
    finished = [run.finished for run in found]
    assert not any(finished[:8])
    assert any(finished)


@pytest.mark.parametrize("factor", [1.0, 0.5])
def test_where_nothing_repeats_learning_is_finished_at_once_and_stays_so(factor):
    found = [run for seed in range(40) for run in learn(factor, 3, 1.0, seed, 0 * DISTURBANCE)]
    # 1 % of 120 by chance
    assert sum(not run.finished for run in found) <= 6


def test_the_uncertainty_is_that_of_repeated_experiments():
    found = [learn(1.0, 1, 0.5, seed)[0] for seed in range(60)]
    spread = np.std([run.rms for run in found], ddof=1)
    assert np.sqrt(np.mean([run.rms_u**2 for run in found])) == pytest.approx(spread, rel=0.35)


def test_rms_and_peak_of_several_speeds_have_the_jackknife_written_out():
    rng, learning = np.random.default_rng(3), identity(1.0)
    signals = [size * (DISTURBANCE + 0.3 * rng.standard_normal((5, POINTS))) for size in (1, 1.02)]
    judged = learning_run(
        [Cycles(0.256, signal, np.zeros(POINTS), EVERYTHING) for signal in signals], learning, 0
    )
    smoothed = [learning.smoothed(signal, 0.256) for signal in signals]
    for found, statistic in (
        (judged.peak_u, lambda means: np.abs(means).max()),
        (judged.rms_u, lambda means: np.sqrt(np.mean(means**2))),
    ):
        without = [
            statistic(np.array([np.delete(each, i, axis=0).mean(axis=0) for each in smoothed]))
            for i in range(5)
        ]
        assert found == pytest.approx(np.sqrt(4 * np.var(without)), rel=1e-9, abs=0)


def test_only_the_part_that_is_used_counts():
    half = EVERYTHING.copy()
    half[POINTS // 2 :] = False
    signal = np.where(half, 0.0, 5.0) + np.zeros((4, POINTS))
    judged = learning_run([Cycles(0.256, signal, np.zeros(POINTS), half)], identity(1.0), 0)
    # Q reaches over the edge by a few samples
    assert judged.rms < 0.7
    assert judged.peak < 4
