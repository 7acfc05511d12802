"""The torque behind the low-pass, against scipy and against one Kalman filter over all states."""

from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.signal import butter, lfilter, sosfiltfilt

from rigtool.experiments.force_filter import passed
from rigtool.experiments.force_filter.kalman import STATE
from rigtool.experiments.force_filter.plant import (
    ANGLE,
    MOVING_STATES,
    NOISE,
    STATES,
    TORQUE,
)

ALL = STATES + passed.ORDER
KEPT = 0.97
Q = slice(STATES, ALL)


def test_the_section_is_the_low_pass_of_scipy():
    section = passed.section(10.0, 1e-3)
    torque = np.random.default_rng(1).normal(size=300)
    q, found = np.zeros(passed.ORDER), []
    for value in torque:
        found.append(section[-1] @ np.append(q, value))
        q = section[:-1] @ np.append(q, value)
    expected = lfilter(*butter(passed.ORDER, 10.0, fs=1000.0), torque)
    np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-12)


def test_the_delay_is_what_separates_it_from_a_low_pass_without_phase_shift():
    time = np.arange(0, 2, 1e-3)
    slow = np.sin(2 * np.pi * 1.5 * time)
    late = lfilter(*butter(passed.ORDER, 10.0, fs=1000.0), slow)
    same = sosfiltfilt(butter(passed.ORDER, 10.0, fs=1000.0, output="sos"), slow)
    shift = round(passed.delay(10.0) / 1e-3)
    np.testing.assert_allclose(late[shift:][500:1500], same[500:1500], rtol=0, atol=5e-3)


def whole(state):
    """Mean (14,) and covariance (14, 14) of x and q together."""
    covariance = np.zeros((ALL, ALL))
    covariance[:STATES, :STATES] = state["covariance"][0]
    covariance[:STATES, Q] = state["shared_covariance"][0]
    covariance[Q, :STATES] = state["shared_covariance"][0].T
    covariance[Q, Q] = state["passed_covariance"][0]
    return np.concatenate([state["mean"][0], state["passed"][0]]), covariance


def put(state, mean, covariance):
    state["mean"], state["passed"] = mean[:STATES], mean[Q]
    state["covariance"], state["passed_covariance"] = covariance[:STATES, :STATES], covariance[Q, Q]
    state["shared_covariance"] = covariance[:STATES, Q]


@given(st.integers(0, 2**32 - 1), st.floats(0.5, 50.0))
def test_it_is_one_kalman_filter_over_all_states(seed, bandwidth_hz):
    rng = np.random.default_rng(seed)
    root = rng.normal(size=(ALL, ALL))
    mean, covariance = rng.normal(size=ALL), root @ root.T
    section = passed.section(bandwidth_hz, 1e-3)
    state = np.zeros(1, dtype=STATE)
    put(state, mean, covariance)
    rows = np.zeros((STATES, STATES))
    rows[:MOVING_STATES] = rng.normal(size=(MOVING_STATES, STATES))

    # y of the states as they are
    row = np.empty(STATES)
    value, variance = passed.output(state[0], section, row)
    weights = np.zeros(ALL)
    weights[Q], weights[TORQUE] = section[-1, :-1], section[-1, -1]
    assert value == pytest.approx(weights @ mean, rel=1e-9, abs=1e-9)
    assert variance == pytest.approx(weights @ covariance @ weights, rel=1e-9)
    np.testing.assert_allclose(row, (covariance @ weights)[:STATES], rtol=1e-9, atol=1e-9)

    # a step: x moves by `rows`, q by the low-pass
    step = np.zeros((ALL, ALL))
    step[:MOVING_STATES, :STATES] = rows[:MOVING_STATES]
    step[np.arange(MOVING_STATES, STATES), np.arange(MOVING_STATES, STATES)] = 1
    step[NOISE, NOISE] = KEPT
    step[Q, Q], step[Q, TORQUE] = section[:-1, :-1], section[:-1, -1]
    passed.predict(state[0], section, rows, KEPT, NOISE, np.empty((2, STATES)))
    mean, covariance = step @ mean, step @ covariance @ step.T
    found, after = whole(state)
    scale = np.abs(covariance).max()
    np.testing.assert_allclose(found[Q], mean[Q], rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(after[Q], covariance[Q], rtol=1e-9, atol=1e-12 * scale)

    # an update by the angle, whose variance falls by a share
    put(state, mean, covariance)
    variance, share, shift = covariance[ANGLE, ANGLE], 0.6, 0.3
    gain = covariance[:, ANGLE] / variance
    passed.update(state[0], gain[:STATES].copy(), shift, variance * share, variance)
    found, after = whole(state)
    expected = covariance - np.outer(gain, gain) * variance * share
    np.testing.assert_allclose(found[Q], (mean + gain * shift)[Q], rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(after[Q], expected[Q], rtol=1e-9, atol=1e-11 * scale)


def test_compiled_code_stays_within_its_arrays():
    # Python raises where machine code writes beyond an array.
    rng = np.random.default_rng(1)
    section, rows = passed.section(10.0, 1e-3), rng.normal(size=(STATES, STATES))
    root = rng.normal(size=(ALL, ALL))
    found = []
    for predict in (passed.predict, passed.predict.__wrapped__):
        state = np.zeros(1, dtype=STATE)
        put(state, np.arange(ALL, dtype=float), root @ root.T)
        plain = SimpleNamespace(**{name: state[name][0] for name in STATE.names})
        of_numba = predict is passed.predict
        predict(state[0] if of_numba else plain, section, rows, KEPT, NOISE, np.empty((2, STATES)))
        found.append(whole(state))
    for one, other in zip(*found, strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-12, atol=1e-12)
