"""Minimum of a function of one positive number."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

POINTS = 25
"""In equal ratios between the bounds: those beside the lowest bracket the minimum."""


def minimum(function: Callable[[float], float], low: float, high: float) -> float:
    """Return where `function` is lowest between two positive bounds, to a part in a thousand.

    Brent's method locates it (R. P. Brent, Algorithms for Minimization without Derivatives, 1973,
    chapter 5).
    """
    from scipy.optimize import minimize_scalar

    grid = np.geomspace(low, high, POINTS)
    best = int(np.argmin([function(value) for value in grid]))
    found = minimize_scalar(
        lambda logarithm: function(math.exp(logarithm)),
        bounds=(math.log(grid[max(best - 1, 0)]), math.log(grid[min(best + 1, POINTS - 1)])),
        method="bounded",
        options={"xatol": 5e-4},
    )
    return math.exp(found.x)
