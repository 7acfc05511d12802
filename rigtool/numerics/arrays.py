"""Types of arrays: Array = float64 numbers, ComplexArray = complex128 numbers, Mask = booleans."""

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]
Mask = NDArray[np.bool_]

TINY = 1e-300
"""What stands for zero in a divisor or a logarithm."""
