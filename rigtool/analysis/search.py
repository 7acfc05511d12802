"""Where a function of one positive number has its minimum."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np


def minimum(
    function: Callable[[float], float], low: float, high: float, *, points: int = 9
) -> float:
    """Return where `function` is lowest between two positive bounds, to a part in a thousand.

    `points` in equal ratios find the valley, a golden section its bottom (Kiefer 1953).
    """
    grid = np.geomspace(low, high, points)
    best = int(np.argmin([function(value) for value in grid]))
    a, b = math.log(grid[max(best - 1, 0)]), math.log(grid[min(best + 1, points - 1)])
    golden = (math.sqrt(5) - 1) / 2
    c, d = b - golden * (b - a), a + golden * (b - a)
    at_c, at_d = function(math.exp(c)), function(math.exp(d))
    while b - a > 1e-3:
        if at_c < at_d:
            b, d, at_d = d, c, at_c
            c = b - golden * (b - a)
            at_c = function(math.exp(c))
        else:
            a, c, at_c = c, d, at_d
            d = a + golden * (b - a)
            at_d = function(math.exp(d))
    return math.exp((a + b) / 2)
