"""Turns of a steadily turning shaft: known orders come back, whatever the time axis."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from rigtool.errors import InsufficientDataError
from rigtool.experiments.ripple.imported_turns import (
    aliases,
    fill,
    find_turns,
    reduction,
    refined_speed,
)
from rigtool.experiments.ripple.orders import (
    Ripple,
    Sampling,
    Spectrum,
    spectrum,
)
from tests.experiments.ripple.fine import FINE

POSITIONS = 500


def orders_of(waveforms, orders, sampling=FINE):
    return spectrum(Ripple(waveforms, sampling), orders)


def turning(turns=3.0, speed=0.2, start=0.37, seed=1, orders=((7, 0.8, 0.3), (28, 0.2, -1.0))):
    """Irregular time, angle in turns, and torque with these orders: (order, amplitude, phase)."""
    random = np.random.default_rng(seed)
    count = int(turns * 4000)
    time = np.cumsum(random.uniform(0.5, 1.5, count))
    time *= abs(turns / speed) / time[-1]
    angle = start + speed * time
    torque = 0.1 + sum(a * np.cos(2 * np.pi * k * angle + p) for k, a, p in orders)
    return time, angle, torque


@pytest.mark.parametrize("speed", [0.2, -0.2])
def test_orders_come_back_with_amplitude_and_phase(speed):
    found = find_turns(*turning(speed=speed), POSITIONS)
    assert found.speed == pytest.approx(2 * math.pi * speed, rel=1e-3, abs=0)
    assert len(found.torque) == 3
    found_orders = orders_of(fill(found.torque)[0], 100)
    for order, amplitude, phase in ((7, 0.8, 0.3), (28, 0.2, -1.0)):
        assert found_orders.amplitude[order - 1] == pytest.approx(amplitude, rel=5e-3, abs=0)
        assert found_orders.phase[order - 1] == pytest.approx(phase, rel=0, abs=0.01)
    assert found_orders.strongest() == 7


def test_the_ripple_of_the_motion_is_told_apart_from_its_speed():
    time, angle, torque = turning()
    moved = angle + 1e-3 / (2 * np.pi) * np.cos(2 * np.pi * 12 * angle)
    found_orders = orders_of(fill(find_turns(time, moved, torque, POSITIONS).deviation)[0], 50)
    assert found_orders.strongest() == 12
    assert found_orders.amplitude[11] == pytest.approx(1e-3, rel=0.02, abs=0)


def test_what_is_before_the_steady_motion_is_left_out():
    """A run that first goes back to where it starts, and swings."""
    time, angle, torque = turning(turns=1.0, start=0.0, orders=((7, 0.8, 0.3),))
    away = np.exp(-time / 0.05) * np.cos(40 * time)
    found = find_turns(time, angle + away, torque - 5 * away, POSITIONS)
    assert 0.05 < found.settled < 0.6
    amplitude = orders_of(fill(found.torque)[0], 20).amplitude
    assert amplitude[6] == pytest.approx(0.8, rel=0.03, abs=0)


@settings(deadline=None, max_examples=25)
@given(st.integers(1, 60), st.floats(-3.1, 3.1), st.floats(-5, 5), st.booleans())
def test_any_order_any_start_either_direction(order, phase, start, backwards):
    speed = -0.2 if backwards else 0.2
    found = find_turns(
        *turning(turns=2.0, speed=speed, start=start, orders=((order, 1.0, phase),)), POSITIONS
    )
    found_orders = orders_of(fill(found.torque)[0], 80)
    assert found_orders.strongest() == order
    error = math.remainder(found_orders.phase[order - 1] - phase, 2 * math.pi)
    assert abs(error) < 0.05


def test_a_gap_of_one_turn_is_filled_from_the_others():
    first, second = np.arange(8.0), np.arange(8.0) + 2
    second[3] = np.nan
    filled, gap = fill(np.stack([first, second]))
    assert gap == 0
    assert filled[1, 3] == 3.0


def test_a_gap_of_all_turns_is_bridged_and_reported():
    values = np.array([[0.0, np.nan, np.nan, 3.0, 2.0, 1.0, 0.0, 0.0]])
    filled, gap = fill(values)
    assert filled[0, 1:3].tolist() == [1.0, 2.0]
    assert gap == 2 / 8
    around = np.roll(values, 7)  # the same gap across the end of the turn
    np.testing.assert_allclose(fill(around)[0], np.roll(filled, 7), rtol=1e-14, atol=0)


def test_one_turn_has_the_noise_of_the_orders_around():
    random = np.random.default_rng(3)
    floors = [
        orders_of(random.normal(size=(1, POSITIONS)), 100).noise_floor.mean() for _ in range(20)
    ]
    # White noise of unit variance: each order's rms amplitude is sqrt(4/n), sinc aside.
    assert np.mean(floors) == pytest.approx(math.sqrt(4 / POSITIONS), rel=0.06, abs=0)


@pytest.mark.parametrize("backwards", [False, True])
def test_samples_of_a_steady_motion_are_a_step_apart(backwards):
    """Which Sampling needs; nothing of it where samples skip cells."""
    angle = 0.2 + np.arange(4001) * (3.2 / 4000)
    time, torque = np.arange(4001) * 1e-2, np.cos(2 * np.pi * 3 * angle)
    found = find_turns(time, -angle if backwards else angle, torque, POSITIONS)
    assert found.step == pytest.approx(3.2 / 4000, rel=1e-9)
    skipping = angle + np.where(np.arange(4001) % 50 == 0, 2.5 / POSITIONS, 0.0)
    assert find_turns(time, skipping, torque, POSITIONS).step == 0


def test_reduction_with_its_uncertainty():
    zero = np.zeros(3)
    order = np.arange(1.0, 4)
    before = Spectrum(order, np.array([1.0, 0.5, 0.01]), zero, np.array([0.1, 0.0, 0.1]))
    after = Spectrum(order, np.array([0.2, 0.6, 0.0]), zero, np.array([0.05, 0.0, 0.1]))
    value, u = reduction(before, after)
    np.testing.assert_allclose(value[:2], [0.8, -0.2], rtol=1e-12, atol=0)
    assert np.isnan(value[2])  # what is noise cannot be reduced
    expected = math.hypot(0.05, 0.2 * 0.1) / math.sqrt(2)
    np.testing.assert_allclose(u[:2], [expected, 0.0], rtol=1e-12, atol=0)


@pytest.mark.parametrize("samples", [251.0, 137.3, 100.0])
def test_few_samples_a_turn_are_fitted_over_many_turns(samples):
    """Orders within three of their u, and u of the size that the noise makes it."""
    random = np.random.default_rng(int(samples))
    noise, turns = 0.1, 40
    count = int(samples * turns)
    angle = 0.37 + np.arange(count) / samples
    known = ((1, 0.5, 0.2), (2, 0.3, 1.0), (3, 0.1, 2.0), (6, 0.8, 0.3), (24, 0.1, 0.5))
    torque = sum(a * np.cos(2 * np.pi * k * angle + p) for k, a, p in known)
    torque = torque + random.normal(0, noise, count)
    found = find_turns(np.arange(count) / 1000, angle, torque, POSITIONS)
    assert found.orders >= 24
    assert len(found.torque) * found.turns_a_row == pytest.approx(turns, abs=1, rel=0)
    fitted = orders_of(found.torque, found.orders)
    u = fitted.noise_floor / math.sqrt(2)
    expected = noise * math.sqrt(2 / count)
    assert np.sqrt(np.mean(u**2)) == pytest.approx(expected, rel=0.3, abs=0)
    for order, amplitude, _ in known:
        assert abs(fitted.amplitude[order - 1] - amplitude) < 4 * expected


def test_cells_of_a_fitted_series_hold_means_over_their_width():
    angle = 0.37 + np.arange(6000) / 100.3
    torque = 0.2 * np.cos(2 * np.pi * 24 * angle + 0.5)
    found = find_turns(np.arange(6000) / 1000, angle, torque, POSITIONS)
    left, right = np.arange(POSITIONS) / POSITIONS, (np.arange(POSITIONS) + 1) / POSITIONS
    wave = [np.sin(2 * np.pi * 24 * edge + 0.5) / (2 * np.pi * 24) for edge in (left, right)]
    means = 0.2 * (wave[1] - wave[0]) * POSITIONS
    np.testing.assert_allclose(found.torque, np.tile(means, (len(found.torque), 1)), atol=1e-6)


@pytest.mark.parametrize("start", [-57.6, 57.6])
@pytest.mark.parametrize("way", [1, -1])
def test_each_fit_holds_turns_of_its_own(start, way):
    """A ripple that grows evenly over 40 turns, wherever the count of turns begins."""
    turns, samples = 40, 137.3
    passed = np.arange(int(turns * samples)) / samples
    angle = start + way * passed
    torque = (1 + passed / turns) * np.cos(2 * np.pi * 3 * angle)
    found = find_turns(np.arange(len(angle)) / 1000, angle, torque, POSITIONS)
    assert len(found.torque) * found.turns_a_row == pytest.approx(turns, abs=1, rel=0)
    cells = (np.arange(POSITIONS) + 0.5) / POSITIONS
    amplitude = 2 * np.mean(found.torque * np.cos(2 * np.pi * 3 * cells), axis=1)
    middle = (np.arange(len(amplitude)) + 0.5) / len(amplitude)
    np.testing.assert_allclose(amplitude, 1 + middle, rtol=2e-3)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda t, a, y: (t, a * 0.1, y), "0.30 of a turn steadily, 0.9 are"),
        (lambda t, a, y: (t, a * 0, y), "0.00 of a turn"),
        (lambda t, a, y: (t[:50], a[:50], y[:50]), "50 samples are too few, 64"),
        (lambda t, a, y: (np.arange(80) * 5.0, np.arange(80.0), y[:80]), "resolve no order"),
        (lambda t, a, y: (t[::-1], a, y), "time does not rise"),
        (lambda t, a, y: (t, a, np.where(y > 0.5, np.nan, y)), "torque is nan"),
    ],
)
def test_data_that_do_not_carry_it(change, message):
    with pytest.raises(InsufficientDataError, match=message):
        find_turns(*change(*turning()), POSITIONS)


def evenly(samples, turns, orders, noise=0.0, start=0.13):
    """Time, angle in turns and torque of an even motion, `samples` a turn."""
    angle = start + np.arange(int(turns * samples)) / samples
    torque = 0.1 + sum(a * np.cos(2 * np.pi * k * angle + p) for k, a, p in orders)
    torque += noise * np.random.default_rng(2).standard_normal(len(angle))
    return np.arange(len(angle)) * 1e-3, angle, torque


@pytest.mark.parametrize("samples", [4992.5, 5000.0, 5163.0])
def test_cells_leave_no_pattern_of_their_own(samples):
    """Orders that are not there: cells that hold two samples, then three, would show some 1 %."""
    found = find_turns(*evenly(samples, 6.0, ((24, 0.5, 0.0), (150, 0.3, 1.0))), 2500)
    found_orders = orders_of(fill(found.torque)[0], found.orders, Sampling(found.step))
    assert found.orders == 500
    for order, amplitude in ((24, 0.5), (150, 0.3)):
        assert found_orders.amplitude[order - 1] == pytest.approx(amplitude, rel=2e-4, abs=0)
        found_orders.amplitude[order - 1] = 0
    assert found_orders.amplitude.max() < 2e-4


@given(st.integers(1, 59))
@settings(deadline=None, max_examples=20)
def test_orders_that_samples_at_the_same_angles_do_not_tell_apart(order):
    """60 samples a turn show order 36 as 24; at 60.6 they distinguish 36 from 24."""
    sums = {60.0: True, 60.6: False}
    for samples, aliased in sums.items():
        turns = evenly(samples, 80, ())[1]
        alias, leak = aliases(turns, min(order, 25), 100)
        assert (leak[-1] > 0) == aliased
        if aliased:
            assert alias[-1] in {60 - min(order, 25), 60 + min(order, 25), 120 - min(order, 25)}
            assert leak[-1] == pytest.approx(1, rel=1e-6, abs=0)


@pytest.mark.parametrize("highest", [18, 19, 20, 21])
def test_aliases_are_looked_for_up_to_the_highest_order(highest):
    """Of 20 samples at equal angles of each turn, orders 20 - k and 20 + k show as order k."""
    alias, leak = aliases(np.arange(200) / 20 + 0.3, 3, highest)
    expected = [20 - k if 20 - k <= highest else np.nan for k in (1, 2, 3)]
    np.testing.assert_array_equal(alias, expected)
    np.testing.assert_allclose(leak, np.isfinite(expected), atol=1e-9)


def test_an_alias_is_in_the_turns():
    found = find_turns(*evenly(60.0, 80, ((36, 0.3, 0.0),), noise=0.01), POSITIONS)
    found_orders = orders_of(found.torque, found.orders)
    assert found_orders.strongest() == 24
    assert found.leak[23] == pytest.approx(1, rel=1e-6, abs=0)
    assert found.alias[23] in (36, 84)


@pytest.mark.parametrize("true", [9.81, 10.0, 10.07, -10.07])
def test_a_stated_speed_is_refined_by_the_orders_of_the_torque(true):
    time, _, torque = evenly(1e3 / abs(true), 80, ((6, 0.3, 0.0), (1, 0.1, 0.5)), noise=0.05)
    found = refined_speed(time, torque, math.copysign(10.0, true))
    # The turns over the whole recording, 80, come out to some thousandths.
    assert (found - true) * time[-1] == pytest.approx(0, rel=0, abs=0.01)
    noise = np.random.default_rng(3).standard_normal(len(time))
    assert refined_speed(time, noise, 10.0) == 10.0
