"""A short motion that shows what strokes do not: pre-sliding, rest, reversals anywhere.

Small triangles about the middle of the range, from a few counts of the encoder to a part of the
stroke, whatever the count, keep friction within its bristles. A hold shows it at rest. The
remainder is free motion with speeds, ways and pauses drawn from a fixed seed, so that each
recording repeats it.
"""

from __future__ import annotations

import math

import numpy as np

from rigtool.experiments.force_model.records import bristle_scale, halved
from rigtool.rigs.motion import SpeedProfile

TRIANGLE_LENGTHS = (3, 6, 12, 25, 50, 100)
"""Lengths of a short bristle from end to end, in turn: counts of a coarse encoder. A finer one also
shows halves of the smallest, down to as many counts."""

TRIANGLE_STROKES = 6
"""Strokes of each triangle."""

LEG_TIME = 0.35
"""Time from end to end of a triangle, s."""

HOLD_TIME = 1.0

FREE_SPEED = 0.1
"""Speed of free motion, rad/s of the motor."""

ACCELERATION_TIME = 0.1
"""Time from standstill to speed, s."""

PAUSE_SHARE = 0.15
"""Share of free motion's moves that are followed by a pause of up to `HOLD_TIME`."""

SHORTEST_PIECE = 1e-6
"""Shortest piece of the motion, s: shorter ones are rounding."""

MOTION_SEED = 20060607


def exploration(
    low: float, high: float, count: float, fastest: float, time: float, number: int = 0
) -> SpeedProfile:
    """Return the motion from `low`, within `low`..`high` rad, at most `fastest` rad/s.

    `count` rad is that of the encoder; free motion lasts for about `time` s. Each `number` has a
    free motion of its own.
    """
    path, scale = _Path(low), bristle_scale(high - low, count)
    path.go((low + high) / 2, fastest / 4)
    for lengths in (*halved(TRIANGLE_LENGTHS[0], scale / count)[::-1], *TRIANGLE_LENGTHS):
        for leg in range(TRIANGLE_STROKES):
            length = lengths * scale * (0.5 if leg in (0, TRIANGLE_STROKES - 1) else 1.0)
            path.go(path.angle + (-1) ** leg * length, lengths * scale / LEG_TIME)
    path.hold(HOLD_TIME)
    rng = np.random.default_rng([MOTION_SEED, number])
    begun = path.times[-1]
    while path.times[-1] < begun + time:
        speed = math.exp(rng.uniform(math.log(FREE_SPEED), math.log(fastest)))
        way = math.exp(rng.uniform(math.log(scale), math.log(high - low)))
        way = min(way, speed * time / 10)
        room_up, room_down = high - path.angle, path.angle - low
        up = rng.uniform() < room_up / (room_up + room_down)
        path.go(path.angle + (min(way, room_up) if up else -min(way, room_down)), speed)
        if rng.uniform() < PAUSE_SHARE:
            path.hold(rng.uniform(0.1, HOLD_TIME))
    path.hold(HOLD_TIME)
    return SpeedProfile(tuple(path.times), tuple(path.speeds))


class _Path:
    """Points of a speed profile, from rest to rest."""

    def __init__(self, angle: float) -> None:
        self.angle = angle
        self.times, self.speeds = [0.0], [0.0]

    def go(self, angle: float, speed: float) -> None:
        """Move to an angle, rad, at a speed, rad/s, or as fast as the way allows."""
        way = angle - self.angle
        if way == 0:
            return
        ramp = ACCELERATION_TIME
        speed = min(speed, abs(way) / ramp)
        self._add(ramp, math.copysign(speed, way))
        self._add(abs(way) / speed - ramp, math.copysign(speed, way))
        self._add(ramp, 0.0)
        self.angle = angle

    def hold(self, time: float) -> None:
        """Stand still, s."""
        self._add(time, 0.0)

    def _add(self, time: float, speed: float) -> None:
        if time > SHORTEST_PIECE:
            self.times.append(self.times[-1] + time)
            self.speeds.append(speed)
