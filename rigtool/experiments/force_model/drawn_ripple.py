"""What an amplifier may draw at another power-up, from the ripple that was learned.

The orders of which most is expected, in the mean square, are followed (`force_sensor.power_up`).
What of the ripple is not is in the variance alone: the other orders c, and what grows with the
current, (g + h |i|) kT i. At another power-up these are off by

    n^2 sum over orders of (C^2 + (kT i)^2 A(i)^2) / (1 + (order b' tau)^2),
    C^2 = |c|^2, 0 where followed,   A(i)^2 = |g + h |i||^2,

in the mean over phases, behind the lag tau at the rotor's speed b'. The current i carries friction
and inertia besides M. Load friction looks like the low orders of g: the square of what was learned
holds the square of its errors already.

One misalignment has the same phases at all currents: in the rows of `power_up`, what is followed
grows by the part of g + h |i| that lies along c, over the amplitude A of another power-up.

What is followed may be larger than it was learned: along a part of a turn waves look alike, like
the housing's friction, and those of low orders like a constant. Learning sizes all orders at once
(`Problem.size_waves`), and along such a part the high ones alone are determined. So ripple and
cogging are those of `sized_waves`, and A^2 is |c|^2 and the variance of c. What of c was learned
as other terms acts at the learned power-up as well: c is the mean of what acted.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np
from numpy.typing import NDArray

from rigtool.experiments.force_model.force_model import ForceModel
from rigtool.experiments.force_model.learning import LearnedModel
from rigtool.experiments.force_model.model import ROTOR_ORDERS, Kind, Term
from rigtool.experiments.force_model.sliding_problem import SIZED, SLIDING_PARAMETERS
from rigtool.numerics.arrays import Array

FOLLOWED = 6
"""Number of orders that are followed: the work of a row grows with the square of their number."""

FADES, SIZES = (0.0, 1.0, 2.0, 3.0), 2.0 ** np.arange(4)
"""Priors of the waves: their spread falls as order^-fade; root of the sum of their variances, in
parts of the larger one of ripple and cogging in the learned priors."""


@dataclass(frozen=True, eq=False)
class LearnedRipple:
    """The ripple of the learned power-up: the `orders` that are followed, as they rise, cosine and
    sine of each (12,) N m as they are at low speed, and the variance that another power-up's have;
    and of every order of `ROTOR_ORDERS` what the variance alone has (14, 4): C^2, and coefficients
    of 1, |i| and i^2 of A(i)^2; and what the followed ones grow by (6, 2): per torque of the
    current, 1/(N m), and per that and the current's size, 1/(N m A)."""

    orders: NDArray[np.int64]
    coefficient: Array
    drawn: Array
    unfollowed: Array
    growth: Array


def learned_ripple(model: ForceModel) -> LearnedRipple:
    """Return the ripple of a learned model."""
    learned = model.learned

    def squares(one: Array, other: Array) -> Array:
        found = (one @ learned.coefficient) * (other @ learned.coefficient)
        return found.reshape(-1, 2).sum(axis=1)

    still = sums(learned, *SIZED)
    mean, variance = sized_waves(learned)
    gain, bent = sums(learned, Kind.GAIN_RIPPLE), sums(learned, Kind.SQUARE_RIPPLE)
    drawn = (mean**2 + variance).reshape(-1, 2).sum(axis=1) / 2
    other = squares(still, still)
    strongest = np.sort(np.argsort(-drawn, kind="stable")[:FOLLOWED])
    other[strongest] = 0.0
    growing = squares(gain, gain), 2 * squares(gain, bent), squares(bent, bent)
    return LearnedRipple(
        strongest + ROTOR_ORDERS[0],
        mean.reshape(-1, 2)[strongest].ravel(),
        np.repeat(drawn[strongest], 2),
        np.column_stack([other, *growing]),
        _growth(learned, mean, 2 * drawn)[strongest],
    )


def _growth(learned: LearnedModel, mean: Array, square: Array) -> Array:
    """Return `LearnedRipple.growth` of every order (14, 2): the parts of g and h along c, the mean
    (28,), over the amplitude A, of `square` (14,) N2 m2."""
    pairs = mean.reshape(-1, 2)
    scale = np.hypot(*pairs.T) * np.sqrt(square)
    kinds = Kind.GAIN_RIPPLE, Kind.SQUARE_RIPPLE
    found = [(sums(learned, kind) @ learned.coefficient).reshape(-1, 2) for kind in kinds]
    along = np.column_stack([np.sum(pairs * one, axis=1) for one in found])
    return np.divide(along, scale[:, None], out=0 * along, where=scale[:, None] > 0)


def sums(learned: LearnedModel, *kinds: Kind) -> Array:
    """Return what sums the terms of some kinds to cosine and sine of each order (28, t)."""
    sums = np.zeros((2 * len(ROTOR_ORDERS), len(learned.terms)))
    for number, term in enumerate(learned.terms):
        if term.kind in kinds and term.order in ROTOR_ORDERS:
            sums[2 * (term.order - 1) + term.quarter, number] = 1.0
    return sums


def sized_waves(learned: LearnedModel) -> tuple[Array, Array]:
    """Return mean and variance of ripple and cogging together, cosine and sine of each order (28,),
    N m and N2 m2, over the priors (`_priors`).

    Learned were c with covariance P under a prior of variances S. Under S' they are, with
    D = 1 / S' - 1 / S, and Z the probability of what was recorded,

        c' = (1 + P D)^-1 c,   P' = (1 + P D)^-1 P,
        Z' / Z = (|S| / (|S'| |1 + P D|))^(1/2) exp(-c D c' / 2)

    (products of normal densities). Z' weighs the priors, which are alike beforehand (D. J. C.
    MacKay, Neural Computation 4(3) 415-447, 1992).
    """
    used = np.array([term.kind in SIZED and term.spread > 0 for term in learned.terms])
    if not used.any():
        return np.zeros(2 * len(ROTOR_ORDERS)), np.zeros(2 * len(ROTOR_ORDERS))
    terms = [term for term, one in zip(learned.terms, used, strict=True) if one]
    spread, first = np.array([term.spread for term in terms]), len(SLIDING_PARAMETERS)
    c, p = learned.coefficient[used] / spread, learned.covariance[first:, first:][used][:, used]
    shown, basis = np.linalg.eigh(p / np.outer(spread, spread))
    p = (basis * np.clip(shown, 0.0, 1.0)) @ basis.T  # nothing learned is less sure than before
    scaled = sums(learned, *SIZED)[:, used] * spread
    ratio = _priors(terms) / spread
    d = ratio**-2 - 1
    left = np.eye(len(terms)) + p * d[:, None, :]
    right = np.column_stack([c, p @ scaled.T])
    solved = np.linalg.solve(left, np.broadcast_to(right, (len(d), *right.shape)))
    evidence = -np.log(ratio).sum(axis=1) - np.linalg.slogdet(left)[1] / 2
    evidence -= np.sum(c * d * solved[:, :, 0], axis=1) / 2
    weights = np.exp(evidence - evidence.max())
    weights /= weights.sum()
    means = solved[:, :, 0] @ scaled.T
    variances = np.einsum("nt,ktn->kn", scaled, solved[:, :, 1:])
    mean: Array = weights @ means
    variance: Array = weights @ (variances + (means - mean) ** 2)
    return mean, variance


def _priors(terms: Sequence[Term]) -> Array:
    """Return the spreads (k, t) of ripple and cogging in every prior, N m."""
    spread, order = (np.array([getattr(t, name) for t in terms]) for name in ("spread", "order"))
    ripple = np.array([term.kind is Kind.RIPPLE for term in terms])
    still = np.where(ripple, 0.0, spread)
    shapes = [np.where(ripple, (1.0 * order) ** -fade, 0.0) for fade in FADES]
    own = [[shape / (np.linalg.norm(shape) or 1.0) for shape in kind] for kind in (shapes, [still])]
    sizes = SIZES * max(np.linalg.norm(spread[ripple]), np.linalg.norm(still))
    each = product(*(product(sizes, kind) for kind in own))
    return np.array([one * first + other * second for (one, first), (other, second) in each])
