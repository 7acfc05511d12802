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
"""Longest step of the tendon's integration, in radians of its resonance."""


def bristle(path: Array, length: float, periodic: bool) -> Array:
    """Return the deflection, -1 to 1 (n,), along a path (n,), both in rad.

    A path that repeats is gone through twice, of which the second time counts.
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
    """Integrate by the midpoint rule (G. G. Dahlquist, BIT 3, 27-43, 1963), the bristle exactly.

    Between its samples the motor's angle is a cubic (Hermite), whose slope at a sample is half of
    the rise from the one before to the one after.
    """
    count, wraps = angle.size, rounds > 1
    dt = interval / finer
    half = dt / (2.0 * inertia)
    kept = 1.0 + half * (damping + stiffness * dt / 2.0)
    a, speed, z = angle[0] - moment * math.sin(angle[0]) / stiffness, 0.0, 0.0
    slope = (angle[1 % count] - (angle[count - 1] if wraps else angle[0])) / 2.0
    for _ in range(rounds):
        for i in range(count):
            here, after = angle[i], i + 2
            there = angle[(i + 1) % count if wraps else min(i + 1, count - 1)]
            next_slope = (angle[after % count if wraps else min(after, count - 1)] - here) / 2.0
            carried[i] = stiffness * (here - a) + damping * (slope / interval - speed)
            output[i] = a
            square = 3.0 * (there - here) - 2.0 * slope - next_slope
            cube = slope + next_slope - 2.0 * (there - here)
            for j in range(finer):
                x = (j + 0.5) / finer
                b = here + x * (slope + x * (square + x * cube))
                rate = (slope + x * (2.0 * square + x * 3.0 * cube)) / interval
                d = dt * speed
                sign = 1.0 if d > 0 else -1.0
                z = sign - (sign - z) * math.exp(-abs(d) / tip_length)
                pull = stiffness * (b - a) + damping * rate - tip * z
                pull -= moment * math.sin(a + d / 2.0)
                middle = (speed + half * pull) / kept
                speed = 2.0 * middle - speed
                a += dt * middle
            slope = next_slope
