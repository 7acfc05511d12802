"""The same estimate with what came later: the filter's equations run backwards.

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
from numpy.typing import NDArray

from rigtool.experiments.force_filter.plant import (
    ANGLE,
    LOAD,
    MOVING_STATES,
    NOISE,
    SINE,
    STATES,
)
from rigtool.numerics.compiled import compiled

Array = NDArray[np.float64]


def room(count: int) -> tuple[Array, ...]:
    """Return room for what the filter keeps of `count` steps.

    Derivative of the moving states (count, 7, 12), where a stroke began (count,), correction s d /
    s^2 [1/rad], weight 1 - rho and prior variance s^2 [rad2] of the update, (count,) each, its gain
    (count, 12), and the covariance of the torque, and of the torque behind the low-pass, with the
    states (count, 12).
    """
    numbers = [np.empty(count) for _ in range(4)]
    rows = [np.empty((count, STATES)) for _ in range(3)]
    return (np.empty((count, MOVING_STATES, STATES)), *numbers, *rows)


@compiled
def _before_update(
    adjoint: Array, information: Array, gain: Array, correction: float, g: float, s2: float
) -> None:
    total = 0.0
    for i in range(STATES):
        total += gain[i] * adjoint[i]
    adjoint[ANGLE] -= g * total + correction
    # (I - g K H)' L (I - g K H): only row and column of the angle change
    column = np.zeros(STATES)
    square = 0.0
    for i in range(STATES):
        for j in range(STATES):
            column[i] += information[i, j] * gain[j]
        square += gain[i] * column[i]
    for i in range(STATES):
        if i != ANGLE:
            information[i, ANGLE] -= g * column[i]
            information[ANGLE, i] = information[i, ANGLE]
    information[ANGLE, ANGLE] += g * (g * square - 2.0 * column[ANGLE]) + g / s2


@compiled
def _before_prediction(
    adjoint: Array, information: Array, derivative: Array, fresh: bool, kept: float, work: Array
) -> None:
    diagonal = np.ones(STATES)
    diagonal[NOISE] = kept
    if fresh:
        for i in range(SINE, LOAD + 1):
            diagonal[i] = 0.0
    old = adjoint.copy()
    for j in range(STATES):
        adjoint[j] = old[j] * diagonal[j] if j >= MOVING_STATES else 0.0
        for m in range(MOVING_STATES):
            adjoint[j] += derivative[m, j] * old[m]
    for i in range(STATES):
        for j in range(STATES):
            total = information[i, j] * diagonal[j] if j >= MOVING_STATES else 0.0
            for m in range(MOVING_STATES):
                total += information[i, m] * derivative[m, j]
            work[i, j] = total
    for i in range(STATES):
        for j in range(i + 1):
            total = diagonal[i] * work[i, j] if i >= MOVING_STATES else 0.0
            for m in range(MOVING_STATES):
                total += derivative[m, i] * work[m, j]
            information[i, j] = information[j, i] = total


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
    work = np.empty((STATES, STATES))
    for k in range(len(torque) - 1, -1, -1):
        row = passed_row[k]
        shift = reduction = 0.0
        for i in range(STATES):
            shift += torque_row[k, i] * adjoint[i]
            inner = 0.0
            for j in range(STATES):
                inner += information[i, j] * row[j]
            reduction += row[i] * inner
        torque[k] -= shift
        deviation[k] = math.sqrt(max(deviation[k] ** 2 - reduction, 0.0))
        _before_update(adjoint, information, gain[k], correction[k], weight[k], variance[k])
        _before_prediction(adjoint, information, derivative[k], fresh[k] > 0.5, kept, work)
