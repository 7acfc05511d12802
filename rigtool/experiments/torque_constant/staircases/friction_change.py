"""Whether friction of the shaft changes with the temperature [7.1.1].

Beforehand, a change is as probable as none, and normal about 0 with the standard deviation
P = `FRICTION_CHANGE` f. The change that least squares find has a variance V by scatter. With the
squares Q that they leave,

    K = P^2/(P^2 + V),   Q = (1 - K) Q_steady + K Q_changing,

a part K of that change is left, as by a pseudo-observation of none, and for n independent residuals

    p(changes)/p(steady) = sqrt(1 - K) (Q/Q_steady)^(-n/2) :

a change that they do not show is as probable as before, and no larger (A. Gelman et al., Bayesian
Data Analysis, 3rd ed., 2013, sections 2.5 and 7.4).
"""

from __future__ import annotations

import math
from typing import TypeVar

import numpy as np

from rigtool.experiments.torque_constant.staircases.least_squares import LeastSquares
from rigtool.numerics.arrays import TINY, Array
from rigtool.numerics.residual_covariance import independent_samples

FRICTION_CHANGE = 5e-3
"""Standard deviation of the relative change of friction with temperature, 1/K, beforehand: 15 %
over 30 K (assumed). Friction of a joint depends on its temperature (A. C. Bittencourt,
S. Gunnarsson, J. Dyn. Syst. Meas. Control 134(5), 051013, 2012)."""

Number = TypeVar("Number", float, Array)


def friction_changes(
    weight: Array, changing: LeastSquares, steady: LeastSquares, trend: Array
) -> tuple[float, float]:
    """Return the probability that friction changes, and the part K of the change found.

    The shared columns of `changing` end with that change, those of both have friction as the
    second, or neither has any. `weight` (m, p) and `trend` (m,) are those of `of_trend`.
    """
    if len(changing.shared) == len(steady.shared):
        return 0.0, 0.0
    free, count = of_trend(weight, changing, trend)
    tied, _ = of_trend(weight, steady, trend)
    beforehand = (FRICTION_CHANGE * float(steady.shared[1])) ** 2
    single = free / count / max(float(trend @ trend), TINY)
    scatter = single * float(changing.shared_cover[-1, -1])
    known = beforehand / max(beforehand + scatter, TINY)
    left = between(known, min(free / max(tied, TINY), 1.0), 1.0)
    return 1 / (1 + left ** (count / 2) / math.sqrt(max(1 - known, TINY))), known


def of_trend(weight: Array, fit: LeastSquares, trend: Array) -> tuple[float, float]:
    """Return the sum of squares of the residuals of staircases combined by `trend` (m,), and its
    degrees of freedom. Residuals are correlated along the staircase; plateaus without `weight`
    (m, p) are not used."""
    residual = (trend @ fit.residual)[np.mean(weight, axis=0) > 0]
    independent = independent_samples(residual, np.full(len(residual), True), 1)
    free = max(len(residual) - fit.design.shape[1], 1) * independent / len(residual)
    return float(residual @ residual), free


def between(part: float, first: Number, second: Number) -> Number:
    """Return what is the first of two for a part of 1, and the second for 0."""
    return second + part * (first - second)


def either(probability: float, values: list[float], us: list[float]) -> tuple[float, float]:
    """Return mean and standard deviation where the first of two has this `probability`."""
    first, second = values
    square = between(probability, us[0] ** 2, us[1] ** 2)
    square += probability * (1 - probability) * (first - second) ** 2
    return between(probability, first, second), math.sqrt(square)
