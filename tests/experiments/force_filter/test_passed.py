"""The torque behind the low-pass, against scipy and against one Kalman filter over all states."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.signal import butter, lfilter, sosfiltfilt

from rigtool.experiments.force_filter import passed
from rigtool.experiments.force_filter.joint_covariance import propagate, remove
from rigtool.experiments.force_filter.linear import ROW_LENGTH, forwards
from rigtool.experiments.force_filter.passed import JOINT_STATES
from rigtool.experiments.force_filter.plant import ANGLE, FACTOR_COUNT, NOISE, STATES, TORQUE

KEPT = 0.97
Q = slice(STATES, JOINT_STATES)


def test_the_section_is_the_low_pass_of_scipy():
    section = passed.section(10.0, 1e-3)
    torque = np.random.default_rng(1).normal(size=300)
    q, found = np.zeros(passed.LOW_PASS_ORDER), []
    for value in torque:
        found.append(section[-1] @ np.append(q, value))
        q = section[:-1] @ np.append(q, value)
    expected = lfilter(*butter(passed.LOW_PASS_ORDER, 10.0, fs=1000.0), torque)
    np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-12)


def test_the_delay_is_what_separates_it_from_a_low_pass_without_phase_shift():
    time = np.arange(0, 2, 1e-3)
    slow = np.sin(2 * np.pi * 1.5 * time)
    late = lfilter(*butter(passed.LOW_PASS_ORDER, 10.0, fs=1000.0), slow)
    same = sosfiltfilt(butter(passed.LOW_PASS_ORDER, 10.0, fs=1000.0, output="sos"), slow)
    shift = round(passed.delay(10.0) / 1e-3)
    np.testing.assert_allclose(late[shift:][500:1500], same[500:1500], rtol=0, atol=5e-3)


@given(st.integers(0, 2**32 - 1), st.floats(0.5, 50.0))
def test_it_is_one_kalman_filter_over_all_states(seed, bandwidth_hz):
    rng = np.random.default_rng(seed)
    root = rng.normal(size=(JOINT_STATES, JOINT_STATES))
    mean, covariance = rng.normal(size=JOINT_STATES), root @ root.T
    section = passed.section(bandwidth_hz, 1e-3)
    rows = np.zeros((JOINT_STATES + 1, ROW_LENGTH))
    rows[:JOINT_STATES, :JOINT_STATES] = covariance

    # y of the states as they are
    shared = np.empty(STATES)
    value, variance = passed.output(mean[:STATES], mean[Q], rows.ravel(), section, shared)
    weights = np.zeros(JOINT_STATES)
    weights[Q], weights[TORQUE] = section[-1, :-1], section[-1, -1]
    assert value == pytest.approx(weights @ mean, rel=1e-9, abs=1e-9)
    assert variance == pytest.approx(weights @ covariance @ weights, rel=1e-9)
    np.testing.assert_allclose(shared, (covariance @ weights)[:STATES], rtol=1e-9, atol=1e-9)

    # a step of three samples: x moves by them, q by the low-pass
    factors = rng.normal(size=(3, FACTOR_COUNT))
    factors[:, -1] = 0.0
    moved = np.eye(STATES, ROW_LENGTH).ravel()
    for k in range(3):
        forwards(moved, STATES, factors, k)
    step = np.zeros((JOINT_STATES, JOINT_STATES))
    step[:STATES, :STATES] = moved.reshape(STATES, ROW_LENGTH)[:, :STATES]
    step[NOISE] *= KEPT
    step[Q, Q], step[Q, TORQUE] = section[:-1, :-1], section[:-1, -1]
    flat, q = rows.ravel(), mean[Q].copy()
    passed.predict(q, flat, section, mean[TORQUE])
    propagate(flat, np.zeros(STATES * ROW_LENGTH), factors, 3, KEPT)
    np.testing.assert_allclose(q, (step @ mean)[Q], rtol=1e-9, atol=1e-9)
    expected = step @ covariance @ step.T
    scale = np.sqrt(np.diag(expected))
    found = rows[:JOINT_STATES, :JOINT_STATES]
    np.testing.assert_allclose(found / scale, expected / scale, rtol=0, atol=1e-9 * scale.max())
    np.testing.assert_array_equal(found, found.T)

    # an update by the angle, whose variance falls by a share
    variance, share = found[ANGLE, ANGLE], 0.6
    gain = rows[ANGLE] / variance
    expected = found - np.outer(gain, gain)[:JOINT_STATES, :JOINT_STATES] * variance * share
    remove(flat, gain, np.sqrt(variance * share))
    np.testing.assert_allclose(found / scale, expected / scale, rtol=0, atol=1e-9 * scale.max())
