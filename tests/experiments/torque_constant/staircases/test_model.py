"""Heat in the winding over staircases, against the differential equation in small steps."""

from types import SimpleNamespace

import numpy as np
from numpy.testing import assert_allclose

from rigtool.experiments.torque_constant.staircases.model import winding

COPPER = 3.93e-3  # 1/K, IEC 60028
TIME_CONSTANT = 29.0
STEP = 1e-3


def stairs_of(begin, lasts, degc, current=0.0, settled=0.0):
    """Return plateaus (m, p) that last so long, s, the first `settled` of which are left out."""
    return SimpleNamespace(
        begin=begin,
        middle=begin + (settled + lasts) / 2,
        end=begin + lasts,
        current=current + 0 * begin,
        temperature=degc,
    )


def heat_in_small_steps(time, current, housing):
    """Return w' = i^2 (1 + COPPER (T - 20)) - w / TIME_CONSTANT at each time, A2 s."""
    power, heat = current**2 * (1 + COPPER * (housing - 20)), np.zeros(len(time))
    for k in range(1, len(time)):
        heat[k] = heat[k - 1] + STEP * (power[k] - heat[k - 1] / TIME_CONSTANT)
    return heat


def test_heat_is_that_of_the_current_in_warm_copper():
    levels, count = np.array([1.0, 3.0, 4.0, 2.0]), 2
    begin = np.array([np.arange(4.0) + 30 * k for k in range(count)])  # s, each for 0.8 s
    degc = np.full((count, 4), 50.0)
    stairs = stairs_of(begin, 0.8, degc, np.tile(levels, (count, 1)), settled=0.3)
    found, lagging = winding(stairs, TIME_CONSTANT)
    time = np.arange(0, 35, STEP)
    current = np.zeros(len(time))
    for first, level in zip(begin.ravel(), np.tile(levels, count), strict=True):
        current[(time >= first) & (time < first + 0.8)] = level
    heat = heat_in_small_steps(time, current, 50.0)
    # where the settled part has its middle
    assert_allclose(found, np.interp(begin + 0.55, time, heat), rtol=5e-3)
    assert_allclose(lagging, degc, rtol=1e-12)


def test_the_winding_lags_behind_a_housing_that_warms_evenly():
    """T' = (T_h - T) / tau: behind by rate * tau * (1 - exp(-t / tau))."""
    begin = np.arange(100.0)[None]
    settled = begin + 0.55
    degc = 30.0 + 0.02 * settled
    heat, lagging = winding(stairs_of(begin, 0.8, degc, settled=0.3), TIME_CONSTANT)
    assert_allclose(heat, 0)
    expected = -0.02 * TIME_CONSTANT * -np.expm1(-settled / TIME_CONSTANT)
    assert_allclose(lagging - degc, expected, rtol=1e-3)


def test_heat_that_is_left_from_the_staircase_before():
    """Pauses of 8 s: a quarter of the time constant."""
    levels, count = np.array([2.0, 4.0, 3.0]), 3
    begin = np.array([1.0 * np.arange(3) + 10 * k for k in range(count)])
    degc = np.full((count, 3), 20.0)
    stairs = stairs_of(begin, 1.0, degc, np.tile(levels, (count, 1)))
    found, _ = winding(stairs, TIME_CONSTANT)
    time = np.arange(0, 25, STEP)
    current = np.zeros(len(time))
    for first, level in zip(begin.ravel(), np.tile(levels, count), strict=True):
        current[(time >= first) & (time < first + 1.0)] = level
    heat = heat_in_small_steps(time, current, 20.0)
    assert_allclose(found, np.interp(begin + 0.5, time, heat), rtol=0.02)


def test_the_winding_follows_a_housing_that_leaps():
    """T' = (T_h - T) / tau, halfway between the middles of plateaus of 20 s, 5 s apart."""
    begin = np.array([0.0, 25.0, 50.0, 75.0])[None]
    degc = np.array([[20.0, 20.0, 24.0, 24.0]])
    _, lagging = winding(stairs_of(begin, 20.0, degc), TIME_CONSTANT)
    since = np.array([12.5, 37.5])
    assert_allclose(lagging[0, :2], 20.0)
    assert_allclose(lagging[0, 2:], 24.0 - 4.0 * np.exp(-since / TIME_CONSTANT), rtol=1e-9)
