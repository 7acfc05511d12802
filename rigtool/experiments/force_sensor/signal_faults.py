"""Signals that contradict each other: an encoder or a current that does not change, or leaps.

The filter takes an encoder that stays at one count for a rotor at rest. But a rotor at rest is held
by friction and by the load, so that the motor's torque changes there by less than

    T = 2 F + (1 + 2 m) M / n

with friction F, that of the load m, the largest learned torque M and the torque factor n. Where it
changes by more, the encoder does not count, or something blocks the rotor. Means over `WINDOW_TIME`
are compared: within it, a torque beyond friction turns a rotor by more than a count.

The rig's own loop answers a distance d of rotor and set point with a torque g d or more, g the
smallest gain of its controller, and leads by a time t. While the encoder stays at one count, its
integrator grows on the side on which the set point is. Where the set point comes nearer, the two
parts may cancel; where it goes away, they add. An a = d + t d' that grows on its side by more than
what the torque grows there over g, and `UNEXPLAINED_DISTANCE`, leaves a rotor that the loop does
not see at rest. So does one that is further away than at first in the mean of `MEAN_TIME`, or of
`MEAN_TURNS` of the integrator.

A motor that moves a rig to and fro works against friction. Over a path L within a range R of
angles, a load that helps in some of the passes does M R / (2 n) at most on the whole. A load that
takes the current to its limit may be larger, so the motion there does not count. Where the motor's
work is below -F L / 2 - M R / (2 n), current and encoder have opposite signs, or a hand
drives the rig.

A current that stays at its highest or lowest value, to the last digit, while the rotor moves, and
at no other, was cut off there.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from rigtool.experiments.controller_torque import NO_ANSWER, UNEXPLAINED_DISTANCE, LoopAnswer
from rigtool.experiments.force_filter.lost_counts import COUNTING_TIME, LEAP_RATIO, Counts
from rigtool.experiments.force_model.steps import NO_CURRENT
from rigtool.experiments.force_sensor.sensor import SensorProperties
from rigtool.numerics.arrays import Array, Mask
from rigtool.numerics.plateaus import runs_of

WINDOW_TIME = 20e-3

FROZEN_TIME = 1.0
"""Time from which on a current that is the same, to the last digit, is looked at, s."""

MOVED_COUNTS = 50.0
"""Counts beyond which a rotor has moved under it."""

SELDOM = 0.1
"""Largest part of the other windows of its kind in which a current stays the same, where one that
does so is remarkable."""

CUT_WINDOWS, CUT_RATIO, CUT_STEP = 5, 5.0, 0.01
"""Windows at one end of its values from which on a current was cut off there, and their ratio to
those at any other value; the largest step to the next value, of its range: a current of coarse
steps stays the same, too."""

MEAN_TIME, MEAN_TURNS = 1.0, 2.0
"""Time over which a loop without a fault leaves no distance of rotor and set point, s, and in
periods of its integrator: a softer one answers later than that."""

UNEXPLAINED_MEAN = UNEXPLAINED_DISTANCE / 2
"""Mean distance that is accepted without a torque, rad: most of the others change sign."""

SETTLING_TIME = 1.0
"""Time about a fault that has no value either, s: the filter finds back."""


@dataclass(frozen=True)
class SignalFault:
    """A fault from `start` to `end` s, from the begin of the recording's stretch, in words, empty
    where those of the one before hold; whether there is `no_value` about it."""

    start: float
    end: float
    text: str
    no_value: bool

    def within(self, time: Array, *, causal: bool) -> Mask:
        """Return which times (m,) s have no value; what is smoothed has none before it either."""
        ahead = 0.0 if causal else SETTLING_TIME
        found: Mask = (time >= self.start - ahead) & (time <= self.end + SETTLING_TIME)
        return found & self.no_value


class SignalWatch:
    """Watches samples without a gap; they are added as they come.

    Where the rig's own loop moves it, it is `commanded`: nothing else drives it all the time. The
    answer of that `loop` bounds how far a set point can leave a rotor; none does where its gain is
    zero.
    """

    def __init__(
        self,
        instrument: SensorProperties,
        *,
        commanded: bool = False,
        loop: LoopAnswer = NO_ANSWER,
        before: SignalWatch | None = None,
    ) -> None:
        own, reach, plant = instrument, instrument.reach, instrument.plant
        most = float(np.abs(plant.friction_map[:, 0]).max()) + abs(plant.housing_asymmetry)
        friction = plant.static * (1 + abs(plant.asymmetry)) + plant.housing_friction * most
        load_friction = plant.load_friction + float(plant.friction_map[:, 1].max())
        carried = (1 + 2 * load_friction) * reach.torque / plant.torque_factor
        self._held, self._limited = 2 * friction + carried, own.limited
        self._braked = (plant.coulomb + plant.housing_friction) / 2
        self._helped = reach.torque / plant.torque_factor / 2
        self._turn, self._commanded, self._loop = own.count, commanded, loop
        self._counts: Counts = own.counts(0.0 if before is None else before._counts.lost)
        self._origin: float = math.nan if before is None else before._origin
        self._constant, self._interval = own.torque_constant, own.interval
        self._size = max(1, round(WINDOW_TIME / own.interval))
        self._waiting = np.empty((4, 0))
        self._windows: list[Array] = []

    def add(self, samples: Array, setpoint: Array | None = None) -> Array:
        """Watch samples (c, n): encoder in counts, current A, temperature degC; and the set point
        of the position (n,), rad, where the rig's own loop moves it. Return the samples with the
        counts put back that were lost."""
        counts = self._counts.add(encoder := samples[0])
        if counts is not encoder:
            samples = np.vstack([counts, samples[1:]])
        wanted = np.full(samples.shape[1], np.nan) if setpoint is None else setpoint
        whole = np.hstack([self._waiting, np.vstack([samples[:3], wanted])])
        count = whole.shape[1] // self._size
        self._waiting = whole[:, count * self._size :]
        if count:
            rows = whole[:, : count * self._size].reshape(4, count, self._size)
            encoder, current, wanted = rows[0], rows[1], rows[3]
            ends = [f(axis=1) for one in (encoder, current) for f in (one.min, one.max)]
            cold, slope = self._constant
            torque = (cold + slope * rows[2].mean(axis=1)) * current.mean(axis=1)
            moved = encoder[:, -1] - encoder[:, 0]
            distance = wanted[:, 0] - encoder[:, 0] * self._turn
            self._windows.append(np.array([*ends, torque, moved, distance]))
        return samples

    def faults(self) -> tuple[SignalFault, ...]:
        """Return what was seen so far, in order of time."""
        found = [*self._leaped()]
        if self._windows:
            low, high, least, most, torque, moved, distance = np.hstack(self._windows)
            limited = self._limited(np.maximum(np.abs(least), np.abs(most)))
            free = np.where(limited, 0.0, moved) * self._turn
            found += self._opposed(torque, free, float(np.ptp(low)) * self._turn)
            found += self._stopped(low, low == high, torque, distance, limited)
            found += self._left(np.where(limited, np.inf, torque), distance)
            same = (least == most) & ~limited  # at its limit, a current may well stay
            found += self._frozen(low, high, most, same)
            found += self._cut(most, least, same & (low < high))
        return tuple(sorted(found, key=lambda one: one.start))

    def _leaped(self) -> Iterator[SignalFault]:
        every = self._counts.leaps
        if every is None:
            return
        wrapped, leaps = every[every.wraps > 0], every[every.wraps == 0]
        if count := len(wrapped.sample):
            first, last = wrapped.sample[[0, -1]] * self._interval
            text = (
                f"the encoder's counter wraps at {wrapped.wraps[0]:.0f} counts, {count} times from "
                f"{first:.3f} to {last:.3f} s: they are put back"
            )
            yield SignalFault(float(first), float(last), text, False)
        if not (count := len(leaps.sample)):
            return
        largest = leaps.counts[np.argmax(np.abs(leaps.counts))]
        time, since = leaps.sample * self._interval, leaps.since * self._interval
        # what it rested before, it may not have counted; from one edge to the next it has
        begins = np.where(time - since > COUNTING_TIME, since, time)
        rests = np.count_nonzero(~leaps.put_back)
        behind = "counts were lost or added"
        if rests < count:
            behind += " and are put back"
        if rests:
            behind += (
                f", or the encoder had stopped, for {rests} of them came after a rest: if it had "
                "not, angles behind these are off by as many"
            )
        text = (
            f"the encoder leaps from one sample to the next, {count} times from {time[0]:.3f} to "
            f"{time[-1]:.3f} s, by up to {largest:.0f} counts; {LEAP_RATIO:g} times the learned "
            f"speed is {self._counts.largest_step:.0f}: {behind}; check the encoder's cable and "
            "supply"
        )
        apart = np.flatnonzero(begins[1:] - time[:-1] > 2 * SETTLING_TIME) + 1
        for first, last in zip([0, *apart], [*(apart - 1), -1], strict=True):
            yield SignalFault(float(begins[first]), float(time[last]), text, True)
            text = ""

    def _opposed(self, torque: Array, moved: Array, reached: float) -> Iterator[SignalFault]:
        work, path = float(torque @ moved), float(np.abs(moved).sum())
        if work >= -self._braked * path - self._helped * reached:
            return
        yield SignalFault(
            *self._times(0, len(torque)),
            f"the motor brakes wherever the rotor moves, by {-work / path * 1e3:.3g} mN m on the "
            f"average, and friction by {2e3 * self._braked:.3g} mN m besides: current and encoder "
            "have opposite signs, or a hand drives the rig; if none does, change one of the signs",
            self._commanded,
        )

    def _stopped(
        self, count: Array, still: Mask, torque: Array, distance: Array, limited: Mask
    ) -> Iterator[SignalFault]:
        for first, last in _runs(count, still):
            change = float(np.ptp(torque[first:last]))
            own = slice(first, last)
            away, growth = self._unanswered(torque[own], distance[own], limited[own])
            if change > self._held:
                why = (
                    f"the motor's torque changes by {change * 1e3:.3g} mN m; friction and the "
                    f"largest learned load hold a rotor up to {self._held * 1e3:.3g} mN m: the "
                    "encoder does not count, or the rotor is blocked"
                )
            elif self._loop.gain * (away - UNEXPLAINED_DISTANCE) > growth:
                why = (
                    f"the set point goes away by {away:.3g} rad, and the motor's torque changes by "
                    f"{growth * 1e3:.3g} mN m only; the loop would answer with "
                    f"{self._loop.gain * away * 1e3:.3g} mN m or more: the encoder does not count, "
                    "or the loop is not that of [rig.controller]"
                )
            else:
                continue
            start, end = self._times(first, last)
            yield SignalFault(
                start,
                end,
                f"the encoder stays at {count[first]:.0f} from {start:.3f} to {end:.3f} s, while "
                f"{why}; no torque has a value there; check the encoder's cable and supply, and "
                "record again",
                True,
            )

    def _unanswered(self, torque: Array, distance: Array, limited: Mask) -> tuple[float, float]:
        """Return by how much a set point goes away from a rotor at rest, rad, and the growth of
        torque on its side meanwhile, N m, where they contradict each other the most; zeros where
        nothing is known. All are those of windows (n,); where the current is `limited`, the loop
        cannot answer."""
        found, most = (0.0, 0.0), 0.0
        if not self._loop.gain > 0 or np.isnan(distance).any():
            return found
        led = distance + self._loop.lead * np.gradient(distance, self._size * self._interval)
        for side in (1, -1):
            out = np.maximum(side * led, 0.0)
            least = np.minimum.accumulate(out)
            since = np.maximum.accumulate(np.where(out == least, np.arange(len(out)), 0))
            away, growth = out - least, np.maximum(side * (torque - torque[since]), 0.0)
            beyond = np.where(limited, 0.0, self._loop.gain * away - growth)
            if beyond[at := int(beyond.argmax())] > most:
                most, found = float(beyond[at]), (float(away[at]), float(growth[at]))
        return found

    def _left(self, torque: Array, distance: Array) -> Iterator[SignalFault]:
        window = self._size * self._interval
        size = round(max(MEAN_TIME, MEAN_TURNS * self._loop.turn) / window)
        if len(torque) < size or not self._loop.gain > 0 or not self._commanded:
            return
        mean, answer = (sliding_window_view(one, size).mean(axis=1) for one in (distance, torque))
        if math.isnan(self._origin):
            self._origin = float(mean[0])
        off, each = np.abs(mean - self._origin), np.abs(distance - self._origin)
        most = (np.abs(answer) + 2 * self._braked) / self._loop.gain + UNEXPLAINED_MEAN
        (at,) = np.nonzero(off > most)
        if not len(at):
            return
        # the mean is that of windows, of which some are beyond
        ends = [int(k) + np.flatnonzero(each[k : k + size] > most[k])[[0, -1]] for k in at[[0, -1]]]
        start, end = self._times(int(ends[0][0]), int(ends[1][1]) + 1)
        worst = int(at[np.argmax(off[at])])
        yield SignalFault(
            start,
            end,
            f"the rotor is {off[worst]:.3g} rad further from its set point than at first, in the "
            f"mean of {size * window:.3g} s and more from {start:.3f} to {end:.3f} s, and the "
            f"motor's torque is {abs(answer[worst]) * 1e3:.3g} mN m; the loop would answer with "
            f"{off[worst] * self._loop.gain * 1e3:.3g} mN m or more: counts were lost or added, or "
            "the loop is not that of [rig.controller]; no torque has a value there; check the "
            "encoder's cable and supply, and record again",
            True,
        )

    def _frozen(self, low: Array, high: Array, most: Array, same: Mask) -> Iterator[SignalFault]:
        rests = low == high
        for first, last in _runs(most, same):
            start, end = self._times(first, last)
            moved = float(high[first:last].max() - low[first:last].min())
            others = np.ones(len(same), dtype=bool) if moved else rests.copy()
            others[first:last] = False
            if (
                end - start < FROZEN_TIME
                or others.sum() * self._size * self._interval < end - start
            ):
                continue
            if same[others].mean() > SELDOM or 0 < moved < MOVED_COUNTS:
                continue
            what = "the encoder's count" if not moved else f"the rotor moves by {moved:.0f} counts"
            yield SignalFault(
                start,
                end,
                f"the current stays at {most[first]:.6g} A to the last digit from {start:.3f} to "
                f"{end:.3f} s, {'like' if not moved else 'while'} {what}; it does so in "
                f"{100 * same[others].mean():.0f} % of the other time: unless nothing drives the "
                "motor there, its channel has stopped and the torque is wrong; check what records "
                "it",
                self._commanded and moved > 0,
            )

    def _cut(self, most: Array, least: Array, same: Mask) -> Iterator[SignalFault]:
        driven = same & (np.abs(most) > NO_CURRENT)
        values, counts = np.unique(most[driven], return_counts=True)
        seen = np.unique(np.concatenate([most, least]))
        fine = np.diff(seen)[[0, -1]] < CUT_STEP * np.ptp(seen) if len(seen) > 2 else [False] * 2
        ends = np.isin(values, seen[[0, -1]][fine])
        others = int(counts[~ends].max(initial=0))
        cut = values[ends & (counts >= max(CUT_WINDOWS, CUT_RATIO * others))]
        at = driven & np.isin(most, cut)
        text = (
            f"the current stays at {' and '.join(f'{value:.6g}' for value in cut)} A, its largest "
            f"or smallest value, in {at.sum() * self._size * self._interval:.3g} s in which the "
            "rotor moves, and at no other: it was cut off there, and the torque is wrong; raise "
            "the limit of the drive or of what records it, move slower, or against less"
        )
        for first, last in runs_of(at):
            yield SignalFault(*self._times(first, last), text, self._commanded)
            text = ""

    def _times(self, first: int, last: int) -> tuple[float, float]:
        window = self._size * self._interval
        return first * window, last * window


def _runs(values: Array, same: Mask) -> Iterator[tuple[int, int]]:
    """Yield first and last + 1 of the windows, two at least, with `same` and equal values (n,)."""
    goes_on = same[1:] & same[:-1] & (values[1:] == values[:-1])
    for first, last in runs_of(goes_on):
        yield first, last + 1
