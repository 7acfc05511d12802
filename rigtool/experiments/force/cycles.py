"""Force from motor current: cycles of a hanging load, their scatter, their peak [chapter 8].

A load F at an arm r takes the torque T(a) = F r sin(a) at the output angle a. Each cycle lifts
it (rising stroke) and lowers it (falling stroke). T is read at one angle of each rising stroke, and
as a curve over the whole up-and-down. Friction that grows with load adds to one stroke and
subtracts from the other [8.2]:

    T_lifting = T_load + T_ef,  T_lowering = T_load - T_ef,  T_ef = (T_lifting - T_lowering) / 2

In a soft instrument the load lags behind: the peak appears at a later angle than 90 degrees, and
T_load / shift estimates the stiffness (thesis Fig. 62).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from rigtool.errors import InsufficientDataError
from rigtool.numerics.arrays import Array
from rigtool.numerics.checks import require_signals
from rigtool.numerics.shapiro_wilk import p_value
from rigtool.numerics.steady_mean import steady_mean, steady_us

HYSTERESIS = 0.1
"""Part of the stroke by which the position must pass the middle to count as having passed."""

PEAK_HALF_WIDTH = math.radians(30)
"""Output angle on either side of a peak that a cubic is fitted to, rad. For a half sine it is
off by 3e-4 of the height."""


@dataclass(frozen=True)
class Cycle:
    """Samples at which one up-and-down starts, turns and ends."""

    start: int
    top: int
    end: int


@dataclass(frozen=True)
class LoadStatistics:
    """Readings of one load: torques in N m.

    `std` is the scatter S of single readings, `u` the standard uncertainty of their mean from that
    scatter alone, with `dof` degrees of freedom. `effective_count` is the number of independent
    readings that would have this u.
    """

    mean: float
    std: float
    count: int
    effective_count: float
    u: float
    dof: float


@dataclass(frozen=True)
class Normality:
    """Readings against a normal distribution.

    `ordered` (n,) are the readings sorted, `quantile` (n,) where a standard normal distribution
    expects them, `probability` (n,) the same as probability; `p` is the Shapiro-Wilk probability of
    a sample at least this unlike a normal one.
    """

    ordered: Array
    quantile: Array
    probability: Array
    p: float


class Peak(NamedTuple):
    """Top of a curve: angle in rad, torque in N m."""

    angle: float
    torque: float


@dataclass(frozen=True)
class Peaks:
    """Peaks of each cycle while lifting and while lowering, all (n,): rad and N m."""

    lifting_angle: Array
    lifting_torque: Array
    lowering_angle: Array
    lowering_torque: Array


def find_cycles(position: ArrayLike) -> list[Cycle]:
    """Find the up-and-downs of a position (n,), in any unit, from its lowest and highest points.

    A last cycle that ends before it is down again is left out, as is a first one that starts high.
    Raises `InsufficientDataError` where there is none.
    """
    (p,) = require_signals(3, position=position)
    low, high = float(p.min()), float(p.max())
    middle, margin = (low + high) / 2, HYSTERESIS * (high - low)
    side = np.where(p > middle + margin, 1, np.where(p < middle - margin, -1, 0))
    decided = np.flatnonzero(side)
    changes = decided[1:][np.diff(side[decided]) != 0]
    turns = _turning_points(p, [0, *changes.tolist(), p.size])
    first_low = 0 if side[decided[:1]].sum() < 0 else 1
    cycles = [
        Cycle(*turns[i : i + 3])
        for i in range(first_low, len(turns) - 2, 2)
        if max(p[turns[i]], p[turns[i + 2]]) < low + margin
    ]
    if not cycles:
        raise InsufficientDataError(
            f"the position between {low:.4g} and {high:.4g} makes no full up-and-down: "
            + _why_no_cycle(p[turns[first_low::2]], low)
        )
    return cycles


def _why_no_cycle(lows: Array, low: float) -> str:
    """Return why strokes, with these `lows` (n,), make no cycle, and what to do."""
    if len(lows) < 3:
        return "record at least one cycle"
    return (
        f"only once it goes down to {low:.4g}, else to {np.median(lows):.4g}, so it leaves its "
        "path there: take a smaller load or a stiffer [rig.controller], which holds it"
    )


def readings(position: ArrayLike, torque: ArrayLike, cycles: list[Cycle], angle: float) -> Array:
    """Return the torque at which each rising stroke passes an angle, (len(cycles),) in N m.

    `position` (n,) is the output angle and `torque` (n,) the torque there, both filtered; between
    samples they are interpolated linearly. Raises `InsufficientDataError` where a stroke does not
    pass the angle.
    """
    p, values = require_signals(3, position=position, torque=torque)
    found = np.empty(len(cycles))
    for number, cycle in enumerate(cycles):
        stroke = slice(cycle.start, cycle.top + 1)
        rising = np.maximum.accumulate(p[stroke])
        if not rising[0] < angle < rising[-1]:
            raise InsufficientDataError(
                f"cycle {number} moves from {math.degrees(rising[0]):.4g} to "
                f"{math.degrees(rising[-1]):.4g} deg and never passes measure_angle "
                f"{math.degrees(angle):.4g} deg: measure at an angle within the stroke"
            )
        found[number] = np.interp(angle, rising, values[stroke])
    return found


def statistics(values: ArrayLike) -> LoadStatistics:
    """Summarise the readings (n,) of a load, N m.

    u = S / sqrt(m), where m = n (1 - r) / (1 + r) allows for a correlation r >= 0 from one reading
    to the next (first-order autoregression; Bayley and Hammersley, J. R. Stat. Soc. Suppl. 8
    (1946) 184). A negative r is taken as zero: forty readings cannot prove it.
    """
    (x,) = require_signals(3, values=values)
    mean, std = float(x.mean()), float(x.std(ddof=1))
    deviation = x - mean
    power = float(deviation @ deviation)
    correlation = max(0.0, float(deviation[1:] @ deviation[:-1]) / power) if power > 0 else 0.0
    effective = max(2.0, x.size * (1 - correlation) / (1 + correlation))
    return LoadStatistics(
        mean=mean,
        std=std,
        count=x.size,
        effective_count=effective,
        u=std / math.sqrt(effective),
        dof=effective - 1,
    )


def steady_statistics(series: Sequence[Array]) -> list[LoadStatistics]:
    """Summarise the readings (n,) of all loads, N m, whose strokes pay back alike
    (`numerics.steady_mean`)."""
    found = []
    for values, (u, dof) in zip(series, steady_us(series), strict=True):
        std = float(values.std(ddof=1))
        found.append(
            LoadStatistics(float(steady_mean(values)), std, values.size, (std / u) ** 2, u, dof)
        )
    return found


def normality(values: ArrayLike) -> Normality:
    """Compare readings (n,) with a normal distribution [Fig. 60].

    Order statistic medians after Filliben, Technometrics 17 (1975) 111: m_i = (i - 0.3175) /
    (n + 0.365), m_n = 0.5**(1/n), m_1 = 1 - m_n. Test of Shapiro and Wilk. Raises
    `InsufficientDataError` for fewer than 3 readings or readings without any scatter.
    """
    from statistics import NormalDist

    (x,) = require_signals(3, values=values)
    ordered = np.sort(x)
    if ordered[0] == ordered[-1]:
        raise InsufficientDataError(
            f"all {x.size} readings are {x[0]} N m: no distribution can be judged from them"
        )
    probability: Array = (np.arange(1.0, x.size + 1) - 0.3175) / (x.size + 0.365)
    probability[-1] = 0.5 ** (1 / x.size)
    probability[0] = 1 - probability[-1]
    quantile = np.array([NormalDist().inv_cdf(p) for p in probability.tolist()])
    # Shapiro-Wilk knows no scale; numbers near one keep its sums well conditioned.
    scaled = (ordered - ordered.mean()) / ordered.std()
    return Normality(ordered=ordered, quantile=quantile, probability=probability, p=p_value(scaled))


def curves(
    position: ArrayLike, signal: ArrayLike, cycles: list[Cycle], grid: Array
) -> tuple[Array, Array]:
    """Return a signal over position, for rising and for falling strokes.

    `grid` (m,) rises, in the unit of `position`; both results are (len(cycles), m). At the ends,
    where a stroke turns before it reaches the grid's last point, its last value is held.
    """
    p, values = require_signals(3, position=position, signal=signal)
    up, down = np.empty((2, len(cycles), grid.size))
    for number, cycle in enumerate(cycles):
        rising, falling = slice(cycle.start, cycle.top + 1), slice(cycle.top, cycle.end + 1)
        up[number] = np.interp(grid, np.maximum.accumulate(p[rising]), values[rising])
        back = np.maximum.accumulate(p[falling][::-1])
        down[number] = np.interp(grid, back, values[falling][::-1])
    return up, down


def up_and_down(up: Array, down: Array) -> Array:
    """Join curves (..., m) of rising and falling strokes to the thesis's up-and-down (..., 2m-1).

    The second half runs back: its abscissa is twice the stroke minus the position, which gives
    0 to 3400 quad counts for 180 degrees of grasper [8.1].
    """
    return np.concatenate([up, down[..., -2::-1]], axis=-1)


def find_peak(angle: ArrayLike, torque: ArrayLike) -> Peak:
    """Find the top of a curve by a cubic; `angle` (m,) rises, rad, `torque` (m,) N m.

    A spring skews the half sine of a load: a parabola would put its top several per cent of the
    shift too low, the cubic term takes that up. The window of `PEAK_HALF_WIDTH` follows the top
    until it stays. Raises `InsufficientDataError` where the curve has no peak whose window lies at
    least three quarters within it.
    """
    a, values = require_signals(5, angle=angle, torque=torque)
    first, last = a[0] + PEAK_HALF_WIDTH / 2, a[-1] - PEAK_HALF_WIDTH / 2
    centre, still = float(a[np.argmax(values)]), float(a[1] - a[0]) / 2
    for _ in range(50):
        near = np.abs(a - centre) <= PEAK_HALF_WIDTH
        if not first <= centre <= last or np.count_nonzero(near) < 5:
            break
        offset = a[near] - centre
        # Weights fade to the ends of the window: no point enters or leaves it with a jump, so that
        # the window comes to rest on an oscillating curve, too.
        weight = 1 - (offset / PEAK_HALF_WIDTH) ** 2
        cubic = np.polyfit(offset, values[near], 3, w=weight)
        if cubic[1] >= 0:
            break
        step = float(np.clip(-cubic[2] / (2 * cubic[1]), -PEAK_HALF_WIDTH, PEAK_HALF_WIDTH))
        centre += step
        if abs(step) <= still:
            return Peak(centre, float(np.polyval(cubic, step)))
    raise InsufficientDataError(
        f"the torque has no peak between {math.degrees(a[0]):.3g} and {math.degrees(a[-1]):.3g} "
        "deg: use a load that is large against the disturbances, but small enough to keep the "
        "peak within the stroke"
    )


def peaks(angle: Array, up: Array, down: Array) -> Peaks:
    """Find the peak of each rising (n, m) and falling (n, m) stroke over `angle` (m,)."""
    lifting, lowering = (np.array([find_peak(angle, c) for c in curves]) for curves in (up, down))
    return Peaks(*lifting.T, *lowering.T)


def _turning_points(p: Array, bounds: list[int]) -> list[int]:
    """Return the extreme of each stretch between two passes of the middle."""
    turns = []
    middle = (p.min() + p.max()) / 2
    for begin, stop in pairwise(bounds):
        stretch = p[begin:stop]
        high = stretch.mean() > middle
        turns.append(begin + int(np.argmax(stretch) if high else np.argmin(stretch)))
    return turns
