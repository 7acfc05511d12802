"""Standard uncertainty of a statistic of repeated measurements, by leaving out each in turn.

    u^2 = (n - 1)/n sum over i of (s_i - mean of s)^2,  s_i the statistic without repeat i

Efron & Stein, Annals of Statistics 9(3), 586-596, 1981.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from rigtool.numerics.arrays import Array


def jackknife(count: int, statistic: Callable[[NDArray[np.intp]], float]) -> tuple[float, float]:
    """Return a statistic over `count` repeats and its standard uncertainty.

    `statistic` takes the indices of the repeats to use. Raises ValueError for fewer than two.
    """
    if count < 2:
        raise ValueError(f"{count} repeat has no scatter: at least 2 are needed")
    everything = np.arange(count)
    without = np.array([statistic(np.delete(everything, i)) for i in everything])
    return statistic(everything), standard_uncertainty(without)


def standard_uncertainty(without: Array) -> float:
    """Return u of a statistic from its values without each of the repeats, (count,)."""
    count = len(without)
    scatter = float(np.sum((without - without.mean()) ** 2))
    return math.sqrt((count - 1) / count * scatter)
