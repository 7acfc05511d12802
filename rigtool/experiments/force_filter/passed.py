"""The torque behind a low-pass, as further states of the filter.

    q of the next step = A q + B M,   y = C q + D M                       Butterworth, order 2

What the filter states of M at one moment is mostly noise that the low-pass takes away: right after
a step its deviation is ten times what is left of it in y. So mean and covariance of q go along, and
y has a mean and a deviation of its own. Measurements show q through x alone; nothing depends on q.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from rigtool.experiments.force_filter.plant import ANGLE, MOVING_STATES, STATES, TORQUE
from rigtool.numerics.arrays import Array
from rigtool.numerics.compiled import compiled

Record = Any

ORDER = 2

FIELDS = [
    ("passed", "f8", (ORDER,)),
    ("passed_covariance", "f8", (ORDER, ORDER)),
    ("shared_covariance", "f8", (STATES, ORDER)),
]
"""Fields of the filter's state: mean and covariance of q, and covariance of x and q."""


def section(corner_hz: float, step_time: float) -> Array:
    """Return A, B over C, D of the low-pass, (3, 3), for steps of `step_time` s."""
    from scipy.signal import butter, tf2ss

    a, b, c, d = tf2ss(*butter(ORDER, corner_hz, fs=1 / step_time))
    return np.block([[a, b], [c, d]])


def delay(corner_hz: float) -> float:
    """Return by how much y is late at low frequencies, s."""
    return math.sqrt(2) / (2 * math.pi * corner_hz)


@compiled
def predict(
    s: Record, low_pass: Array, derivative: Array, kept: float, noise: int, work: Array
) -> None:
    """Advance q and its covariances by a step, before x: `derivative` (7, 12) of x by itself.

    `kept` is what remains of state `noise`; the other states behind the moving ones stay. `work`
    (2, 12) is overwritten.
    """
    q, own, shared, x, p = s.passed, s.passed_covariance, s.shared_covariance, s.mean, s.covariance
    for i in range(ORDER):
        for n in range(STATES):
            work[i, n] = p[n, TORQUE] * low_pass[i, ORDER]
            for j in range(ORDER):
                work[i, n] += shared[n, j] * low_pass[i, j]
    first, second, cross, other = own[0, 0], own[1, 1], own[0, 1], shared[TORQUE]
    for i in range(ORDER):
        for j in range(i + 1):
            a, b, c = low_pass[i]
            d, e, f = low_pass[j]
            total = a * first * d + (a * e + b * d) * cross + b * second * e
            total += (a * f + c * d) * other[0] + (b * f + c * e) * other[1]
            own[i, j] = own[j, i] = total + c * f * p[TORQUE, TORQUE]
    before, after = q[0], q[1]
    for i in range(ORDER):
        q[i] = low_pass[i, 0] * before + low_pass[i, 1] * after + low_pass[i, ORDER] * x[TORQUE]
    for i in range(ORDER):
        for n in range(MOVING_STATES):
            total = 0.0
            for m in range(STATES):
                total += derivative[n, m] * work[i, m]
            shared[n, i] = total
        for n in range(MOVING_STATES, STATES):
            shared[n, i] = work[i, n] * (kept if n == noise else 1.0)


@compiled
def update(s: Record, gain: Array, shift: float, removed: float, variance: float) -> None:
    """Update with a correction of the filter, before x: its gain (12,), the angle's shift, and
    `removed`, by which the angle's variance fell from `variance`."""
    q, own, shared = s.passed, s.passed_covariance, s.shared_covariance
    for i in range(ORDER):
        own_gain = shared[ANGLE, i] / variance
        q[i] += own_gain * shift
        for j in range(i + 1):
            own[i, j] -= own_gain * shared[ANGLE, j] / variance * removed
            own[j, i] = own[i, j]
    for i in range(ORDER):
        own_gain = shared[ANGLE, i] / variance
        for n in range(STATES):
            shared[n, i] -= gain[n] * own_gain * removed


@compiled
def output(s: Record, low_pass: Array, row: Array) -> tuple[float, float]:
    """Return mean and variance of y; `row` (12,) receives its covariance with x."""
    c, d = low_pass[ORDER], low_pass[ORDER, ORDER]
    mean = d * s.mean[TORQUE]
    variance = d * d * s.covariance[TORQUE, TORQUE]
    for n in range(STATES):
        row[n] = d * s.covariance[n, TORQUE]
    for i in range(ORDER):
        mean += c[i] * s.passed[i]
        variance += 2.0 * d * c[i] * s.shared_covariance[TORQUE, i]
        for j in range(ORDER):
            variance += c[i] * s.passed_covariance[i, j] * c[j]
        for n in range(STATES):
            row[n] += c[i] * s.shared_covariance[n, i]
    return mean, variance
