"""What the steps of an encoder look like as orders of the turn, beside closed forms."""

import math

import numpy as np
import pytest
from numpy.testing import assert_allclose

from rigtool.control.position_loop import position_loop
from rigtool.experiments.ripple.encoder_steps import step_orders

COUNTS, CELLS, TURNS = 1000, 500, 4


def orders_of(passed, sample_time, orders):
    """Return orders of the angle: torque over T/P."""
    loop = position_loop(
        crossover_hz=5.0,
        lead_ratio=4.0,
        integrator_hz=0.0,
        lowpass_hz=60.0,
        lowpass_damping=0.7,
        inertia=1e-5,
        sample_time=sample_time,
    )
    torque = step_orders(passed, TURNS, COUNTS, loop, 1, orders)
    order = np.arange(1.0, orders + 1)
    answer = loop.complementary_sensitivity.response(order) / loop.plant.response(order)
    return torque / np.abs(answer)


def even(turn_time):
    return np.linspace(3.0, 3.0 + TURNS * turn_time, TURNS * CELLS + 1)


@pytest.mark.parametrize("harmonic", [1, 2])
def test_edges_near_a_multiple_of_the_rate_are_a_sawtooth_of_low_orders(harmonic):
    """Two counts a sample, or one and a half: but for a whole one, or half of one, a turn."""
    sample_time = (harmonic + 1) / (harmonic * COUNTS - 1)
    orders = orders_of(even(1.0), sample_time, 6)
    expected = 2 * np.pi / COUNTS / (np.pi * harmonic * np.arange(1, 7))
    assert_allclose(orders, expected, rtol=0.03)


def test_edges_far_from_a_multiple_of_the_rate_are_no_low_order():
    assert orders_of(even(1.0), 1 / 1234.56, 30).max() < 0.02 * 2 * np.pi / COUNTS


def test_motion_moves_an_alias_by_its_orders():
    """An alias of order 20, and an angle that swings by 0.3 steps at order 3: sidebands J1(0.6 pi).

    J1 of 2 pi 0.3 beside J0 of it, each times step/pi.
    """
    passed, edges = even(1.0), np.arange(TURNS * CELLS + 1) / CELLS
    swung = passed - 0.3 / COUNTS * np.sin(2 * np.pi * 3 * edges)
    orders = orders_of(swung, 1 / (COUNTS - 20), 30)
    step = 2 * np.pi / COUNTS
    bessel = {20: 0.2906, 17: 0.5815, 23: 0.5815}  # J0 and J1 of 1.885, by their series
    for order, part in bessel.items():
        assert orders[order - 1] == pytest.approx(part * step / math.pi, rel=0.1)
