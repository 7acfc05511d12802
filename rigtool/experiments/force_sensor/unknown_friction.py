"""Friction that the tables do not hold, found in the recording itself.

A force from outside has one sign at one angle in both directions of motion, or acts in some of the
passes only. Friction that the tables do not hold, that of another instrument, or by angle where
the encoder was zeroed elsewhere, opposes every pass in both directions; where they hold too much,
it drives every pass. With the torque m_d of the passes in direction d in which nothing touches, in
each cell of the angle

    h = sign(m_+) min(|m_+|, |m_-|)  where m_+ m_- < 0, else 0,    H = root of the mean h^2

m_d is the median of the passes within `NEAR` u of the one whose magnitude is their lower quartile.
Where these are `ALIKE` of the passes or less, something touches nearly always; where less than
`SHOWN` of the cells are left, it does so everywhere, as a force that swings all the time, and
nothing is compared.
Where H shows that the tables are of another instrument, all of m_d up to 2 H may be their error:

    w^2 = mean over cells and directions of min(|m_d|, 2 H)^2,    u^2 + w^2 instead of u^2

Ripple of another power-up may be found that is none, but this friction in one direction. With it
taken off, this direction shows little, and the other twice the error. With H' < H of the torque as
it is given, m_d of this torque counts up to 4 H - 2 H'. What ripple takes off both directions alike
leaves (m_+ - m_-) / 2, which is the friction. Ripple that lags differs between the directions: of
the torque before it was taken off, |h| is at most |m_+ - m_-| / 2 of the torque that is given.

A load that opposes every motion alike, such as a damper, cannot be distinguished from friction.

Friction that grows with the load more than the tables hold shows where something touches through a
reversal: with the torques m_1 before, in direction d, and m_2 after it, at the same angles, where
a spring has the same torque,

    l = d (m_1 - m_2) / |m_1 + m_2|,    u^2 + (median of l)^2 M^2 instead of u^2

where both quartiles of l are beyond `DOUBTED_SHARE` on one side.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from rigtool.numerics.arrays import Array, Mask, joined

ANGLE_CELLS = 24
"""Parts of the learned angle."""

FEWEST_PASSES, FEWEST_CELLS, SHOWN = 2, 3, 2 / 3
"""Passes in each direction below which a cell is not compared; cells, and part of those with enough
passes, below which nothing is. Tables of other instruments leave four fifths of the cells at least
(14 recordings with contacts), a steady sine force mostly less than 0.6."""

QUARTILE, NEAR, ALIKE = 0.25, 3.0, 0.4
"""Which of the passes is taken for one that nothing touches; how far others like it are, in u; and
which part of all they must be: else the cell shows nothing."""

FEWEST_REVERSALS, DOUBTED_SHARE, LARGEST_SHARE = 4, 0.02, 0.3
"""Reversals under a load below which none is compared; part of the load from which on u is widened;
and the largest that is friction's: beyond it a contact begins or ends."""

LASTING_CELLS, MOSTLY = 0.9, 0.5
"""Part of the cells in which a torque that lasts is alike; part of the passes that is most."""

NEXT_TIME, REVERSAL_TIME, LOAD_OVER_U = 0.06, 0.4, 10.0
"""Time after a reversal that is compared with the same angles before it, s; the longest reversal,
and the longest time before it, s; and the least load in u: errors of both sides are far below."""

SPEED_TIME = 0.055
"""Time over which the direction is found, s."""

DOUBTED, CHANCE, REFUSED = 1 / 3, 1.5, 2.0
"""H over u from which on u is widened; H over u, times the root of the passes in each direction, up
to which strokes that deviate by u show as much once in a hundred recordings; size of the median of
h over u from which on nothing is given. The friction of another instrument is larger or smaller
along most of the angle; a force that swings within a pass has both signs."""


@dataclass(frozen=True, eq=False)
class Passes:
    """Passes through the angle without a reversal: signs of the `direction` (p,), mean `torque` in
    each cell and its `u`, N m, (p, CELLS); NaN where a pass is not. `shares` (r,) are l of the
    reversals under a load, `speed` rad/s is the rotor's, with its sign, (p, CELLS) or of all."""

    direction: Array
    torque: Array
    u: Array
    shares: Array = field(default_factory=lambda: np.empty(0))
    speed: Array | float = 0.0

    @classmethod
    def of(
        cls,
        step_time: float,
        angle: Array,
        sliding: Mask,
        reach: tuple[float, float],
        torque: Array,
        u: Array,
    ) -> Passes:
        """Return those of rows (m,) every `step_time` s: angle rad, torque and u N m.

        `sliding` (m,) marks rows with a value at which the rotor slides, `reach` rad is the learned
        range of angles.
        """
        half = max(1, round(SPEED_TIME / step_time / 2))
        rows = np.arange(len(angle))
        before, after = np.maximum(rows - half, 0), np.minimum(rows + half, len(angle) - 1)
        speed = (angle[after] - angle[before]) / (np.maximum(after - before, 1) * step_time)
        way = np.where(sliding, np.sign(speed), 0.0)
        edges = np.flatnonzero(np.diff(way, prepend=0.0, append=0.0))
        low, high = reach
        cell = np.clip((angle - low) / (high - low) * ANGLE_CELLS, 0, ANGLE_CELLS - 1).astype(
            np.intp
        )
        spans = [slice(*ends) for ends in itertools.pairwise(edges.tolist()) if way[ends[0]]]
        found = []
        for span in spans:
            own = cell[span]
            count = np.bincount(own, minlength=ANGLE_CELLS)
            every = torque, u, speed
            sums = [np.bincount(own, one[span], minlength=ANGLE_CELLS) for one in every]
            found.append(np.where(count > 0, sums, np.nan) / np.maximum(count, 1))
        means = np.array(found).reshape(-1, 3, ANGLE_CELLS)
        signs = np.array([way[span.start] for span in spans])
        shares = _shares(spans, signs, angle, torque, u, step_time)
        return cls(signs, means[:, 0], means[:, 1], shares, means[:, 2])


@dataclass(frozen=True)
class UnknownFriction:
    """H `size` and w `widening`, N m; H over u, and the median of h over u without its sign,
    `typical`; and the `passes` in each direction that show it."""

    size: float
    widening: float
    over_u: float
    typical: float
    passes: int

    @property
    def by_chance(self) -> bool:
        """Whether strokes that deviate as u states may show as much."""
        return self.over_u**2 * self.passes < CHANCE**2


def unknown_friction(
    parts: Sequence[Passes],
    hand: float | None = None,
    bare: float = 0.0,
    given: Sequence[Passes] = (),
) -> UnknownFriction | None:
    """Return what the passes of stretches show; None where too few cells have both directions.

    Torque that drives a pass with more than `hand` N m is a hand that moves the rig, not friction.
    `bare` N m is H of the torque from which no ripple was taken off; where `parts` are those of
    that torque, `given` are the same passes of the torque that is given.
    """
    every = _cells(parts, hand)
    shown = _shown(every)
    if np.count_nonzero(shown) < FEWEST_CELLS:
        return None
    up, down, size = every[shown].T
    least = np.sign(up) * np.minimum(np.abs(up), np.abs(down))
    if given:
        given_up, given_down, _ = _cells(given, hand)[shown].T
        least = np.sign(least) * np.fmin(np.abs(least), np.abs(given_up - given_down) / 2)
    # friction of an instrument changes along many cells, a load may touch at one, or at an end
    next_to = np.pad(np.where(up * down < 0, least, 0.0), 1, mode="reflect")
    opposing = np.median([next_to[:-2], next_to[1:-1], next_to[2:]], axis=0)
    whole, usual = float(np.sqrt(np.mean(opposing**2))), float(np.median(size))
    limit = 4 * max(whole, bare) - 2 * whole
    wide = float(np.sqrt(np.mean(np.minimum(np.abs([up, down]), limit) ** 2)))
    typical = float(np.abs(np.median(opposing / size)))
    direction, torque = joined(parts, "direction", "torque")
    known = np.isfinite(torque)[:, shown]
    passes = min(int(np.median(known[direction == sign].sum(axis=0))) for sign in (1.0, -1.0))
    return UnknownFriction(whole, wide, whole / usual, typical, passes)


def lasting_torque(parts: Sequence[Passes], hand: float | None = None) -> float:
    """Return the torque N m that acts in both directions, by more than u at most of the angles, and
    alike at `LASTING_CELLS` of them; 0 where none does. `hand` as in `unknown_friction`.

    Tissue acts at a part of the angles, and differently at each.
    """
    every = _cells(parts, hand)
    cells = every[_shown(every)]
    if len(cells) < FEWEST_CELLS:
        return 0.0
    up, down, size = cells.T
    lasting = float(np.median((up + down) / 2))
    least, most = np.sort([up * np.sign(lasting), down * np.sign(lasting)], axis=0)
    alike = (least > ALIKE * abs(lasting)) & (most < abs(lasting) / ALIKE)
    everywhere = np.mean(alike) >= LASTING_CELLS
    return lasting if everywhere and np.median(least) > np.median(size) else 0.0


def driven_part(parts: Sequence[Passes], hand: float) -> float:
    """Return the part of the passes by cells that more than `hand` N m drives, the lesser of both
    directions; 0 where it is less than half."""
    driven = []
    for sign in (1.0, -1.0):
        torque = np.concatenate([sign * p.torque[p.direction == sign].ravel() for p in parts])
        known = torque[np.isfinite(torque)]
        driven.append(float(np.mean(known < -hand)) if len(known) else 0.0)
    return min(driven) if min(driven) >= MOSTLY else 0.0


def _shown(every: Array) -> Mask:
    """Return which of the cells (CELLS, 3) show what nothing touches; none where few of them do."""
    shown: Mask = np.asarray(np.isfinite(every).all(axis=1))
    if np.count_nonzero(shown) < SHOWN * np.count_nonzero(np.isfinite(every[:, 2])):
        return np.zeros_like(shown)
    return shown


def _cells(parts: Sequence[Passes], hand: float | None) -> Array:
    """Return torques N m of either direction that nothing touches, and u, in each cell (CELLS, 3);
    NaN where passes show none, u as well where they are too few."""
    direction, torque, u = joined(parts, "direction", "torque", "u")
    if hand is not None:
        torque = np.where(direction[:, None] * torque >= -hand, torque, np.nan)
    found = np.full((ANGLE_CELLS, 3), np.nan)
    for cell, (own, doubt) in enumerate(zip(torque.T, u.T, strict=True)):
        known = np.isfinite(own)
        sides = [own[known & (direction == sign)] for sign in (1.0, -1.0)]
        if min(map(len, sides)) >= FEWEST_PASSES:
            size = float(np.median(doubt[known]))
            found[cell] = *(_untouched(side, size) for side in sides), size
    return found


def _shares(
    spans: Sequence[slice], signs: Array, angle: Array, torque: Array, u: Array, step_time: float
) -> Array:
    """Return l of the reversals under a load (r,), from spans of rows without a reversal."""
    next_to, longest = max(1, round(NEXT_TIME / step_time)), round(REVERSAL_TIME / step_time)
    found = []
    for number, (before, after) in enumerate(itertools.pairwise(spans)):
        if signs[number] == signs[number + 1] or after.start - before.stop > longest:
            continue
        ends = _same_angles(before, after, signs[number] * angle, next_to)
        if ends is None or before.stop - ends[0].min() > longest:
            continue
        first, second = (float(torque[end].mean()) for end in ends)
        if abs(first + second) / 2 > LOAD_OVER_U * max(float(u[end].mean()) for end in ends):
            found.append(signs[number] * (first - second) / abs(first + second))
    return np.array(found)


def _same_angles(
    before: slice, after: slice, path: Array, size: int
) -> tuple[NDArray[np.intp], NDArray[np.intp]] | None:
    """Return the rows (size,) on either side of a reversal that are nearest to it at the same
    angles; None where a side does not have them. The `path` (m,) rad rises before it and falls
    after it."""
    there = np.maximum.accumulate(path[before])
    begin = after.start + int(np.argmax(path[after] <= there[-1]))
    rows = np.arange(begin, begin + size)
    if rows[-1] >= after.stop or path[rows].max() > there[-1] or path[rows].min() < there[0]:
        return None
    return before.start + np.searchsorted(there, path[rows]), rows


def unknown_share(parts: Sequence[Passes]) -> float:
    """Return the part of a load that is friction which the tables do not hold, by the reversals of
    stretches; 0 where they do not show any."""
    every = np.concatenate([part.shares for part in parts])
    near = every[np.abs(every) < LARGEST_SHARE]
    if len(near) < FEWEST_REVERSALS or 2 * len(near) < len(every):
        return 0.0
    low, middle, high = np.quantile(near, [QUARTILE, 0.5, 1 - QUARTILE])
    return float(middle) if low > DOUBTED_SHARE or high < -DOUBTED_SHARE else 0.0


def _untouched(torque: Array, u: float) -> float:
    """Return the torque N m of the passes (p,) of one direction that nothing touches, or NaN."""
    by_size = torque[np.argsort(np.abs(torque))]
    middle = by_size[int(QUARTILE * (len(torque) - 1))]
    for _ in range(3):
        alike = np.abs(torque - middle) <= NEAR * u
        middle = np.median(torque[alike])
    return float(middle) if alike.mean() > ALIKE else math.nan
