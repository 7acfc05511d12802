"""Mean torque at constant speeds (holds) over whole revolutions, and its uncertainty.

Cogging and the amplifier's ripple repeat with the rotor's angle: over the angle of whole
revolutions they average out [7.1.3]. Noise that varies more slowly than the samples makes the mean
of n samples over the time T uncertain by

    u2 = S0/n (1 - (1 - exp(-2 pi K))/(2 pi K)),   S(k) = S0/(1 + (k/K)^2)

with S the power |X_k|2/n of the torque's discrete Fourier transform at k/T, taken as that of noise
with one corner, K/T (S0/n where K is large): a corner near 1/T is no flat spectrum. S0 for each K
by Whittle's likelihood of the lowest k (Arkiv for Matematik 2, 423, 1953); the logarithm of u2 is
averaged over K by likelihood. With N revolutions, the k that are multiples of N are ripple; they
are left out.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from rigtool.errors import InsufficientDataError
from rigtool.numerics.arrays import TINY, Array, Mask, joined
from rigtool.numerics.checks import require_rising, require_signals
from rigtool.numerics.plateaus import runs_of
from rigtool.numerics.settling import settled_from

STEADY_ACCELERATION = 1e-3
"""Acceleration in a hold, relative to the highest speed, stays below this, 1/s."""

NOISE_ORDINATES = 24
"""Lowest Fourier components from which noise is taken."""

NOISE_CORNERS = np.append(np.geomspace(0.5, 200.0, 24), 1e9)
"""Corners of the noise, K in cycles a hold; the last one is that of white noise."""

SAME_SPEED = 0.01
"""Relative difference of speeds up to which they are one."""

SHAKING_TIME = 0.05
"""Torque that varies faster than this, s, comes from the speed loop, not from friction."""

SHAKING_LIMIT = 0.25
"""Relative standard deviation of the speed, from fast torque, above which a hold is left out."""

UNEVEN_LIMIT = 0.12
"""Relative standard deviation of the speed, as the encoder shows it, above which a hold is left
out: it smooths a Stribeck curve by some 0.4 of its square."""

UNEVEN_COUNTS, UNEVEN_TIME = 3, 5e-3
"""Counts, and s, over which that speed is taken: friction that falls with speed swings the shaft
near the crossover of its loop, up to 100 Hz, and a whole period of that shows nothing."""

RIPPLE_ORDERS = 100
"""Orders of ripple that vary the speed over a turn: cogging of 12 slots and 14 poles has order 84,
which the inertia does not hold at low speed."""

MIN_SAMPLES = 16
"""Smallest number of samples in a hold."""

MIN_KEPT = 8
"""Smallest number of samples that settling and whole turns may leave of a hold."""

AT_REST = 1e-3
"""Speeds below this part of the highest one are standstill."""


@dataclass(frozen=True)
class Holds:
    """Means of constant-speed holds, all (n,).

    `speed` in rad/s with its sign, `torque` in N m, `u` its standard uncertainty with `dof`;
    `revolutions` counts the whole turns averaged, 0 where there was less than one. `shaking` is
    the standard deviation of speed that the torque's fast part makes, relative to the speed:
    above `SHAKING_LIMIT` the torque belongs to no single speed: the shaft starts and stops, say.
    `settled` is the time left out at the start, s; `lagging`, N m, is how far ripple that lags
    behind its angle may shift the torque; `uneven` the relative standard deviation of the
    speed as the encoder shows it, 0 where its step is not known.
    """

    speed: Array
    torque: Array
    u: Array
    dof: Array
    revolutions: Array
    shaking: Array
    settled: Array
    lagging: Array
    uneven: Array

    @property
    def steady(self) -> Mask:
        """Which holds turn evenly enough for their torque to belong to their speed, (n,)."""
        return (self.shaking <= SHAKING_LIMIT) & (self.uneven <= UNEVEN_LIMIT)

    @property
    def swing(self) -> Array:
        """The standard deviation of the speed about its mean, rad/s, (n,)."""
        return self.shaking * np.abs(self.speed)

    def __getitem__(self, chosen: Mask | NDArray[np.intp]) -> Holds:
        return Holds(*(getattr(self, name)[chosen] for name in self.__dataclass_fields__))

    def lagging_line(self) -> tuple[float, float]:
        """Return the line of `lagging` over speed: at rest, N m, and its slope, N m s/rad."""
        speed = np.abs(self.speed)
        apart = speed - speed.mean()
        slope = float(apart @ self.lagging / max(apart @ apart, TINY))
        return float(self.lagging.mean() - slope * speed.mean()), slope


def find_holds(
    *,
    time: ArrayLike,
    angle: ArrayLike,
    torque: ArrayLike,
    setpoint: ArrayLike | None,
    inertia: float,
    count: float = 0.0,
) -> Holds:
    """Average torque over whole revolutions of each constant-speed hold in a recording.

    All signals (n,): `time` in s, measured `angle` and its `setpoint` in rad, `torque` in N m.
    `inertia` on the shaft in kg m2, `count` the encoder's step in rad, 0 if unknown. Holds are
    where the set point's speed is constant; without a set point the whole recording is one.
    Settling is left out: with a set point, the samples before the following error stays in its
    range of the last turn; without one, the samples that make the mean of torque or speed less
    certain (`_warm_up`). Raises `InsufficientDataError` without a hold.
    """
    t, shaft, effort = require_signals(MIN_SAMPLES, time=time, angle=angle, torque=torque)
    require_rising(t)
    if setpoint is None:
        stretches = [(0, len(t))]
        wanted, watched = shaft, None
    else:
        _, wanted = require_signals(MIN_SAMPLES, time=t, position_setpoint=setpoint)
        stretches = _steady_stretches(t, wanted)
        watched = wanted - shaft
    found = [
        _hold(
            t[a:b],
            wanted[a:b],
            effort[a:b],
            None if watched is None else watched[a:b],
            inertia,
            count,
        )
        for a, b in stretches
        if b - a >= MIN_SAMPLES
    ]
    holds = [hold for hold in found if hold is not None]
    if not holds:
        raise InsufficientDataError(
            "no stretch of constant speed was found in the position set point that leaves "
            f"{MIN_KEPT} samples once it has settled: hold each speed for some revolutions"
        )
    return Holds(*np.array(holds).T)


def pool(parts: list[Holds]) -> Holds:
    """Return the holds of several recordings as one."""
    return Holds(*joined(parts, *Holds.__dataclass_fields__))


def _steady_stretches(time: Array, setpoint: Array) -> list[tuple[int, int]]:
    """Return first and last + 1 sample of each stretch of constant speed other than zero."""
    speed = np.diff(setpoint) / np.diff(time)
    highest = float(np.max(np.abs(speed)))
    if highest == 0:
        return []
    # A change of speed between samples i and i + 1 ends a stretch at sample i + 1.
    change = np.abs(np.diff(speed)) / np.diff(time)[1:] > STEADY_ACCELERATION * highest
    change |= (np.diff(time)[1:] > 1.5 * np.median(np.diff(time))) | (
        np.abs(speed[1:]) < AT_REST * highest
    )
    return [(first, last + 2) for first, last in runs_of(~change)]


def _hold(
    time: Array,
    position: Array,
    torque: Array,
    watched: Array | None,
    inertia: float,
    count: float,
) -> tuple[float, ...] | None:
    """Return the columns of `Holds` for one hold, None where too little of it has settled."""
    travel = np.abs(position - position[-1])
    if watched is None:
        settled = max(_warm_up(torque), _warm_up(np.gradient(position, time)))
    else:
        settled = settled_from(watched, len(watched) // 2)
    revolutions = int(travel[settled] / (2 * np.pi) + 1e-9)
    first = settled
    if revolutions >= 1:
        first = int(np.searchsorted(-travel, -revolutions * 2 * np.pi * (1 + 1e-9)))
    kept = torque[first:]
    if len(kept) < MIN_KEPT:
        return None
    speed = (position[-1] - position[first]) / (time[-1] - time[first])
    u, dof = _uncertainty(kept, revolutions)
    sample = float(np.median(np.diff(time)))
    shaking = _shaking(kept, sample, inertia) / max(abs(speed), TINY)
    left_out = float(time[settled] - time[0])
    shaft = position if watched is None else position - watched
    work, lagging = _by_ripple(time[first:], shaft[first:], kept, revolutions)
    uneven = _uneven(shaft[first:], speed * sample, sample, count) if count else 0.0
    turns, mean = float(revolutions), float(np.mean(kept)) + work
    return float(speed), mean, u, dof, turns, shaking, left_out, lagging, uneven


def _uneven(angle: Array, step: float, sample: float, count: float) -> float:
    """Return the relative standard deviation of the speed; `step` rad is the mean of a `sample`.

    Over as many samples as the shaft needs for `UNEVEN_COUNTS` of the encoder, and `UNEVEN_TIME`;
    less what its steps, `count` rad, make.
    """
    way = max(UNEVEN_COUNTS * count, UNEVEN_TIME / sample * abs(step))
    width = min(math.ceil(way / max(abs(step), TINY)), len(angle) // 2)
    moved = angle[width:] - angle[:-width]
    square = float(np.var(moved)) - count**2 / 4  # the most, of a shaft that turns evenly
    return math.sqrt(max(square, 0.0)) / max(abs(step) * width, TINY)


def _by_ripple(time: Array, angle: Array, torque: Array, revolutions: int) -> tuple[float, float]:
    """Return what to add to the mean torque where ripple varies the speed over a turn.

    Ripple that belongs to the angle does no work in a whole turn, but the shaft stays longer where
    ripple holds it back: the mean over angle, int torque dangle / int dangle, is free of ripple,
    that over time is not. They differ by the mean of torque times relative speed, order by order;
    what noise adds has no order. Last, the part of torque and speed in quadrature: as much work as
    ripple does that lags behind its angle by up to a quarter of a period.
    """
    place, turned = (time - time[0]) / (time[-1] - time[0]), angle[-1] - angle[0]
    if revolutions < 1 or abs(turned) < np.pi:  # a shaft that is not read
        return 0.0, 0.0
    highest = min(RIPPLE_ORDERS, (len(angle) - 1) // (4 * revolutions))
    cycles = np.arange(1, highest + 1) * revolutions
    swing, wave = (
        np.fft.rfft(signal[:-1])[cycles] * (2 / (len(angle) - 1))
        for signal in ((angle - angle[0]) / turned - place, torque)
    )
    power = wave * np.conj(2j * np.pi * cycles * swing) / 2
    return float(power.real.sum()), float(np.abs(power.imag).sum())


def _warm_up(values: Array) -> int:
    """Return how many samples of the first half to leave out for the most certain mean.

    The d that minimises the squared standard error of the mean of the rest,
    sum over i >= d of (x_i - mean)^2 / (n - d)^2, over means of five samples (MSER-5: White,
    Simulation 69(6) 323-334, 1997). Samples of the settling raise this sum more than
    their number lowers it.
    """
    batches = values[: len(values) // 5 * 5].reshape(-1, 5).mean(axis=1)
    batches = batches - batches.mean()
    left = np.arange(len(batches), 0, -1)
    sums, squares = (np.cumsum(part[::-1])[::-1] for part in (batches, batches**2))
    error = (squares - sums**2 / left) / left**2.0
    return 5 * int(np.argmin(error[: max(1, len(batches) // 2)]))


def _uncertainty(torque: Array, revolutions: int) -> tuple[float, float]:
    """Return the standard uncertainty of the mean of correlated samples, and its dof."""
    return mean_uncertainties([(torque, revolutions)])[0]


def mean_uncertainties(
    series: Sequence[tuple[Array, int]], ordinates: int = NOISE_ORDINATES
) -> list[tuple[float, float]]:
    """Return the standard uncertainty of each mean of correlated samples, N m, and its dof.

    The `series` (n,), N m, each with its whole turns, last equally long: they share the corner of
    their noise, and each has its own level, from its lowest `ordinates`.
    """
    noise = [_noise_by_corner(*one, ordinates) for one in series]
    log_likelihood = np.sum([likelihood for _, likelihood, _ in noise], axis=0)
    likelihood = np.exp(log_likelihood - log_likelihood.max())
    likelihood /= likelihood.sum()
    found = []
    for log_u2, _, count in noise:
        if not np.isfinite(log_u2).all():  # no noise
            found.append((0.0, 2.0 * count))
            continue
        mean = float(likelihood @ log_u2)
        spread = float(likelihood @ (log_u2 - mean) ** 2) + 1 / count
        found.append((math.exp(mean / 2), 2 / spread))
    return found


def _noise_by_corner(torque: Array, revolutions: int, ordinates: int) -> tuple[Array, Array, int]:
    """Return log u^2 of a mean and its log-likelihood by corner, and the number of ordinates.

    The logarithm is minus infinity where there is no noise.
    """
    n = len(torque)
    power = np.abs(np.fft.rfft(torque - np.mean(torque))) ** 2 / n
    k = np.arange(1, len(power))
    if revolutions >= 2:
        k = k[k % revolutions != 0]
    k = k[:ordinates]
    if not power[k].any():
        return np.full(NOISE_CORNERS.shape, -np.inf), np.zeros(NOISE_CORNERS.shape), len(k)
    shape = 1 + (k / NOISE_CORNERS[:, None]) ** 2
    level = (power[k] * shape).mean(axis=1)
    log_likelihood = np.log(shape).sum(axis=1) - len(k) * np.log(level)
    cycles = 2 * np.pi * NOISE_CORNERS
    return np.log(level * (1 + np.expm1(-cycles) / cycles) / n), log_likelihood, len(k)


def _shaking(torque: Array, sample: float, inertia: float) -> float:
    """Return the standard deviation of speed that the fast part of the torque makes, rad/s.

    Zero where the samples are too far apart to show it.
    """
    width = round(SHAKING_TIME / sample)
    if width < 10:
        return 0.0
    speed = np.cumsum(torque - _around(torque, width)) * sample / inertia
    return float(np.std(speed - _around(speed, width)))


def _around(values: Array, width: int) -> Array:
    """Return the mean of `width` values (n,) around each; the first and the last go on beyond."""
    before = width // 2
    sums = np.cumsum(np.pad(values - values.mean(), (before + 1, width - before - 1), mode="edge"))
    return (sums[width:] - sums[:-width]) / width + values.mean()
