"""Rows of the torque on the output, each read under two hypotheses of the amplifier's ripple.

A row is the mean of some steps. Under each of two hypotheses of `power_up` its value y is

    y = sum of beta_j w_j + M + e   where nothing touches, else a random walk that may leap,

and counts by the probability that nothing touches (probabilistic data association: Y. Bar-Shalom,
E. Tse, Automatica 11(5) 451-460, 1975). The state is one record, which compiled functions change.
"""

from __future__ import annotations

import math

import numpy as np

from rigtool.experiments.force_filter import passed
from rigtool.experiments.force_filter.plant import Record
from rigtool.experiments.force_model.drawn_ripple import FOLLOWED
from rigtool.experiments.force_model.model import ROTOR_ORDERS
from rigtool.experiments.force_sensor.lasting_contact import (
    DRIFT,
    counted,
    lasts_too,
    normal,
    weighed,
)
from rigtool.numerics.compiled import compiled, compiled_allocating

ROW_TIME = 20e-3
"""Mean time of a row, s: friction's own noise hardly changes within it."""

DRAW = (137, 29, 1024)
"""Factor, addend and modulus that draw the length of each row, half to one and a half times the
mean (D. H. Lehmer): a force that swings with the rows would meet them at the same phases again and
again, and rows in which it is small would look untouched."""

NOISE, WALKS, AFTER_REVERSAL, CONTACT = 0.7, (1.5, 6.0), 1.5, 100.0
"""In deviations of a stroke: noise of a row, slow and fast random walk of M under a contact per
square root of a second, and what M may change by over a reversal and where it leaps."""

BEGINS, ENDS, CHANGES = 0.2, 0.7, 2.0
"""Rates at which contacts begin, end, and leap or change their walk, 1/s. A contact under one
hypothesis may be ripple under the other. It lasts for t with the probability exp(-`ENDS` t): the
time t may speak against it by no more than `ENDS` t once both hypotheses see a contact."""

RECOGNISED, LATE_TIME = 0.9, 0.5
"""Probability of a contact from which on it is recognised; and the time, s of sliding, of which at
least as much, and twice as much at most, is then taken back."""

HELD_TIME = 2.0
"""Time, s, after which what is taken off the filter's drive torque is renewed. Ripple becomes known
in seconds. Renewed within a weak contact, what the contact first adds to the ripple feeds on itself
by the friction: with 0.25 s, errors of weak contacts in strokes are up to 1.9 times as large (two
development rigs with thrice the load friction), with 4 s all are as with 2."""

MIN_UNTOUCHED_PROBABILITY = 1e-6
"""Probability that nothing touches, below which a row does not count."""

ROW_EVIDENCE = 0.5
"""Part of the logarithm of a row's ratio of likelihoods that counts: noise of a row lasts for more
than one."""

MEMORY, FORGOTTEN = 2.0, 1000.0
"""Of M where nothing touches, s: about that of a stroke. And the time of sliding in which the doubt
of the ripple grows by what it was at first: strokes pay back what others deviate by, a weak contact
may be taken for ripple, and rows are not as independent as the equations have it."""

MAX_LOG_RATIO = 50.0
"""Largest logarithm of both likelihoods' ratio: no weight is closer to 0 or 1."""

BEFOREHAND = 0.5
"""Probability of another power-up before anything is seen."""

CHANGED, SAME = 0.5, 0.5
"""Where the ripple is near the learned one: what it has changed by, in deviations of what a
power-up draws, and the probability, before anything is seen, that it has not changed at all. With
changes of 0.3, scores at another power-up are 0.5 % larger; without the probability, those at the
learned one are 1 to 2 % larger (six development rigs)."""

SPREAD_STEPS = 4
"""Steps for which a variance of the ripple holds: waves hardly change, firmware has little time."""

LARGEST_RIPPLE_RATIO = 3.0
"""Largest ratio of an order's amplitude at another power-up to the learned one."""

LEAST_PART = 1e-9
"""Least part of a variance that rounding leaves."""

PARAMETERS = np.dtype(
    [(name, "f8") for name in ("lag", "factor", "steps", "time", "size", "late")]
    + [(name, "f8") for name in ("step_time", "inertia", "friction", "length", "slow", "shown")]
    + [(name, "f8") for name in ("load_friction", "onset", "held", "lag_time", "square")]
    + [("orders", "i8", (FOLLOWED,)), ("unfollowed", "f8", (len(ROTOR_ORDERS), 4))]
)
"""`orders` and `unfollowed` are those of `drawn_ripple`, `square` is the sum of A^2."""

WAVE_COUNT = 2 * FOLLOWED

STATE = np.dtype(
    [
        # and what is taken off the filter's drive torque, N m: by the waves' coefficients `held`
        ("waves", "f8", (WAVE_COUNT + 1,)),
        ("held", "f8", (WAVE_COUNT,)),
        ("held_steps", "f8"),
        # as the filter's torque shows them, and what its other states `FOLLOWED` are then off by
        ("seen", "f8", (WAVE_COUNT + 1,)),
        ("angle", "f8", (WAVE_COUNT + 1,)),
        ("speed", "f8", (WAVE_COUNT + 1,)),
        ("housing", "f8", (WAVE_COUNT + 1,)),
        ("sine", "f8", (WAVE_COUNT + 1,)),
        ("cosine", "f8", (WAVE_COUNT + 1,)),
        ("direction", "f8"),
        # the row that is being filled, how many steps it has, and how many there are, and slide
        ("row", "f8", (WAVE_COUNT + 1,)),
        ("length", "f8"),
        ("drawn_length", "f8"),
        ("filled", "f8"),
        ("slid", "f8"),
        # under either hypothesis, the learned power-up first: what is expected and its variance
        ("expected", "f8", (2, WAVE_COUNT)),
        ("drawn", "f8", (2, WAVE_COUNT)),
        ("mean", "f8", (2, WAVE_COUNT + 1)),
        ("covariance", "f8", (2, WAVE_COUNT + 1, WAVE_COUNT + 1)),
        ("touched", "f8", (2,)),  # the probability that something touches
        # mean and covariance as they were, the earlier one first, and rows since the later one
        ("means", "f8", (2, 2, WAVE_COUNT + 1)),
        ("covariances", "f8", (2, 2, WAVE_COUNT + 1, WAVE_COUNT + 1)),
        ("since", "f8", (2,)),
        # a contact that lasts: what 1 N m of it changes the means by, its mean and variance, and
        # its probability; as they were, as means
        ("shift", "f8", (2, WAVE_COUNT + 1)),
        ("shifts", "f8", (2, 2, WAVE_COUNT + 1)),
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
        ("doubted", "f8"),  # the wave whose doubt grows next
        ("passed", "f8", (passed.LOW_PASS_ORDER,)),
    ]
)


def row_steps(step_time: float) -> int:
    """Return the mean number of steps of a row."""
    return max(1, round(ROW_TIME / step_time))


def late_rows(step_time: float) -> int:
    """Return the rows of `LATE_TIME`."""
    return round(LATE_TIME / (row_steps(step_time) * step_time))


def held_steps(step_time: float) -> int:
    """Return the steps of `HELD_TIME`."""
    return max(1, round(HELD_TIME / step_time))


@compiled_allocating
def read_row(s: Record, p: Record) -> None:
    """Take in a row, and begin the next one."""
    slides = s.slid >= s.length
    _pass_time(s, p, slides)
    if slides:
        touching = _touching(s, p)
        for h in range(2):
            likely = _by_ripple(s, p, h, touching)
            s.other += likely if h else -likely
        s.other = min(max(s.other, -MAX_LOG_RATIO), MAX_LOG_RATIO)
        for i in range(0, WAVE_COUNT, 2):
            first, second = s.mean[1, i] - s.expected[1, i], s.mean[1, i + 1] - s.expected[1, i + 1]
            square = s.drawn[1, i] + s.drawn[1, i + 1]
            if first * first + second * second > LARGEST_RIPPLE_RATIO**2 * square:
                _begin_anew(s)
                break
        if min(s.touched[0], s.touched[1]) > RECOGNISED:
            s.other = s.proven
        else:
            most = ENDS * p.time
            s.proven += min(max(s.other - s.proven, -most), most)
        for h in range(2):
            _take_back(s, p, h)
    mix(s)
    for i in range(WAVE_COUNT + 1):
        s.row[i] = 0.0
    s.filled = s.slid = 0.0
    s.drawn_length = (DRAW[0] * s.drawn_length + DRAW[1]) % DRAW[2]
    s.length = p.steps // 2 + p.steps * s.drawn_length // DRAW[2]


@compiled_allocating
def renew_unfollowed(s: Record, p: Record, speed: float) -> None:
    """Renew the sums over the orders that are not followed, for a speed of the rotor, rad/s."""
    s.unfollowed[:] = 0.0
    for i in range(p.unfollowed.shape[0]):
        behind = 1.0 / (1.0 + ((i + 1) * speed * p.lag_time) ** 2)
        for j in range(4):
            s.unfollowed[j] += behind * p.unfollowed[i, j]


@compiled_allocating
def _same(s: Record) -> float:
    """Return the logarithm of the likelihoods' ratio of the learned ripple itself to one near it:
    the density of no change over what it was before any row (`power_up`)."""
    root, left = np.zeros((WAVE_COUNT, WAVE_COUNT)), np.zeros(WAVE_COUNT)
    total = 0.0
    for i in range(WAVE_COUNT):
        drawn = s.drawn[0, i]
        if drawn <= 0.0:  # no such order
            continue
        left[i] = s.mean[0, i] + s.lasts[0] * s.lasting[0, 0] * s.shift[0, i]
        for j in range(i + 1):
            if s.drawn[0, j] <= 0.0:
                continue
            own = s.covariance[0, i, j]
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
    limited = min(max(ROW_EVIDENCE * _same(s), -MAX_LOG_RATIO), MAX_LOG_RATIO)
    same, near, other = SAME * math.exp(limited), 1.0 - SAME, math.exp(s.other)
    total = same + near + other
    same, s.weights[0], s.weights[1] = same / total, near / total, other / total
    own = np.empty((2, WAVE_COUNT))
    s.known[:] = 0.0
    for h in range(2):
        for i in range(WAVE_COUNT):
            own[h, i] = s.mean[h, i] + s.lasts[h] * s.lasting[h, 0] * s.shift[h, i]
            s.known[i] += s.weights[h] * own[h, i]
    counts = min((s.weights[1] / BEFOREHAND) ** 2, 1.0)
    s.counts[0], s.counts[1] = s.weights[0], max(counts, s.weights[1])
    for i in range(WAVE_COUNT):
        for j in range(i + 1):
            s.doubt[i, j] = same * s.known[i] * s.known[j]
            for h in range(2):
                lasting, variance = s.lasting[h]
                variance = s.lasts[h] * (variance + (1.0 - s.lasts[h]) * lasting**2)
                apart = (own[h, i] - s.known[i]) * (own[h, j] - s.known[j])
                apart += s.covariance[h, i, j] + variance * s.shift[h, i] * s.shift[h, j]
                s.doubt[i, j] += s.counts[h] * apart


@compiled
def _pass_time(s: Record, p: Record, slides: bool) -> None:
    """Go on to the end of a row."""
    begins, ends = BEGINS * p.time, ENDS * p.time
    s.fast += CHANGES * p.time * (0.5 - s.fast)
    for i in range(2):
        s.level_variance[i] += (WALKS[i] * p.size) ** 2 * p.time
        if not slides:  # part of the row is no sliding: friction may be off by a stroke's own
            s.level_variance[i] += (AFTER_REVERSAL * p.size) ** 2 * p.time / ROW_TIME
    kept = math.exp(-p.time / MEMORY) if slides else 0.0
    fresh, one = (1.0 - kept * kept) * p.size**2, int(s.doubted)
    for h in range(2):
        s.touched[h] += begins - (begins + ends) * s.touched[h]
        s.shift[h, WAVE_COUNT] *= kept
        s.mean[h, WAVE_COUNT] *= kept
        for i in range(WAVE_COUNT):
            s.covariance[h, i, WAVE_COUNT] *= kept
            s.covariance[h, WAVE_COUNT, i] *= kept
        own = s.covariance[h, WAVE_COUNT, WAVE_COUNT]
        s.covariance[h, WAVE_COUNT, WAVE_COUNT] = kept * kept * own + fresh
        if slides:  # at rest nothing makes ripple and what lasts less known
            s.lasting[h, 1] += (DRIFT * p.size) ** 2 * p.time
            s.covariance[h, one, one] += s.drawn[h, one] * WAVE_COUNT * p.time / FORGOTTEN
    if slides:
        s.doubted = (one + 1) % WAVE_COUNT  # in turn


@compiled
def _touching(s: Record, p: Record) -> float:
    """Return the logarithm of a row's likelihood where something touches, and take it in there."""
    noise, anew = (NOISE * p.size) ** 2, (CONTACT * p.size) ** 2
    value, leap = s.row[WAVE_COUNT], anew + noise
    leaps = math.log(CHANGES * p.time) - 0.5 * (value**2 / leap + math.log(leap))
    slow = fast = 0.0
    for i in range(2):
        own = s.level_variance[i] + noise
        likely = -0.5 * ((value - s.level[i]) ** 2 / own + math.log(own))
        if leaps > likely:
            s.level[i], s.level_variance[i] = 0.0, anew
            own, likely = leap, leaps
        part = s.level_variance[i] / own
        s.level[i] += part * (value - s.level[i])
        s.level_variance[i] *= 1.0 - part
        slow, fast = fast, likely
    together, s.fast = weighed(s.fast, slow, fast)
    return together


@compiled_allocating
def _by_ripple(s: Record, p: Record, h: int, touching: float) -> float:
    """Return the part of the logarithm of a row's likelihood under a hypothesis, and take it in
    there."""
    gain = np.empty(WAVE_COUNT + 1)
    value, s.row[WAVE_COUNT] = s.row[WAVE_COUNT], 1.0
    error, variance, seen = value, (NOISE * p.size) ** 2, 1.0
    for i in range(WAVE_COUNT + 1):
        error -= s.row[i] * s.mean[h, i]
        seen += s.row[i] * s.shift[h, i]
        gain[i] = 0.0
        for j in range(WAVE_COUNT + 1):
            gain[i] += s.covariance[h, i, j] * s.row[j]
        variance += s.row[i] * gain[i]
    before = s.touched[h]
    likely, s.touched[h] = weighed(before, normal(error, variance), touching)
    part = (1.0 - s.touched[h]) / variance
    s.row[WAVE_COUNT] = value
    lasts = lasts_too(s.lasting[h], error, seen, variance, 1.0 - s.touched[h])
    other, _ = weighed(before, lasts, touching)
    together, s.lasts[h] = counted(s.lasts[h], ROW_EVIDENCE * likely, ROW_EVIDENCE * other)
    if s.touched[h] > 1.0 - MIN_UNTOUCHED_PROBABILITY:
        return together
    for i in range(WAVE_COUNT + 1):
        s.mean[h, i] += part * gain[i] * error
        s.shift[h, i] -= part * gain[i] * seen
        for j in range(WAVE_COUNT + 1):
            s.covariance[h, i, j] -= part * gain[i] * gain[j]
    return together


@compiled_allocating
def _take_back(s: Record, p: Record, h: int) -> None:
    """Go back to what was known before a contact that is recognised, or keep what is known now."""
    s.since[h] += 1.0
    if s.touched[h] > RECOGNISED:
        s.means[h, 1] = s.mean[h] = s.means[h, 0]
        s.shifts[h, 1] = s.shift[h] = s.shifts[h, 0]
        s.lastings[h, 1] = s.lasting[h] = s.lastings[h, 0]
        s.shift[h, WAVE_COUNT] = 0.0
        s.covariances[h, 1] = s.covariance[h] = s.covariances[h, 0]
        s.mean[h, WAVE_COUNT] = 0.0
        s.covariance[h, WAVE_COUNT, :] = s.covariance[h, :, WAVE_COUNT] = 0.0
        s.covariance[h, WAVE_COUNT, WAVE_COUNT] = p.size**2
    elif s.since[h] >= p.late:
        s.means[h, 0], s.shifts[h, 0] = s.means[h, 1], s.shifts[h, 1]
        s.lastings[h, 0], s.covariances[h, 0] = s.lastings[h, 1], s.covariances[h, 1]
        s.means[h, 1], s.shifts[h, 1] = s.mean[h], s.shift[h]
        s.lastings[h, 1], s.covariances[h, 1] = s.lasting[h], s.covariance[h]
    else:
        return
    s.since[h] = 0.0


@compiled_allocating
def _begin_anew(s: Record) -> None:
    """Forget another power-up's ripple: what was taken for it is too large."""
    s.other, s.proven = min(s.other, 0.0), min(s.proven, 0.0)
    for i in range(WAVE_COUNT):
        s.mean[1, i], s.shift[1, i] = s.expected[1, i], 0.0
        for j in range(WAVE_COUNT + 1):
            s.covariance[1, i, j] = s.covariance[1, j, i] = 0.0
        s.covariance[1, i, i] = s.drawn[1, i]
    for k in range(2):
        s.means[1, k], s.shifts[1, k], s.lastings[1, k] = s.mean[1], s.shift[1], s.lasting[1]
        s.covariances[1, k] = s.covariance[1]
