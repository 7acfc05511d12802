"""Path of an arm that swings after each step of a staircase, and friction along that path.

Friction follows dz = +-|1 -+ z|^i |dx| / s along every swing of the arm, to and fro (P. R. Dahl,
1968), so that z depends on how far the arm overshoots. The gauge shows the swings with damping:

    torque = x + lag dx/dt                                                              (1)

where x is the elastic torque of the arm.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from rigtool.numerics.arrays import TINY, Array
from rigtool.numerics.compiled import compiled

MAX_TURNS = 12
"""Largest number of turns of the arm that count after one step."""

LARGEST_DAMPING = 0.6
"""Damping ratio of an arm each of whose swings is a tenth of the one before."""

FEWEST_FOR_RATE = 6
"""Fewest staircases of a kind that show how swings change with the size of the torque."""

LONGEST_RIPPLE_LAG, LAGS = 48.0, 24
"""Longest lag with which ripple may follow a step, in values of a course, and lags that are tried
beside none."""

NOISE_RANGE = 6.0
"""Turns count beyond this many standard deviations of the noise, whose own range is about 5."""

LEAST_REST, FULL_SLIDE = TINY, -1.0 + 2.0**-53
"""In place of r = 0 and of the logarithm's argument where contacts slide."""


@dataclass(frozen=True)
class Courses:
    """Mean courses of torque over g kinds of staircases, those with the same set points.

    `torque` (g, p) in N m is that of the settled plateaus, `course` (g, p, c) over the whole of
    each, `part` (g, p) the time between two values of the course, s; `noise` (g,) in N m the
    standard deviation of one, and `dropped` (g, p, c) what was taken off the mean courses as
    noise. Each of m staircases is of a `kind` (m,) and differs from its mean by
    `score` (m, r) of r changes: by `torque_rate` (g, r, p) in N m of the settled torques, and in
    all by the swings `swing_change` (m, p, c), N m; by `at_once` (m, p, c) if ripple had no lag.
    """

    setpoint: Array
    torque: Array
    course: Array
    part: Array
    noise: Array
    dropped: Array
    kind: NDArray[np.int64]
    score: Array
    torque_rate: Array
    swing_change: Array
    at_once: Array

    def of_each(self) -> tuple[Array, Array, Array]:
        """Return torque (m, p) and course (m, p, c) of each staircase without its own noise, and
        the course if ripple had no lag."""
        change = np.einsum("mr,mrp->mp", self.score, self.torque_rate[self.kind])
        course = self.course[self.kind] + change[:, :, None]
        torque = self.torque[self.kind] + change
        return torque, course + self.swing_change, course + self.at_once

    def ripple_steps(self) -> Array:
        """Return what ripple adds to each step of the torque (m, p), N m; 0 on average."""
        torque = np.einsum("mr,mrp->mp", self.score[:, 1:], self.torque_rate[self.kind, 1:])
        return np.diff(torque, prepend=torque[:, :1])

    def less(self, torque: Array, rate: Array) -> Courses:
        """Return the courses without parts (g, p) of their torques and (g, r, p) of the rates."""
        return replace(
            self,
            torque=self.torque - torque,
            course=self.course - torque[:, :, None],
            torque_rate=self.torque_rate - rate,
        )


def mean_courses(
    setpoint: Array,
    torque: Array,
    course: Array,
    duration: Array,
    temperature: Array,
    noise: float,
) -> Courses:
    """Average set points (m, p), torques, courses (m, p, c) and durations over equal staircases.

    `temperature` (m,) is that of each, degC; `noise` in N m the standard deviation of one value of
    a course.
    """
    step = 2e-3 * max(float(np.ptp(setpoint)), 1e-12)
    kind = np.unique(np.round(setpoint / step), axis=0, return_inverse=True)[1].reshape(-1)
    kinds = [kind == number for number in range(int(kind.max()) + 1)]

    def mean(values: Array) -> Array:
        return np.stack([values[those].mean(axis=0) for those in kinds])

    swing = course - torque[:, :, None]
    smooth, left, rates = [], [], []
    score, (swing_change, at_once) = np.empty((len(torque), 3)), np.empty((2, *course.shape))
    for those in kinds:
        average, left_here = without_noise(
            swing[those].mean(axis=0), noise / math.sqrt(those.sum())
        )
        smooth.append(average)
        left.append(left_here)
        score[those], rate, grown, begins = _torque_changes(
            setpoint[those][0], torque[those], temperature[those]
        )
        rates.append(rate)
        part = duration[those].mean(axis=0) / course.shape[2]
        swing_change[those], at_once[those] = _swing_changes(
            grown, begins, swing[those], average, torque[those].mean(axis=0), part, noise
        )
    courses = mean(torque)
    return Courses(
        setpoint=mean(setpoint),
        torque=courses,
        course=courses[:, :, None] + np.stack(smooth),
        part=mean(duration) / course.shape[2],
        noise=np.array(left),
        dropped=mean(swing) - np.stack(smooth),
        kind=kind.astype(np.int64),
        score=score,
        torque_rate=np.stack(rates),
        swing_change=swing_change,
        at_once=at_once,
    )


def _torque_changes(
    setpoint: Array, torque: Array, temperature: Array
) -> tuple[Array, Array, Array, Array]:
    """Return by how much (m, 3) equal staircases of torques (m, p) differ from their mean, what
    each of these changes does to the torque (3, p), and the relative changes (2, m, p) of what the
    current adds with each step: with the `temperature` (m,), and with the angle; and by how much
    the torque differs with which each begins (m,), N m.

    The changes are by temperature, and by ripple in proportion to the set point (p,) and to its
    i |i|; where enough staircases show it, also what friction makes of them.
    """
    columns = np.stack([np.ones(len(setpoint)), setpoint, setpoint * np.abs(setpoint)])
    inverse = np.linalg.pinv(columns)
    off = torque - torque.mean(axis=0)
    begins, found = np.split(off @ inverse, [1], axis=1)
    warm = temperature - temperature.mean()
    warm /= max(float(np.linalg.norm(warm)), TINY)
    ripple = found - np.outer(warm, warm @ found)
    score = np.column_stack([warm, ripple])
    rate = np.stack([warm @ found @ columns[1:], *columns[1:]])
    if len(torque) >= FEWEST_FOR_RATE:
        size = np.maximum(np.linalg.norm(score, axis=0), TINY)
        rest = np.linalg.lstsq(score / size, off - score @ rate)[0]
        rate = rate + rest / size[:, None]
    steps = np.diff(columns[1:], prepend=columns[1:, :1])
    mean_steps = (torque.mean(axis=0) @ inverse)[1:] @ steps
    still = mean_steps == 0  # the first plateau, and those that lengthen a shorter staircase
    grown = np.stack([found - ripple, ripple]) @ steps / np.where(still, np.inf, mean_steps)
    return score, rate, grown, begins[:, 0]


def _swing_changes(
    grown: Array,
    begins: Array,
    swing: Array,
    average: Array,
    torque: Array,
    part: Array,
    noise: float,
) -> tuple[Array, Array]:
    """Return by how much swings (m, p, c) differ from their `average` (p, c), without noise, and
    what that would be if ripple had no lag.

    Swings grow as their steps do, `grown` (2, m, p): with the constant at once, but an amplifier's
    ripple may follow a step of the current with a lag: its course is the mean course behind a
    low-pass of first order, from the `torque` (p,) before, with `part` (p,) s between two values.
    Lags are averaged over, each as probable as what it leaves. The torque with which a staircase
    `begins` (m,) is also that of its friction, which changes the first swings: what is in
    proportion to it shows no lag. What else stands out of the noise in proportion to the staircase
    is added.
    """
    with_constant, with_ripple = grown
    found: Array = with_constant[:, :, None] * average
    rippled = with_ripple[:, :, None] * average
    if len(swing) < FEWEST_FOR_RATE:
        return found + rippled, found + rippled
    begins = begins / max(float(np.linalg.norm(begins)), TINY)
    rest, own = (_off(begins, each) for each in (swing - average - found, with_ripple))
    matched = np.einsum("mp,mpc->pc", own, rest)
    power = np.sum(own**2, axis=0)[:, None]
    lags = np.append(0.0, np.geomspace(np.max(part), LONGEST_RIPPLE_LAG * np.max(part), LAGS))
    lagged = np.stack([_behind(average, torque, lag / part) for lag in lags])
    square = float(np.sum(rest**2)) + np.sum(power * lagged**2 - 2 * matched * lagged, axis=(1, 2))
    variance = max(float(square.min()) / rest.size, TINY)
    probable = np.exp(-(square - square.min()) / (2 * variance))
    course = np.tensordot(probable / probable.sum(), lagged, 1)
    delayed = with_ripple[:, :, None] * course
    # Friction changes with the constant, too: what that does to swings is no lag of ripple.
    left: list[Array] = []
    for size in (grown[0].mean(axis=1), begins, grown[1].mean(axis=1)):
        root = max(float(np.linalg.norm(size)), TINY)
        rest = swing - average - found - delayed - sum(left)
        own = without_noise(np.tensordot(size / root, rest, 1), noise)[0]
        left.append((size / root)[:, None, None] * own)
    common = found + sum(left)  # what friction does to swings does not wait for the lag
    return common + delayed, common + rippled


def _off(unit: Array, values: Array) -> Array:
    """Return values (m, ...) less what is in proportion to a vector (m,) of length 1."""
    return values - np.multiply.outer(unit, np.tensordot(unit, values, 1))


def _behind(swing: Array, torque: Array, lag: Array) -> Array:
    """Return swings (p, c) behind a low-pass whose lag (p,) is in values of the course; before each
    plateau is the torque of the one before (p,)."""
    keeps = np.exp(-1 / np.maximum(lag, 1e-6))
    state = np.concatenate([[0.0], torque[:-1] - torque[1:]])
    found = np.empty(swing.shape)
    for k, value in enumerate(swing.T):
        kept = keeps if k else np.sqrt(keeps)  # a value is the mean over its part of the time
        state = value + kept * (state - value)
        found[:, k] = state
    return found


def without_noise(values: Array, noise: float) -> tuple[Array, float]:
    """Return a matrix (p, c) without most of its noise, and the standard deviation of what is left.

    All steps swing in few ways, so few singular values stand out of those of noise; the others are
    dropped (M. Gavish, D. L. Donoho, IEEE Trans. Inf. Theory 60, 5040, 2014, equation 3).
    """
    rows, columns = values.shape
    ratio = min(rows, columns) / max(rows, columns)
    root = ratio + 1 + math.sqrt(ratio**2 + 14 * ratio + 1)
    limit = math.sqrt(2 * (ratio + 1) + 8 * ratio / root) * math.sqrt(max(rows, columns)) * noise
    # LAPACK's singular values do not converge on some rounded courses; eigenvalues do.
    square, right = np.linalg.eigh(values.T @ values)
    kept = square > limit**2
    part = kept.sum() * (rows + columns) / (rows * columns)
    return (values @ right[:, kept]) @ right[:, kept].T, noise * math.sqrt(min(float(part), 1.0))


def longest_lag(courses: Courses) -> float | None:
    """Return the longest lag of (1) that is plausible, s; None unless most steps show a swing.

    An arm of natural frequency w and damping ratio d has the lag 2 d/w; what swings at all has less
    than `LARGEST_DAMPING`. Friction that holds the arm back makes it swing faster: the slowest
    steps are the arm's own.
    """
    fastest = float(np.min(courses.part)) / 20
    each = _turns(courses, courses.torque, courses.course, [fastest])
    swings, when = (values[:, 0] for values in each)
    seen = swings[2] != 0
    if np.mean(seen[:, 1:]) <= 0.5:
        return None
    # Of an arm that turns only once on a plateau, the step itself began the half period.
    between = np.where(when[1] > 0, when[1] - when[0], when[0]) * courses.part
    half_period = float(np.quantile(between[seen], 0.9))
    return 2 * LARGEST_DAMPING * half_period / math.pi


def paths(courses: Courses, torque: Array, course: Array, lags: Sequence[float]) -> Array:
    """Return the path to each plateau, (l, TURNS + 2, n, p) N m: its swings, signed, in sequence.

    `torque` (n, p) and `course` (n, p, c) are those of all kinds, or of all staircases. `lags` (l,)
    are those of (1), s. The path to the first plateau is empty.
    """
    return np.moveaxis(_turns(courses, torque, course, lags)[0], 1, 0)


def _turns(
    courses: Courses, torque: Array, course: Array, lags: Sequence[float]
) -> tuple[Array, Array]:
    """Return the path, and in which part of the course (TURNS, l, n, p) each turn showed."""
    own = len(torque) != len(courses.torque)
    kind = courses.kind if own else np.arange(len(torque))
    follow = -np.expm1(-courses.part[kind] / np.reshape(lags, (-1, 1, 1)))
    threshold = NOISE_RANGE * courses.noise[kind, None] * np.sqrt(follow / (2 - follow))
    swings = np.zeros((MAX_TURNS + 2, *follow.shape))
    when = np.zeros((MAX_TURNS, *follow.shape))
    _turn(torque, course, follow, threshold, swings, when)
    return swings, when


@compiled
def _turn(
    torque: Array, course: Array, follow: Array, threshold: Array, swings: Array, when: Array
) -> None:
    """Write what `_turns` returns, where the elastic torque follows by a part `follow` (l, n, p) of
    the way in each value of a course, and turns count beyond a `threshold` (l, n, p), N m."""
    lags, kinds, plateaus = follow.shape
    for lag in range(lags):
        for n in range(kinds):
            for j in range(1, plateaus):
                elastic = extreme = turned = torque[n, j - 1]
                direction, count = np.sign(torque[n, j] - elastic), 0
                for moment in range(course.shape[2]):
                    elastic += follow[lag, n, j] * (course[n, j, moment] - elastic)
                    if (elastic - extreme) * direction > 0.0:
                        extreme = elastic
                    back = (extreme - elastic) * direction
                    if back > threshold[lag, n, j] and count < MAX_TURNS:
                        swings[count, lag, n, j] = extreme - turned
                        when[count, lag, n, j] = moment
                        turned, extreme, direction = extreme, elastic, -direction
                        count += 1
                swings[count, lag, n, j] = extreme - turned
                swings[count + 1, lag, n, j] = torque[n, j] - extreme


def straight_path(courses: Courses) -> Array:
    """Return the path of an arm that friction hardly holds back, (1, g, p) N m: k times a step."""
    slope = np.ptp(courses.torque) / np.ptp(courses.setpoint)
    first = courses.setpoint[:, :1]
    return slope * np.diff(courses.setpoint, prepend=first)[None]


def friction_state(
    swings: Array, transition: ArrayLike, exponent: ArrayLike
) -> tuple[Array, Array]:
    """Return a and b of the friction's state z = a + b z0, (..., p) each.

    `swings` (n, ..., p) and `transition` are in N m; transition and exponent have any shapes that
    go with (...). Where the exponent is not 1, b is the derivative at z0 = 0. A swing dx changes
    r = |1 -+ z| by

        log(r / r0) = log(1 - (1 - i) y) / (1 - i), or -y for i = 1,  y = |dx| / s r0^(i - 1)

    until contacts with i < 1 slide, r = 0.
    """
    shape = np.broadcast_shapes(swings.shape[1:-1], np.shape(transition), np.shape(exponent))
    along = np.moveaxis(swings, 0, -1)
    ways = np.array(np.broadcast_to(along, (*shape, *along.shape[-2:])), order="C")
    laws = np.empty((2, *shape))
    laws[0], laws[1] = transition, exponent
    state, kept = np.empty((2, *ways.shape[:-1]))
    flat = (laws[0].size, *along.shape[-2:])
    _follow(
        ways.reshape(flat),
        *laws.reshape(2, -1),
        *(each.reshape(flat[:2]) for each in (state, kept)),
    )
    return state, kept


@compiled
def _follow(swings: Array, transition: Array, exponent: Array, state: Array, kept: Array) -> None:
    """Write a as `state` and b as `kept` (k, p), for swings (k, p, n), transition and exponent (k,)
    as in `friction_state`."""
    for k in range(len(transition)):
        less = 1.0 - exponent[k]
        z = changes = 0.0
        state[k, 0], kept[k, 0] = z, 1.0
        for j in range(1, swings.shape[1]):
            for n in range(swings.shape[2]):
                swing = swings[k, j, n]
                if swing == 0.0:
                    continue
                side = math.copysign(1.0, swing)
                before = max(1.0 - side * z, LEAST_REST)
                change = -abs(swing) / transition[k] * before**-less
                if less != 0.0:
                    change = math.log1p(max(less * change, FULL_SLIDE)) / less
                z = side * (1.0 - before * math.exp(change))
                changes += change
            state[k, j], kept[k, j] = z, math.exp(exponent[k] * changes)
