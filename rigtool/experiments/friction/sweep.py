"""Torque against speed from a slow sweep [7.2.1, 7.2.2, Fig. 30, 32, 34].

torque(v) = mean of (torque - J a) over the samples in a bin of speed. In a bin through which the
shaft turns more than once the mean covers whole revolutions only, so that ripple averages out.
"""

from __future__ import annotations

from collections import defaultdict
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike

from rigtool.errors import InsufficientDataError
from rigtool.numerics.arrays import TINY, Array
from rigtool.numerics.checks import require_rising, require_signals

SPEED_BINS = 60
"""Number of bins of speed over the whole sweep."""

ACCELERATION_LIMIT = 2.0
"""Largest acceleration in the sweep, relative to its median."""


@dataclass(frozen=True)
class TorqueSpeed:
    """Means by bin, (n,): `speed` in rad/s, `torque` in N m, whole `revolutions` averaged.

    `u` is the standard uncertainty of the torque, N m, from the scatter of the single turns in a
    bin (GUM 4.2.3), `dof` its degrees of freedom; NaN where a bin has less than two.
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
    rows = []
    single: dict[int, list[float]] = defaultdict(list)
    for first, last in pairwise(starts.tolist()):
        if label[first] >= 0 and last - first >= 2:
            kept, whole = _whole_turns(angle[first:last])
            part = slice(first + kept.start, first + kept.stop)
            corrected = effort[part] - inertia * acceleration[part]
            rows.append((label[first], np.mean(speed[part]), np.mean(corrected), whole))
            for turn in np.array_split(corrected, whole) if whole else ():
                single[int(label[first])].append(float(np.mean(turn)))
    if not rows:
        raise InsufficientDataError(
            f"the speed set point leaves each of {SPEED_BINS} ranges of speed with the next "
            "sample: its steps are too coarse for a curve; sweep more slowly"
        )
    passes = np.array(rows)
    # A sweep up and down passes each bin twice: average the passes.
    _, index = np.unique(passes[:, 0], return_inverse=True)
    count = np.bincount(index)
    speed, torque, turns = (np.bincount(index, weights=passes[:, k]) for k in (1, 2, 3))
    errors = [_standard_error(single[number]) for number in np.unique(passes[:, 0]).tolist()]
    u, dof = np.array(errors).T
    return TorqueSpeed(speed / count, torque / count, turns.astype(np.float64), u, dof)


def _standard_error(means: list[float]) -> tuple[float, float]:
    """Return the standard uncertainty of a mean and its degrees of freedom."""
    if len(means) < 2:
        return float("nan"), float("nan")
    return float(np.std(means, ddof=1) / np.sqrt(len(means))), len(means) - 1.0


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
