"""A load on the end of a springy tendon: where it is and what it pulls with [8.2, Fig. 61-63].

    J a'' = s - tip z - M sin(a),   s = k (b - a) + c (b' - a')

b is the output angle that the motor's own angle stands for, a that of the grasper, which lags; s is
the torque that the tendon carries, M = F r the moment of the hanging load about the axis and
J = F r^2 / g its inertia. z is the direction of the joint's friction, a bristle that bends by
`CONTACT_ANGLE` before it slides (P. R. Dahl, AIAA J. 14(12) 1675-1682, 1976). At rest s = M sin(a)
and a = b - s / k: the shift of the peak; a moving load swings at sqrt(k / J): the 5 Hz of Fig. 61.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy import constants

from rigtool.numerics.arrays import Array
from rigtool.numerics.compiled import compiled

CONTACT_ANGLE = 0.01
"""Angle over which a friction contact turns round, rad: small against a stroke."""

FASTEST = 2 * math.pi * 80.0
"""Resonance that an unloaded grasper is given, rad/s: its own inertia is not known, and all that
matters of it is that it follows at once."""

STEP = 0.1
"""Longest step of the integration, in radians of the fastest resonance; it is stable below 2."""

SETTLING = 2.0
"""Time after which a swing is taken to repeat itself, s: ten cycles of 5 Hz."""


@dataclass(frozen=True)
class Tendon:
    """Stiffness N m/rad, damping N m s/rad and friction of the far joint N m, at the output."""

    stiffness: float
    damping: float
    tip_friction: float


def swing(
    angle: Array, period: float, tendon: Tendon, moment: float, arm: float
) -> tuple[Array, Array]:
    """Return the tendon's torque, N m, and the grasper's angle, rad, over one period (n,).

    `angle` (n,) rad is the motor's angle at the output over a motion of this period, s, that
    repeats; `moment` N m is that of the hanging load at 90 degrees, `arm` m where it hangs.
    """
    inertia = max(moment * arm / constants.g, tendon.stiffness / FASTEST**2)
    resonance = math.sqrt(tendon.stiffness / inertia)
    count = angle.size
    finer = max(1, math.ceil(period / count * resonance / STEP))
    before = math.ceil(SETTLING / period * count)
    torque, grasper = np.empty(count), np.empty(count)
    _swing(
        angle,
        period / count,
        finer,
        before,
        inertia,
        tendon.stiffness,
        tendon.damping,
        tendon.tip_friction,
        moment,
        torque,
        grasper,
    )
    return torque, grasper


def contact(speed: Array, period: float) -> Array:
    """Return the direction of friction, -1 to 1 (n,), from a speed (n,) rad/s that repeats."""
    direction = np.empty(speed.size)
    _contact(speed * (period / speed.size / CONTACT_ANGLE), direction)
    return direction


@compiled
def _swing(
    angle: Array,
    interval: float,
    finer: int,
    before: int,
    inertia: float,
    stiffness: float,
    damping: float,
    tip: float,
    moment: float,
    torque: Array,
    grasper: Array,
) -> None:
    """Integrate by semi-implicit Euler, the damping and the bristle implicitly."""
    count = angle.size
    dt = interval / finer
    a, speed, z = angle[-before % count], 0.0, 0.0
    for n in range(-before, count):
        i = n % count
        here = angle[i]
        rise = (angle[(i + 1) % count] - here) / finer
        for j in range(finer):
            b = here + j * rise
            driven = stiffness * (b - a) + damping * rise / dt
            if j == 0:
                torque[i], grasper[i] = driven - damping * speed, a
            z = (z + speed * dt / CONTACT_ANGLE) / (1.0 + abs(speed) * dt / CONTACT_ANGLE)
            pull = driven - tip * z - moment * math.sin(a)
            speed = (speed + dt * pull / inertia) / (1.0 + dt * damping / inertia)
            a += dt * speed


@compiled
def _contact(way: Array, direction: Array) -> None:
    z = 0.0
    for _ in range(2):
        for i in range(way.size):
            z = (z + way[i]) / (1.0 + abs(way[i]))
            direction[i] = z
