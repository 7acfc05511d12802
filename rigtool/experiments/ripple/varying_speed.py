"""Ripple of the motor where the position loop lets it vary the speed.

The loop answers to a torque over time, ripple is a function of the angle:

    controller torque(t) = T d(t),   d(t) = ripple(angle(t))

with the complementary sensitivity T. Where the speed varies, an order of the angle is no single
frequency: strong orders k and j make the controller's torque over the angle have orders k + j and
|k - j|, which no motor makes. T is therefore taken off over time, and the orders are those of
d over the angle. When the rotor passes an angle, its encoder shows.
"""

from __future__ import annotations

import numpy as np

from rigtool.numerics.arrays import Array, ComplexArray

POINTS = 16384
"""Points of a turn between which waves are straight: order 100 loses a ten-thousandth."""

SPEED_ORDERS = 30
"""Orders by which ripple varies the speed: the inertia holds higher ones."""


def speed_variation(elapsed: Array) -> float:
    """Return the relative standard deviation of the speed around the turn.

    `elapsed` (n,) at the edges of n - 1 cells, as in `orders.Ripple`.
    """
    cells = len(elapsed) - 1
    late = np.fft.rfft(elapsed[:-1] - np.arange(cells) / cells)[1 : SPEED_ORDERS + 1] * (2 / cells)
    return float(np.linalg.norm(2 * np.pi * np.arange(1, len(late) + 1) * late)) / np.sqrt(2)


def motor_orders(asked: ComplexArray, loop: ComplexArray, elapsed: Array) -> ComplexArray:
    """Return the orders 1..m of the motor's torque over the angle from those of the controller's.

    `asked` and `loop`, T at each order, (m,); `elapsed` (n + 1,) as in `orders.Ripple`.
    """
    cells = len(elapsed) - 1
    late = np.fft.rfft(elapsed[:-1] - np.arange(cells) / cells)
    # Two orders of the speed make their sum, too; beyond are the steps of the encoder.
    late[2 * SPEED_ORDERS + 1 :] = 0.0
    angle = np.arange(POINTS) / POINTS
    time = angle + np.fft.irfft(late * (POINTS / cells), POINTS)
    over_time = np.interp(angle, time, _wave(asked), period=1.0)
    ripple = _wave(_orders(over_time, len(asked)) / loop)
    return _orders(np.interp(time, angle, ripple, period=1.0), len(asked))


def _wave(orders: ComplexArray) -> Array:
    spectrum = np.zeros(POINTS // 2 + 1, dtype=np.complex128)
    spectrum[1 : len(orders) + 1] = orders * (POINTS / 2)
    return np.fft.irfft(spectrum, POINTS)


def _orders(wave: Array, count: int) -> ComplexArray:
    return np.asarray(np.fft.rfft(wave)[1 : count + 1] * (2 / POINTS))
