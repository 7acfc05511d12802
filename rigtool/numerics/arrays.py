"""Types of arrays: Array = float64 numbers, ComplexArray = complex128 numbers, Mask = booleans."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]
Mask = NDArray[np.bool_]

TINY = 1e-300
"""What stands for zero in a divisor or a logarithm."""


def joined(parts: Sequence[Any], *names: str) -> tuple[Any, ...]:
    """Return arrays (n, ...) of parts, by their names, each joined along its first axis."""
    return tuple(np.concatenate([getattr(part, name) for part in parts]) for name in names)
