"""The estimate with later samples: the filter's equations run backwards.

    adjoint   l~ = (I - g K H)' l - H' s d / s^2,        l of the step before = Phi' l~
              L~ = (I - g K H)' L (I - g K H) + H' H g / s^2,   L = Phi' L~ Phi
    smoothed  x + P l with the filter's x and P after its update, variance P - P L P

with H the angle and g = 1 - rho the weight of the update (A. E. Bryson and M. Frazier 1963, in the
form of G. J. Bierman for scalar measurements, Int. J. Control 18(4) 1973). It inverts no matrix,
and is stable where the filter is.
"""

from __future__ import annotations

import math

import numpy as np

from rigtool.experiments.force_filter.linear import ROW_LENGTH, THETA, C, L, N, S
from rigtool.experiments.force_filter.linear import backwards as multiply_back
from rigtool.experiments.force_filter.plant import ANGLE, FACTOR_COUNT, STATES
from rigtool.numerics.arrays import Array
from rigtool.numerics.compiled import compiled, compiled_allocating

ADJOINT_COLUMN = STATES
"""Column of the adjoint, behind those of L."""


def room(count: int, samples: int) -> tuple[Array, ...]:
    """Return arrays for the data that the filter keeps of `count` steps of `samples` samples each.

    Factors of the samples (count * samples, FACTOR_COUNT), see `linear`; where a stroke began
    (count,), correction s d / s^2 [1/rad], weight 1 - rho and prior variance s^2 [rad2] of the
    update, (count,) each, its gain (count, 12), and the covariance of the torque, and of the torque
    behind the low-pass, with the states (count, 12).
    """
    numbers = [np.empty(count) for _ in range(4)]
    rows = [np.empty((count, STATES)) for _ in range(3)]
    return (np.empty((count * samples, FACTOR_COUNT)), *numbers, *rows)


@compiled
def _times(symmetric: Array, weights: Array, k: int, product: Array) -> None:
    """Let product (12,) be a symmetric matrix (12 * ROW_LENGTH,) times row k of the weights (m,
    12)."""
    for j in range(0, STATES, 4):  # a processor does four columns at once
        a = b = c = d = 0.0
        for m in range(STATES):
            weight, place = weights[k, m], m * ROW_LENGTH + j
            a += weight * symmetric[place]
            b += weight * symmetric[place + 1]
            c += weight * symmetric[place + 2]
            d += weight * symmetric[place + 3]
        product[j], product[j + 1], product[j + 2], product[j + 3] = a, b, c, d


@compiled
def _before_update(
    rows: Array, gain: Array, k: int, correction: float, g: float, s2: float, column: Array
) -> None:
    # (I - g K H)' L (I - g K H): only row and column of the angle change
    _times(rows, gain, k, column)
    total = square = 0.0
    for i in range(STATES):
        total += gain[k, i] * rows[i * ROW_LENGTH + ADJOINT_COLUMN]
        square += gain[k, i] * column[i]
    rows[THETA + ADJOINT_COLUMN] -= g * total + correction
    for i in range(STATES):
        if i != ANGLE:
            rows[i * ROW_LENGTH + ANGLE] -= g * column[i]
            rows[THETA + i] = rows[i * ROW_LENGTH + ANGLE]
    rows[THETA + ANGLE] += g * (g * square - 2.0 * column[ANGLE]) + g / s2


@compiled
def _before_prediction(
    rows: Array, factors: Array, k: int, samples: int, kept: float, drawn: float, columns: int
) -> None:
    """Multiply by the transpose of a step's derivative; `drawn` is 0 where a stroke began."""
    for j in range(columns):
        rows[N + j] *= kept
        rows[S + j] *= drawn
        rows[C + j] *= drawn
        rows[L + j] *= drawn
    for i in range(samples):
        multiply_back(rows, columns, factors, (k + 1) * samples - 1 - i)


@compiled_allocating
def smooth_steps(
    rows: Array,
    kept: float,
    steps: tuple[Array, ...],
    torque: Array,
    deviation: Array,
) -> None:
    """Smooth m steps; `torque` (m,) and `deviation` (m,) of the torque behind the low-pass hold the
    filter's and receive the smoothed.

    `rows` (12 * ROW_LENGTH,) are those of the information L, with the adjoint as their column
    `ADJOINT_COLUMN`, after the last step, zero at the end of a recording, and are changed into
    those before the first. `kept` is what a step leaves of friction noise.
    """
    factors, fresh, correction, weight, variance, gain, torque_row, passed_row = steps
    column, samples = np.empty(STATES), factors.shape[0] // max(len(torque), 1)
    here, there = rows.copy(), np.zeros_like(rows)
    for k in range(len(torque) - 1, -1, -1):
        _times(here, passed_row, k, column)
        shift = reduction = 0.0
        for i in range(STATES):
            shift += torque_row[k, i] * here[i * ROW_LENGTH + ADJOINT_COLUMN]
            reduction += passed_row[k, i] * column[i]
        torque[k] -= shift
        deviation[k] = math.sqrt(max(deviation[k] ** 2 - reduction, 0.0))
        _before_update(here, gain, k, correction[k], weight[k], variance[k], column)
        drawn = 0.0 if fresh[k] > 0.5 else 1.0
        _before_prediction(here, factors, k, samples, kept, drawn, STATES + 1)
        for i in range(STATES):
            for j in range(STATES):
                there[i * ROW_LENGTH + j] = here[j * ROW_LENGTH + i]
            there[i * ROW_LENGTH + ADJOINT_COLUMN] = here[i * ROW_LENGTH + ADJOINT_COLUMN]
        _before_prediction(there, factors, k, samples, kept, drawn, STATES)
        for i in range(STATES):
            for j in range(i):
                there[i * ROW_LENGTH + j] = there[j * ROW_LENGTH + i]
        here, there = there, here
    for i in range(len(rows)):
        rows[i] = here[i]
