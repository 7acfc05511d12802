"""What an amplifier may draw at another power-up, from the ripple that was learned.

The orders of which most is expected, in the mean square, are followed (`power_up`). What of the
ripple is not is in the variance alone: the other orders c, and what grows with the current,
(g + h |i|) kT i. At another power-up these are off by

    n^2 sum over orders of (C^2 + (kT i)^2 A(i)^2) / (1 + (order b' tau)^2),
    C^2 = |c|^2, 0 where followed,   A(i)^2 = |g + h |i||^2,

in the mean over phases, behind the lag tau at the rotor's speed b'. The current i carries friction
and inertia besides M. Load friction looks like the low orders of g: the square of what was learned
holds the square of its errors already.

What is followed may be larger than it was learned: along a part of a turn waves look alike, and
like the housing's friction. So its A^2 is |c|^2 and the variance of c, of which the prior has the
size that the recordings show (`Problem.size_waves`).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rigtool.experiments.force_model.force_model import ForceModel
from rigtool.experiments.force_model.model import ROTOR_ORDERS, Kind
from rigtool.experiments.force_model.sliding_problem import SLIDING_PARAMETERS
from rigtool.numerics.arrays import Array

FOLLOWED = 6
"""Number of orders that are followed: the work of a row grows with the square of their number."""


@dataclass(frozen=True, eq=False)
class LearnedRipple:
    """The ripple of the learned power-up: the `orders` that are followed, as they rise, cosine and
    sine of each (12,) N m as they are at low speed, and the variance that another power-up's have;
    and of every order of `ROTOR_ORDERS` what the variance alone has (14, 4): C^2, and coefficients
    of 1, |i| and i^2 of A(i)^2."""

    orders: NDArray[np.int64]
    coefficient: Array
    drawn: Array
    unfollowed: Array


def learned_ripple(model: ForceModel) -> LearnedRipple:
    """Return the ripple of a learned model."""
    learned, first = model.learned, len(SLIDING_PARAMETERS)
    covariance = learned.covariance[first:, first:]

    def waves(*kinds: Kind) -> Array:
        sums = np.zeros((2 * len(ROTOR_ORDERS), len(learned.terms)))
        for number, term in enumerate(learned.terms):
            if term.kind in kinds and term.order in ROTOR_ORDERS:
                sums[2 * (term.order - 1) + term.quarter, number] = 1.0
        return sums

    def squares(one: Array, other: Array) -> Array:
        found = (one @ learned.coefficient) * (other @ learned.coefficient)
        return found.reshape(-1, 2).sum(axis=1)

    still = waves(Kind.RIPPLE, Kind.COGGING)
    gain, bent = waves(Kind.GAIN_RIPPLE), waves(Kind.SQUARE_RIPPLE)
    doubt = np.sum(still @ covariance * still, axis=1).reshape(-1, 2).sum(axis=1)
    other = squares(still, still)
    drawn = (other + doubt) / 2
    strongest = np.sort(np.argsort(-drawn, kind="stable")[:FOLLOWED])
    other[strongest] = 0.0
    growing = squares(gain, gain), 2 * squares(gain, bent), squares(bent, bent)
    return LearnedRipple(
        strongest + ROTOR_ORDERS[0],
        (still @ learned.coefficient).reshape(-1, 2)[strongest].ravel(),
        np.repeat(drawn[strongest], 2),
        np.column_stack([other, *growing]),
    )
