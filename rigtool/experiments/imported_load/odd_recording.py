"""A recording unlike all others: with a load, a sign or a unit that is stated wrongly.

Left out, its residuals have the mean square q_i; those of the others in that fit have q_j. The
ratio for each of r recordings,

    t_i = sqrt(q_i (r - 2) / sum of q_j),

is an externally studentised residual of whole recordings. The largest of r is odd beyond Student's
t with r - 2 degrees of freedom at the level 1 - p / (2 r) (R. D. Cook, S. Weisberg, Residuals and
Influence in Regression, 1982, 2.2.2).
"""

from __future__ import annotations

import numpy as np

from rigtool.experiments.imported_load.side import Sums
from rigtool.numerics.arrays import TINY, Array

FALSE_ALARMS = 0.01
"""Part p of sets of recordings, none of which is odd, in which one is taken for it."""


def ratios(sums: Sums, recordings: int) -> Array:
    """Return the ratio (r,) of each of so many recordings, 0 for those without rows."""
    found = np.zeros(recordings)
    moving = np.flatnonzero(sums.rows)
    for number in moving:
        others = np.setdiff1d(moving, [number])
        weights = sums.solve(others) - sums.centre
        squares = sums.square - 2 * sums.right @ weights
        squares += np.einsum("i,rij,j->r", weights, sums.normal, weights)
        mean = np.maximum(squares, 0.0) / np.maximum(sums.rows, TINY)
        usual = float(mean[others].sum()) / max(len(moving) - 2, 1)
        found[number] = np.sqrt(mean[number] / max(usual, TINY))
    return found


def limit(recordings: int) -> float:
    """Return the ratio beyond which the largest of three recordings or more is odd."""
    from scipy.special import stdtrit

    return float(stdtrit(recordings - 2, 1 - FALSE_ALARMS / (2 * recordings)))
