"""The torque behind a low-pass, as further states of the filter.

    q of the next step = A q + B M,   y = C q + D M                       Butterworth, order 2

The deviation of M at one moment is mostly noise that the low-pass removes: right after a step it is
ten times the deviation of y. Mean and covariance of q are therefore carried along, and y has a mean
and a deviation of its own. Measurements show q through x alone; nothing depends on q.
"""

from __future__ import annotations

import math

import numpy as np

from rigtool.experiments.force_filter.linear import ROW_LENGTH, M
from rigtool.experiments.force_filter.plant import STATES, TORQUE
from rigtool.numerics.arrays import Array
from rigtool.numerics.compiled import compiled
from rigtool.numerics.recursion import butterworth

LOW_PASS_ORDER = 2

JOINT_STATES = STATES + LOW_PASS_ORDER
"""States and q together: rows of their covariance, of which each has `ROW_LENGTH` columns."""

FIRST_OF_Q = STATES * ROW_LENGTH
"""Where the rows of q begin."""


def section(corner_hz: float, step_time: float) -> Array:
    """Return A, B over C, D of the low-pass, (3, 3), for steps of `step_time` s."""
    low_pass = butterworth(1 / step_time, corner_hz)
    change, feed = low_pass.state_space()
    return np.block([[change, feed[:, None]], [np.array([1.0, 0.0, low_pass.b0])]])


def settled(low_pass: Array) -> Array:
    """Return the states q (2,) of a `section` behind which a torque of 1 N m has always been."""
    change, feed = low_pass[:LOW_PASS_ORDER, :LOW_PASS_ORDER], low_pass[:LOW_PASS_ORDER, -1]
    found = np.linalg.solve(np.eye(LOW_PASS_ORDER) - change, feed)
    return np.asarray(found, dtype=np.float64)


def delay(corner_hz: float) -> float:
    """Return the delay of y at low frequencies, s."""
    return math.sqrt(2) / (2 * math.pi * corner_hz)


@compiled
def predict(q: Array, rows: Array, low_pass: Array, torque: float) -> None:
    """Advance q (2,), and its rows and columns of the joint covariance (14 * ROW_LENGTH,), by a
    step, before x; `torque` N m is what the filter finds."""
    a, b, c = low_pass[0, 0], low_pass[0, 1], low_pass[0, LOW_PASS_ORDER]
    d, e, f = low_pass[1, 0], low_pass[1, 1], low_pass[1, LOW_PASS_ORDER]
    q[0], q[1] = a * q[0] + b * q[1] + c * torque, d * q[0] + e * q[1] + f * torque
    for j in range(ROW_LENGTH):
        first, second, third = rows[FIRST_OF_Q + j], rows[FIRST_OF_Q + ROW_LENGTH + j], rows[M + j]
        rows[FIRST_OF_Q + j] = a * first + b * second + c * third
        rows[FIRST_OF_Q + ROW_LENGTH + j] = d * first + e * second + f * third
    for i in (FIRST_OF_Q, FIRST_OF_Q + ROW_LENGTH):
        first, second, third = rows[i + STATES], rows[i + STATES + 1], rows[i + TORQUE]
        rows[i + STATES] = a * first + b * second + c * third
        rows[i + STATES + 1] = d * first + e * second + f * third
    rows[FIRST_OF_Q + STATES + 1] = rows[FIRST_OF_Q + ROW_LENGTH + STATES]
    for n in range(STATES):
        rows[n * ROW_LENGTH + STATES], rows[n * ROW_LENGTH + STATES + 1] = (
            rows[FIRST_OF_Q + n],
            rows[FIRST_OF_Q + ROW_LENGTH + n],
        )


@compiled
def output(x: Array, q: Array, rows: Array, low_pass: Array, shared: Array) -> tuple[float, float]:
    """Return mean and variance of y; `shared` (12,) receives the covariance of y and x."""
    a, b, d = (
        low_pass[LOW_PASS_ORDER, 0],
        low_pass[LOW_PASS_ORDER, 1],
        low_pass[LOW_PASS_ORDER, LOW_PASS_ORDER],
    )
    for n in range(STATES):
        shared[n] = (
            a * rows[FIRST_OF_Q + n] + b * rows[FIRST_OF_Q + ROW_LENGTH + n] + d * rows[M + n]
        )
    mean = a * q[0] + b * q[1] + d * x[TORQUE]
    variance = d * shared[TORQUE]
    for i in (STATES, STATES + 1):
        weight = a if i == STATES else b
        variance += weight * (
            a * rows[FIRST_OF_Q + i] + b * rows[FIRST_OF_Q + ROW_LENGTH + i] + d * rows[M + i]
        )
    return mean, variance
