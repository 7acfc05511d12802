"""The highest value within a span of samples about each.

    m_1 = x,   m_2w(i) = max(m_w(i), m_w(i + w)),   highest(i) = max(m_w(i), m_w(i + n - w))

with w the largest power of two up to the n samples of the span: as many passes as n has binary
digits, each over the whole array.
"""

from __future__ import annotations

from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

Scalar = TypeVar("Scalar", bound=np.generic)


def highest(values: NDArray[Scalar], before: int, after: int) -> NDArray[Scalar]:
    """Return the highest of values (n,) from `before` samples before each to `after` behind it.

    Spans end at the ends of the array; (n,).
    """
    first, last = np.repeat(values[:1], before), np.repeat(values[-1:], after)
    found = np.concatenate([first, values, last])
    size, width = before + after + 1, 1
    while 2 * width <= size:
        found = np.maximum(found[:-width], found[width:])
        width *= 2
    count = len(values)
    return np.maximum(found[:count], found[size - width :][:count])
