"""Amplitude and shift of a map by speed: found again where they are known."""

import math

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from scipy.stats import sem

from rigtool.experiments.learning.rows import Row
from rigtool.experiments.learning.speed_tuning import best_shift, tune, written_out
from rigtool.experiments.learning.turns import turn_angles

POSITION = turn_angles(360)
TURNS = 10


def shape(angle):
    return 1e-3 * (np.cos(2 * angle + 1) + 0.4 * np.cos(angle) + 0.1 * np.cos(6 * angle - 2))


def row(speed, amplitude=1.0, shift=0.0, noise=1e-5, seed=0, friction=0.0):
    rng = np.random.default_rng([seed, round(abs(speed) * 1000), int(speed > 0)])
    scatter = noise * rng.standard_normal((TURNS, POSITION.size))
    return Row(speed, friction + amplitude * shape(POSITION + shift) + scatter)


@settings(max_examples=40, deadline=None)
@given(
    amplitude=st.floats(0.2, 2.0),
    shift=st.floats(-0.7, 0.7),
    noise=st.floats(1e-6, 1e-4),
    seed=st.integers(0, 10_000),
)
@example(amplitude=2.0, shift=0.5, noise=1e-6, seed=95)
def test_amplitude_and_shift_are_found_within_their_uncertainty(amplitude, shift, noise, seed):
    learned = row(6.0, noise=0.0)
    found = tune(learned, [row(12.0, amplitude, shift, noise, seed, friction=2e-3)])
    assert found.speed.tolist() == [6.0, 12.0]
    # Student's t with 9 degrees of freedom exceeds 7 once in 30 000 times.
    assert abs(found.amplitude[1] - amplitude) < 7 * found.amplitude_u[1] + 1e-9
    assert abs(found.shift[1] - shift) < 7 * found.shift_u[1] + 1e-9
    assert found.correlation[1] > 0.8
    assert (found.amplitude[0], found.shift[0], found.correlation[0]) == (1.0, 0.0, 1.0)


@given(st.floats(-0.7, 0.7))
def test_without_noise_a_shift_is_found_to_rounding(shift):
    found = tune(row(6.0, noise=0.0), [row(12.0, 0.8, shift, noise=0.0)])
    assert found.shift[1] == pytest.approx(shift, rel=0, abs=1e-9)


def test_uncertainties_are_those_of_repeated_experiments():
    learned = row(6.0, noise=0.0)
    found = [tune(learned, [row(12.0, 0.7, 0.2, 1e-4, seed)]) for seed in range(60)]
    for name in ("amplitude", "shift"):
        values = np.array([getattr(item, name)[1] for item in found])
        u = np.array([getattr(item, f"{name}_u")[1] for item in found])
        assert np.sqrt(np.mean(u**2)) == pytest.approx(values.std(ddof=1), rel=0.35), name


def test_shifts_are_followed_from_speed_to_speed():
    """Beyond half a period of the leading order a single speed could not show it."""
    speeds = np.array([-12.0, -9, -6, -3, 3, 6, 9, 12, 15])
    shifts = 0.35 * (6.0 - speeds) / 3
    rows = [row(s, 1.0, d) for s, d in zip(speeds, shifts, strict=True) if s != 6.0]
    found = tune(row(6.0, noise=0.0), rows)
    np.testing.assert_allclose(found.speed, speeds, rtol=0, atol=0)
    np.testing.assert_allclose(found.shift, shifts, rtol=0, atol=0.02)


def test_the_map_stays_where_its_speed_was_recorded_again():
    found = tune(row(6.0, noise=0.0), [row(6.0, 0.8, 0.2), row(12.0, 0.9, 0.1, noise=0.0)])
    assert (found.speed.tolist(), found.amplitude[0]) == ([6.0, 12.0], 1.0)
    assert (found.shift[0], found.shift[1]) == (0.0, pytest.approx(0.1, rel=0, abs=1e-9))


@pytest.mark.parametrize("amplitude", [0.0, -0.5])
def test_what_does_not_repeat_is_not_compensated(amplitude):
    """Zero where nothing like the map is there; a map upside down is another map, shifted."""
    rng = np.random.default_rng(2)
    other = Row(12.0, 1e-4 * rng.standard_normal((TURNS, POSITION.size)))
    found = tune(row(6.0, noise=0.0), [other])
    assert found.amplitude[1] == 0.0
    assert found.amplitude_u[1] > 0
    upside_down = tune(row(6.0, noise=0.0), [row(12.0, amplitude)])
    assert upside_down.amplitude[1] >= 0


def test_nothing_learned_is_nothing_tuned():
    learned = Row(6.0, np.zeros((TURNS, POSITION.size)))
    found = tune(learned, [row(12.0), row(-6.0)])
    table, _ = written_out(POSITION, learned, found)
    assert found.amplitude.tolist() == [0.0, 1.0, 0.0]
    assert not table.torque.any()


def test_the_table_written_out_is_the_map_with_amplitude_and_phase():
    learned = row(6.0, noise=0.0)
    speeds = np.array([-30.0, -6, -1, 1, 3, 20])
    rows = [row(s, 1.2 - 0.02 * abs(s), 0.02 * (6 - s)) for s in speeds]
    found = tune(learned, rows)
    table, u = written_out(POSITION, learned, found)
    assert table.period == 2 * math.pi
    assert u.shape == table.torque.shape
    rng = np.random.default_rng(0)
    position = rng.uniform(-20, 20, 500)
    speed = np.concatenate([rng.uniform(-30, -1, 250), rng.uniform(1, 20, 250)])
    amplitude, shift = found.at(speed)
    expected = amplitude * shape(position + shift)
    # Rows differ by 0.3 rad of the leading order at most: 1 % half way, 9 % of the sixth order
    np.testing.assert_allclose(table.evaluate(position, speed), expected, rtol=0, atol=0.03e-3)


def test_u_of_the_table_has_that_of_amplitude_and_shift():
    """At 0.3 of the map, the other speed's noise in both is more than that of the map itself."""
    angles = np.arange(1, 7)[:, None] * POSITION
    waves, tables, us = np.array([np.cos(angles), np.sin(angles)]), [], []
    for seed in range(60):
        rng = np.random.default_rng([11, seed])
        one, other = (
            1e-4 * (rng.standard_normal((2, TURNS, 6)) @ waves).sum(axis=0) for _ in range(2)
        )
        learned = Row(6.0, shape(POSITION) + one)
        found = tune(learned, [Row(12.0, 0.3 * shape(POSITION + 0.2) + other)])
        table, u = written_out(POSITION, learned, found)
        tables.append(table.torque[-1])
        us.append(u[-1])
    scatter = np.array(tables).std(axis=0, ddof=1)
    assert np.sqrt(np.mean(np.square(us))) == pytest.approx(np.sqrt(np.mean(scatter**2)), rel=0.15)


@settings(max_examples=50, deadline=None)
@given(shift=st.floats(-1.4, 1.4), near=st.floats(-0.1, 0.1))
def test_the_best_shift_is_the_true_one_without_noise(shift, near):
    wave = np.array([0.4, 1.0 + 1.0j, 0.0, 0.1j])
    turned = wave * np.exp(1j * np.arange(1, 5) * shift)
    assert best_shift(wave, turned, near, math.pi / 2) == pytest.approx(shift, rel=0, abs=1e-9)


def test_u_of_an_amplitude_is_that_of_a_mean_of_turns():
    other = row(12.0, 0.7, 0.2, noise=1e-4, seed=3)
    found = tune(row(6.0, noise=0.0), [other])
    pattern = shape(POSITION + found.shift[1])
    each = other.moves @ pattern / (pattern @ pattern)
    assert found.amplitude_u[1] == pytest.approx(sem(each), rel=1e-6)
