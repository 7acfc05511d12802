"""Free motion by a hand or another controller: drawn stretches of pace and pauses.

    x(t) = x0 + a sum_i b_i sin(2 pi f_i tau(t) + phi_i) / sum_i b_i,   d tau / dt = pace

Sums of sines reverse as a hand does, at angles that never repeat; the pace is constant within a
stretch, 0 in a pause, and changes from one to the next as half a cosine. So the motion keeps to
its range at all times, and to its highest speed: the sum cannot exceed a, its slope the largest
pace times 2 pi sum b_i f_i a / sum b_i.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from rigtool.numerics.arrays import Array
from rigtool.recipe.virtual import Hand

FREQUENCY_RATIOS = (1.0, 2.09, 3.36, 6.45)
"""Relative to each other; far from ratios of small numbers, so that nothing repeats."""

BLEND_TIME = 0.15
"""From one pace to the next, s; a stretch that is shorter takes all its time for it."""


@dataclass(frozen=True)
class FreeMotion:
    """A motion as `Motion` describes it; `paces` hold from `times` [s] on."""

    duration: float
    middle: float
    amplitudes: Array
    phases: Array
    times: Array
    paces: Array

    @property
    def start(self) -> float:
        """Where it starts, rad."""
        return self.middle + float(self.amplitudes @ np.sin(self.phases))

    def setpoint(self, time: Array) -> tuple[Array, Array, Array]:
        """See `Motion.setpoint`."""
        run, pace, change = self._run(time)
        frequencies = 2 * np.pi * np.array(FREQUENCY_RATIOS)
        angle = np.outer(run, frequencies) + self.phases
        sine, cosine = np.sin(angle), np.cos(angle)
        slope = cosine @ (self.amplitudes * frequencies)
        bend = -sine @ (self.amplitudes * frequencies**2)
        position = self.middle - self.start + sine @ self.amplitudes
        return position, slope * pace, bend * pace**2 + slope * change

    def _run(self, time: Array) -> tuple[Array, Array, Array]:
        """Return tau, its slope and its slope's slope at these times, each (n,)."""
        before = np.concatenate([[0.0], self.paces[:-1]])
        lengths = np.diff(np.append(self.times, self.duration))
        blends = np.minimum(BLEND_TIME, lengths)
        done = np.concatenate(
            [[0.0], np.cumsum(self.paces * lengths + (before - self.paces) * blends / 2)[:-1]]
        )
        piece = np.clip(np.searchsorted(self.times, time, side="right") - 1, 0, len(lengths) - 1)
        since, blend = time - self.times[piece], blends[piece]
        old, new = before[piece], self.paces[piece]
        part = np.minimum(since, blend)
        phase = np.pi * part / blend
        run = done[piece] + new * since + (old - new) * (part + np.sin(phase) * blend / np.pi) / 2
        pace = new + (old - new) * (1 + np.cos(phase)) / 2
        return run, pace, (new - old) * np.sin(phase) * np.pi / (2 * blend)


def draw(hand: Hand, angle_ratio: float, duration: float, rng: np.random.Generator) -> FreeMotion:
    """Draw free motion of the motor; `angle_ratio` is motor angle per output angle."""
    low, high = (math.radians(angle) * angle_ratio for angle in hand.angle_deg)
    shares = rng.uniform(0.5, 1.0, len(FREQUENCY_RATIOS))
    amplitudes = (high - low) / 2 * shares / shares.sum()
    fastest = float(2 * np.pi * amplitudes @ np.array(FREQUENCY_RATIOS))  # at pace 1, rad/s
    phases = rng.uniform(0.0, 2 * np.pi, len(FREQUENCY_RATIOS))
    times, paces, now = [], [], 0.0
    while now < duration:
        rests = rng.uniform() < hand.pause_share
        slow, fast = np.log(hand.speed_rev_per_s)
        speed = 2 * np.pi * math.exp(rng.uniform(slow, fast))
        times.append(now)
        paces.append(0.0 if rests else speed / fastest)
        now += rng.uniform(*hand.stretch)
    stop = max(duration - BLEND_TIME, duration / 2)  # at rest in the end
    kept = [(time, pace) for time, pace in zip(times, paces, strict=True) if time < stop]
    moments, rates = zip(*kept, (stop, 0.0), strict=True)
    return FreeMotion(
        duration, (low + high) / 2, amplitudes, phases, np.array(moments), np.array(rates)
    )
