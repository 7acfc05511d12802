"""What all hypotheses of a power-up's ripple know of it together.

Filters k with the weights p_k, the means m_k and the covariances P_k give

    m = sum of p_k m_k,    P = sum of q_k (P_k + (m_k - m) (m_k - m)')

(Y. Bar-Shalom, X. R. Li, T. Kirubarajan, Estimation with Applications to Tracking and Navigation,
2001, section 11.6.2): near the learned ripple and of another one, each with and without a load that
hangs, and the learned ripple itself, with no covariance; `mix` says how q differs from p. The state
is one record, which compiled functions change.
"""

from __future__ import annotations

import math

import numpy as np

from rigtool.experiments.force_filter import passed
from rigtool.experiments.force_filter.plant import Record
from rigtool.experiments.force_model.drawn_ripple import FOLLOWED
from rigtool.experiments.force_model.model import ROTOR_ORDERS
from rigtool.experiments.force_sensor.power_up.lasting_contact import HANGING
from rigtool.numerics.compiled import compiled, compiled_allocating

ROW_EVIDENCE = 0.5
"""Part of the logarithm of a row's ratio of likelihoods that counts: noise of a row lasts for more
than one."""

MAX_LOG_RATIO = 50.0
"""Largest logarithm of both likelihoods' ratio: no weight is closer to 0 or 1."""

BEFOREHAND = 0.5
"""Probability of another power-up before anything is seen."""

CHANGED, SAME = 0.5, 0.5
"""Where the ripple is near the learned one: what it has changed by, in deviations of what a
power-up draws, and the probability, before anything is seen, that it has not changed at all. With
changes of 0.3, scores at another power-up are 0.5 % larger; without the probability, those at the
learned one are 1 to 2 % larger (six development rigs)."""

LEAST_PART = 1e-9
"""Least part of a variance that rounding leaves."""

PARAMETERS = np.dtype(
    [(name, "f8") for name in ("lag", "factor", "steps", "time", "size", "late")]
    + [(name, "f8") for name in ("step_time", "inertia", "friction", "length", "slow", "shown")]
    + [(name, "f8") for name in ("load_friction", "onset", "held", "lag_time", "square")]
    + [("orders", "i8", (FOLLOWED,)), ("unfollowed", "f8", (len(ROTOR_ORDERS), 4))]
    + [("hanging", "f8", (len(HANGING),)), ("growth", "f8", (FOLLOWED, 2))]
)
"""`orders`, `unfollowed` and `growth` are those of `drawn_ripple`, `square` is the sum of A^2,
`hanging` the variances of a load that hangs."""

WAVE_COUNT, FILTERS = 2 * FOLLOWED, 4
PARTS = WAVE_COUNT + 1 + len(HANGING)
"""Of a filter: waves, what a stroke deviates by, and c1, c2, c0 of a load that hangs. Filters: near
the learned ripple, another ripple, and both again where such a load may hang."""

TURNS = FILTERS * WAVE_COUNT

STATE = np.dtype(
    [
        # and what is taken off the filter's drive torque, N m: by the waves' coefficients `held`
        ("waves", "f8", (WAVE_COUNT + 1,)),
        ("held", "f8", (WAVE_COUNT,)),
        ("held_steps", "f8"),
        # torque of the current, N m, and that by its size, N m A, behind the ripple's lag
        ("current", "f8", (2,)),
        # as the filter's torque shows them, and what its other states `FOLLOWED` are then off by
        ("seen", "f8", (WAVE_COUNT + 1,)),
        ("angle", "f8", (WAVE_COUNT + 1,)),
        ("speed", "f8", (WAVE_COUNT + 1,)),
        ("housing", "f8", (WAVE_COUNT + 1,)),
        ("sine", "f8", (WAVE_COUNT + 1,)),
        ("cosine", "f8", (WAVE_COUNT + 1,)),
        ("direction", "f8"),
        # the row that is being filled, how many steps it has, and how many there are, and slide
        ("row", "f8", (PARTS,)),
        ("length", "f8"),
        ("drawn_length", "f8"),
        ("filled", "f8"),
        ("slid", "f8"),
        # under either hypothesis, the learned power-up first: what is expected and its variance;
        # by each filter
        ("expected", "f8", (2, WAVE_COUNT)),
        ("drawn", "f8", (2, WAVE_COUNT)),
        ("mean", "f8", (FILTERS, PARTS)),
        ("covariance", "f8", (FILTERS, PARTS, PARTS)),
        ("touched", "f8", (FILTERS,)),  # the probability that something touches
        # mean and covariance as they were, the earlier one first, and rows since the later one
        ("means", "f8", (FILTERS, 2, PARTS)),
        ("covariances", "f8", (FILTERS, 2, PARTS, PARTS)),
        ("since", "f8", (FILTERS,)),
        ("hangs", "f8", (2,)),  # the probability that a load hangs
        # a contact that lasts: what 1 N m of it changes the means by, its mean and variance, and
        # its probability; as they were, as means
        ("shift", "f8", (2, PARTS)),
        ("shifts", "f8", (2, 2, PARTS)),
        ("lasting", "f8", (2, 2)),
        ("lastings", "f8", (2, 2, 2)),
        ("lasts", "f8", (2,)),
        ("other", "f8"),  # logarithm of the likelihoods' ratio
        ("proven", "f8"),  # what of it stays where both hypotheses see a contact
        # of all hypotheses: weights of these two, what they count in the variance; mean and
        # covariance (its lower part) of the ripple, and the variance on the output that holds now
        ("weights", "f8", (2,)),
        ("counts", "f8", (2,)),
        ("known", "f8", (WAVE_COUNT,)),
        ("doubt", "f8", (WAVE_COUNT, WAVE_COUNT)),
        ("spread", "f8"),
        # where something touches: M by a slow and a fast walk, and the probability of the fast one
        ("level", "f8", (2,)),
        ("level_variance", "f8", (2,)),
        ("fast", "f8"),
        ("unfollowed", "f8", (4,)),  # sums over the orders at the speed of the last row
        ("doubted", "f8"),  # the wave whose doubt grows next, of the filter in turn
        ("passed", "f8", (passed.LOW_PASS_ORDER,)),
    ]
)


@compiled
def _expected(s: Record, f: int, i: int) -> float:
    """Return what a filter expects of a wave's coefficient."""
    if f > 1:
        return float(s.mean[f, i])
    return s.mean[f, i] + s.lasts[f] * s.lasting[f, 0] * s.shift[f, i]


@compiled_allocating
def _same(s: Record, f: int) -> float:
    """Return the logarithm of the likelihoods' ratio of the learned ripple itself to one near it:
    the density of no change over what it was before any row (`power_up`), of a filter near it."""
    root, left = np.zeros((WAVE_COUNT, WAVE_COUNT)), np.zeros(WAVE_COUNT)
    total = 0.0
    for i in range(WAVE_COUNT):
        left[i] = _expected(s, f, i)
        for j in range(i + 1):
            drawn = s.drawn[0, j]
            if drawn <= 0.0:  # no such order
                continue
            own = s.covariance[f, i, j]
            for k in range(j):
                own -= root[i, k] * root[j, k]
            if j < i:
                root[i, j] = own / root[j, j]
                left[i] -= root[i, j] * left[j]
            else:
                own = max(own, LEAST_PART * drawn)
                root[i, i] = math.sqrt(own)
                left[i] /= root[i, i]
                total -= 0.5 * (left[i] ** 2 + math.log(own / drawn))
    return total


@compiled_allocating
def mix(s: Record) -> None:
    """Put the hypotheses together: weights, mean and covariance of the ripple.

    Of two normal densities, one far wider, intervals are wider than their variance has it. So
    another power-up counts wholly in the variance unless it is less likely than beforehand; then
    by the square of the ratio, but by its probability at least.
    """
    same = 0.0
    for f in range(0, FILTERS, 2):
        limited = min(max(ROW_EVIDENCE * _same(s, f), -MAX_LOG_RATIO), MAX_LOG_RATIO)
        same += SAME * (s.hangs[0] if f else 1.0 - s.hangs[0]) * math.exp(limited)
    near, other = 1.0 - SAME, math.exp(s.other)
    total = same + near + other
    same, s.weights[0], s.weights[1] = same / total, near / total, other / total
    counts = min((s.weights[1] / BEFOREHAND) ** 2, 1.0)
    s.counts[0], s.counts[1] = s.weights[0], max(counts, s.weights[1])
    own, part = np.empty((FILTERS, WAVE_COUNT)), np.empty(FILTERS)
    s.known[:] = 0.0
    for f in range(FILTERS):
        h = f % 2
        part[f] = s.hangs[h] if f > 1 else 1.0 - s.hangs[h]
        for i in range(WAVE_COUNT):
            own[f, i] = _expected(s, f, i)
            s.known[i] += s.weights[h] * part[f] * own[f, i]
    for i in range(WAVE_COUNT):
        for j in range(i + 1):
            s.doubt[i, j] = same * s.known[i] * s.known[j]
            for f in range(FILTERS):
                apart = (own[f, i] - s.known[i]) * (own[f, j] - s.known[j])
                apart += s.covariance[f, i, j]
                if f < 2:
                    lasting, variance = s.lasting[f]
                    variance = s.lasts[f] * (variance + (1.0 - s.lasts[f]) * lasting**2)
                    apart += variance * s.shift[f, i] * s.shift[f, j]
                s.doubt[i, j] += s.counts[f % 2] * part[f] * apart
