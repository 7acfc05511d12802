"""Torque against speed from a slow sweep [7.2.1, 7.2.2, Fig. 30, 32, 34].

torque(v) = mean of (torque - J a) over the samples in a bin of speed. In a bin through which the
shaft turns more than once the mean covers whole revolutions only, so that ripple averages out. Its
standard uncertainty is that of correlated samples, from the spectrum over the angle between the
orders of the ripple, as in a hold: neighbouring turns share slow noise, and their scatter alone
shows too little of it.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike, NDArray

from rigtool.errors import InsufficientDataError
from rigtool.experiments.friction.holds import MIN_SAMPLES, mean_uncertainties
from rigtool.numerics.arrays import TINY, Array
from rigtool.numerics.checks import require_rising, require_signals

SPEED_BINS = 60
"""Number of bins of speed over the whole sweep."""

ACCELERATION_LIMIT = 2.0
"""Largest acceleration in the sweep, relative to its median."""

BIN_ORDINATES = 6
"""Fourier components from which the noise of a bin is taken: up to some 10 Hz in a second. Above,
the loop and the encoder's steps make more than friction does."""


@dataclass(frozen=True)
class TorqueSpeed:
    """Means by bin, (n,): `speed` in rad/s, `torque` in N m, whole `revolutions` averaged.

    `u` is the standard uncertainty of the torque, N m, with its degrees of freedom `dof`; NaN where
    a pass through a bin holds fewer than two turns, in which noise and ripple look alike.
    """

    speed: Array
    torque: Array
    revolutions: Array
    u: Array
    dof: Array


def torque_speed_curve(
    *, time: ArrayLike, setpoint: ArrayLike, torque: ArrayLike, inertia: float
) -> TorqueSpeed:
    """Return the torque-speed curve of a sweep.

    `time` (n,) in s, `setpoint` of the shaft's angle in rad, `torque` in N m, `inertia` in kg m2.
    Raises `InsufficientDataError` where the speed does not sweep.
    """
    t, angle, effort = require_signals(100, time=time, position_setpoint=setpoint, torque=torque)
    require_rising(t)
    speed = np.gradient(angle, t)
    acceleration = np.gradient(speed, t)
    if np.ptp(speed) <= 1e-6 * max(np.abs(speed).max(), TINY):
        raise InsufficientDataError(
            f"the speed set point stays at {speed[0]:.3g} rad/s: a sweep runs through speeds"
        )
    usual = float(np.median(np.abs(acceleration)))
    swept = np.abs(acceleration) <= ACCELERATION_LIMIT * usual
    edges = np.linspace(speed[swept].min(), speed[swept].max(), SPEED_BINS + 1)
    number = np.clip(np.digitize(speed, edges) - 1, 0, SPEED_BINS - 1)
    # One pass through one bin is one stretch of samples.
    label = np.where(swept, number, -1)
    starts = np.concatenate([[0], np.flatnonzero(np.diff(label)) + 1, [len(label)]])
    rows, parts = [], []
    for first, last in pairwise(starts.tolist()):
        if label[first] >= 0 and last - first >= 2:
            kept, whole = _whole_turns(angle[first:last])
            part = slice(first + kept.start, first + kept.stop)
            corrected = effort[part] - inertia * acceleration[part]
            rows.append((label[first], np.mean(speed[part]), np.mean(corrected), whole))
            parts.append((angle[part], speed[part], corrected))
    if not rows:
        raise InsufficientDataError(
            f"the speed set point leaves each of {SPEED_BINS} ranges of speed with the next "
            "sample: its steps are too coarse for a curve; sweep more slowly"
        )
    passes = np.array(rows)
    # A sweep up and down passes each bin twice: average the passes.
    _, index = np.unique(passes[:, 0], return_inverse=True)
    count = np.bincount(index)
    sums: list[Array] = [np.bincount(index, column).astype(float) for column in passes[:, 1:].T]
    middle, level, turns = sums[0] / count, sums[1] / count, sums[2]
    slope = np.gradient(level, middle)[index] if len(level) > 1 else np.zeros(len(passes))
    u, dof = _noise(parts, passes[:, 3].astype(int), slope)
    square, fourth = np.bincount(index, u**2), np.bincount(index, u**4 / dof)
    with np.errstate(invalid="ignore"):  # Welch and Satterthwaite
        return TorqueSpeed(middle, level, turns, np.sqrt(square) / count, square**2 / fourth)


def _noise(
    parts: Sequence[tuple[Array, Array, Array]], turns: NDArray[np.intp], slope: Array
) -> tuple[Array, Array]:
    """Return u of the mean torque of each pass and its dof (p,); NaN for fewer than two `turns`.

    `parts` hold angle, speed and torque of each pass, `slope` (p,) is that of torque over speed,
    N m s/rad. Over the angle, ripple keeps its orders while the speed changes.
    """
    found = np.full((len(parts), 2), math.nan)
    shown = [n for n, part in enumerate(parts) if turns[n] >= 2 and len(part[0]) >= MIN_SAMPLES]
    series = []
    for n in shown:
        angle, speed, torque = parts[n]
        way = np.abs(angle - angle[0])
        level = torque - slope[n] * (speed - speed.mean())
        series.append((np.interp(np.linspace(0, way[-1], len(way)), way, level), int(turns[n])))
    if shown:
        found[shown] = mean_uncertainties(series, BIN_ORDINATES)
    return found[:, 0], found[:, 1]


def _whole_turns(angle: Array) -> tuple[slice, int]:
    """Return the middle part with whole revolutions, and their number; all where it is zero."""
    travel = np.abs(angle - angle[0])
    turns = int(travel[-1] / (2 * np.pi))
    if turns == 0 or np.any(np.diff(travel) < 0):
        return slice(0, len(angle)), 0
    spare = (travel[-1] - turns * 2 * np.pi) / 2
    first = int(np.searchsorted(travel, spare))
    last = int(np.searchsorted(travel, travel[first] + turns * 2 * np.pi * (1 - 1e-9)))
    return slice(first, last), turns
