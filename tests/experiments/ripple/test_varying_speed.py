"""Torque that accelerates a rotor around the turn, beside its equation of motion."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from rigtool.experiments.ripple.orders import LoopRipple, Sampling
from rigtool.experiments.ripple.varying_speed import (
    LEAP,
    fastest,
    friction_changes,
    motor_orders,
    slowest,
    speed_variation,
    uneven_orders,
)
from tests.experiments.ripple.fine import FINE

CELLS, POINTS, ORDERS, INERTIA = 500, 200_000, 60, 2e-5
EDGES = np.linspace(0.0, 2 * np.pi, CELLS + 1)
ANGLE = np.linspace(0.0, 2 * np.pi, POINTS + 1)


def durations(speed):
    """Return the time for each cell (1, cells) of a speed over `ANGLE`."""
    passed = np.concatenate([[0.0], np.cumsum(2 / (speed[1:] + speed[:-1]) * np.diff(ANGLE))])
    return np.diff(np.interp(EDGES, ANGLE, passed))[None]


def accelerating(durations, sampling=FINE, width=1):
    """Return the orders that accelerate the inertia: without torque, those of the ripple less."""
    still = LoopRipple(
        np.zeros_like(durations), sampling, durations, np.zeros(ORDERS), 0.0, np.zeros(ORDERS)
    )
    asked, found = motor_orders(still, INERTIA, np.ones(ORDERS, complex), width)
    assert not asked.any()
    return -found


@pytest.mark.parametrize("swing", [0.02, 0.3, 0.7])
def test_what_accelerates_is_inertia_times_acceleration_at_any_swing(swing):
    """Speed 9 (1 + swing cos 4 angle + 0.1 swing cos 21 angle): w dw/d(angle) over the angle."""
    speed = 9 * (1 + swing * (np.cos(4 * ANGLE + 0.3) + 0.1 * np.cos(21 * ANGLE)))
    slope = -9 * swing * (4 * np.sin(4 * ANGLE + 0.3) + 2.1 * np.sin(21 * ANGLE))
    expected = np.fft.rfft((INERTIA * speed * slope)[:-1])[1 : ORDERS + 1] * 2 / POINTS
    for width in (1, 2):
        found = accelerating(durations(speed), width=width)[0]
        assert_allclose(found, expected, atol=5e-3 * width**2 * np.abs(expected).max())


def test_samples_far_apart_attenuate_it_as_they_do_a_torque():
    speed = 9 * (1 + 0.01 * np.cos(40 * ANGLE))
    sampling = Sampling(0.008, 4)
    taken = durations(speed)
    alone = accelerating(taken)[0]
    found = accelerating(taken, sampling)[0]
    assert found[39] * sampling.gain(np.array([40.0])) == pytest.approx(alone[39], rel=1e-9)


def test_what_noise_does_to_single_turns_leans_nowhere():
    """The square of a speed with 20 % of noise is 4 % more than that of its mean, and more where
    the rotor is slow: the mean of the turns has that of the mean durations."""
    taken = durations(9 * (1 + 0.3 * np.cos(ANGLE)))
    noise = 0.2 * np.random.default_rng(1).standard_normal((20, CELLS))
    turns = taken * (1 + noise - noise.mean(axis=0))
    found = accelerating(turns)
    alone = accelerating(taken)[0]
    assert_allclose(found.mean(axis=0), alone, rtol=1e-9, atol=1e-9 * np.abs(alone).max())
    assert np.abs(found[0] - alone).max() > 0.01 * np.abs(alone).max()


def test_torque_counts_by_the_time_that_it_acts_and_turns_to_when_it_does():
    """Order 3 in cells of which every other takes three times as long: over two cells the longer
    ones count more, which moves the wave by a quarter of a cell to and fro, and its mean not."""
    wave = np.cos(3 * (np.arange(CELLS) + 0.5) * 2 * np.pi / CELLS) / np.sinc(3 / CELLS)
    turned = np.exp(-0.1j * np.arange(1, ORDERS + 1))
    taken = np.tile([1e-3, 3e-3], (2, CELLS // 2))
    for width in (1, 2):
        torque = np.tile(wave * np.sinc(3 / CELLS), (2, 1))
        own = LoopRipple(torque, FINE, taken, np.zeros(ORDERS), 0.0, np.zeros(ORDERS))
        asked, _ = motor_orders(own, INERTIA, turned, width)
        assert_allclose(asked[:, 2], np.exp(-0.3j), rtol=2e-3)
        assert np.abs(np.delete(asked, 2, axis=1)).max() < 1e-3


def waving(part, order):
    """Return durations with a standard deviation of `part` at an order."""
    wave = np.sqrt(2) * np.cos(order * (np.arange(CELLS) + 0.5) * 2 * np.pi / CELLS)
    return 2e-3 * (1 + part * wave)[None] * np.array([[0.5], [1.5]])


@pytest.mark.parametrize("part", [0.0, 0.02, 0.2])
def test_the_variation_of_the_speed_is_its_standard_deviation(part):
    assert speed_variation(waving(part, 5)) == pytest.approx(part, rel=1e-3, abs=1e-9)


@pytest.mark.parametrize(("order", "part"), [(1, 0.1), (30, 0.1), (31, 0.0)])
def test_the_speed_varies_up_to_order_30_if_not_more_are_asked_for(order, part):
    assert speed_variation(waving(0.1, order)) == pytest.approx(part, rel=1e-3, abs=1e-9)
    assert speed_variation(waving(0.1, order), 31) == pytest.approx(0.1, rel=1e-3)


@pytest.mark.parametrize(("order", "expected"), [(2, 1 / 0.8), (31, 1.0)])
def test_the_fastest_place_is_where_a_cell_takes_least_time(order, expected):
    assert fastest(waving(0.2 / np.sqrt(2), order)) == pytest.approx(expected, rel=1e-3)
    assert fastest(waving(1.0, 2)) == LEAP


def test_friction_changes_by_the_steeper_slope_to_the_speeds_around_and_at_the_ends_by_any():
    """Between others a slope of 2 and -0.5 mN m s, then of -0.5 and 1; backwards as forwards."""
    speed, friction = np.array([1.0, 2.0, 6.0, 8.0]), np.array([3.0, 5.0, 3.0, 5.0]) * 1e-3
    ends = 3e-3 / np.sqrt(3), 5e-3 / np.sqrt(3)
    for sign in (1, -1):
        found = friction_changes(speed, sign * friction, 0.9)
        assert_allclose(found, [ends[0], 2e-3 * 2.0, 1e-3 * 6.0, ends[1]])
    for few in (1, 2):
        found = friction_changes(speed[:few], friction[:few], 0.9)
        assert_allclose(found, friction[:few] / np.sqrt(3))


def test_viscous_friction_shows_that_none_of_a_mixed_lubrication_is_left():
    speed = np.array([1.0, 4.0, 9.0, 20.0])
    found = friction_changes(speed, 2e-3 + 1e-4 * speed, 0.9)
    assert found[0] == pytest.approx(1e-4, rel=1e-3)


@pytest.mark.parametrize("velocity", [0.3, 0.5, 0.8, 1.2])
@pytest.mark.parametrize("lowest", [0.4, 0.7, 1.0])
def test_friction_of_a_mixed_lubrication_changes_by_no_more(velocity, lowest):
    """Of as much more friction at rest as there is of the other."""

    def friction(v):
        return 2e-3 + 2e-3 * np.exp(-((v / velocity) ** 2)) + 2e-5 * v

    speed = np.array([1.0, 4.0, 9.0, 20.0])
    found = friction_changes(speed, friction(speed), lowest)[0]
    low = min(lowest, 0.999)
    change = abs(friction(low) - friction(1.0)) / (1 - low)
    assert change <= np.sqrt(3) * found
    if velocity == 0.3 and lowest == 1.0:
        assert found < 0.1 * 2e-3


def test_the_lowest_speed_is_that_of_the_slowest_place():
    assert slowest(durations(9 * (1 + 0.3 * np.cos(3 * ANGLE)))) == pytest.approx(
        0.7 / np.sqrt(1 - 0.3**2), rel=0.01
    )


def test_torque_changes_with_an_uneven_speed_as_friction_and_ripple_may():
    """A speed of 1 + 0.1 cos 3 angle: friction in order 3; ripple of order 8 in 5 and 11."""
    taken = np.repeat(durations(9 * (1 + 0.1 * np.cos(3 * ANGLE))), 2, axis=0)
    wave = np.cos(8 * (np.arange(CELLS) + 0.5) * 2 * np.pi / CELLS)
    own = LoopRipple(
        np.tile(2e-3 * wave, (2, 1)), FINE, taken, np.zeros(ORDERS), 1e-3, np.zeros(ORDERS)
    )
    found = uneven_orders(own, ORDERS)
    mean = np.sqrt(1 - 0.1**2)  # of the speed over time
    assert found[2] == pytest.approx(1e-3 * 0.1 / mean, rel=2e-3)
    for order in (5, 11):
        assert found[order - 1] == pytest.approx(1e-3 * 0.1 / mean / np.sqrt(3), rel=2e-3)
