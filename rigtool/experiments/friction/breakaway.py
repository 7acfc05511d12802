"""Breakaway torque, at which the shaft begins to move, around the turn [7.1.2, Fig. 22].

A slow ramp of torque first bends the contacts of the bearings (pre-sliding: the shaft creeps by a
fraction of a degree), then the shaft breaks away and runs off. The shaft has broken away where it
moves from one angle to twice that angle within a small part of the ramp's time; the torque is read
at the time where that motion, extrapolated back as a straight line, begins:

    t0 = t1 - (t2 - t1),   t1, t2 = first times beyond the angle and its double

The angle is doubled while the motion is still slow compared with the ramp.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from rigtool.errors import InsufficientDataError
from rigtool.numerics.arrays import Array
from rigtool.numerics.checks import require_signals
from rigtool.numerics.turn_mean import TurnMean, group_angles, mean_over_turn

RAMP_END_DROP = 0.02
"""A ramp ends where the torque falls by this part of its highest value between two samples."""

MIN_RAMP_SAMPLES = 16
"""Samples that a ramp needs."""

BREAKAWAY_TIME = 0.05
"""Breakaway takes less than this part of the ramp's time; a slower motion is pre-sliding."""


@dataclass(frozen=True)
class TorqueRamp:
    """One ramp: samples `begin` to `end` (excluded); `torque` (NaN: never broke away), N m."""

    begin: int
    end: int
    position: float  # at its beginning, rad within a turn
    direction: float  # +1 or -1
    torque: float  # magnitude
    against: bool = False  # the shaft ran off the other way


def find_ramps(
    *, time: ArrayLike, angle: ArrayLike, torque: ArrayLike, threshold: float
) -> list[TorqueRamp]:
    """Find the ramps in a recording and the torque at which each breaks the shaft away.

    `time` (n,) in s, `angle` of the shaft in rad, `torque` in N m; `threshold` is the motion that
    counts as breakaway, rad. A ramp begins where torque falls back or time has a gap. Raises
    `InsufficientDataError` where there is none.
    """
    t, shaft, effort = require_signals(2, time=time, angle=angle, torque=torque)
    size = np.abs(effort)
    step = float(np.median(np.diff(t)))
    fallen = np.diff(size) < -RAMP_END_DROP * size.max()
    new = np.flatnonzero((np.diff(t) > 10 * step) | (np.diff(t) <= 0) | fallen) + 1
    edges = np.concatenate([[0], new, [len(t)]])
    ramps = []
    for first, last in zip(edges[:-1].tolist(), edges[1:].tolist(), strict=True):
        part = slice(first, last)
        if size[last - 1] <= 0.1 * size.max():
            continue
        direction = 1.0 if effort[last - 1] > 0 else -1.0
        back = direction * (shaft[first] - shaft[part])
        against = bool(back.max() > 2 * threshold)  # further than contacts spring back
        if last - first < MIN_RAMP_SAMPLES and not against:
            continue
        onset = _onset(t[part] - t[first], direction * shaft[part], threshold)
        broke = np.nan if onset is None else float(np.interp(onset, t[part] - t[first], size[part]))
        position = float(np.mod(shaft[first], 2 * np.pi))
        ramps.append(TorqueRamp(first, last, position, direction, broke, against))
    if not ramps:
        longest = int(np.diff(edges).max())
        found = "" if longest >= MIN_RAMP_SAMPLES else f"; the longest has {longest} samples"
        raise InsufficientDataError(
            "no ramp of torque was found: each must rise slowly from zero at standstill, with "
            f"{MIN_RAMP_SAMPLES} samples or more{found}: lower stribeck.breakaway_rate, raise "
            "stribeck.breakaway_angle where ramps end too soon, or shorten rig.sample_time"
        )
    return ramps


def _onset(time: Array, angle: Array, threshold: float) -> float | None:
    """Return when the shaft breaks away, s; None where it does not."""
    # The shaft may first spring back as the current begins: count from its furthest point.
    moved = angle - np.minimum.accumulate(angle)
    while threshold <= moved.max():
        once = float(time[np.argmax(moved >= threshold)])
        beyond = moved > 2 * threshold
        if beyond.any():
            doubling = float(time[np.argmax(beyond)]) - once
        else:
            # The recording ends during the motion: it would go on as it went beyond the angle.
            further = max(moved[-1] - threshold, 1e-9)
            doubling = (float(time[-1]) - once) * threshold / further
        if doubling <= BREAKAWAY_TIME * once:
            return max(0.0, once - doubling)
        threshold *= 2
    return None


@dataclass(frozen=True)
class Breakaway:
    """Breakaway torques by position (k,) rad, magnitudes in N m, NaN where there is none.

    `scatter` is the standard deviation of a single one about the part that repeats around the
    turn, with `dof` (0: unknown). In `stuck` ramps the shaft did not break away: the means of the
    others, which are too low, have no uncertainty.
    """

    position: Array
    positive: Array
    negative: Array
    scatter: float
    dof: float
    stuck: int = 0

    @property
    def level(self) -> TurnMean:
        """Mean over the turn of half the distance between the directions: static friction, N m."""
        return self._mean((self.positive + self.negative) / 2)

    @property
    def middle(self) -> TurnMean:
        """Mean over the turn of the middle between the directions, N m."""
        return self._mean((self.positive - self.negative) / 2)

    def _mean(self, values: Array) -> TurnMean:
        known = np.isfinite(values)
        mean = mean_over_turn(self.position[known], values[known])
        return replace(mean, u=np.nan) if self.stuck else mean

    @property
    def paired(self) -> int:
        """Number of positions at which the shaft broke away in both directions."""
        return int(np.count_nonzero(np.isfinite(self.positive + self.negative)))

    @property
    def lowest(self) -> float:
        """Smallest torque of both directions, N m."""
        return float(np.nanmin([self.positive, self.negative]))

    @property
    def highest(self) -> float:
        """Largest torque of both directions, N m."""
        return float(np.nanmax([self.positive, self.negative]))


def around_turn(ramps: list[TorqueRamp], positions: Array | None = None) -> Breakaway:
    """Return ramps by position; `positions` (k,), rad, of another series to pair them with.

    Raises `InsufficientDataError` where most ramps do not break away, or a constant torque turns
    the shaft.
    """
    stuck = int(sum(np.isnan(ramp.torque) for ramp in ramps))
    against = sum(ramp.against for ramp in ramps)
    if 2 * against >= stuck > 0:
        raise InsufficientDataError(
            f"a constant torque turned the shaft against {against} of {len(ramps)} ramps: it is "
            "larger than friction; take it off: the amplifier's offset, or a load on the shaft"
        )
    if 2 * stuck >= len(ramps):
        raise InsufficientDataError(
            f"the shaft did not break away in {stuck} of {len(ramps)} ramps: where it stood still, "
            "raise stribeck.breakaway_limit; where it crept, stribeck.breakaway_angle"
        )
    by_sign = [np.array([r.position for r in ramps if r.direction == s]) for s in (1.0, -1.0)]
    # those of the direction with most ramps, rising
    here = group_angles(max(by_sign, key=len))[0] if positions is None else positions
    reach = np.pi / len(here)
    total = {sign: np.zeros(len(here)) for sign in (1.0, -1.0)}
    count = {sign: np.zeros(len(here)) for sign in (1.0, -1.0)}
    for ramp in ramps:
        gap = np.abs(np.angle(np.exp(1j * (here - ramp.position))))
        nearest = int(np.argmin(gap))
        if gap[nearest] <= reach and not np.isnan(ramp.torque):
            total[ramp.direction][nearest] += ramp.torque
            count[ramp.direction][nearest] += 1
    columns = {
        sign: np.where(count[sign] > 0, total[sign] / np.maximum(count[sign], 1), np.nan)
        for sign in total
    }
    scatters, dof = [], 0.0
    for values in columns.values():
        known = np.isfinite(values)
        if known.sum() >= 4:
            mean = mean_over_turn(here[known], values[known])
            scatters.append((mean.scatter**2, mean.dof))
            dof += mean.dof
    scatter = float(np.sqrt(sum(s * d for s, d in scatters) / dof)) if dof else np.nan
    return Breakaway(here, columns[1.0], columns[-1.0], scatter, dof, stuck)
