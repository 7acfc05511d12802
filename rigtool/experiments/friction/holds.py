"""Mean torque at constant speeds: holds, whole revolutions, and what scatter says of the mean.

Cogging and the amplifier's ripple repeat with the rotor's angle: over whole revolutions they
average out [7.1.3]. Noise that varies more slowly than the samples makes the mean of n samples
uncertain by

    u2 = S(0) / n,   S(0) = mean of |X_k|2 / n over the lowest k

with X the discrete Fourier transform of the torque (Heidelberger and Welch, Communications of the
ACM 24(4) 233-245, 1981); of N revolutions the k that are multiples of N are ripple and left out.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from rigtool.errors import InsufficientDataError
from rigtool.numerics.checks import require_rising, require_signals

Array = NDArray[np.float64]

STEADY = 1e-3
"""A hold changes its speed by less than this part of the highest speed in a second."""

BAND = 0.25
"""Settled is what stays within the range of the last part, widened by this much on either side."""

ORDINATES = 6
"""Lowest Fourier components from which the noise at zero frequency is taken."""

SHAKING_TIME = 0.05
"""Torque that varies faster than this, s, is the speed loop's own restlessness."""

SHAKING_LIMIT = 0.25
"""Speed that the torque's restlessness makes, relative to the mean: above, a hold is no hold."""

SHORTEST = 16
"""Samples that a hold needs."""

STANDSTILL = 1e-3
"""Speeds below this part of the highest one are standstill."""


@dataclass(frozen=True)
class Holds:
    """Means of constant-speed holds, all (n,).

    `speed` in rad/s with its sign, `torque` in N m, `u` its standard uncertainty with `dof`;
    `revolutions` counts the whole turns averaged, 0 where there was less than one. `shaking` is
    the standard deviation of speed that the torque's fast part makes, relative to the speed:
    above `SHAKING_LIMIT` the shaft starts and stops, and the torque belongs to no one speed.
    `settled` is how much was left out at the start, s.
    """

    speed: Array
    torque: Array
    u: Array
    dof: Array
    revolutions: Array
    shaking: Array
    settled: Array

    def __getitem__(self, chosen: NDArray[np.bool_]) -> Holds:
        return Holds(*(getattr(self, name)[chosen] for name in self.__dataclass_fields__))


def find_holds(
    *,
    time: ArrayLike,
    angle: ArrayLike,
    torque: ArrayLike,
    setpoint: ArrayLike | None,
    inertia: float,
) -> Holds:
    """Average torque over whole revolutions of each constant-speed hold in a recording.

    All signals (n,): `time` in s, measured `angle` and its `setpoint` in rad, `torque` in N m.
    `inertia` on the shaft in kg m2. Holds are where the set point's speed is constant; without a
    set point the whole recording is one. Settling is left out: all before the following error stays
    within its range in the last part of the hold; without a set point, what makes the mean of
    torque or speed less certain (`_warm_up`). Raises `InsufficientDataError` without a hold.
    """
    t, shaft, effort = require_signals(SHORTEST, time=time, angle=angle, torque=torque)
    require_rising(t)
    if setpoint is None:
        stretches = [(0, len(t))]
        wanted, watched = shaft, None
    else:
        _, wanted = require_signals(SHORTEST, time=t, position_setpoint=setpoint)
        stretches = _steady_stretches(t, wanted)
        watched = wanted - shaft
    holds = [
        _hold(t[a:b], wanted[a:b], effort[a:b], None if watched is None else watched[a:b], inertia)
        for a, b in stretches
        if b - a >= SHORTEST
    ]
    if not holds:
        raise InsufficientDataError(
            "no stretch of constant speed was found in the position set point: hold each speed "
            "for some revolutions"
        )
    return Holds(*np.array(holds).T)


def pool(parts: list[Holds]) -> Holds:
    """Put the holds of several recordings together."""
    names = Holds.__dataclass_fields__
    return Holds(*(np.concatenate([getattr(part, name) for part in parts]) for name in names))


def _steady_stretches(time: Array, setpoint: Array) -> list[tuple[int, int]]:
    """Return first and last + 1 sample of each stretch of constant speed other than zero."""
    speed = np.diff(setpoint) / np.diff(time)
    highest = float(np.max(np.abs(speed)))
    if highest == 0:
        return []
    # A change of speed between samples i and i + 1 ends a stretch at sample i + 1.
    change = np.abs(np.diff(speed)) / np.diff(time)[1:] > STEADY * highest
    change |= (np.diff(time)[1:] > 1.5 * np.median(np.diff(time))) | (
        np.abs(speed[1:]) < STANDSTILL * highest
    )
    edges = np.flatnonzero(np.diff(np.concatenate([[True], change, [True]]).astype(np.int8)))
    return [(int(a), int(b) + 2) for a, b in edges.reshape(-1, 2)]


def _hold(
    time: Array, position: Array, torque: Array, watched: Array | None, inertia: float
) -> tuple[float, ...]:
    """Return the columns of `Holds` for one hold."""
    travel = np.abs(position - position[-1])
    if watched is None:
        settled = max(_warm_up(torque), _warm_up(np.gradient(position, time)))
    else:
        settled = _settling(travel, watched)
    revolutions = int(travel[settled] / (2 * np.pi) + 1e-9)
    first = settled
    if revolutions >= 1:
        first = int(np.searchsorted(-travel, -revolutions * 2 * np.pi * (1 + 1e-9)))
    kept = torque[first:]
    speed = (position[-1] - position[first]) / (time[-1] - time[first])
    u, dof = _uncertainty(kept, revolutions)
    sample = float(np.median(np.diff(time)))
    shaking = _shaking(kept, sample, inertia) / max(abs(speed), 1e-300)
    left_out = float(time[settled] - time[0])
    return float(speed), float(np.mean(kept)), u, dof, float(revolutions), shaking, left_out


def _settling(travel: Array, watched: Array) -> int:
    """Return the first sample from which on a signal stays as it is in the last turn (or half)."""
    turns = travel[0] / (2 * np.pi)
    last = np.searchsorted(-travel, -2 * np.pi) if turns >= 2 else len(watched) // 2
    low, high = np.min(watched[last:]), np.max(watched[last:])
    margin = BAND * (high - low)
    outside = (watched[:last] < low - margin) | (watched[:last] > high + margin)
    return int(np.flatnonzero(outside)[-1]) + 1 if outside.any() else 0


def _warm_up(values: Array) -> int:
    """Return how many samples to leave out at the start, of the first half, for the surest mean.

    The d that minimises the squared standard error of the mean of what follows,
    sum over i >= d of (x_i - mean)^2 / (n - d)^2, over means of five samples (MSER-5: White,
    Simulation 69(6) 323-334, 1997). What settles costs more by its deviation than it adds.
    """
    batches = values[: len(values) // 5 * 5].reshape(-1, 5).mean(axis=1)
    batches = batches - batches.mean()
    left = np.arange(len(batches), 0, -1)
    sums, squares = (np.cumsum(part[::-1])[::-1] for part in (batches, batches**2))
    error = (squares - sums**2 / left) / left**2.0
    return 5 * int(np.argmin(error[: max(1, len(batches) // 2)]))


def _uncertainty(torque: Array, revolutions: int) -> tuple[float, float]:
    """Return the standard uncertainty of the mean of correlated samples and its dof."""
    n = len(torque)
    power = np.abs(np.fft.rfft(torque - np.mean(torque))) ** 2
    k = np.arange(1, len(power))
    if revolutions >= 2:
        k = k[k % revolutions != 0]
    lowest = power[k[:ORDINATES]]
    return math.sqrt(float(np.mean(lowest))) / n, 2.0 * len(lowest)


def _shaking(torque: Array, sample: float, inertia: float) -> float:
    """Return the standard deviation of speed that the fast part of the torque makes, rad/s.

    Samples that are too far apart do not show it: then it counts as none.
    """
    width = round(SHAKING_TIME / sample)
    if width < 10:
        return 0.0
    speed = np.cumsum(torque - _smooth(torque, width)) * sample / inertia
    return float(np.std(speed - _smooth(speed, width)))


def _smooth(values: Array, width: int) -> Array:
    """Return a moving mean, with the ends repeated."""
    padded = np.pad(values, (width // 2, width - 1 - width // 2), mode="edge")
    sums = np.concatenate([[0.0], np.cumsum(padded)])
    smooth: Array = (sums[width:] - sums[:-width]) / width
    return smooth
