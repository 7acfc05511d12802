"""What residuals of a least-squares fit show beside the model, and the doubt that it leaves.

A function g of some quantity that the model lacks leaves its trace in the residuals, but only that
part of it that looks like none of the regressors. How strongly it acted where it does look like
regressor j is not known; it is taken to be as strong there as where it shows:

    u_j^2 = P alike_j / sum of own_j^2

with P the residuals' power that a function of the quantity explains beyond chance, own_j what the
other regressors do not explain of regressor j, and alike_j the part of it that a function of the
quantity explains. Functions are means over ranges of the quantity.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

RANGES = 24
"""Ranges of the quantity in which the mean residual is looked at."""

FEWEST_RANGES = 4
"""With fewer, each of four independent samples, nothing is said of structure."""


def own(design: Array, column: int) -> Array:
    """Return what the other regressors do not explain of one, (n,)."""
    others = np.delete(design, column, axis=1)
    fit = np.linalg.lstsq(others, design[:, column], rcond=None)[0]
    rest: Array = design[:, column] - others @ fit
    return rest


def own_part(design: Array, column: int) -> float:
    """Return the part of a regressor's power that the others do not explain (1 - R^2)."""
    power = max(float(np.sum(design[:, column] ** 2)), 1e-300)
    return float(np.sum(own(design, column) ** 2)) / power


def structure(
    over: Array, residual: Array, design: Array, independent: float
) -> tuple[float, Array]:
    """Return the part of the residual's power that a function of `over` explains beyond chance.

    And the doubt about each parameter (p,) that follows. `over` (n,), `residual` (n,), `design`
    (n, p); residuals are worth `independent` samples.
    """
    ranges = min(RANGES, int(independent / 4))
    if ranges < FEWEST_RANGES:
        return 0.0, np.zeros(design.shape[1])
    order = np.argsort(over, kind="stable")
    chance = ranges / independent
    share = max(0.0, (_explained_by(order, residual, ranges) - chance) / (1 - chance))
    power = share * float(np.sum(residual**2))
    doubt = np.zeros(design.shape[1])
    for column in range(design.shape[1]):
        rest = own(design, column)
        alike = _explained_by(order, rest, ranges)
        doubt[column] = math.sqrt(power * alike / max(float(np.sum(rest**2)), 1e-300))
    return share, doubt


def _explained_by(order: NDArray[np.intp], values: Array, ranges: int) -> float:
    """Return the part of the power of values that is in their means over ranges of `order`."""
    parts = np.array_split(values[order], ranges)
    explained = sum(len(part) * float(part.mean()) ** 2 for part in parts)
    return explained / max(float(np.sum(values**2)), 1e-300)
