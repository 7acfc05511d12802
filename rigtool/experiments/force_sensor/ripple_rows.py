"""Rows of the torque on the output, each read under two hypotheses of the amplifier's ripple.

A row is the mean of some steps. Under each of two hypotheses of `power_up` its value y is

    y = sum of beta_j w_j + M + load + e   where nothing touches, else a random walk that may leap,

with and without a load that hangs (`lasting_contact`), which makes four filters. A row counts by
the probability that nothing touches (probabilistic data association: Y. Bar-Shalom, E. Tse,
Automatica 11(5) 451-460, 1975). The state is one record, which compiled functions change.
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
    HANGING,
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

SPREAD_STEPS = 8
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
    + [("hanging", "f8", (len(HANGING),))]
)
"""`orders` and `unfollowed` are those of `drawn_ripple`, `square` is the sum of A^2, `hanging` the
variances of a load that hangs."""

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
            alone, hung = _by_ripple(s, p, h, touching), _by_ripple(s, p, h + 2, touching)
            likely, s.hangs[h] = counted(s.hangs[h], alone, hung)
            s.other += likely if h else -likely
        s.other = min(max(s.other, -MAX_LOG_RATIO), MAX_LOG_RATIO)
        for f in range(1, FILTERS, 2):
            if _is_none(s, f):
                _begin_anew(s, p, f)
        near = s.touched[0] + s.hangs[0] * (s.touched[2] - s.touched[0])
        other = s.touched[1] + s.hangs[1] * (s.touched[3] - s.touched[1])
        if min(near, other) > RECOGNISED:
            s.other = s.proven
        else:
            most = ENDS * p.time
            s.proven += min(max(s.other - s.proven, -most), most)
        for f in range(FILTERS):
            _take_back(s, p, f)
    mix(s)
    for i in range(PARTS):
        s.row[i] = 0.0
    s.filled = s.slid = 0.0
    s.drawn_length = (DRAW[0] * s.drawn_length + DRAW[1]) % DRAW[2]
    s.length = p.steps // 2 + p.steps * s.drawn_length // DRAW[2]


@compiled
def _is_none(s: Record, f: int) -> bool:
    """Return whether what a filter takes for another power-up's ripple is too large for one."""
    for i in range(0, WAVE_COUNT, 2):
        first, second = s.mean[f, i] - s.expected[1, i], s.mean[f, i + 1] - s.expected[1, i + 1]
        square = s.drawn[1, i] + s.drawn[1, i + 1]
        if first * first + second * second > LARGEST_RIPPLE_RATIO**2 * square:
            return True
    return False


@compiled_allocating
def renew_unfollowed(s: Record, p: Record, speed: float) -> None:
    """Renew the sums over the orders that are not followed, for a speed of the rotor, rad/s."""
    s.unfollowed[:] = 0.0
    for i in range(p.unfollowed.shape[0]):
        behind = 1.0 / (1.0 + ((i + 1) * speed * p.lag_time) ** 2)
        for j in range(4):
            s.unfollowed[j] += behind * p.unfollowed[i, j]


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
        drawn = s.drawn[0, i]
        if drawn <= 0.0:  # no such order
            continue
        left[i] = _expected(s, f, i)
        for j in range(i + 1):
            if s.drawn[0, j] <= 0.0:
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
    fresh = (1.0 - kept * kept) * p.size**2
    for f in range(FILTERS):
        s.touched[f] += begins - (begins + ends) * s.touched[f]
        s.mean[f, WAVE_COUNT] *= kept
        for i in range(PARTS):
            s.covariance[f, i, WAVE_COUNT] *= kept
            s.covariance[f, WAVE_COUNT, i] *= kept
        s.covariance[f, WAVE_COUNT, WAVE_COUNT] += fresh
    for h in range(2):
        if slides:  # at rest nothing makes ripple and what lasts less known
            s.lasting[h, 1] += (DRIFT * p.size) ** 2 * p.time
        s.shift[h, WAVE_COUNT] *= kept
    if slides:  # one wave of one filter, in turn
        turn = int(s.doubted)
        f, i = turn % FILTERS, turn // FILTERS
        s.covariance[f, i, i] += s.drawn[f % 2, i] * TURNS * p.time / FORGOTTEN
        s.doubted = (turn + 1) % TURNS


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
def _by_ripple(s: Record, p: Record, f: int, touching: float) -> float:
    """Return the part of the logarithm of a row's likelihood by a filter, and take it in there."""
    gain = np.empty(PARTS)
    value, s.row[WAVE_COUNT] = s.row[WAVE_COUNT], 1.0
    error, variance = value, (NOISE * p.size) ** 2
    for i in range(PARTS):
        error -= s.row[i] * s.mean[f, i]
        gain[i] = 0.0
        for j in range(PARTS):
            gain[i] += s.covariance[f, i, j] * s.row[j]
        variance += s.row[i] * gain[i]
    before = s.touched[f]
    likely, s.touched[f] = weighed(before, normal(error, variance), touching)
    likely *= ROW_EVIDENCE
    untouched = 1.0 - s.touched[f]
    part, counts = untouched / variance, untouched >= MIN_UNTOUCHED_PROBABILITY
    if f < 2:
        seen = 0.0
        for i in range(PARTS):
            seen += s.row[i] * s.shift[f, i]
        seen += 1.0
        lasts = lasts_too(s.lasting[f], error, seen, variance, untouched)
        other, _ = weighed(before, lasts, touching)
        likely, s.lasts[f] = counted(s.lasts[f], likely, ROW_EVIDENCE * other)
        for i in range(PARTS if counts else 0):
            s.shift[f, i] -= part * gain[i] * seen
    s.row[WAVE_COUNT] = value
    for i in range(PARTS if counts else 0):
        s.mean[f, i] += part * gain[i] * error
        for j in range(PARTS):
            s.covariance[f, i, j] -= part * gain[i] * gain[j]
    return likely


@compiled_allocating
def _take_back(s: Record, p: Record, f: int) -> None:
    """Go back to what was known before a contact that is recognised, or keep what is known now."""
    s.since[f] += 1.0
    if s.touched[f] > RECOGNISED:
        s.means[f, 1] = s.mean[f] = s.means[f, 0]
        s.covariances[f, 1] = s.covariance[f] = s.covariances[f, 0]
        s.mean[f, WAVE_COUNT] = 0.0
        s.covariance[f, WAVE_COUNT, :] = s.covariance[f, :, WAVE_COUNT] = 0.0
        s.covariance[f, WAVE_COUNT, WAVE_COUNT] = p.size**2
        if f < 2:
            s.shifts[f, 1] = s.shift[f] = s.shifts[f, 0]
            s.lastings[f, 1] = s.lasting[f] = s.lastings[f, 0]
            s.shift[f, WAVE_COUNT] = 0.0
    elif s.since[f] >= p.late:
        s.means[f, 0], s.means[f, 1] = s.means[f, 1], s.mean[f]
        s.covariances[f, 0], s.covariances[f, 1] = s.covariances[f, 1], s.covariance[f]
        if f < 2:
            s.shifts[f, 0], s.shifts[f, 1] = s.shifts[f, 1], s.shift[f]
            s.lastings[f, 0], s.lastings[f, 1] = s.lastings[f, 1], s.lasting[f]
    else:
        return
    s.since[f] = 0.0


@compiled_allocating
def _begin_anew(s: Record, p: Record, f: int) -> None:
    """Forget another power-up's ripple: what was taken for it is too large."""
    if (s.hangs[1] > 0.5) == (f > 1):
        s.other, s.proven = min(s.other, 0.0), min(s.proven, 0.0)
    for i in range(PARTS):
        if i == WAVE_COUNT:
            continue
        s.mean[f, i] = s.expected[1, i] if i < WAVE_COUNT else 0.0
        for j in range(PARTS):
            s.covariance[f, i, j] = s.covariance[f, j, i] = 0.0
        if i < WAVE_COUNT:
            s.covariance[f, i, i] = s.drawn[1, i]
        elif f > 1:
            s.covariance[f, i, i] = p.hanging[i - WAVE_COUNT - 1]
    for k in range(2):
        s.means[f, k], s.covariances[f, k] = s.mean[f], s.covariance[f]
    if f < 2:
        for i in range(WAVE_COUNT):
            s.shift[f, i] = 0.0
        for k in range(2):
            s.shifts[f, k], s.lastings[f, k] = s.shift[f], s.lasting[f]
