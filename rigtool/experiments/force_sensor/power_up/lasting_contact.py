"""A weak load that acts all the time, beside ripple that a power-up draws.

Along a part of a turn ripple of low orders has a mean, as has a weak load that stays or grows
slowly, and a mass that hangs goes with the first order of the output's angle: alone, either
explains what rows of the torque show.

A load that hangs, c0 + c1 cos a + c2 sin a at the output's angle a, holds still. It is in the
states of filters of its own (`ripple_rows`), as rows that it explains look touched without it.

A contact c that lasts is a slow random walk while the rotor slides: less known in a rest, it would
make the ripple less known, which no rest changes. Errors e of a filter without c are then those of
one with it, but for

    e = s c + error,   s = 1 + H V,   V' = V - K s

with the filter's row H and gain K: V is what c has made of its states, and a filter of c alone
gives its mean, its variance, and the likelihood of the row (B. Friedland, IEEE Trans. Autom.
Control 14(4) 359-367, 1969).
"""

from __future__ import annotations

import math

from rigtool.numerics.arrays import Array
from rigtool.numerics.compiled import compiled

LASTS, LASTING, DRIFT, LEAST_LASTS = 0.03, 5.0, 0.5, 1e-3
"""Probability, before anything is seen, that a weak contact acts all the time; its deviation, and
what it changes by per square root of a second of sliding, in deviations of a stroke; its least
probability.

Contacts that come and go look like one as well: where another power-up's ripple is in doubt, a
probability of 0.1 makes the intervals' score up to 7 % larger (six development rigs), and with
0.005 a contact that does last is taken for ripple (intervals hold in 33 %)."""

HANGS, HANGING = 0.2, (10.0, 10.0, 5.0)
"""Probability, before anything is seen, that a load hangs all the time; and deviations of c1, c2
and c0, in deviations of a stroke.

With a probability of 0.1, scores without such a load are 0.5 % smaller, but those of a mass of 2.4
mN m at another power-up are up to 61 % larger (three development rigs, causal). Without c0, a push
of 2 mN m is taken for a mass at another power-up, with up to 2.5 times the score. With a random
walk of c0, a mass becomes unlikely within a minute of strokes."""


@compiled
def weighed(probability: float, one: float, other: float) -> tuple[float, float]:
    """Return the logarithm of the likelihood of a row that has `one`'s or, with a probability, the
    `other`'s, and the probability then."""
    one += math.log(1.0 - probability)
    other += math.log(probability)
    largest = max(one, other)
    together = largest + math.log(math.exp(one - largest) + math.exp(other - largest))
    return together, math.exp(other - together)


@compiled
def counted(lasts: float, one: float, other: float) -> tuple[float, float]:
    """Return `weighed`, of a probability that keeps away from 0 and 1."""
    together, lasts = weighed(lasts, one, other)
    return together, min(max(lasts, LEAST_LASTS), 1.0 - LEAST_LASTS)


@compiled
def normal(error: float, variance: float) -> float:
    """Return the logarithm of a normal's likelihood, but for a constant."""
    return -0.5 * (error**2 / variance + math.log(variance))


@compiled
def lasts_too(
    lasting: Array, error: float, seen: float, variance: float, untouched: float
) -> float:
    """Return the logarithm of a row's likelihood where a contact lasts of which the error has
    `seen`, and take it in there, by the probability that nothing else touches (B. Friedland 1969);
    `lasting` (2,) are its mean and variance.
    """
    left, whole = error - seen * lasting[0], variance + seen**2 * lasting[1]
    part = untouched * seen * lasting[1] / whole
    lasting[0] += part * left
    lasting[1] *= 1.0 - part * seen
    return normal(left, whole)
