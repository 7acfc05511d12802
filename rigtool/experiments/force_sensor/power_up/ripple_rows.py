"""Rows of the torque on the output, each read under two hypotheses of the amplifier's ripple.

A row is the mean of some steps. Under each of two hypotheses of `power_up` its value y is

    y = sum of beta_j w_j + M + load + e   where nothing touches, else a random walk that may leap,

with and without a load that hangs (`lasting_contact`), which makes four filters. A row counts by
the probability that nothing touches (probabilistic data association: Y. Bar-Shalom, E. Tse,
Automatica 11(5) 451-460, 1975).
"""

from __future__ import annotations

import math

import numpy as np

from rigtool.experiments.force_filter.plant import Record
from rigtool.experiments.force_sensor.power_up.lasting_contact import (
    DRIFT,
    counted,
    lasts_too,
    normal,
    weighed,
)
from rigtool.experiments.force_sensor.power_up.mixed_ripple import (
    FILTERS,
    MAX_LOG_RATIO,
    PARTS,
    ROW_EVIDENCE,
    TURNS,
    WAVE_COUNT,
    mix,
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

MEMORY, FORGOTTEN = 2.0, 1000.0
"""Of M where nothing touches, s: about that of a stroke. And the time of sliding in which the doubt
of the ripple grows by what it was at first: strokes pay back what others deviate by, a weak contact
may be taken for ripple, and rows are not as independent as the equations have it."""

SPREAD_STEPS = 8
"""Steps for which a variance of the ripple holds: waves hardly change, firmware has little time."""

LARGEST_RIPPLE_RATIO = 3.0
"""Largest ratio of an order's amplitude at another power-up to the learned one."""


def row_steps(step_time: float) -> int:
    """Return the mean number of steps of a row."""
    return max(1, round(ROW_TIME / step_time))


def least_row_time(step_time: float) -> float:
    """Return the time of the shortest row, s."""
    return row_steps(step_time) // 2 * step_time


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
    leaps = math.log(CHANGES * p.time) + normal(value, leap)
    slow = fast = 0.0
    for i in range(2):
        own = s.level_variance[i] + noise
        likely = normal(value - s.level[i], own)
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
