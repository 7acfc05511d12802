"""Weighted sums of rows, y_j = sum over i of w_i r_ij: most of the time of filter and smoother."""

from __future__ import annotations

from rigtool.numerics.arrays import Array
from rigtool.numerics.compiled import compiled


@compiled
def four(weights: Array, rows: Array, count: int, j: int) -> tuple[float, float, float, float]:
    """Return columns j to j + 3 of the sum of the first `count` weights (n,) times rows (n, m).

    A processor adds them up at once; each is added up in the order of the rows.
    """
    a = b = c = d = 0.0
    for m in range(count):
        weight = weights[m]
        a += weight * rows[m, j]
        b += weight * rows[m, j + 1]
        c += weight * rows[m, j + 2]
        d += weight * rows[m, j + 3]
    return a, b, c, d
