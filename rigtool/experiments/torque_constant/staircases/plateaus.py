"""Plateaus of staircases of current against a force gauge, and the amplifier's linearity [7.1.1].

torque = mean force on a plateau * arm length
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from rigtool.errors import InsufficientDataError
from rigtool.numerics.arrays import Array, Mask
from rigtool.numerics.checks import require_rising, require_signals
from rigtool.numerics.plateaus import group_numbers

LEVEL_TOLERANCE = 1e-3
"""Part of the span within which set points count as one level."""

SWING_PARTS = 96
"""Parts of a plateau's time that resolve the arm's swing after each step."""

ALIKE = 3.0
"""Standard uncertainties within which deviations of levels could each be the largest."""

MINIMUM_PLATEAUS = 8
"""Smallest number of plateaus in a recording."""


@dataclass(frozen=True)
class Plateaus:
    """Means over the settled part of each constant stretch of set point, all (n,).

    `current_setpoint` and `current` in A, `torque` in N m, `temperature` in degC, `rotor_angle` in
    rad (NaN where unknown), `begin` and `end` in s, `middle` in s that of the settled part;
    `staircase` numbers the staircases from 0.
    `position` in rad is the rotor's as it gives way (NaN where unknown), in steps of `count`.
    `course` (n, COURSE) in N m is the torque over the whole stretch, its settling included, as
    means over equal parts of its time. `resolution` in N m is that of the gauge's readings, `noise`
    in N m the scatter of a reading from one to the next, `readings` their number in the stretch.
    """

    current_setpoint: Array
    current: Array
    torque: Array
    temperature: Array
    rotor_angle: Array
    position: Array
    count: Array
    begin: Array
    middle: Array
    end: Array
    staircase: NDArray[np.int64]
    course: Array
    resolution: Array
    noise: Array
    readings: Array


def plateaus_of_set_point(
    *,
    time: ArrayLike,
    current_setpoint: ArrayLike,
    current: ArrayLike,
    force: ArrayLike,
    temperature: ArrayLike,
    rotor_angle: ArrayLike | None,
    arm_length: float,
    settle_time: float,
    gauge_resolution: float = 0.0,
    position: ArrayLike | None = None,
    count: float = 0.0,
) -> Plateaus:
    """Find the plateaus of all staircases in a recording, from the set point itself.

    All signals (n,) in SI units, temperature in degC, `position` of the rotor while the arm gives
    way, where that is known, in steps of `count`; `arm_length` in m; the first `settle_time`
    seconds of each plateau are left out. The gauge resolves `gauge_resolution` in N, or more
    coarsely where its readings show it. A gap in time or another rotor angle starts a new
    staircase. Raises `InsufficientDataError` where the set point is no staircase.
    """
    t, setpoint, measured, newton, degc = require_signals(
        10,
        time=time,
        current_setpoint=current_setpoint,
        current=current,
        force=force,
        temperature=temperature,
    )
    angle = np.zeros(len(t))
    if rotor_angle is not None:
        _, angle = require_signals(1, time=t, rotor_angle=rotor_angle)
    sample = require_rising(t)
    new_staircase = (np.diff(t) > 10 * sample + 0.5 * settle_time) | (np.abs(np.diff(angle)) > 0.01)
    starts, flat = _stretches(setpoint, new_staircase)
    number = np.repeat(np.arange(len(starts)), np.diff(np.append(starts, len(t))))
    settled = t - t[starts][number] >= settle_time - 0.5 * sample
    counts = np.bincount(number, weights=settled)
    keep = (counts >= 3) & flat
    if np.count_nonzero(keep) < MINIMUM_PLATEAUS:
        raise InsufficientDataError(
            f"the current set point has {np.count_nonzero(keep)} plateaus longer than the "
            f"{settle_time:g} s of settling, {MINIMUM_PLATEAUS} are needed: hold each step longer, "
            "or record more often"
        )

    def mean(values: Array) -> Array:
        return np.bincount(number, weights=values * settled)[keep] / counts[keep]

    ends = np.append(starts[1:], len(t)) - 1
    staircase = np.concatenate([[0], np.cumsum(new_staircase)])[starts][keep]
    return Plateaus(
        current_setpoint=mean(setpoint),
        current=mean(measured),
        torque=mean(newton) * arm_length,
        temperature=mean(degc),
        rotor_angle=mean(angle) if rotor_angle is not None else np.full(keep.sum(), np.nan),
        position=(
            mean(np.asarray(position, dtype=np.float64))
            if position is not None
            else np.full(keep.sum(), np.nan)
        ),
        count=np.full(keep.sum(), count),
        begin=t[starts][keep],
        middle=mean(t) + sample / 2,
        end=t[ends][keep] + sample,
        staircase=np.unique(staircase, return_inverse=True)[1].astype(np.int64),
        course=_course(newton, starts[keep], ends[keep] + 1) * arm_length,
        resolution=np.full(keep.sum(), max(gauge_resolution, _resolution(newton)) * arm_length),
        noise=_noise(newton, number, settled)[keep] * arm_length,
        readings=np.bincount(number)[keep].astype(np.float64),
    )


def _stretches(setpoint: Array, ends: Mask) -> tuple[NDArray[np.intp], Mask]:
    """Return where constant stretches of a set point (n,) start, and whether each is flat (k,).

    Stretches also end where `ends` (n - 1,) is true.
    """
    span = float(np.ptp(setpoint))
    if span == 0:
        raise InsufficientDataError(
            f"the current set point is {setpoint[0] + 0.0:g} A throughout: a staircase is needed"
        )
    tolerance = LEVEL_TOLERANCE * span
    changes = ends | (np.abs(np.diff(setpoint)) > tolerance)
    starts = np.concatenate([[0], np.flatnonzero(changes) + 1])
    height = np.maximum.reduceat(setpoint, starts) - np.minimum.reduceat(setpoint, starts)
    return starts, height <= 3 * tolerance


def pool(parts: Sequence[Plateaus]) -> Plateaus:
    """Return the plateaus of several runs as one series in time."""
    placed = [parts[0]]
    for part in parts[1:]:
        before = placed[-1]
        later = before.end[-1] - part.begin[0] + 3600.0
        moved = {
            "begin": part.begin + later,
            "middle": part.middle + later,
            "end": part.end + later,
            "staircase": part.staircase + before.staircase[-1] + 1,
        }
        placed.append(replace(part, **moved))
    names = vars(parts[0])
    return Plateaus(**{name: np.concatenate([vars(p)[name] for p in placed]) for name in names})


def _resolution(readings: Array) -> float:
    """Return the step in which an instrument reads: what all differences are multiples of.

    Euclid's algorithm over all differences; 0 where it ends within the rounding of the numbers. Two
    readings may be many steps apart, where each plateau has a single one.
    """
    rounding = SINGLE_ROUNDING * float(np.abs(readings).max(initial=0.0))
    difference = np.diff(np.unique(readings))
    difference = left = difference[difference > 4 * rounding]
    step = 0.0
    while left.size and left.min() > FEWEST_ROUNDINGS * rounding:
        step = float(left.min())
        number = np.round(difference / step)
        rest = np.abs(difference - number * step)
        left = rest[rest > (2 + number) * rounding]  # the step itself is rounded
    return step if not left.size else 0.0


def _noise(values: Array, number: NDArray[np.int64], settled: Mask) -> Array:
    """Return the standard deviation of noise in the settled values of each stretch, (stretches,).

    Second differences contain the noise and little of a swing (J. von Neumann et al., Ann. Math.
    Statist. 12, 153, 1941, for first differences).
    """
    second = np.diff(values, 2)
    within = settled[:-2] & (number[:-2] == number[2:])
    square = np.bincount(number[1:-1], weights=second**2 * within, minlength=number[-1] + 1)
    count = np.bincount(number[1:-1], weights=within, minlength=number[-1] + 1)
    return np.sqrt(square / np.maximum(count, 1) / 6)


def _course(values: Array, start: NDArray[np.int64], stop: NDArray[np.int64]) -> Array:
    """Return means (n, COURSE) over equal parts of values[start:stop], for n such stretches."""
    total = np.concatenate([[0.0], np.cumsum(values)])
    length = (stop - start)[:, None]
    edges = start[:, None] + length * np.linspace(0, 1, SWING_PARTS + 1)
    integral = np.interp(edges, np.arange(len(total)), total)
    return np.diff(integral) * SWING_PARTS / length


SINGLE_ROUNDING = 2.0**-23
"""Rounding of a stored reading, relative."""

FEWEST_ROUNDINGS = 40
"""Of the largest reading: a step of an instrument is larger."""


@dataclass(frozen=True)
class Linearity:
    """Measured current = offset + gain * set point, and the deviation of each level from it, A.

    `dof` belongs to gain and offset: the levels' where these lie off the line by more than repeats
    scatter, else the repeats', as in `deviation_dof`.
    """

    gain: float
    gain_u: float
    offset: float
    offset_u: float
    dof: int
    deviation: float
    deviation_u: float
    deviation_dof: int
    current_setpoint: Array
    current: Array
    deviations: Array


def amplifier_linearity(plateaus: Plateaus) -> Linearity:
    """Fit the amplifier's DC characteristic through the means of each level [7.1.1].

    `deviation` is the largest distance of a level's mean from the line, A: where many are as large
    within scatter, up to sqrt(2 ln n) standard uncertainties too large on average (M. R. Leadbetter
    et al., Extremes and Related Properties of Random Sequences, 1983, section 1.5), which is in its
    uncertainty. Raises `InsufficientDataError` for fewer than 3 levels.
    """
    step = LEVEL_TOLERANCE * float(np.ptp(plateaus.current_setpoint))
    level = group_numbers(plateaus.current_setpoint, step)
    count = np.bincount(level)
    if len(count) < 3:
        raise InsufficientDataError(
            f"the staircases have {len(count)} levels of current, 3 are needed for the "
            "linearity of the amplifier: raise `steps`"
        )
    setpoint = np.bincount(level, weights=plateaus.current_setpoint) / count
    current = np.bincount(level, weights=plateaus.current) / count
    scatter = float(np.sum((plateaus.current - current[level]) ** 2))
    dof = max(len(level) - len(count), 1)
    design = np.column_stack([setpoint, np.ones(len(setpoint))])
    inverse = np.linalg.pinv(design)
    gain, offset = inverse @ current
    deviations = current - design @ np.array([gain, offset])
    # The gain rests on the ends, which have fewer plateaus. Deviations count as scatter, too.
    by_scatter = inverse**2 @ (scatter / dof / count)
    by_lack = np.sum(inverse**2, axis=1) * float(deviations @ deviations) / (len(count) - 2)
    lacks = bool(by_lack[0] > by_scatter[0])
    u = np.sqrt(by_lack if lacks else by_scatter)
    worst = int(np.argmax(np.abs(deviations)))
    level_u = math.sqrt(scatter / dof / count[worst])
    # The largest of n alike is too large by scatter, by up to sqrt(2 ln n) u on average.
    alike = np.count_nonzero(np.abs(deviations) >= abs(deviations[worst]) - ALIKE * level_u)
    return Linearity(
        gain=float(gain),
        gain_u=float(u[0]),
        offset=float(offset),
        offset_u=float(u[1]),
        dof=len(count) - 2 if lacks else dof,
        deviation=float(abs(deviations[worst])),
        deviation_u=level_u * math.sqrt(1 + 2 * math.log(alike)),
        deviation_dof=dof,
        current_setpoint=setpoint,
        current=current,
        deviations=deviations,
    )
