"""Counts that an encoder loses, adds or wraps from one sample to the next: they are put back.

A rotor has inertia: from one sample to the next its step does not change by more counts than it
passes at some times the learned speed, however fast it is. What leaps further while it moves is an
error of the count, and all counts behind it are off by

    l = s - s_0

with the leap s and the last step s_0 that was none, counts. It is taken off.

A leap that is a turn of the encoder, or a power of two from 2^15 on, is a counter that wraps.

What leaps after a rest may be a channel that had stopped, and shows again where the rotor is. The
counts behind are taken as they are.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from rigtool.experiments.force_filter.motion_states import FASTEST_LEARNED_RATIO
from rigtool.numerics.arrays import Array, Mask, joined

LEAP_RATIO, LEAP_COUNTS = 5.0, 5.0
"""A change of the step that is a leap: in the highest speed that was learned, and the fewest
counts."""

COUNTING_TIME = 20e-3
"""Time without a count from which on a rotor rests, s: a channel may have stopped."""

WRAPS = 2.0 ** np.arange(15, 65)
"""Where counters wrap, counts."""


@dataclass(frozen=True)
class Leaps:
    """Steps of `counts` (n,) at `sample` (n,); the last count before passed at sample `since` (n,).
    `wraps` (n,) are the counts at which the counter wraps, or 0; what is `put_back` (n,) is not in
    the counts behind."""

    sample: Array
    since: Array
    counts: Array
    wraps: Array
    put_back: Mask

    def __getitem__(self, which: Mask) -> Leaps:
        return Leaps(*(getattr(self, name)[which] for name in self.__dataclass_fields__))

    @classmethod
    def joined(cls, parts: Sequence[Leaps]) -> Leaps:
        """Return parts (one at least) one behind the other."""
        return cls(*joined(parts, *cls.__dataclass_fields__))


class Counts:
    """Puts counts of `count` rad back, one sample each `interval` s, as they come; `lost` ones are
    off from the begin on. `speed` rad/s is the highest one that was learned. `shown` are the
    samples of the last block where an encoder that may have stopped leaps to where the rotor is."""

    def __init__(self, count: float, speed: float, interval: float, lost: float = 0.0) -> None:
        fastest = FASTEST_LEARNED_RATIO * speed * interval
        self.largest_step = max(LEAP_RATIO * fastest / count, LEAP_COUNTS)
        self.lost = lost
        self.shown = np.zeros(0, dtype=np.intp)
        self._leaps: list[Leaps] = []
        self._turn = round(2 * np.pi / count)
        self._resting = COUNTING_TIME / interval
        self._seen = self._changed = 0
        self._last, self._step = np.nan, np.nan

    @property
    def leaps(self) -> Leaps | None:
        """All leaps so far, if there were any."""
        return Leaps.joined(self._leaps) if self._leaps else None

    def add(self, encoder: Array) -> Array:
        """Return the counts (n,) with those put back that were lost or added."""
        self.shown = self.shown[:0]
        if not encoder.size:
            return encoder
        steps = np.diff(encoder, prepend=self._last)
        leap = self._leaping(steps)
        (at,) = np.nonzero(leap)
        changed = np.append(self._changed - self._seen, np.flatnonzero((steps != 0) & ~leap))
        found = encoder - self.lost if self.lost else encoder
        if at.size:
            usual = np.append(self._step, steps[~leap])
            before = usual[at - np.arange(at.size)]
            since = changed[np.searchsorted(changed, at) - 1]
            more = steps[at] - np.where(before == before, before, 0.0)
            wraps = self._wraps(np.abs(more))
            put_back = (wraps > 0) | (at - since <= self._resting)
            own = np.where(wraps > 0, np.copysign(wraps, more), more) * put_back
            found = found - np.bincount(at, own, encoder.size).cumsum()
            self.lost += float(own.sum())
            self.shown = at[~put_back]
            sample, since = (np.asarray(one + self._seen, dtype=float) for one in (at, since))
            self._leaps.append(Leaps(sample, since, steps[at], wraps, put_back))
        if not leap.all():
            self._step = float(steps[~leap][-1])
        self._changed = int(changed[-1]) + self._seen
        self._seen += encoder.size
        self._last = float(encoder[-1])
        return found

    def _leaping(self, steps: Array) -> Mask:
        """Return which of these steps (n,) leap: they differ from the last one that did not. The
        first one is where the rotor already moves."""
        leap: Mask = np.abs(steps) > self.largest_step
        before = self._step
        for k in np.flatnonzero(leap).tolist():
            if k and not leap[k - 1]:
                before = steps[k - 1]
            leap[k] = abs(steps[k] - before) > self.largest_step
        return leap

    def _wraps(self, size: Array) -> Array:
        """Return where a counter wraps that leaps by so many counts (n,); 0 where it does not."""
        found = np.zeros(size.shape)
        for wraps in (self._turn, *WRAPS.tolist()):
            if 4 * self.largest_step < wraps:
                found[np.abs(size - wraps) <= self.largest_step] = wraps
        return found
