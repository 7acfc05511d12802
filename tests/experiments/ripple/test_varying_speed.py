"""Orders of a motor whose ripple varies its speed, beside a wave that is made point by point."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from rigtool.experiments.ripple.varying_speed import motor_orders, speed_variation

ORDERS, POINTS = 40, 4096
TURN = np.arange(POINTS) / POINTS
ORDER = np.arange(1, ORDERS + 1)
LOOP = 1 / (1 + 1j * ORDER / 25)


@pytest.mark.parametrize("swing", [0.0, 0.4])
def test_the_loop_is_taken_off_over_time_and_orders_are_those_of_the_angle(swing):
    """The angle leads and lags by `swing` rad/4 four times a turn; no motor makes orders 14, 22."""
    ripple = np.zeros(ORDERS, dtype=complex)
    ripple[[3, 17]] = 1.0, 0.6 * np.exp(0.7j)
    angle = TURN + swing / 4 * np.sin(2 * np.pi * 4 * TURN + 0.3) / (2 * np.pi)
    waves = np.exp(2j * np.pi * np.outer(angle, ORDER))
    over_time = np.real(waves @ ripple)
    frequency = np.exp(2j * np.pi * np.outer(TURN, ORDER))
    spectrum = frequency.conj().T @ over_time * 2 / POINTS
    asked = np.real(frequency @ (spectrum * LOOP))
    # Means over equal steps of the angle: each sample weighs by how far the rotor turns in it.
    rate = 1 + swing * np.cos(2 * np.pi * 4 * TURN + 0.3)
    by_angle = waves.conj().T @ (asked * rate) * 2 / POINTS
    edges = np.linspace(0.0, 1.0, 501)
    inside = np.concatenate([angle - 1, angle, angle + 1])
    elapsed = np.interp(edges, inside, np.concatenate([TURN - 1, TURN, TURN + 1]))
    elapsed -= elapsed[0]  # a turn begins at the encoder's zero
    found = motor_orders(by_angle, LOOP, elapsed)
    assert_allclose(np.abs(found)[:24], np.abs(ripple)[:24], atol=3e-3)
    # T taken off order by order would leave these:
    left = np.abs(by_angle / LOOP)[[13, 21]]
    assert (left > 0.02).all() if swing else (left < 1e-6).all()


@pytest.mark.parametrize("part", [0.0, 0.02, 0.2])
def test_the_variation_of_the_speed_is_its_standard_deviation(part):
    """Time a cell takes is 1 + a sqrt(2) cos of order 5."""
    place = np.arange(501) / 500
    late = part * np.sqrt(2) * np.sin(2 * np.pi * 5 * place) / (2 * np.pi * 5)
    assert speed_variation(place + late) == pytest.approx(part, rel=1e-3, abs=1e-9)


@pytest.mark.parametrize(("order", "part"), [(1, 0.1), (30, 0.1), (31, 0.0)])
def test_the_speed_varies_up_to_order_30(order, part):
    place = np.arange(501) / 500
    late = 0.1 * np.sqrt(2) * np.sin(2 * np.pi * order * place) / (2 * np.pi * order)
    assert speed_variation(place + late) == pytest.approx(part, rel=1e-3, abs=1e-9)


def test_steps_of_the_encoder_in_the_times_of_a_turn_make_no_order():
    """Edges at order 92 that shift the times, beside order 94 of the torque: no order 2 of it."""
    edges = np.linspace(0.0, 1.0, 501)
    elapsed = edges + 2e-4 * np.sin(2 * np.pi * 92 * edges)
    asked = np.zeros(100, dtype=complex)
    asked[93] = 1.0
    found = motor_orders(asked, np.ones(100, dtype=complex) / (1 + 1j * np.arange(1, 101)), elapsed)
    assert np.abs(found)[1] < 1e-3 * np.abs(found)[93]
