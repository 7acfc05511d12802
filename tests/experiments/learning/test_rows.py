"""Learning from moves, and judging them: closed forms, and a loop simulated by scipy."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import signal

from rigtool.control.position_loop import position_loop
from rigtool.errors import InsufficientDataError
from rigtool.experiments.learning.filters import Learning, zpetc
from rigtool.experiments.learning.rows import (
    Row,
    assemble,
    fit_amplitudes,
    learned_rows,
    residual,
    torque_rows,
)
from rigtool.numerics.moves import cut_moves
from rigtool.rigs.motion import Triangle

DT = 125e-6
LOOP = position_loop(
    crossover_hz=50.0,
    lead_ratio=3.0,
    integrator_hz=8.0,
    lowpass_hz=400.0,
    lowpass_damping=0.7,
    inertia=1.503e-5,
    sample_time=DT,
)
T = LOOP.complementary_sensitivity
LEARNING = Learning(T, zpetc(T, 0.999), 100.0, 4, 1.0)
POSITION = np.arange(200, 1500) * (2 * np.pi / 4000)


def motion(speed=7.3, cycles=5):
    return Triangle(low=0.0, high=2.67, speed=speed, turn_angle=0.3, cycles=cycles)


def disturbance(position, direction):
    """Ripple and friction, smooth within the band of Q at these speeds."""
    return 1e-3 * np.cos(2 * position + 0.4) + 3e-4 * np.sin(5 * position) + 2e-3 * direction


def run(speed=7.3, cycles=5, noise=0.0, seed=0):
    """Simulate moves of a loop that a disturbance acts on; returns time, set point, torque."""
    moves = motion(speed, cycles)
    time = np.arange(round(moves.duration / DT)) * DT
    setpoint, velocity, _ = moves.setpoint(time)
    acting = disturbance(setpoint, np.tanh(velocity / 0.2 / speed))
    num = np.pad(T.num, (T.relative_degree, 0))
    torque = signal.lfilter(num, T.den, acting)
    return time, setpoint, torque + noise * np.random.default_rng(seed).normal(size=len(time))


@pytest.mark.parametrize("speed", [0.9, 7.3, 26.7])
def test_one_update_learns_the_disturbance_at_each_position(speed):
    moves = cut_moves(*run(speed), 3)
    inner = POSITION[450:-450]  # what reverses at the ends rings on for some milliseconds
    for row in learned_rows(moves, speed, LEARNING, inner):
        assert abs(row.speed) == speed
        expected = disturbance(inner, np.sign(row.speed))
        # 1 % of the ripple; the cut of Q at 100 Hz costs some of order 5 at the highest speed
        np.testing.assert_allclose(row.mean, expected, rtol=0, atol=1.3e-5)


def test_uncertainty_is_that_of_the_noise():
    """White noise through Q: variance by the mean of |Q|^2 over frequency."""
    noise, moves = 1e-3, 30
    cut = cut_moves(*run(cycles=moves + 1, noise=noise), moves)
    rows = torque_rows(cut, 7.3, LEARNING, POSITION[450:-450])
    gain = LEARNING.robustness(np.linspace(0, 0.5 / DT, 20001))
    expected = noise * np.sqrt(np.mean(gain**2))
    for row in rows:
        assert row.non_repeatable_rms == pytest.approx(expected, rel=0.12, abs=0)
        u = np.sqrt(np.mean(row.u**2))
        assert u == pytest.approx(expected / np.sqrt(moves), rel=0.12, abs=0)


def test_amplitudes_are_the_least_squares_factors():
    rng = np.random.default_rng(2)
    shapes = {sign: rng.normal(size=50) for sign in (-1, 1)}
    learned = [Row(sign * speed, np.tile(shapes[sign], (3, 1)))
               for sign in (-1, 1) for speed in (1.0, 9.0)]  # fmt: skip
    low = [
        Row(sign * speed, factor * shapes[sign] + rng.normal(0, 1e-3, (4, 50)))
        for speed, factor in ((0.5, 1.2), (0.2, 1.4))
        for sign in (-1, 1)
    ]
    found = fit_amplitudes(low, learned)
    np.testing.assert_array_equal(found.speed, [0, 0.2, 0.5, 1.0])
    np.testing.assert_allclose(found.amplitude, [0, 1.4, 1.2, 1], rtol=1e-3, atol=0)
    assert found.u[0] == found.u[-1] == 0
    assert (found.u[1:3] > 1e-5).all()
    assert (found.u[1:3] < 1e-3).all()
    rising = sorted(learned, key=lambda row: row.speed)
    table = assemble(np.arange(50.0), rising, found)
    np.testing.assert_array_equal(table.speed, [-9, -1, 1, 9])
    np.testing.assert_allclose(
        table.evaluate(np.arange(50.0), np.full(50, -0.2)),
        found.amplitude[1] * shapes[-1],
        rtol=1e-9,
        atol=1e-12,
    )


def test_nothing_can_be_scaled_from_nothing():
    zero = [Row(sign, np.zeros((3, 20))) for sign in (-1.0, 1.0)]
    low = [Row(sign * 0.5, np.ones((3, 20))) for sign in (-1, 1)]
    with pytest.raises(InsufficientDataError, match="nothing to scale"):
        fit_amplitudes(low, zero)
    assert fit_amplitudes([], zero).amplitude.tolist() == [0, 1]


@settings(max_examples=30, deadline=None)
@given(scale=st.floats(0.01, 0.99), seed=st.integers(0, 1000))
def test_residual_of_a_scaled_disturbance(scale, seed):
    rng = np.random.default_rng(seed)
    before = [Row(v, np.tile(rng.normal(size=40), (5, 1))) for v in (-2.0, 2.0)]
    after = [Row(row.speed, scale * row.moves) for row in before]
    found = residual(before, after)
    everything = np.concatenate([row.mean for row in after])
    assert found["residual_peak"].value == pytest.approx(np.abs(everything).max(), rel=1e-9, abs=0)
    assert found["residual_rms"].value == pytest.approx(
        np.sqrt(np.mean(everything**2)), rel=1e-9, abs=0
    )
    assert found["reduction"].value == pytest.approx(1 - scale, rel=1e-9, abs=1e-12)
    assert found["residual_peak"].u == pytest.approx(0, abs=1e-12)
    assert found["residual_rms"].dof == 4


def test_residual_uncertainty_covers_what_repetition_shows():
    """The jackknife's u against the scatter of the statistic over many simulated experiments."""
    rng = np.random.default_rng(11)
    shape = 1e-3 * np.cos(np.linspace(0, 6, 30))

    def experiment():
        rows = [Row(v, shape + rng.normal(0, 4e-4, (20, 30))) for v in (-1.0, 1.0)]
        return residual(rows, rows)["residual_rms"]

    found = [experiment() for _ in range(150)]
    scatter = np.std([item.value for item in found], ddof=1)
    assert np.mean([item.u for item in found]) == pytest.approx(scatter, rel=0.2, abs=0)


def test_moves_know_nothing_of_the_direction_they_started_in():
    """A recording that starts on its way down gives the same rows."""
    time, setpoint, torque = run(cycles=6)
    late = len(time) // 12 + 1000
    whole = cut_moves(time, setpoint, torque, 3)
    part = cut_moves(time[late:], setpoint[late:], torque[late:], 3)
    for a, b in zip(
        torque_rows(whole, 7.3, LEARNING, POSITION),
        torque_rows(part, 7.3, LEARNING, POSITION),
        strict=True,
    ):
        np.testing.assert_allclose(a.mean, b.mean, rtol=0, atol=1e-6)


@pytest.mark.parametrize("torque", [0.0, 5e-324])
def test_without_torque_nothing_can_be_removed(torque):
    row = Row(3.0, np.full((3, 4), torque))
    with pytest.raises(InsufficientDataError, match="is zero throughout"):
        residual([row], [row])
