"""The learned table against scipy's interpolation, and its rules at the edges."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.interpolate import RegularGridInterpolator

from rigtool.control.lookup_table import LookupTable

POSITION = np.arange(40, 101) * (2 * np.pi / 4000)
SPEED = np.array([-20.0, -7.0, -1.5, 1.5, 8.0, 20.0])
LOW = np.array([0.0, 0.4, 0.9, 1.5])
AMPLITUDE = np.array([0.0, 1.3, 1.1, 1.0])


def table(seed=0, **changes):
    torque = np.random.default_rng(seed).normal(0, 2e-3, (len(SPEED), len(POSITION)))
    values = {
        "position": POSITION,
        "speed": SPEED,
        "torque": torque,
        "low_speed": LOW,
        "amplitude": AMPLITUDE,
    }
    return LookupTable(**{**values, **changes})


def points(count=2000, seed=1):
    rng = np.random.default_rng(seed)
    return rng.uniform(POSITION[0], POSITION[-1], count), rng.uniform(-20, 20, count)


def test_agrees_with_scipy_on_the_table_written_out():
    learned = table()
    scaled = [a * learned.torque[2] for a in AMPLITUDE[2:0:-1]]
    rows = [*learned.torque[:2], learned.torque[2], *scaled, np.zeros(len(POSITION))]
    rows += [*(a * learned.torque[3] for a in AMPLITUDE[1:3]), *learned.torque[3:]]
    speeds = [-20, -7, -1.5, -0.9, -0.4, 0, 0.4, 0.9, 1.5, 8, 20]
    expected = RegularGridInterpolator((speeds, POSITION), np.array(rows))
    position, speed = points()
    np.testing.assert_allclose(
        learned.evaluate(position, speed),
        expected(np.column_stack([speed, position])),
        rtol=1e-9,
        atol=1e-12,
    )


def test_the_smallest_table_has_two_positions_and_a_speed():
    table = LookupTable(
        np.array([1.0, 3.0]), np.array([2.0]), np.array([[4.0, 8.0]]), np.array([0.0, 2.0]), [0, 1]
    )
    found = table.evaluate(np.array([1.5, 1.5, 9.0]), np.array([2.0, 1.0, 3.0]))
    np.testing.assert_allclose(found, [5.0, 2.5, 8.0], rtol=1e-12)


@pytest.mark.parametrize("count", [0, 1, 2, 3, 6])
def test_any_number_of_low_speeds_scales_in_both_directions(count):
    low = np.array([0.0, *np.linspace(0.3, 1.2, count), 1.5])
    amplitude = np.array([0.0, *np.linspace(1.7, 0.8, count), 1.0])
    learned = table(low_speed=low, amplitude=amplitude)
    speed = np.linspace(-1.5, 1.5, 200)
    expected = np.interp(np.abs(speed), low, amplitude)[:, None] * np.where(
        speed[:, None] < 0, learned.torque[2], learned.torque[3]
    )
    for number in (0, 17, 60):
        found = learned.evaluate(np.full(200, POSITION[number]), speed)
        np.testing.assert_allclose(found, expected[:, number], rtol=1e-9, atol=1e-12)


@settings(max_examples=50, deadline=None)
@given(row=st.integers(0, len(SPEED) - 1), column=st.integers(0, len(POSITION) - 1))
def test_returns_what_was_learned_at_its_entries(row, column):
    learned = table()
    found = learned.evaluate(POSITION[[column]], SPEED[[row]])
    assert found[0] == pytest.approx(learned.torque[row, column], rel=1e-9, abs=1e-15)


@settings(max_examples=50, deadline=None)
@given(speed=st.floats(0, 1.5), column=st.integers(0, len(POSITION) - 1))
def test_low_speeds_scale_the_lowest_row_of_their_direction(speed, column):
    learned = table()
    factor = np.interp(speed, LOW, AMPLITUDE)
    found = learned.evaluate(POSITION[[column, column]], np.array([speed, -speed]))
    expected = factor * learned.torque[[3, 2], column]
    np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-12)


def test_nothing_is_extrapolated():
    learned = table()
    outside = np.array([-3.0, 9.0])
    np.testing.assert_allclose(
        learned.evaluate(outside, np.array([99.0, -99.0])),
        [learned.torque[-1, 0], learned.torque[0, -1]],
        rtol=1e-12,
        atol=0,
    )
    covered = learned.covers(
        np.array([0.07, 0.07, 0.07, -3.0, POSITION[0], POSITION[-1]]),
        np.array([5.0, 0.0, 20.1, 5.0, -20.0, 20.0]),
    )
    assert covered.tolist() == [True, True, False, False, True, True]


def test_a_direction_that_was_not_learned_is_zero_and_not_covered():
    full = table()
    learned = table(speed=SPEED[3:], torque=full.torque[3:])
    position, speed = points(200)
    found = learned.evaluate(position, speed)
    assert (found[speed < 0] == 0).all()
    np.testing.assert_allclose(
        found[speed > 0], full.evaluate(position, speed)[speed > 0], rtol=1e-9, atol=1e-12
    )
    assert learned.covers(position, speed).tolist() == (speed >= 0).tolist()


def test_is_continuous_through_standstill_and_between_rows():
    learned = table()
    speed = np.linspace(-21, 21, 42001)
    torque = learned.evaluate(np.full(len(speed), 0.1), speed)
    steepest = np.abs(np.diff(learned._rows, axis=0)).max() / 0.4
    assert np.abs(np.diff(torque)).max() <= steepest * 0.001 * (1 + 1e-9)


TURN = np.arange(64) * (2 * np.pi / 64)


def turn_table(seed=0, start=0.0):
    torque = np.random.default_rng(seed).normal(0, 2e-3, (len(SPEED), len(TURN)))
    return table(position=start + TURN, torque=torque, period=2 * np.pi)


@settings(max_examples=50, deadline=None)
@given(
    position=st.floats(-20, 20),
    speed=st.floats(-20, 20),
    turns=st.integers(-1000, 1000),
    start=st.floats(-3, 3),
)
def test_a_table_with_a_period_repeats_after_each_turn(position, speed, turns, start):
    learned = turn_table(start=start)
    here = learned.evaluate(np.array([position]), np.array([speed]))
    there = learned.evaluate(np.array([position + 2 * np.pi * turns]), np.array([speed]))
    # steepest: 15 mN m between entries; the angle itself is rounded
    np.testing.assert_allclose(there, here, rtol=0, atol=1e-12)
    assert learned.covers(np.array([position]), np.array([speed])).all()
    assert not learned.covers(np.array([position]), np.array([20.1])).any()


def test_a_periodic_table_is_that_of_scipy_with_its_first_entry_again_at_the_end():
    learned = turn_table()
    rows = [*learned.torque[:3], learned.torque[2] * AMPLITUDE[2], learned.torque[2] * AMPLITUDE[1]]
    rows += [np.zeros(64), *(a * learned.torque[3] for a in AMPLITUDE[1:3]), *learned.torque[3:]]
    speeds = [-20, -7, -1.5, -0.9, -0.4, 0, 0.4, 0.9, 1.5, 8, 20]
    grid = (speeds, np.append(TURN, 2 * np.pi))
    expected = RegularGridInterpolator(grid, np.column_stack([rows, np.array(rows)[:, 0]]))
    rng = np.random.default_rng(3)
    position, speed = rng.uniform(0, 2 * np.pi, 2000), rng.uniform(-20, 20, 2000)
    np.testing.assert_allclose(
        learned.evaluate(position, speed),
        expected(np.column_stack([speed, position])),
        rtol=1e-9,
        atol=1e-12,
    )


def test_a_periodic_table_is_continuous_over_its_seam():
    learned = turn_table()
    position = np.linspace(-0.3, 0.3, 6001)
    torque = learned.evaluate(position, np.full(len(position), 8.0))
    closed = np.append(learned.torque[4], learned.torque[4][0])
    steepest = np.abs(np.diff(closed)).max() / (2 * np.pi / 64)
    assert np.abs(np.diff(torque)).max() <= steepest * 1e-4 * (1 + 1e-6)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"position": POSITION**2}, "equal steps"),
        ({"position": POSITION[::-1]}, "equal steps"),
        ({"speed": SPEED[::-1]}, "rise"),
        ({"speed": np.array([-20.0, -7.0, -1.5, 0.0, 8.0, 20.0])}, "zero"),
        ({"torque": np.zeros((2, 2))}, r"\(2, 2\)"),
        ({"torque": np.full((6, 61), np.nan)}, "not finite"),
        ({"low_speed": LOW[:-1], "amplitude": AMPLITUDE[:-1]}, "from 0 to 1.5"),
        ({"low_speed": LOW[:-1]}, "each with an amplitude"),
        ({"amplitude": np.array([0.5, 1, 1, 1])}, "start at 0"),
        ({"period": 2 * np.pi}, "cover its period of 6.28319 rad once"),
    ],
)
def test_a_table_that_makes_no_sense_is_refused(changes, message):
    with pytest.raises(ValueError, match=message):
        table(**changes)


@pytest.mark.parametrize("period", [None, 0.4])
def test_the_learned_range_ends_at_its_edges_but_for_rounding(period):
    """A millionth of the lowest speed, and of the step between positions."""
    small = LookupTable(
        position=np.array([0.5, 0.6, 0.7, 0.8]),
        speed=np.array([-20.0, 0.01, 10.0]),
        torque=np.ones((3, 4)),
        low_speed=np.array([0.0, 0.01]),
        amplitude=np.array([0.0, 1.0]),
        period=period,
    )
    beyond = np.array([0.9e-8, 1.1e-8])
    for edge, sign in ((10.0, 1.0), (-20.0, -1.0)):
        assert small.covers(np.full(2, 0.6), edge + sign * beyond).tolist() == [True, False]
    beyond *= 10
    for edge, sign in ((0.8, 1.0), (0.5, -1.0)):
        within = small.covers(edge + sign * beyond, np.full(2, 5.0))
        assert within.tolist() == [True, period is not None]
