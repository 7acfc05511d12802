"""How ripple that nobody knows of shows in the torque that the filter finds.

While the rotor slides, the filter is an observer of angle, speed, friction and torque. It finds a
change of the drive torque late, and fast changes in part. What stays the same along a stroke is
shared between the torque and the stroke's own deviation. Errors by a drive torque follow the
filter's own gains (B. Friedland, IEEE Trans. Autom. Control 14(4) 359-367, 1969).
"""

from __future__ import annotations

import math

from rigtool.experiments.force_filter.plant import Plant, Record
from rigtool.numerics.arrays import Array
from rigtool.numerics.compiled import compiled

HELD_LENGTHS, SHOWN_TIME = 3.0, 12e-3
"""Lengths of the bearings' bristle in a step, below which they hold the rotor; and the time, s, in
which the filter's torque then shows a ripple."""

LARGEST_SHOWN = 2.0
"""Largest part of a wave that the filter's torque may show."""


def turned_inertia(plant: Plant) -> float:
    """Return the inertia at the rotor of all that turns, kg m2, on a tendon that does not yield."""
    return plant.inertia + plant.grasper_inertia / (plant.angle_ratio * plant.torque_factor)


@compiled
def show(s: Record, p: Record, follows: Array, torque: float) -> None:
    """Advance by a step the waves as the filter's torque shows them.

    Tendon and output turn with the rotor, and the filter is an observer of angle, speed, friction
    of the housing and torque. A drive torque that it does not know comes with its gains into each:
    `follows` (9,), of which the last three are the output's angle, speed and the bristle. Where the
    rotor is so slow that its bearings hold it, the torque follows within `SHOWN_TIME`.
    """
    output, speed, bristle = follows[6], follows[7], follows[8]
    if bristle * s.direction < -0.5:  # a stroke begins
        s.direction = 1.0 if bristle > 0.0 else -1.0
        s.sine[:] = s.cosine[:] = 0.0
    by_sine, by_cosine = bristle * math.sin(output), bristle * math.cos(output)
    left = math.exp(-abs(speed) * p.step_time / p.length)
    # what the tendon carries is felt with the friction that grows with it
    carried = 1.0 + p.load_friction * bristle * torque / math.hypot(torque, p.onset)
    bent = (1.0 - bristle if speed > 0.0 else 1.0 + bristle) * left * p.step_time / p.length
    last, lost = s.waves.shape[0] - 1, abs(speed) < p.slow
    for j in range(last + 1):
        held = by_sine * s.sine[j] + by_cosine * s.cosine[j] - p.friction * s.housing[j]
        s.housing[j] = left * s.housing[j] + bent * s.speed[j]
        s.speed[j] += p.step_time / p.inertia * (carried * s.seen[j] + held - s.waves[j])
        s.angle[j] += p.step_time * s.speed[j]
        before, off = s.seen[j], s.angle[j]
        s.angle[j] -= follows[0] * off
        s.speed[j] -= follows[1] * off
        s.housing[j] -= follows[2] * off
        s.sine[j] += follows[3] * off
        s.cosine[j] += follows[4] * off
        s.seen[j] += follows[5] / p.factor * off
        large = j < last and abs(s.seen[j]) > LARGEST_SHOWN
        lost = lost or large  # the last wave, which is a sum of the others
        if abs(speed) < p.slow or large or (lost and j == last):
            s.angle[j] = s.speed[j] = s.housing[j] = 0.0
            s.seen[j] = before + p.shown * (s.waves[j] - before)
