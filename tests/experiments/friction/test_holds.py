"""The uncertainty of a hold's mean, over draws of noise with a corner of its own."""

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy import stats
from scipy.ndimage import uniform_filter1d
from scipy.signal import lfilter

from rigtool.experiments.friction.holds import (
    NOISE_ORDINATES,
    Holds,
    _around,
    _uncertainty,
    _warm_up,
    find_holds,
)

SPEED, TURNS, SAMPLES, DRAWS = 10.0, 6, 1200, 200


def drawn_hold(cycles, rng):
    """A hold with ripple once a turn and noise whose corner is at this many cycles a hold."""
    time = np.arange(SAMPLES) * (TURNS * 2 * np.pi / SPEED / (SAMPLES - 1))
    angle = SPEED * time
    decay = np.exp(-2 * np.pi * cycles / SAMPLES)
    start = [decay * rng.standard_normal()]
    drive = np.sqrt(1 - decay**2) * rng.standard_normal(SAMPLES)
    noise, _ = lfilter([1.0], [1.0, -decay], drive, zi=start)
    return {"time": time, "angle": angle, "torque": 5.0 + np.sin(angle) + 0.1 * noise}


@pytest.mark.parametrize(("cycles", "lowest"), [(1.0, 0.93), (2.0, 0.93), (6.0, 0.9), (200.0, 0.9)])
def test_intervals_hold_wherever_the_noise_has_its_corner(cycles, lowest):
    """Fewer than 180 of 200 intervals of 95 % would hold by chance once in a thousand."""
    rng, held, u = np.random.default_rng(7), 0, []
    for _ in range(DRAWS):
        signals = drawn_hold(cycles, rng)
        found = find_holds(**signals, setpoint=signals["angle"], inertia=1e-5)
        width = stats.t.ppf(0.975, found.dof[0]) * found.u[0]
        held += abs(found.torque[0] - 5.0) <= width
        u.append(found.u[0])
    assert held / DRAWS >= lowest
    exact = 0.1 * np.sqrt(1 - (1 - np.exp(-2 * np.pi * cycles)) / (2 * np.pi * cycles))
    exact /= np.sqrt(np.pi * cycles)
    assert 0.8 < np.sqrt(np.mean(np.square(u))) / exact < 1.45


@pytest.mark.parametrize("cycles", [1.0, 6.0, 200.0])
def test_units_of_torque_and_time_change_nothing(cycles):
    signals, torque, time = drawn_hold(cycles, np.random.default_rng(3)), 64.0, 0.25
    one = find_holds(**signals, setpoint=signals["angle"], inertia=1e-5)
    other = find_holds(
        time=time * signals["time"],
        angle=signals["angle"],
        torque=torque * signals["torque"],
        setpoint=signals["angle"],
        inertia=torque * time**2 * 1e-5,
    )
    for name, unit in (
        *(("torque", torque), ("u", torque), ("speed", 1 / time), ("settled", time)),
        *(("dof", 1.0), ("revolutions", 1.0), ("uneven", 1.0)),
    ):
        assert_allclose(getattr(other, name) / unit, getattr(one, name), rtol=1e-9)


def test_a_hold_without_noise_has_the_degrees_of_freedom_of_its_spectrum():
    """Each ordinate of a periodogram is a chi-square of two degrees of freedom."""
    assert _uncertainty(np.full(SAMPLES, 5.0), TURNS) == (0.0, 2 * NOISE_ORDINATES)
    assert _uncertainty(np.full(25, 5.0), 1) == (0.0, 2 * 12)


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_the_warm_up_is_what_makes_the_mean_of_the_rest_most_certain(seed):
    """MSER-5 written out: White, Simulation 69(6) 323-334, 1997."""
    values = np.random.default_rng(seed).normal(size=203)
    values[:37] += np.linspace(4, 0, 37)
    means = [np.mean(values[k : k + 5]) for k in range(0, 200, 5)]
    errors = [np.var(means[d:]) / len(means[d:]) for d in range(20)]
    found = _warm_up(values)
    assert found == 5 * int(np.argmin(errors))
    assert 15 <= found <= 60


@pytest.mark.parametrize(("direction", "order"), [(1.0, 1), (-1.0, 1), (1.0, 24)])
def test_ripple_that_varies_the_speed_does_no_work_over_a_turn(direction, order):
    """A shaft with speed w0 (1 + a cos(k angle)) under M = f + b cos(k angle): over the angle the
    mean of M is f; over time it is f - a b/2 to second order. A shaft that is not read shows
    nothing."""
    friction, part, ripple, turns = 4e-3, 0.05, 3e-3, 5
    angle = np.linspace(0, 2 * np.pi * turns, 40001)
    time = np.concatenate(
        [[0], np.cumsum(np.diff(angle) / (1 + part * np.cos(order * (angle[1:] - 4e-4))))]
    )
    even = np.linspace(0, time[-1], 4000)
    turned = np.interp(even, time, angle)
    torque = direction * friction + ripple * np.cos(order * turned)
    wanted = direction * even * angle[-1] / time[-1]
    signals = {"time": even, "torque": torque, "setpoint": wanted, "inertia": 1e-5}
    found = find_holds(angle=direction * turned, **signals)
    assert found.torque[0] == pytest.approx(direction * friction, rel=2e-3)
    assert torque.mean() - direction * friction == pytest.approx(-part * ripple / 2, rel=0.02)
    assert found.lagging[0] < 0.02 * part * ripple / 2
    unread = find_holds(angle=0 * turned, **signals)
    assert unread.torque[0] == pytest.approx(torque.mean(), rel=1e-6)


def test_ripple_in_quadrature_with_the_speed_counts_as_uncertainty():
    time = np.linspace(0, 4 * np.pi, 2001)
    angle = time + 0.02 * np.sin(time)  # speed 1 + 0.02 cos
    signals = {"time": time, "angle": angle, "setpoint": time, "inertia": 1e-5}
    found = find_holds(torque=4e-3 + 3e-3 * np.sin(time), **signals)
    assert found.lagging[0] == pytest.approx(0.02 * 3e-3 / 2, rel=1e-9)
    assert found.torque[0] == pytest.approx(4e-3, rel=1e-4)


@pytest.mark.parametrize(
    ("speeds", "shown", "expected"),
    [
        ([1.0, 2.0, 4.0], [0.0, 0.0, 0.0], (0.0, 0.0)),  # no hold turned once
        ([-2.0, 2.0, 2.0], [1e-4, 2e-4, 3e-4], (2e-4, 0.0)),  # one speed has no slope
        ([1.0, -2.0, 4.0], [1e-4, 3e-4, 7e-4], (-1e-4, 2e-4)),
    ],
)
def test_the_line_of_lagging_ripple_has_two_numbers_from_any_holds(speeds, shown, expected):
    rest = np.ones((6, 3))
    holds = Holds(np.array(speeds), *rest, np.array(shown), np.ones(3))
    assert holds.lagging_line() == pytest.approx(expected, rel=1e-9, abs=1e-18)


@pytest.mark.parametrize("width", [10, 11, 70])
def test_means_around_each_sample_are_those_of_scipy(width):
    values = 1e3 + np.random.default_rng(width).standard_normal(50)
    expected = uniform_filter1d(values, width, mode="nearest")
    assert_allclose(_around(values, width), expected, rtol=1e-12)


@pytest.mark.parametrize("swing_hz", [0.0, 3.0, 47.0])
@pytest.mark.parametrize("speed", [0.4, 0.47, 1.0])
def test_the_encoder_shows_how_much_the_speed_varies(speed, swing_hz):
    """A speed with a sine of relative standard deviation 0.3: by ripple, or near the crossover of
    a loop where friction falls with speed, in steps of an encoder of 8000 counts. An even speed
    shows nothing, whatever part of a count it takes a sample."""
    time, count = np.arange(0, 30, 8e-3), 2 * np.pi / 8000
    rate = 2 * np.pi * swing_hz
    angle = speed * time
    if swing_hz:
        angle = angle + 0.3 * np.sqrt(2) * speed * np.sin(rate * time) / rate
    found = find_holds(
        time=time,
        angle=np.floor(angle / count) * count,
        torque=np.full(len(time), 4e-3),
        setpoint=speed * time,
        inertia=1e-5,
        count=count,
    )
    if swing_hz:
        assert 0.6 * 0.3 < found.uneven[0] < 1.1 * 0.3
    else:
        assert found.uneven[0] < 1e-3


def test_slow_swings_of_a_soft_loop_are_no_settling():
    """A loop of a few Hz follows noise by swings that are longer than a turn at high speed."""
    time = np.arange(0, 6, 8e-3)
    behind = 0.3 * np.exp(-time / 0.2) + 0.05 * np.sin(2 * np.pi * 0.4 * time)
    found = find_holds(
        time=time,
        angle=30 * time - behind,
        torque=np.full(len(time), 4e-3),
        setpoint=30 * time,
        inertia=1e-5,
    )
    assert 0.2 < found.settled[0] < 0.8
    assert found.revolutions[0] > 20
