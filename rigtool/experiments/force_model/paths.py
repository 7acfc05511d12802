"""Effects that depend on the path: bristles, lagging waves, a load swinging on its tendon.

bristle     dz = (sign(dx) - z) |dx| / length, solved exactly for each step of a path
            (P. R. Dahl, AIAA J. 14(12) 1675-1682, 1976): it depends on the path, not on time
lag         T dy/dt = u - y, exact for an input that is linear between samples
tendon      J a'' = s - t z - M sin a,  s = k (b - a) + c (b' - a'): `tendon`
"""

from __future__ import annotations

import math

import numpy as np

from rigtool.numerics.arrays import Array
from rigtool.numerics.compiled import compiled

SWING_SETTLING_TIME = 2.0
"""Time after which a swing is taken to repeat itself, s."""

RESONANCE_STEP = 0.05
"""Longest step of the tendon's integration, in radians x of its resonance. A leapfrog raises the
resonance by x^2/24, so that the stiffness seems larger by 2e-4."""


def bristle(path: Array, length: float, periodic: bool) -> Array:
    """Return the deflection, -1 to 1 (n,), along a path (n,), both in rad.

    A path that repeats is followed twice, and the second time counts.
    """
    found = np.empty(path.size)
    _bristle(path, length, 2 if periodic else 1, found)
    return found


def lagged(waves: Array, interval: float, time: float, periodic: bool) -> Array:
    """Return waves (m, n), sampled every `interval` s, after a first-order lag of `time` s."""
    if not len(waves):
        return waves.copy()
    found = np.empty_like(waves)
    _lag(waves, interval / time, 2 if periodic else 1, found)
    return found


def tendon(
    angle: Array,
    interval: float,
    stiffness: float,
    damping: float,
    inertia: float,
    tip_friction: float,
    tip_length: float,
    moment: float,
    periodic: bool,
) -> tuple[Array, Array]:
    """Return torque carried, N m, and angle of the output, rad, (n,) each.

    `angle` (n,) is the motor's at the output, `inertia` kg m2 and `moment` N m those of what hangs
    on the output.
    """
    finer = max(1, math.ceil(interval * math.sqrt(stiffness / inertia) / RESONANCE_STEP))
    carried, output = np.empty(angle.size), np.empty(angle.size)
    _tendon(
        angle,
        interval,
        finer,
        stiffness,
        damping,
        inertia,
        tip_friction,
        tip_length,
        moment,
        1 + math.ceil(SWING_SETTLING_TIME / (interval * angle.size)) if periodic else 1,
        carried,
        output,
    )
    return carried, output


@compiled
def _bristle(path: Array, length: float, rounds: int, found: Array) -> None:
    z = 0.0
    last = path[0]
    for _ in range(rounds):
        for i in range(path.size):
            d = path[i] - last
            last = path[i]
            sign = 1.0 if d > 0 else -1.0
            z = sign - (sign - z) * math.exp(-abs(d) / length)
            found[i] = z


@compiled
def _lag(waves: Array, x: float, rounds: int, found: Array) -> None:
    kept = math.exp(-x)
    after = 1.0 - (1.0 - kept) / x
    before = (1.0 - kept) / x - kept
    count = waves.shape[1]
    for m in range(waves.shape[0]):
        y, last = waves[m, 0], waves[m, 0]
        for _ in range(rounds):
            for i in range(count):
                y = kept * y + before * last + after * waves[m, i]
                last = waves[m, i]
                found[m, i] = y


@compiled
def _tendon(
    angle: Array,
    interval: float,
    finer: int,
    stiffness: float,
    damping: float,
    inertia: float,
    tip: float,
    tip_length: float,
    moment: float,
    rounds: int,
    carried: Array,
    output: Array,
) -> None:
    """Integrate by a leapfrog, of second order also with the damping: angles of the output and its
    bristle are half a step ahead of its speed. The torque in the tendon is the mean of both half
    steps about a sample. Between samples the motor's angle is a cubic with mean slopes at both (E.
    Catmull, R. Rom 1974): corners would let the output ring."""
    count = angle.size
    dt = interval / finer
    half = dt * damping / (2.0 * inertia)
    a, speed, z = angle[0] - moment * math.sin(angle[0]) / stiffness, 0.0, 0.0
    driven = stiffness * (angle[0] - a)
    for n in range(rounds):
        for i in range(count):
            here = angle[i]
            there = angle[(i + 1) % count] if rounds > 1 or i + 1 < count else here
            before = angle[i - 1] if n + i else here
            after = angle[(i + 2) % count] if rounds > 1 or i + 2 < count else there
            leaving, arriving = (there - before) / 2.0, (after - here) / 2.0
            square = 3.0 * (there - here) - 2.0 * leaving - arriving
            cube = 2.0 * (here - there) + leaving + arriving
            output[i], carried[i] = a - 0.5 * dt * speed, 0.5 * driven
            for j in range(finer):
                x = (j + 0.5) / finer
                b = here + x * (leaving + x * (square + x * cube))
                rate = (leaving + x * (2.0 * square + 3.0 * x * cube)) / interval
                driven = stiffness * (b - a) + damping * rate
                pull = driven - tip * z - moment * math.sin(a)
                slower = speed
                speed = ((1.0 - half) * speed + dt * pull / inertia) / (1.0 + half)
                driven -= damping * 0.5 * (slower + speed)
                if j == 0:
                    carried[i] += 0.5 * driven
                d = dt * speed
                sign = 1.0 if d > 0 else -1.0
                z = sign - (sign - z) * math.exp(-abs(d) / tip_length)
                a += d
