"""What an amplifier may draw at another power-up, from the ripple that was learned.

Ripple that grows with the current, (g + h |i|) kT i w, is in the variance alone. At another
power-up it is off by

    n^2 (kT i)^2 sum over orders of A(i)^2 |lag(w)|^2,    A(i)^2 = |g + h |i||^2,

in the mean over phases. The current i carries friction and inertia besides M. Load friction looks
like the low orders of g: the square of what was learned holds the square of its errors already.
"""

from __future__ import annotations

import numpy as np

from rigtool.experiments.force_model.force_model import ForceModel
from rigtool.experiments.force_model.model import RIPPLE_ORDERS, Kind
from rigtool.experiments.force_model.sliding_problem import SLIDING_PARAMETERS
from rigtool.numerics.arrays import Array

UNCERTAIN_SHARE = 0.3
"""Part of the variance of the ripple's learned waves that counts, as the low orders are learned too
small: that of the high orders is their prior's, which is several times what amplifiers have."""


def learned_ripple(model: ForceModel) -> tuple[Array, Array, Array]:
    """Return the ripple of the learned power-up, cosine and sine of each order N m, as it is at
    low speed; the variance that another power-up's have; and A(i)^2 of what grows with the
    current, coefficients of 1, |i| and i^2 for each order (4, 3)."""
    learned, first = model.learned, len(SLIDING_PARAMETERS)
    covariance = learned.covariance[first:, first:]

    def waves(kinds: tuple[Kind, ...], orders: range) -> Array:
        sums = np.zeros((2 * len(orders), len(learned.terms)))
        for number, term in enumerate(learned.terms):
            if term.kind in kinds and term.order in orders:
                sums[2 * (term.order - 1) + term.quarter, number] = 1.0
        return sums

    def squares(one: Array, other: Array) -> Array:
        found = (one @ learned.coefficient) * (other @ learned.coefficient)
        total: Array = found.reshape(-1, 2).sum(axis=1)
        return total

    still = waves((Kind.RIPPLE, Kind.COGGING), RIPPLE_ORDERS)
    gain, bent = (waves((k,), RIPPLE_ORDERS) for k in (Kind.GAIN_RIPPLE, Kind.SQUARE_RIPPLE))
    growing = np.column_stack([squares(gain, gain), 2 * squares(gain, bent), squares(bent, bent)])
    doubt = np.sum(still @ covariance * still, axis=1).reshape(-1, 2).sum(axis=1)
    drawn = (squares(still, still) + UNCERTAIN_SHARE * doubt) / 2
    return still @ learned.coefficient, np.repeat(drawn, 2), growing
