"""Rows of the torque on the output, each read under two hypotheses of the amplifier's ripple.

A row is the mean of some steps. Under either hypothesis of `power_up` its value y is

    y = sum of beta_j w_j + M + e   where nothing touches, else a random walk that may leap,

and counts by the probability that nothing touches (probabilistic data association: Y. Bar-Shalom,
E. Tse, Automatica 11(5) 451-460, 1975). The state is one record, which compiled functions change.
"""

from __future__ import annotations

import math

import numpy as np

from rigtool.experiments.force_filter import passed
from rigtool.experiments.force_filter.plant import Record
from rigtool.experiments.force_model.model import GAIN_ORDERS, RIPPLE_ORDERS
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
"""Rates at which contacts begin, end, and leap or change their walk, 1/s."""

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

LARGEST_RIPPLE_RATIO = 3.0
"""Largest ratio of an order's amplitude at another power-up to the learned one."""

PARAMETERS = np.dtype(
    [(name, "f8") for name in ("lag", "factor", "steps", "time", "size", "late")]
    + [(name, "f8") for name in ("step_time", "inertia", "friction", "length", "slow", "shown")]
    + [(name, "f8") for name in ("load_friction", "onset", "held")]
)

WAVE_COUNT = 2 * len(RIPPLE_ORDERS)

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
        ("mean", "f8", (WAVE_COUNT + 1,)),
        ("covariance", "f8", (WAVE_COUNT + 1, WAVE_COUNT + 1)),
        ("touched", "f8"),  # the probability that something touches
        # mean and covariance as they were, the earlier one first, and rows since the later one
        ("means", "f8", (2, WAVE_COUNT + 1)),
        ("covariances", "f8", (2, WAVE_COUNT + 1, WAVE_COUNT + 1)),
        ("since", "f8"),
        # a contact that lasts: what 1 N m of it changes the means by, its mean and variance, and
        # its probability; as they were, as means; without other ripple the same
        ("shift", "f8", (WAVE_COUNT + 1,)),
        ("shifts", "f8", (2, WAVE_COUNT + 1)),
        ("lasting", "f8", (2,)),
        ("lastings", "f8", (2, 2)),
        ("lasts", "f8"),
        ("plain_shift", "f8"),
        ("plain_lasting", "f8", (2,)),
        ("plain_lasts", "f8"),
        # without other ripple; logarithm of the likelihoods' ratio
        ("plain", "f8"),
        ("plain_variance", "f8"),
        ("plain_touched", "f8"),
        ("other", "f8"),
        # where something touches: M by a slow and a fast walk, and the probability of the fast one
        ("level", "f8", (2,)),
        ("level_variance", "f8", (2,)),
        ("fast", "f8"),
        ("learned", "f8", (WAVE_COUNT,)),
        ("growing", "f8", (len(GAIN_ORDERS), 3)),  # by powers of the current
        # variance of what a power-up draws; the wave whose doubt grows next
        ("drawn", "f8", (WAVE_COUNT,)),
        ("doubted", "f8"),
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


@compiled
def read_row(s: Record, p: Record) -> None:
    """Take in a row, and begin the next one."""
    slides = s.slid >= s.length
    _pass_time(s, p, slides)
    if slides:
        touching = _touching(s, p)
        s.other += _by_ripple(s, p, touching) - _plain(s, p, touching)
        s.other = min(max(s.other, -MAX_LOG_RATIO), MAX_LOG_RATIO)
        for i in range(0, WAVE_COUNT, 2):
            first, second = s.mean[i] + s.learned[i], s.mean[i + 1] + s.learned[i + 1]
            square = s.drawn[i] + s.drawn[i + 1]
            if first * first + second * second > LARGEST_RIPPLE_RATIO**2 * square:
                _begin_anew(s)
                break
        _take_back(s, p)
    for i in range(WAVE_COUNT + 1):
        s.row[i] = 0.0
    s.filled = s.slid = 0.0
    s.drawn_length = (DRAW[0] * s.drawn_length + DRAW[1]) % DRAW[2]
    s.length = p.steps // 2 + p.steps * s.drawn_length // DRAW[2]


@compiled
def _plain(s: Record, p: Record, touching: float) -> float:
    """Return the part of the logarithm of a row's likelihood under the learned ripple, and take it
    in there."""
    error, variance = s.row[WAVE_COUNT] - s.plain, s.plain_variance + (NOISE * p.size) ** 2
    before = s.plain_touched
    likely, s.plain_touched = weighed(before, normal(error, variance), touching)
    untouched = 1.0 - s.plain_touched
    lasting, seen = s.plain_lasting, 1.0 + s.plain_shift
    other, _ = weighed(before, lasts_too(lasting, error, seen, variance, untouched), touching)
    part = untouched * s.plain_variance / variance
    s.plain += part * error
    s.plain_shift -= part * seen
    s.plain_variance *= 1.0 - part
    together, s.plain_lasts = counted(s.plain_lasts, ROW_EVIDENCE * likely, ROW_EVIDENCE * other)
    return together


@compiled
def _pass_time(s: Record, p: Record, slides: bool) -> None:
    """Go on to the end of a row."""
    begins, ends = BEGINS * p.time, ENDS * p.time
    s.touched += begins - (begins + ends) * s.touched
    s.plain_touched += begins - (begins + ends) * s.plain_touched
    s.fast += CHANGES * p.time * (0.5 - s.fast)
    for i in range(2):
        s.level_variance[i] += (WALKS[i] * p.size) ** 2 * p.time
        if not slides:  # part of the row is no sliding: friction may be off by a stroke's own
            s.level_variance[i] += (AFTER_REVERSAL * p.size) ** 2 * p.time / ROW_TIME
    for lasting in (s.lasting, s.plain_lasting):
        lasting[1] += (DRIFT * p.size) ** 2 * p.time
    kept = math.exp(-p.time / MEMORY) if slides else 0.0
    s.shift[WAVE_COUNT] *= kept
    s.plain_shift *= kept
    s.mean[WAVE_COUNT] *= kept
    s.plain *= kept
    for i in range(WAVE_COUNT):
        s.covariance[i, WAVE_COUNT] *= kept
        s.covariance[WAVE_COUNT, i] *= kept
    fresh = (1.0 - kept * kept) * p.size**2
    s.covariance[WAVE_COUNT, WAVE_COUNT] = (
        kept * kept * s.covariance[WAVE_COUNT, WAVE_COUNT] + fresh
    )
    s.plain_variance = kept * kept * s.plain_variance + fresh
    if slides:
        one = int(s.doubted)  # in turn
        s.covariance[one, one] += s.drawn[one] * WAVE_COUNT * p.time / FORGOTTEN
        s.doubted = (one + 1) % WAVE_COUNT


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
def _by_ripple(s: Record, p: Record, touching: float) -> float:
    """Return the part of the logarithm of a row's likelihood under other ripple, and take it in
    there."""
    gain = np.empty(WAVE_COUNT + 1)
    value, s.row[WAVE_COUNT] = s.row[WAVE_COUNT], 1.0
    error, variance, seen = value, (NOISE * p.size) ** 2, 1.0
    for i in range(WAVE_COUNT + 1):
        error -= s.row[i] * s.mean[i]
        seen += s.row[i] * s.shift[i]
        gain[i] = 0.0
        for j in range(WAVE_COUNT + 1):
            gain[i] += s.covariance[i, j] * s.row[j]
        variance += s.row[i] * gain[i]
    before = s.touched
    likely, s.touched = weighed(before, normal(error, variance), touching)
    part = (1.0 - s.touched) / variance
    s.row[WAVE_COUNT] = value
    lasts = lasts_too(s.lasting, error, seen, variance, 1.0 - s.touched)
    other, _ = weighed(before, lasts, touching)
    together, s.lasts = counted(s.lasts, ROW_EVIDENCE * likely, ROW_EVIDENCE * other)
    if s.touched > 1.0 - MIN_UNTOUCHED_PROBABILITY:
        return together
    for i in range(WAVE_COUNT + 1):
        s.mean[i] += part * gain[i] * error
        s.shift[i] -= part * gain[i] * seen
        for j in range(WAVE_COUNT + 1):
            s.covariance[i, j] -= part * gain[i] * gain[j]
    return together


@compiled_allocating
def _take_back(s: Record, p: Record) -> None:
    """Go back to what was known before a contact that is recognised, or keep what is known now."""
    s.since += 1.0
    if s.touched > RECOGNISED:
        s.means[1] = s.mean[:] = s.means[0]
        s.shifts[1] = s.shift[:] = s.shifts[0]
        s.lastings[1] = s.lasting[:] = s.lastings[0]
        s.shift[WAVE_COUNT] = 0.0
        s.covariances[1] = s.covariance[:] = s.covariances[0]
        s.mean[WAVE_COUNT] = 0.0
        s.covariance[WAVE_COUNT, :] = s.covariance[:, WAVE_COUNT] = 0.0
        s.covariance[WAVE_COUNT, WAVE_COUNT] = p.size**2
    elif s.since >= p.late:
        s.means[0], s.shifts[0], s.lastings[0] = s.means[1], s.shifts[1], s.lastings[1]
        s.covariances[0] = s.covariances[1]
        s.means[1], s.shifts[1], s.lastings[1] = s.mean, s.shift, s.lasting
        s.covariances[1] = s.covariance
    else:
        return
    s.since = 0.0


@compiled_allocating
def _begin_anew(s: Record) -> None:
    """Forget another power-up's ripple: what was taken for it is too large."""
    s.other = min(s.other, 0.0)
    for i in range(WAVE_COUNT):
        s.mean[i], s.shift[i] = -s.learned[i], 0.0
        for j in range(WAVE_COUNT + 1):
            s.covariance[i, j] = s.covariance[j, i] = 0.0
        s.covariance[i, i] = s.drawn[i]
    s.means[:], s.shifts[:], s.lastings[:] = s.mean, s.shift, s.lasting
    s.covariances[:] = s.covariance
