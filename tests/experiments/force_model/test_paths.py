"""Bristles, lags, tendon and the angle between counts against their closed forms."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import solve_ivp

from rigtool.experiments.force_filter.encoder_angle import interpolated
from rigtool.experiments.force_model.paths import bristle, lagged, tendon


@pytest.mark.compiles
@settings(deadline=None)
@given(
    st.floats(1e-4, 1.0),
    st.lists(st.floats(-3.0, 3.0), min_size=2, max_size=6),
    st.integers(2, 40),
)
def test_a_bristle_depends_on_the_path_not_on_its_samples(length, corners, finer):
    coarse = np.array(corners)
    fine = np.interp(
        np.linspace(0, len(coarse) - 1, (len(coarse) - 1) * finer + 1),
        np.arange(len(coarse)),
        coarse,
    )
    np.testing.assert_allclose(
        bristle(fine, length, False)[-1], bristle(coarse, length, False)[-1], rtol=0, atol=1e-9
    )
    assert np.abs(bristle(fine, length, False)).max() <= 1.0


@pytest.mark.compiles
@settings(deadline=None)
@given(st.floats(1e-3, 1.0), st.floats(1e-3, 0.1), st.floats(-5.0, 5.0))
def test_a_ramp_lags_by_the_lags_time(time, interval, slope):
    ramp = slope * interval * np.arange(400.0)
    late = lagged(ramp[None], interval, time, False)[0]
    elapsed = interval * np.arange(400)
    expected = slope * (elapsed - time * (1 - np.exp(-elapsed / time)))
    np.testing.assert_allclose(late, expected, rtol=0, atol=1e-9 * (1 + abs(slope)))


@pytest.mark.compiles
def test_a_slow_load_hangs_where_the_tendon_is_in_balance():
    angle = np.linspace(0, 2.5, 4000)
    carried, output = tendon(angle, 2e-3, 0.2, 1e-3, 1e-5, 0.0, 5e-3, 0.04, False)
    np.testing.assert_allclose(carried[500:-1], 0.04 * np.sin(output[500:-1]), rtol=0, atol=1e-4)
    np.testing.assert_allclose(
        0.2 * (angle - output)[500:-1], carried[500:-1], rtol=0, atol=1e-3 * 0.4
    )


BARE_INERTIA = 2e-6


@pytest.mark.parametrize(("moment", "load_inertia"), [(0.04, 8e-5), (0.0, 0.0)])
@pytest.mark.parametrize("interval", [2e-3, 4e-3])
def test_a_load_that_swings_is_what_scipy_integrates(moment, load_inertia, interval):
    stiffness, damping, inertia = 0.2, 8e-4, BARE_INERTIA + load_inertia
    period = 0.6
    time = np.arange(round(period / interval)) * interval
    turn = 2 * np.pi / period

    def motor(t):
        return np.pi / 2 + 1.2 * np.sin(turn * t), 1.2 * turn * np.cos(turn * t)

    def slope(t, state):
        b, speed = motor(t)
        carried = stiffness * (b - state[0]) + damping * (speed - state[1])
        return [state[1], (carried - moment * np.sin(state[0])) / inertia]

    last = 8 * period
    solved = solve_ivp(
        slope, (0, last), [1.5, 0], t_eval=last - period + time, rtol=1e-8, atol=1e-10
    )
    b, speed = motor(time)
    carried, output = tendon(b, interval, stiffness, damping, inertia, 0.0, 5e-3, moment, True)
    np.testing.assert_allclose(output, solved.y[0], rtol=0, atol=1e-3)
    expected = stiffness * (b - solved.y[0]) + damping * (speed - solved.y[1])
    assert np.std(carried - expected) < 0.02 * np.std(expected)
    # the inertia of the bare output is learned from it, beside loads of forty times as much
    accelerated = -1.2 * turn**2 * np.sin(turn * time)
    more = (carried - expected) @ accelerated / (accelerated @ accelerated)
    assert abs(more) < 0.02 * BARE_INERTIA
    # and the stiffness from how far a load swings
    stiffer = 1.01 * stiffness
    by = tendon(b, interval, stiffer, damping, inertia, 0.0, 5e-3, moment, True)[0] - carried
    assert not moment or abs(0.01 * (carried - expected) @ by / (by @ by)) < 3e-4


def test_friction_of_the_joint_adds_while_rising_and_takes_off_while_falling():
    angle = np.pi / 2 + 0.6 * np.sin(2 * np.pi * np.arange(512) / 512)
    free, held = (
        tendon(angle, 20 / 512, 50.0, 0.05, 8e-5, friction, 5e-3, 0.05, True)[0]
        for friction in (0.0, 1e-3)
    )
    difference = held - free
    assert np.median(difference[:100]) == pytest.approx(1e-3, rel=0.02)
    assert np.median(difference[160:350]) == pytest.approx(-1e-3, rel=0.02)


def test_without_a_load_the_output_follows_at_once():
    angle = np.sin(2 * np.pi * np.arange(256) / 256)
    carried, output = tendon(angle, 1 / 256, 0.2, 1e-4, 1e-6, 0.0, 5e-3, 0.0, True)
    np.testing.assert_allclose(output, angle, rtol=0, atol=5e-3)
    assert np.abs(carried).max() < 1e-3


@settings(deadline=None, max_examples=30)
@given(
    st.floats(0.1, 0.5),
    st.floats(3e-4, 1.2e-3),
    st.floats(1e-6, 4e-6),
    st.integers(1, 10),
    st.sampled_from([250, 500]),
)
def test_what_moves_a_bare_output_is_its_own_inertia(stiffness, damping, inertia, hertz, rate):
    """By the transfer function of a mass on a spring and a damper."""
    turn = 2j * np.pi * hertz
    angle = 0.3 * np.sin(2 * np.pi * hertz * np.arange(rate) / rate)
    carried, _ = tendon(angle, 1 / rate, stiffness, damping, inertia, 0.0, 5e-3, 0.0, True)
    spring = stiffness + turn * damping
    expected = spring * inertia * turn**2 / (spring + inertia * turn**2)
    found = np.fft.rfft(carried)[hertz] / np.fft.rfft(angle)[hertz]
    assert abs(found / expected) == pytest.approx(1, abs=5e-3)
    assert abs(np.angle(found / expected)) < 0.12


@settings(deadline=None)
@given(st.floats(0.05, 3.0), st.floats(0.3, 4.0), st.sampled_from([1, 4, 16]))
def test_edges_tell_the_angle_to_a_part_of_a_count(amplitude, speed, every):
    time = np.arange(0, 3, 125e-6)
    counts = amplitude * 200 * np.sin(speed * time)
    whole = len(time) // every * every
    recorded = np.floor(counts)[:whole].reshape(-1, every).mean(axis=1)
    truth = counts[:whole].reshape(-1, every).mean(axis=1)
    found = interpolated(recorded, np.arange(0.5, len(recorded)))
    assert np.abs(found - truth).max() < 1.0


@pytest.mark.parametrize("side", [1, -1])
def test_where_a_rotor_turns_within_a_count_is_not_taken_for_the_edge(side):
    """Of all heights beyond the edge alike, the mean error is that of no side."""
    time, errors = np.linspace(0, 1, 8000), []
    for height in np.arange(0.05, 1.0, 0.1):
        counts = side * (np.interp(time, [0, 0.3, 0.7, 1], [-30, height, height, -30]) + 0.002)
        recorded = np.floor(counts).reshape(-1, 16).mean(axis=1)
        found = interpolated(recorded, np.arange(0.5, len(recorded)))
        errors.append(side * (found - counts.reshape(-1, 16).mean(axis=1))[225:275].mean())
    assert np.max(np.abs(errors)) < 0.55
    assert abs(np.mean(errors)) < 0.06


@pytest.mark.parametrize("period", [0.7, 1.7, 2.5])
def test_a_motion_that_repeats_may_be_cut_anywhere(period):
    """Also where the cut is in the middle of a fast stroke; a swing settles before."""
    count = round(period / 2e-3)
    phase = 2 * np.pi * np.arange(count) / count
    angle = 1.3 + 0.9 * np.sin(phase) + 0.2 * np.cos(3 * phase)
    given = (2e-3, 0.3, 4e-3, 1e-4, 2e-3, 0.05, 0.04, True)
    whole = tendon(angle, *given)
    for by in (count // 4, count // 2, 3 * count // 4):
        for one, other in zip(whole, tendon(np.roll(angle, -by), *given), strict=True):
            np.testing.assert_allclose(np.roll(other, by), one, rtol=0, atol=2e-5)
    for function in (
        lambda path: bristle(path, 0.2, True),
        lambda path: lagged(path[None], 2e-3, 0.05, True)[0],
    ):
        turned = np.roll(function(np.roll(angle, -(count // 3))), count // 3)
        np.testing.assert_allclose(turned, function(angle), rtol=0, atol=1e-6)
