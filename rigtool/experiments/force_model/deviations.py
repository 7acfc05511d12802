"""Random deviations of friction, from the differences of cycles of one motion.

The deviation of a cycle's torque from the mean cycle is, along a stroke,

    e = d (b1 sin a + b2 cos a + b3 s / n) + f,   b1, b2 ~ N(0, S^2),  b3 ~ N(0, L^2)

with f a first-order process of variance F^2 and memory T, and white noise of variance
W^2 + (V m / m_max)^2 under a load of moment m: steps of a coarse encoder shake the torque, and a
load swings on its tendon. Neither is friction, and neither lasts from one compared row to the next.
S, L, F, T, W and V are those under which the cycles of all recordings are most likely. Subtracting
the mean of n cycles lowers the variance: of strokes, of whose variance the mean keeps the part k
(`kept_by_mean`), 1 - k/n is left, and of f, which does not pay back, 1 - 1/n.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from rigtool.experiments.force_model.records import ROWS_HZ, Record
from rigtool.numerics.arrays import Array
from rigtool.numerics.steady_mean import MIN_READINGS, steady_us

ROWS_APART = 5
"""Rows between those that are compared: f hardly changes between them."""

MIN_STROKE_ROWS = 20
"""Fewest compared rows with which a stroke shows slow deviations."""

UNSEEN_PART = 0.03
"""Part of the friction by which strokes are assumed to deviate where none is long enough to show
it: tendons of the thesis's instrument deviated by 2.6 % (E. Briaire 2006, Table 9)."""

UNSEEN_FRICTION = 3e-3
"""Friction that is assumed without any strokes without load, N m."""

MAX_SCATTER_RATIO = 3.0
"""Scatter of a motion's cycles, over that of most motions, above which they do not repeat."""

SMALLEST_SCATTER = 1e-12
"""Scatter of cycles that do not differ at all, N m."""

WHITE_PART, LOAD_START, TIME_START = 0.05, 0.01, 0.1
"""W and V, in parts of the largest deviation of strokes, L, and T, s, at the beginning of the
search, where S and F are that deviation. W is at least that."""

SEARCH_RANGE, START_WEIGHT = 12.0, 0.01
"""Range of the logarithms in the search, either way, and the weight of their squares."""


@dataclass(frozen=True)
class Deviations:
    """Standard deviations: of a `stroke` N m, of its friction per `load` carried, of `noise` N m
    with its memory `noise_time` s."""

    stroke: float
    load: float
    noise: float
    noise_time: float


@dataclass(frozen=True, eq=False)
class _Stroke:
    """Deviations of strokes at their rows, `own` (strokes, m); there (m, m) the products of the
    shapes that each stroke draws, `alike` and in proportion to the load, `loaded`, and the time
    between rows, `apart` s; under a load of `moment` N m. The mean that was subtracted is that of
    `count` cycles."""

    own: Array
    alike: Array
    loaded: Array
    apart: Array
    count: int
    moment: float


def deviations(
    records: Sequence[Record], angle_ratio: float, torque_factor: float
) -> Deviations | None:
    """Return the deviations that repeated motions show; records that do not repeat are ignored.

    None where no stroke is long enough, or is made three times.
    """
    from scipy.linalg.lapack import dtrtrs
    from scipy.optimize import minimize

    strokes = [s for r in records if r.cycles > 2 for s in _strokes(r, angle_ratio, torque_factor)]
    if not strokes:
        return None
    size = max(float(np.sqrt(np.mean(s.own**2))) for s in strokes)
    largest = max(s.moment for s in strokes) or 1.0
    least, kept = WHITE_PART * size, kept_by_mean(records, angle_ratio)
    start = np.log([size, LOAD_START, size, TIME_START, least, least])

    def cost(x: Array) -> float:
        stroke, load, noise, memory, white, swing = np.exp(
            2 * np.clip(x - start, -SEARCH_RANGE, SEARCH_RANGE) + 2 * start
        )
        memory, white = np.sqrt(memory), white + least**2
        total = START_WEIGHT * float(np.sum((x - start) ** 2))
        for s in strokes:
            whole = (1 - kept / s.count) * (stroke * s.alike + load * s.loaded)
            whole += (1 - 1 / s.count) * noise * np.exp(-s.apart / memory)
            whole.flat[:: len(whole) + 1] += white + swing * (s.moment / largest) ** 2
            factor = np.linalg.cholesky(whole)
            total += len(s.own) * 2 * float(np.sum(np.log(factor.diagonal())))
            rest, _ = dtrtrs(factor.T, s.own.T, trans=1)
            total += float(np.sum(rest**2))
        return total

    found = minimize(cost, start, method="Nelder-Mead", options={"maxiter": 800, "fatol": 0.5})
    return Deviations(*np.exp(found.x[:4]).tolist())


def unseen_deviations(records: Sequence[Record]) -> Deviations:
    """Return the deviations that are assumed where strokes show none: a part of the friction."""
    rows = [r.torques[:, r.used].ravel() for r in records if r.cycles and not r.moment]
    seen = np.concatenate(rows) if rows else np.empty(0)
    friction = math.sqrt(np.mean(seen**2)) if seen.size else UNSEEN_FRICTION
    return Deviations(UNSEEN_PART * friction, 0.01, 0.01 * friction, 0.1)


def _strokes(record: Record, angle_ratio: float, torque_factor: float) -> list[_Stroke]:
    """Return the two strokes of a cycle."""
    used, found = record.used, []
    angle = record.rows(record.angle) / angle_ratio
    speed = record.rows(record.speed)
    left = record.torques - record.torques.mean(axis=0)
    place = np.arange(record.count) / ROWS_HZ
    for sign in (1.0, -1.0):
        rows = np.flatnonzero(used & (speed * sign > 0))
        cut = np.flatnonzero(np.diff(rows) > 1)
        own = left[:, rows]
        if len(cut) == 1:  # the period cuts this stroke in two: it ends in the next cycle
            late, early = rows[cut[0] + 1 :], rows[: cut[0] + 1]
            rows, own = np.append(late, early), np.hstack([left[:-1, late], left[1:, early]])
        rows, own = rows[::ROWS_APART], own[:, ::ROWS_APART]
        if len(rows) < MIN_STROKE_ROWS:
            continue
        a = angle[rows]
        carried = np.abs(record.moment * np.sin(a)) / torque_factor
        time = np.unwrap(place[rows], period=record.count / ROWS_HZ)
        sides = np.stack([np.sin(a), np.cos(a)])
        apart = np.abs(time[:, None] - time)
        alike, loaded = sides.T @ sides, np.outer(carried, carried)
        found.append(_Stroke(own, alike, loaded, apart, record.cycles, record.moment))
    return found


def scatter_ratios(records: Sequence[Record]) -> list[float]:
    """Return the scatter of each record's cycles over that of most of those that have any.

    Above `MAX_SCATTER_RATIO` friction does not explain it: where the loop lets a load swing, no
    cycle is like another, and a model that is not linear does not hold for their mean.
    """
    scatters = [record.scatter for record in records]
    usual = max(float(np.median([s for s in scatters if s] or [0.0])), SMALLEST_SCATTER)
    return [scatter / usual for scatter in scatters]


def scatter_hz(record: Record) -> float:
    """Return the frequency, Hz, at which the cycles of a record differ most from their mean."""
    left = (record.torques - record.torques.mean(axis=0)).ravel()
    power = np.abs(np.fft.rfft(left)) ** 2
    return float(np.argmax(power) * ROWS_HZ / left.size)


def kept_by_mean(records: Sequence[Record], angle_ratio: float) -> float:
    """Return the variance of a mean over strokes, over that of a mean of independent strokes.

    Strokes pay back a part of the deviation of their predecessors. The sine along each direction of
    all repeated motions shows how much (`numerics.steady_mean`). 1 where nothing repeats.
    """
    series = []
    for record in records:
        if record.cycles < MIN_READINGS:
            continue
        speed, sine = record.rows(record.speed), np.sin(record.rows(record.angle) / angle_ratio)
        for sign in (1.0, -1.0):
            rows = record.used & (speed * sign > 0)
            if rows.sum() >= MIN_STROKE_ROWS:
                series.append(record.torques[:, rows] @ sine[rows] / np.sum(sine[rows] ** 2))
    shares = [
        u**2 * len(own) / own.var(ddof=1)
        for own, (u, _) in zip(series, steady_us(series), strict=True)
    ]
    return min(1.0, float(np.median(shares))) if shares else 1.0
