"""The estimate with later samples: the filter's equations run backwards.

    adjoint   l~ = (I - g K H)' l - H' s d / s^2,        l of the step before = Phi' l~
              L~ = (I - g K H)' L (I - g K H) + H' H g / s^2,   L = Phi' L~ Phi
    smoothed  x + P l with the filter's x and P after its update, variance P - P L P

with H the angle, g = 1 - rho the weight of the update. After A. E. Bryson and M. Frazier (1963) as
G. J. Bierman gives it for scalar measurements, Int. J. Control 18(4) 1973: it inverts nothing, and
is stable where the filter is.
"""

from __future__ import annotations

import math

import numpy as np

from rigtool.experiments.force_filter.combined import four
from rigtool.experiments.force_filter.plant import (
    ANGLE,
    LOAD,
    MOVING_STATES,
    NOISE,
    SINE,
    STATES,
)
from rigtool.numerics.arrays import Array
from rigtool.numerics.compiled import compiled


def room(count: int) -> tuple[Array, ...]:
    """Return arrays for the data that the filter keeps of `count` steps.

    Derivative of the moving states (count, 7, 12), where a stroke began (count,), correction s d /
    s^2 [1/rad], weight 1 - rho and prior variance s^2 [rad2] of the update, (count,) each, its gain
    (count, 12), and the covariance of the torque, and of the torque behind the low-pass, with the
    states (count, 12).
    """
    numbers = [np.empty(count) for _ in range(4)]
    rows = [np.empty((count, STATES)) for _ in range(3)]
    return (np.empty((count, MOVING_STATES, STATES)), *numbers, *rows)


@compiled
def _times(symmetric: Array, vector: Array, product: Array) -> None:
    """Let product (12,) be a symmetric matrix (12, 12) times a vector (12,)."""
    for j in range(0, STATES, 4):
        a, b, c, d = four(vector, symmetric, STATES, j)
        product[j], product[j + 1], product[j + 2], product[j + 3] = a, b, c, d


@compiled
def _before_update(
    adjoint: Array,
    information: Array,
    gain: Array,
    correction: float,
    g: float,
    s2: float,
    column: Array,
) -> None:
    # (I - g K H)' L (I - g K H): only row and column of the angle change
    _times(information, gain, column)
    total = square = 0.0
    for i in range(STATES):
        total += gain[i] * adjoint[i]
        square += gain[i] * column[i]
    adjoint[ANGLE] -= g * total + correction
    for i in range(STATES):
        if i != ANGLE:
            information[i, ANGLE] -= g * column[i]
            information[ANGLE, i] = information[i, ANGLE]
    information[ANGLE, ANGLE] += g * (g * square - 2.0 * column[ANGLE]) + g / s2


@compiled
def _before_prediction(
    adjoint: Array, information: Array, derivative: Array, diagonal: Array, work: Array
) -> None:
    """`diagonal` (12,) is that of the last rows of Phi, zero where they are those of `derivative`;
    the last row of `work` (13, 12) is for the adjoint."""
    for i in range(STATES + 1):
        row = information[i] if i < STATES else adjoint
        for j in range(0, STATES, 4):
            a, b, c, d = four(row, derivative, MOVING_STATES, j)
            work[i, j] = a + row[j] * diagonal[j]
            work[i, j + 1] = b + row[j + 1] * diagonal[j + 1]
            work[i, j + 2] = c + row[j + 2] * diagonal[j + 2]
            work[i, j + 3] = d + row[j + 3] * diagonal[j + 3]
    for i in range(STATES):
        adjoint[i] = work[STATES, i]
        for j in range(0, i + 1, 4):
            a, b, c, d = four(derivative[:, i], work, MOVING_STATES, j)
            information[i, j] = a + diagonal[i] * work[i, j]
            information[i, j + 1] = b + diagonal[i] * work[i, j + 1]
            information[i, j + 2] = c + diagonal[i] * work[i, j + 2]
            information[i, j + 3] = d + diagonal[i] * work[i, j + 3]
        for j in range(i):
            information[j, i] = information[i, j]


@compiled
def backwards(
    adjoint: Array,
    information: Array,
    kept: float,
    steps: tuple[Array, ...],
    torque: Array,
    deviation: Array,
) -> None:
    """Smooth m steps; `torque` (m,) and `deviation` (m,) of the torque behind the low-pass hold the
    filter's and receive the smoothed.

    `adjoint` (12,) and `information` (12, 12) are those after the last step, zero at the end of a
    recording, and are changed into those before the first. `kept` is what a step leaves of
    friction noise.
    """
    derivative, fresh, correction, weight, variance, gain, torque_row, passed_row = steps
    work, column = np.empty((STATES + 1, STATES)), np.empty(STATES)
    diagonal = np.zeros(STATES)
    for k in range(len(torque) - 1, -1, -1):
        row = passed_row[k]
        _times(information, row, column)
        shift = reduction = 0.0
        for i in range(STATES):
            shift += torque_row[k, i] * adjoint[i]
            reduction += row[i] * column[i]
        torque[k] -= shift
        deviation[k] = math.sqrt(max(deviation[k] ** 2 - reduction, 0.0))
        for i in range(MOVING_STATES, STATES):
            drawn = fresh[k] > 0.5 and SINE <= i <= LOAD
            diagonal[i] = 0.0 if drawn else kept if i == NOISE else 1.0
        correct = correction[k], weight[k], variance[k]
        _before_update(adjoint, information, gain[k], *correct, column)
        _before_prediction(adjoint, information, derivative[k], diagonal, work)
