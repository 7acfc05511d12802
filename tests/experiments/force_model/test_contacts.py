"""Contacts: thresholds from errors, at the stated rate of false alarms, and what is found."""

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from scipy.signal import lfilter

from rigtool.experiments.force_filter.motion_states import CREEPING_KIND, State
from rigtool.experiments.force_model.contacts import (
    FALSE_ALARMS,
    JUMP_WINDOW,
    MotionKind,
    contacts,
    thresholds,
    trial,
)

STEP = 1e-3


def errors(seconds, seed, memory=0.1, size=0.2e-3):
    """Return errors of a memory, s, normal with this deviation, N m."""
    rng = np.random.default_rng(seed)
    kept = np.exp(-STEP / memory)
    white = rng.standard_normal(round(seconds / STEP))
    return size * lfilter([np.sqrt(1 - kept**2)], [1, -kept], white)


def look(torque, states=None, size=0.2e-3):
    states = np.full(len(torque), State.AGAINST) if states is None else states
    return trial(torque, np.full(len(torque), size), states, STEP)


LIMITS = thresholds([look(errors(400, seed)) for seed in range(2)])


@pytest.mark.parametrize("rate", [1 / 30, 1 / 120])
def test_false_alarms_come_at_the_stated_rate(rate):
    limits = thresholds([look(errors(400, seed)) for seed in range(2)], np.full((3, 2), rate / 2))
    hours = [look(errors(1200, 100 + seed)) for seed in range(3)]
    expected = rate * 3 * 1200
    found = sum(len(contacts(hour, limits)) for hour in hours)
    # jumps of either sign, of which those towards zero do not count; a Poisson's spread
    assert 0.1 * expected < found < expected + 4 * np.sqrt(expected)


def test_a_tail_that_few_values_show_is_followed_further():
    few, many = (
        np.mean([thresholds([look(errors(time, seed))])[MotionKind.STEADY, 1] for seed in seeds])
        for time, seeds in ((60, range(8)), (3000, (7,)))
    )
    assert 1.1 * many < few < 3 * many


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_jump_away_from_zero_is_a_contact_and_one_towards_zero_is_none(sign):
    """By jumps alone: no level is high enough."""
    limits, steps = np.tile([1e-3, np.inf], (3, 1)), np.arange(5000)
    pulse = sign * np.where((steps > 3000) & (steps <= 3800), 5e-3, 0.0)
    (found,) = contacts(look(pulse), limits)
    assert (found.begin, found.end) == (pytest.approx(3001, abs=5), pytest.approx(3801, abs=5))
    assert 3001 <= found.found < 3020
    ends = sign * np.where(steps > 3500, 0.4e-3, 5e-3)
    assert contacts(look(ends), limits) == []
    assert contacts(look(0.1 * pulse), limits) == []


def test_the_unit_of_torque_changes_no_contact():
    unit, time = 64.0, np.arange(30_000) * STEP
    own = [errors(100, 8), errors(30, 9) + np.where(time % 7 > 5, 5e-3, 0.0)]
    limits, found = [], []
    for scale in (1.0, unit):
        quiet, touched = (look(scale * each, size=0.2e-3 * scale) for each in own)
        limits.append(thresholds([quiet]) / np.array([scale, 1.0]))
        found.append(contacts(touched, thresholds([quiet])))
    np.testing.assert_allclose(limits[1], limits[0], rtol=1e-9)
    assert len(found[0]) >= 4
    assert found[1] == found[0]


@pytest.mark.compiles
def test_what_is_in_doubt_is_no_contact():
    """Ripple that may be another's, 0.9 mN m, is found where it is certain."""
    time = np.arange(200_000) * STEP
    torque = errors(200, 5) + 0.9e-3 * np.sin(2 * np.pi * 4 * time)
    states, size = np.full(len(torque), State.AGAINST), np.full(len(torque), 0.2e-3)
    assert contacts(trial(torque, size, states, STEP), LIMITS)
    assert contacts(trial(torque, size, states, STEP, 0.9e-3 / np.sqrt(2)), LIMITS) == []


def test_nothing_is_found_where_nothing_touches():
    assert contacts(look(errors(600, 99)), LIMITS) == []


@settings(max_examples=30, deadline=None)
@given(
    st.floats(1.5e-3, 50e-3), st.booleans(), st.floats(3.0, 8.0), st.floats(0.2, 3.0), st.integers()
)
@example(7.8e-3, True, 3.0, 1.0, -2144)  # noise before it is more than half of what it is found by
def test_a_contact_is_found_soon_and_its_ends_are_right(torque, pushes, at, lasts, seed):
    time = np.arange(14000) * STEP
    rise = np.clip(np.minimum(time - at, at + lasts - time) / 0.05, 0, 1)
    side = 1 if pushes else -1
    test = look(side * torque * rise + errors(14, seed % 1000))
    (found,) = contacts(test, LIMITS)
    begin, noticed, end = (step * STEP for step in (found.begin, found.found, found.end))
    assert at <= noticed <= at + 0.1
    assert begin == pytest.approx(at + 0.025, abs=2 * JUMP_WINDOW / np.sqrt(12))
    assert end == pytest.approx(at + lasts - 0.025, abs=2 * JUMP_WINDOW / np.sqrt(12))


def test_what_grows_slowly_is_found_by_its_level():
    time = np.arange(20000) * STEP
    torque = 5e-3 * np.clip((time - 5) / 4, 0, 1)  # 0.075 mN m in a window
    found = contacts(look(torque + errors(20, 5)), LIMITS)
    assert len(found) == 1
    assert 5 < found[0].found * STEP < 9


def test_errors_of_reversals_do_not_count_in_steady_motion():
    states = np.full(400_000, State.AGAINST)
    torque = errors(400, 3)
    for begin in range(5000, 395_000, 2000):
        states[begin : begin + 50] = State.REVERSED
        torque[begin : begin + 50] += 3e-3 * np.sin(np.linspace(0, np.pi, 50))
    limits = thresholds([look(torque, states)])
    assert limits[MotionKind.REVERSED, 0] > 3e-3
    assert limits[MotionKind.STEADY, 0] < 1.5 * LIMITS[MotionKind.STEADY, 0]
    assert contacts(look(torque, states), limits) == []


def test_a_motion_that_is_not_known_finds_nothing():
    assert np.isinf(LIMITS[MotionKind.STILL]).all()
    torque = errors(20, 5)
    torque[8000:] += 50e-3
    assert contacts(look(torque, np.full(20000, State.STILL)), LIMITS) == []
    assert thresholds([]).tolist() == [[np.inf, np.inf]] * 3


def test_no_contact_is_found_outside_what_was_learned_nor_lasts_there():
    torque = np.zeros(20000)
    torque[8000:] = 20e-3
    states = np.full(20000, State.WITH)
    states[9000:] = State.OUTSIDE
    (found,) = contacts(look(torque, states), LIMITS)
    assert found.end == 9000
    states[:] = State.OUTSIDE
    assert contacts(look(torque, states), LIMITS) == []


def test_the_rate_is_one_an_hour_at_most():
    assert np.sum(FALSE_ALARMS, axis=1) * 3600 == pytest.approx([0.55, 1, 1])


def test_errors_of_creeping_are_not_those_of_steady_motion():
    """A rotor that creeps sticks and slips: leaps are no contacts there, nor widen others."""
    kinds, torque = np.full(400_000, State.AGAINST), errors(400, 3)
    for begin in range(5000, 395_000, 2000):
        kinds[begin : begin + 100] = CREEPING_KIND
        torque[begin + 50 : begin + 100] += 3e-3
    limits = thresholds([look(torque, kinds)])
    assert limits[MotionKind.STEADY, 0] < 1.5 * LIMITS[MotionKind.STEADY, 0]
    assert contacts(look(torque, kinds), limits) == []


def test_no_contact_begins_before_another_one_has_ended():
    torque = np.zeros(14000)
    torque[6000:7000], torque[7000:7500], torque[7500:9000] = 60e-3, 28e-3, 50e-3
    first, second = contacts(look(torque + errors(14, 5)), LIMITS)
    assert first.end <= second.begin
