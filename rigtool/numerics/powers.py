"""Powers of many numbers at once: loops of additions and products, that run several at a time.

A double is 2^n m with 1 <= m < 2, and n is in its upper 12 bits, of which the first is the sign:

    log2(2^n m) = n + 1/2 + 2/ln 2 artanh(s),   s = (m - sqrt 2)/(m + sqrt 2),   |s| < 0.172

with the series of artanh, and 2^y = 2^round(y) exp(ln 2 (y - round(y))) with that of exp (M.
Abramowitz, I. A. Stegun, Handbook of Mathematical Functions, 1964, 4.6.33 and 4.2.1).
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from rigtool.numerics.arrays import Array
from rigtool.numerics.compiled import compiled

FRACTION_BITS, BIAS = 52, 1023
"""Bits of m - 1 in a double, and what is stored for n = 0."""

WHOLE, ROUNDED = 2.0**52, 1.5 * 2.0**52
"""Added to a number below it, the first leaves a whole one in the lowest bits, and the second
rounds, negative ones too."""

FRACTION, ONE = 2**52 - 1, BIAS << 52
"""Bits of m - 1, and those of 1.0."""

WHOLE_BITS = (BIAS + 52) << 52
"""Bits of `WHOLE`."""

ROOT, LOG2 = math.sqrt(2.0), math.log(2.0)


@compiled
def raise_to(base: Array, bits: NDArray[np.uint64], exponent: Array, spare: Array) -> None:
    """Raise each `base` (k,) to its `exponent` (k,), within 2e-11 of the power for |log2| of it
    below 500; bases and powers are at least the least normal double.

    `bits` (k,) is the memory of `base` as integers, `spare` (k,) is room. Each loop writes to one
    array: only then does the compiler see that it may do several numbers at a time.
    """
    for k in range(len(base)):
        spare[k] = base[k]
    for k in range(len(base)):
        bits[k] = (bits[k] >> np.uint64(FRACTION_BITS)) | np.uint64(WHOLE_BITS)
    for k in range(len(base)):
        spare[k], base[k] = base[k] - (WHOLE + BIAS), spare[k]
    for k in range(len(base)):
        bits[k] = (bits[k] & np.uint64(FRACTION)) | np.uint64(ONE)
    for k in range(len(base)):
        s = (base[k] - ROOT) / (base[k] + ROOT)
        q = s * s
        more = q * (1 / 3 + q * (1 / 5 + q * (1 / 7 + q * (1 / 9 + q * (1 / 11 + q / 13)))))
        spare[k] = exponent[k] * (spare[k] + 0.5 + 2.0 / LOG2 * s * (1.0 + more))
    for k in range(len(base)):
        base[k] = spare[k] + ROUNDED
    for k in range(len(base)):
        y = (spare[k] - (base[k] - ROUNDED)) * LOG2
        last = y * (1 / 720 + y * (1 / 5040 + y * (1 / 40320 + y * (1 / 362880 + y / 3628800))))
        more = y * (1 / 2 + y * (1 / 6 + y * (1 / 24 + y * (1 / 120 + last))))
        spare[k] = 1.0 + y * (1.0 + more)
    for k in range(len(base)):
        bits[k] = (bits[k] + np.uint64(BIAS)) << np.uint64(FRACTION_BITS)
    for k in range(len(base)):
        base[k] *= spare[k]
