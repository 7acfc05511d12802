"""Mean over a turn of a quantity that depends on the rotor's angle, from a few angles.

value(angle) = mean + sum over orders k = 1..m of (c_k cos(k angle) + s_k sin(k angle)) + scatter

Equally spaced angles average out every order that is not a multiple of their number. The scatter
about the fitted low orders is the only evidence for orders that cannot be resolved; it determines
the uncertainty of the mean.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rigtool.numerics.arrays import Array
from rigtool.numerics.plateaus import group_numbers

SAME_ANGLE = 0.02
"""Angles closer than this count as one, rad."""


@dataclass(frozen=True)
class TurnMean:
    """Mean over a turn, standard uncertainty and degrees of freedom; `scatter` of one angle.

    `u` and `scatter` are NaN where only one angle is known, `value` too where none is.
    """

    value: float
    u: float
    dof: float
    scatter: float


def group_angles(angle: Array) -> tuple[Array, NDArray[np.int64]]:
    """Return the distinct angles (k,) of `angle` (n,), rad, within a turn, and each one's index.

    Unknown angles (NaN) count as one angle.
    """
    known = np.where(np.isnan(angle), 0.0, np.mod(angle, 2 * np.pi))
    known = np.where(known > 2 * np.pi - SAME_ANGLE / 2, known - 2 * np.pi, known)
    index = group_numbers(known, SAME_ANGLE)
    return np.bincount(index, weights=known) / np.bincount(index), index


def mean_over_turn(angle: Array, value: Array) -> TurnMean:
    """Return the mean over a turn of values (n,) found at angles (n,), rad.

    Values at one angle are averaged first: they share its ripple. If all angles are unknown (NaN),
    the values count as repeats.
    """
    if np.all(np.isnan(angle)):
        angles, means = np.zeros(len(value)), np.asarray(value, dtype=np.float64)
        orders = 0
    else:
        angles, index = group_angles(angle)
        means = np.bincount(index, weights=value) / np.bincount(index)
        orders = len(means) // 4
    count = len(means)
    if count == 0:
        return TurnMean(math.nan, math.nan, 0.0, math.nan)
    if count == 1:
        return TurnMean(float(means[0]), math.nan, 0.0, math.nan)
    design = np.ones((count, 1 + 2 * orders))
    for k in range(1, orders + 1):
        design[:, 2 * k - 1] = np.cos(k * angles)
        design[:, 2 * k] = np.sin(k * angles)
    inverse = np.linalg.pinv(design)
    parameters = inverse @ means
    dof = count - np.linalg.matrix_rank(design)
    residual = means - design @ parameters
    scatter = math.sqrt(float(residual @ residual) / dof)
    u = scatter * math.sqrt(float(np.sum(inverse[0] ** 2)))
    return TurnMean(float(parameters[0]), u, float(dof), scatter)
