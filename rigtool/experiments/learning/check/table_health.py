"""Whether a learned table still fits the rig; if not, what changed, and whether a shift is enough.

The torque learned at one speed in both directions, and the torque now, are separated into the part
that has the sign of the speed (friction) and the part that does not (cogging, amplifier's ripple):

    even = (T(+v) + T(-v))/2,   odd = (T(+v) - T(-v))/2,   each without its mean over the position

    now(p) = scale * learned(p - shift) + remainder

Shift and scale are common to all parts, by least squares: all shifts are tried in steps of an
entry, the best one is refined. Means are reported separately: the mean of odd is friction, that of
even an offset. Uncertainties are from the scatter of the moves; the noise of the table counts like
that of the moves, in proportion to their standard uncertainties.

A table fits if its error does not exceed the scatter of a single move, which no table can remove.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from rigtool.control.lookup_table import LookupTable
from rigtool.errors import InsufficientDataError
from rigtool.experiments.learning.rows import Row
from rigtool.experiments.ripple.orders import summit
from rigtool.numerics.arrays import Array, Mask

SHIFT_REACH = 0.25
"""Part of a limited range by which a shift is looked for, in either direction."""

EQUALLY_GOOD = 0.01
"""Shifts that leave this part of the variance more than the best one fit as well as that."""

CERTAIN_RATIO = 3.0
"""A change counts when it is this many times its standard uncertainty."""

ALIKE_VARIANCE = 0.9
"""Two patterns are the same when they share this part of their variance."""


@dataclass(frozen=True, eq=False)
class ParityPart:
    """One parity at one speed: learned (n,) and each present move (m, n), N m.

    `learned_u` (n,) is the standard uncertainty of the learned part. `odd` has the sign of the
    speed; with one direction alone, everything counts as `even`.
    """

    speed: float
    odd: bool
    learned: Array
    learned_u: Array
    moves: Array

    @property
    def now(self) -> Array:
        """Mean of the moves (n,)."""
        return self.moves.mean(axis=0)


@dataclass(frozen=True)
class HealthChange:
    """A number with its standard uncertainty."""

    value: float
    u: float

    @property
    def certain(self) -> bool:
        """Whether it is clearly not zero."""
        return abs(self.value) > CERTAIN_RATIO * self.u


@dataclass(frozen=True, eq=False)
class TableHealth:
    """Changes since a table was learned; torques in N m, angles in rad.

    `shift` is the angle by which the learned pattern has moved, searched up to `reach`, and `scale`
    its factor there; both are None where the table holds no pattern above its noise. On a range
    (not `whole_turn`) another pattern may look like a shifted one. `friction` and `offset` are
    changes of the means; `friction` is None for one direction, which does not show it.

    The following are rms over position with the scatter of the means taken off: `mismatch` of the
    table as it is, `shape` of its pattern without means, of which `even` and `odd` are parts,
    `scaled` of the pattern with its best scale where it was, `shifted` after the best shift at
    scale one. `unexplained` is the part of the pattern's variance that shift and scale leave,
    `pattern` the rms of the pattern now, `limit` the scatter of a single move.
    """

    shift: HealthChange | None
    whole_turn: bool
    reach: float
    scale: HealthChange | None
    friction: HealthChange | None
    offset: HealthChange
    mismatch: float
    shape: float
    scaled: float
    shifted: float
    even: float
    odd: float
    unexplained: HealthChange
    pattern: float
    limit: float

    @property
    def fits(self) -> bool:
        """Whether the table's error does not exceed the scatter of a single move."""
        return self.mismatch <= self.limit

    @property
    def pattern_fits(self) -> bool:
        """Whether the part that varies with position still fits, without means."""
        return self.shape <= self.limit

    @property
    def shift_is_enough(self) -> bool:
        """Whether the pattern is the same but shifted, which only a whole turn shows."""
        if self.pattern_fits or self.scale_is_enough or self.shift is None:
            return False
        return self.whole_turn and self._explains(self.shifted)

    @property
    def scale_is_enough(self) -> bool:
        """Whether the pattern is the same one at the same angle, larger or smaller."""
        return not self.pattern_fits and self.scale is not None and self._explains(self.scaled)

    def _explains(self, left: float) -> bool:
        """Return whether a change that leaves this rms explains the present pattern."""
        return left <= min(self.limit, math.sqrt(1 - ALIKE_VARIANCE) * self.pattern)

    @property
    def friction_changed(self) -> bool:
        """Whether friction differs by more than its share of the limit."""
        return self.friction is not None and self._beyond(self.friction)

    @property
    def offset_changed(self) -> bool:
        """Whether the mean of both directions differs by more than its share of the limit."""
        return self._beyond(self.offset)

    def _beyond(self, change: HealthChange) -> bool:
        # Pattern, friction and offset add up as squares: below a half, none makes a mismatch.
        least = self.limit / 2
        if not self.whole_turn and not self.pattern_fits:
            least = max(least, self.shape)  # a part of the turn has part of a pattern in its mean
        return change.certain and abs(change.value) > least


def parts(table: LookupTable, u: Array, rows: Sequence[Row], position: Array) -> list[ParityPart]:
    """Pair rows (at `position` (n,), rad) with the table there; `u` has the shape of its torque.

    Raises `InsufficientDataError` for one move, which has no scatter, and where the table does not
    cover a speed.
    """
    uncertain = replace(table, torque=u)
    by_speed: dict[float, dict[bool, ParityPart]] = {}
    for row in rows:
        if len(row.moves) < 2:
            raise InsufficientDataError("a single move has no scatter: record at least 2")
        at = (position, np.full(position.size, row.speed))
        if not table.covers(*at).all():
            raise InsufficientDataError(
                f"the table does not cover {row.speed:.4g} rad/s at all recorded positions: check "
                "at a speed that was learned"
            )
        here = ParityPart(row.speed, False, table.evaluate(*at), uncertain.evaluate(*at), row.moves)
        by_speed.setdefault(abs(row.speed), {})[row.speed > 0] = here
    found: list[ParityPart] = []
    for ways in by_speed.values():
        found += _parities(ways[True], ways[False]) if len(ways) == 2 else ways.values()
    return found


def _parities(forward: ParityPart, backward: ParityPart) -> list[ParityPart]:
    count = min(len(forward.moves), len(backward.moves))
    u = np.hypot(forward.learned_u, backward.learned_u) / 2
    return [
        ParityPart(
            forward.speed,
            odd,
            (forward.learned + sign * backward.learned) / 2,
            u,
            (forward.moves[:count] + sign * backward.moves[:count]) / 2,
        )
        for odd, sign in ((False, 1), (True, -1))
    ]


def judge_table(parts: Sequence[ParityPart], position: Array, period: float | None) -> TableHealth:
    """Compare a table with the torque now; `position` (n,) rad in equal steps.

    `period` is that of the table, rad, where it has one. Raises `InsufficientDataError`
    where the scatter of the moves exceeds the rms of the table.
    """
    speeds = len({part.speed for part in parts})
    count = min(len(part.moves) for part in parts)
    # (parts, n) and (moves, parts, n): the learned pattern, the present one, the part of each move.
    learned = np.stack([part.learned for part in parts])
    now = np.stack([part.now for part in parts])
    moves = np.stack([part.moves[:count] - part.moves[:count].mean(axis=0) for part in parts], 1)
    single = np.array([part.moves.var(axis=0, ddof=1).mean() for part in parts])
    means = np.array([v / len(part.moves) for v, part in zip(single, parts, strict=True)])
    noise = means + np.array([np.mean(part.learned_u**2) for part in parts])
    limit = math.sqrt(single.sum() / speeds)
    held = math.sqrt(np.mean(learned**2, axis=1).sum() / speeds)
    if limit >= held:
        raise InsufficientDataError(
            f"a single move scatters by {limit:.3g} N m rms, the table holds {held:.3g} N m: "
            "they do not resolve it; find the disturbance of the moves, or learn again"
        )
    # The table's own noise, in the proportion of the moves'.
    wider = math.sqrt(noise.sum() / max(means.sum(), np.finfo(float).tiny))

    def excess(off: Array, chosen: Mask | slice = slice(None)) -> float:
        power = np.mean(off**2, axis=1) - noise
        return math.sqrt(max(0.0, float(power[chosen].sum())) / speeds)

    odd = np.array([part.odd for part in parts])
    off, change = now - learned, (now - learned).mean(axis=1)
    scatter = wider * moves.mean(axis=2).std(axis=0, ddof=1) / math.sqrt(count)

    def mean_change(chosen: Mask) -> HealthChange:
        return HealthChange(
            float(change[chosen].mean()), float(np.linalg.norm(scatter[chosen]) / chosen.sum())
        )

    pattern = excess(_varying(now))
    there = _varying(learned)
    patterned = excess(there) > 0
    fit = _fit(learned, now, moves, position, period, patterned)
    factor = float(np.sum(there * now) / max(np.sum(there**2), np.finfo(float).tiny))
    left = fit.now - fit.scale * fit.learned
    power = max(pattern**2, np.finfo(float).tiny)
    influence = 2 * np.mean(left * fit.moves, axis=2).sum(axis=1) / speeds
    unexplained = HealthChange(
        excess(left) ** 2 / power, wider * float(influence.std(ddof=1)) / math.sqrt(count) / power
    )
    u = np.maximum(wider * fit.each.std(axis=0, ddof=1) / math.sqrt(count), fit.misfit_u)
    return TableHealth(
        shift=HealthChange(fit.shift, float(u[1])) if patterned else None,
        whole_turn=period is not None,
        reach=fit.reach,
        scale=HealthChange(fit.scale, float(u[0])) if patterned else None,
        friction=mean_change(odd) if odd.any() else None,
        offset=mean_change(~odd),
        mismatch=excess(off),
        shape=excess(_varying(off)),
        scaled=excess(_varying(now) - factor * there),
        shifted=excess(fit.now - fit.learned),
        even=excess(_varying(off), ~odd),
        odd=excess(_varying(off), odd),
        unexplained=unexplained,
        pattern=pattern,
        limit=limit,
    )


@dataclass(frozen=True, eq=False)
class _Fit:
    """Shift, rad, and scale; patterns (parts, w) and moves (moves, parts, w) where both are known.

    `learned` is shifted, not scaled. `each` (moves, 2) is the part of each move in scale and shift,
    `misfit_u` (2,) is their standard uncertainty by the remaining difference of the patterns.
    """

    shift: float
    scale: float
    reach: float
    learned: Array
    now: Array
    moves: Array
    each: Array
    misfit_u: Array


def _fit(
    learned: Array, now: Array, moves: Array, position: Array, period: float | None, patterned: bool
) -> _Fit:
    """Fit shift and scale of learned and present torque (parts, n), if the table is `patterned`."""
    step = float(position[1] - position[0])
    margin = 0 if period is not None else int(SHIFT_REACH * position.size)
    window = slice(margin, position.size - margin)
    here, there = position[window], _varying(now[:, window])
    shift = step * _nearest(_leftovers(learned, there, margin), period is not None)

    def pattern(by: float) -> Array:
        rows = [np.interp(here - by, position, row, period=period) for row in learned]
        return _varying(np.stack(rows))

    varying = _varying(moves[..., window])
    reach = period / 2 if period is not None else margin * step
    if not patterned:
        none = np.zeros((len(moves), 2))
        return _Fit(0.0, 1.0, reach, pattern(0.0), there, varying, none, none[0])
    for _ in range(4):
        turned = pattern(shift)
        slope = (pattern(shift + step / 2) - pattern(shift - step / 2)) / step
        # scale*learned(p - shift - d) = scale*turned + scale*d*slope
        inverse = np.linalg.pinv(np.column_stack([turned.ravel(), slope.ravel()]))
        scale, moved = inverse @ there.ravel()
        # No jumps from one maximum to the next.
        shift += float(np.clip(moved / scale, -step, step)) if scale > 0 else 0.0
    inverse[1] /= scale
    each = varying.reshape(len(moves), -1) @ inverse.T
    left = there - scale * pattern(shift)
    misfit_u = np.array([_misfit(left, turned, turned), _misfit(left, slope, turned) / scale])
    return _Fit(shift, float(scale), reach, pattern(shift), there, varying, each, misfit_u)


def _misfit(left: Array, slope: Array, pattern: Array) -> float:
    """Return the difference of an estimate from the coarse half of the pattern alone.

    (parts, w) each: `left` of the pattern, the `slope` of the pattern by the estimated number, and
    `pattern`. Coarse are the lowest orders that hold half of the variance. An error of the encoder
    that repeats in every move is fine: it acts on a shift, and does not show in the scatter.
    """
    power = np.cumsum(np.sum(np.abs(np.fft.rfft(pattern)) ** 2, axis=0))
    coarse = int(np.searchsorted(power, power[-1] / 2)) + 1
    lefts, by = (np.fft.rfft(values)[:, :coarse] for values in (left, slope))
    return abs(float(np.real(np.sum(np.conj(by) * lefts)) / np.sum(np.abs(by) ** 2)))


def _varying(values: Array) -> Array:
    """Return values (..., n) without their mean over position."""
    return values - values.mean(axis=-1, keepdims=True)


def _leftovers(learned: Array, there: Array, margin: int) -> Array:
    """Return the part of the variance of patterns `there` that each shift leaves, scale above 0.

    Shifts are entries: -margin..margin on a range, 0..n-1 where patterns are periodic (no margin).
    """
    total = float(np.sum(there**2)) or 1.0
    if margin == 0:
        known = _varying(learned)
        spectra = np.conj(np.fft.rfft(known)) * np.fft.rfft(there)
        products = np.fft.irfft(spectra, known.shape[1]).sum(axis=0)
        powers: Array | float = float(np.sum(known**2))
    else:
        width = there.shape[1]
        starts = range(2 * margin, -1, -1)
        moved = [_varying(learned[:, start : start + width]) for start in starts]
        products = np.array([np.sum(known * there) for known in moved])
        powers = np.array([np.sum(known**2) for known in moved])
    gained = np.maximum(products, 0.0) ** 2 / np.maximum(powers, np.finfo(float).tiny)
    return 1 - gained / total


def _nearest(leftovers: Array, periodic: bool) -> int:
    """Return the shift of the best fit, in entries; of equally good ones the smallest."""
    size = len(leftovers)
    shifts = np.arange(size)
    shifts = np.where(shifts > size // 2, shifts - size, shifts) if periodic else shifts - size // 2
    good = np.flatnonzero(leftovers <= leftovers.min() + EQUALLY_GOOD)
    first = int(good[np.argmin(np.abs(shifts[good]))])
    return int(shifts[summit(-leftovers, first, periodic=periodic)])
