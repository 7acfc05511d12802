"""Functions of motion that make a load model: position, speed, direction, way since reversal.

All are smooth, without unit, and pass the same low-pass as the signals that they explain, so that
the equation still holds between them:

    splines in position                              ripple, friction that depends on position
    speed and its logarithm                          viscous and Stribeck friction
    acceleration                                     inertia
    exp(-way since reversal / length)                pre-sliding: friction that builds up [Dahl]
    cos and sin of orders of the encoder's turn      ripple of the motor, half orders included

P. R. Dahl, AIAA Journal 14(12) 1675-1682, 1976: friction approaches its level with the way.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from rigtool.errors import InsufficientDataError
from rigtool.experiments.imported_load.noise import EffortNoise
from rigtool.numerics.arrays import TINY, Array, Mask
from rigtool.numerics.checks import require_rising, require_signals
from rigtool.numerics.decimation import block_means
from rigtool.numerics.lowpass import lowpass

WORK_RATE = 5
"""Samples for each period of the cut-off at which functions are computed, at least `ROW_RATE`."""

ROW_RATE = 50.0
"""Rows per second that are kept after the low-pass, at least: closer neighbours add nothing."""

END_TIME = 1.0
"""Left out at each end of a recording, s, as by O'Neill et al., IEEE RA-L 3(4) 3027-3034, 2018."""

SPEED_BAND = 2
"""The position passes this many times the bandwidth before it is differentiated."""

STANDSTILL_PART = 0.05
"""Speeds below this part of the highest are near standstill: friction is undetermined there."""

OUTLIER_RATIO = 2.0
"""A speed beyond this many times the recording's 95th percentile is a transient, such as homing."""

ENCODER_ORDERS = tuple(k / 2 for k in range(1, 9))
"""Orders of the encoder's turn; halves are of teeth that meet again every second turn."""

ROUNDING = 1e-9
"""Part of a signal below which its changes are those of rounding."""

MIN_TURNS = 2.0
"""Turns below which orders are left out: splines of position cover them."""

PRESLIDING_LENGTHS = tuple(2.0**-k for k in range(3, 8))
"""Lengths of pre-sliding, in parts of the stroke."""

SPLINE_COUNT = {
    "offset": 32,
    "load": 10,
    "load_squared": 5,
    "load_cubed": 5,
    "viscous": 5,
    "stribeck": 5,
    "reversal": 5,
    "load_reversal": 5,
}
"""Splines along the stroke of groups that vary with position."""


@dataclass(frozen=True, eq=False)
class ShaftPath:
    """How a shaft moved: rows (n,) at even times, s; position in rad or m, speed, acceleration.

    `regular` marks rows that are no part of a transient. They are `rows` of more finely spaced
    ones, `rate` a second: arrays named `fine_*` (m,) are before the low-pass.
    """

    time: Array
    position: Array
    speed: Array
    acceleration: Array
    regular: Mask
    fine_position: Array
    fine_speed: Array
    rate: float
    rows: slice
    bandwidth_hz: float

    def moved(self, by: float) -> ShaftPath:
        """Return the path with another zero of the position."""
        return replace(self, position=self.position + by, fine_position=self.fine_position + by)

    def thin(self, fine: Array) -> Array:
        """Return signals (..., m) low-passed, at the rows (..., n)."""
        return lowpass(self.rate, fine, self.bandwidth_hz)[..., self.rows]


@dataclass(frozen=True, eq=False)
class LoadSignals:
    """What an analysis reads of a recording, at the rows (n,) of its path.

    `output_speed` is that of the output where it has an encoder of its own, else of the motor;
    `reference` is None without a sensor; `place` (n,) is where the load is, by the best encoder.
    """

    path: ShaftPath
    effort: Array
    effort_unit: str
    output_speed: Array
    place: Array
    reference: Array | None
    noise: EffortNoise

    @property
    def sensor(self) -> Array:
        """Torque of the sensor; `ValueError` without one."""
        if self.reference is None:
            raise ValueError("there is no sensor")
        return self.reference


@dataclass(frozen=True)
class Scales:
    """What makes position, speed and torque numbers near 1; `turn` is 0 where orders are left out.

    `low` and `high` bound the position, `standstill` is the speed below which the direction is
    undetermined, `lengths` are those of pre-sliding, in the unit of position.
    """

    low: float
    high: float
    speed: float
    standstill: float
    acceleration: float
    torque: float
    turn: float

    @property
    def lengths(self) -> tuple[float, ...]:
        """Lengths of pre-sliding in the unit of position."""
        return tuple(part * (self.high - self.low) for part in PRESLIDING_LENGTHS)


def path_of(
    time: ArrayLike, position: ArrayLike, bandwidth_hz: float, *signals: ArrayLike
) -> tuple[ShaftPath, list[Array]]:
    """Return the path of a recording, and other signals at its rows, low-passed without phase.

    Signals are (n,), at a constant rate; rows leave out `END_TIME`. Raises `InsufficientDataError`
    where rate or length do not carry the bandwidth.
    """
    arrays = {f"signal {i}": signal for i, signal in enumerate(signals)}
    t, p, *rest = require_signals(20, time=time, position=position, **arrays)
    step = require_rising(t)
    if t[-1] - t[0] < 2 * (END_TIME + 1 / ROW_RATE):
        raise InsufficientDataError(
            f"{t[-1] - t[0]:.3g} s, of which {END_TIME:g} s at either end are left out: "
            "record for longer, or correct the unit of time in the mapping"
        )
    work_rate = max(WORK_RATE * bandwidth_hz, ROW_RATE)
    size = max(1, math.floor(1 / (step * work_rate) * (1 + 1e-6)))
    t, p, *rest = (block_means(values, size) for values in (t, p, *rest))
    rate = 1 / (step * size)
    factor = max(1, round(rate / ROW_RATE))
    smooth = lowpass(rate, p, min(SPEED_BAND * bandwidth_hz, 0.45 * rate))
    speed = np.gradient(smooth, 1 / rate)
    rows = _without_ends(t[::factor], factor)
    slow = np.gradient(lowpass(rate, p, bandwidth_hz), 1 / rate)
    path = ShaftPath(
        time=t[rows],
        position=lowpass(rate, p, bandwidth_hz)[rows],
        speed=slow[rows],
        acceleration=np.gradient(slow, 1 / rate)[rows],
        regular=~_transient(speed, round(rate / bandwidth_hz))[rows],
        fine_position=p,
        fine_speed=speed,
        rate=rate,
        rows=rows,
        bandwidth_hz=bandwidth_hz,
    )
    return path, [path.thin(values) for values in rest]


def _without_ends(time: Array, factor: int) -> slice:
    """Return every `factor`th row but those at the ends; `time` (n,) s is that of all of them."""
    inside = np.flatnonzero((time >= time[0] + END_TIME) & (time <= time[-1] - END_TIME))
    return slice(factor * inside[0], factor * inside[-1] + 1, factor)


def _transient(speed: Array, memory: int) -> Mask:
    """Mark speeds far beyond the usual ones, and what the low-pass spreads them to."""
    magnitude = np.abs(speed)
    wild = magnitude > OUTLIER_RATIO * max(float(np.percentile(magnitude, 95)), TINY)
    if not wild.any():
        return wild
    spread: Mask = np.convolve(wild, np.ones(2 * memory + 1)) > 0.5
    return spread[memory : memory + wild.size]


def find_scales(paths: Sequence[ShaftPath], torques: Sequence[Array], turn: float) -> Scales:
    """Return the scales of recordings; `turn` is one turn of the encoder in the unit of position.

    Raises `InsufficientDataError` where nothing moves or no load acts.
    """
    position = np.concatenate([path.position[path.regular] for path in paths])
    speed = np.abs(np.concatenate([path.speed[path.regular] for path in paths]))
    torque = np.concatenate([t[path.regular] for path, t in zip(paths, torques, strict=True)])
    low, high = float(position.min()), float(position.max())
    highest = float(np.percentile(speed, 99))
    load = float(np.max(np.abs(torque)))
    if not (high - low > ROUNDING * max(abs(low), abs(high)) and highest > 0):
        raise InsufficientDataError("nothing moves in these recordings: record strokes to and fro")
    if load == 0:
        raise InsufficientDataError("the reference torque is zero throughout: apply loads")
    acceleration = np.concatenate([path.acceleration[path.regular] for path in paths])
    return Scales(
        low=low,
        high=high,
        speed=highest,
        standstill=STANDSTILL_PART * highest,
        acceleration=max(float(np.percentile(np.abs(acceleration), 99)), TINY),
        torque=load,
        turn=turn if turn > 0 and high - low >= MIN_TURNS * turn else 0.0,
    )


def splines(place: Array, count: int) -> Array:
    """Return cubic B-splines (n, count) along 0..1; beyond the ends they stay as they are there."""
    from scipy.interpolate import BSpline

    knots = np.concatenate([np.zeros(3), np.linspace(0, 1, count - 2), np.ones(3)])
    return BSpline.design_matrix(np.clip(place, 0, 1), knots, 3).toarray()


def motion_functions(
    path: ShaftPath, scales: Scales, sign: int, *, alone: bool = False
) -> dict[str, Array]:
    """Return the functions of one direction by group, each (n, columns), at the rows of a path.

    They vanish in the other direction; the low-pass spreads both over the reversal between them.
    What it brings of the other direction are the groups `reversal` and `load_reversal`. With
    `alone` they are those of a motion that goes in this direction only, and has for long: friction
    at standstill is at most that.
    """
    speed = path.fine_speed / scales.speed
    rest = scales.standstill / scales.speed
    place = (path.fine_position - scales.low) / (scales.high - scales.low)
    magnitude = np.abs(speed)
    slowness = np.log(np.hypot(magnitude, rest))
    memory = _since_reversal(path, scales) * (not alone)
    along = {count: splines(place, count).T for count in set(SPLINE_COUNT.values())}
    groups = {
        **{name: along[count] for name, count in SPLINE_COUNT.items()},
        "viscous": along[SPLINE_COUNT["viscous"]] * magnitude,
        "stribeck": along[SPLINE_COUNT["stribeck"]] * slowness,
        "load_speed": np.stack([magnitude, slowness]),
        "inertia": np.gradient(path.fine_speed, 1 / path.rate)[None] / scales.acceleration,
        "memory": memory,
        "load_memory": memory,
    }
    way = sign * speed / np.hypot(magnitude, rest)
    here, there = (1 + way) / 2, (1 - way) / 2
    if alone:
        here, there = np.ones_like(way), np.zeros_like(way)
    groups["reversal"] = groups["load_reversal"] = groups["reversal"] * (there / here)
    if scales.turn:
        angle = path.fine_position * (2 * math.pi / scales.turn)
        waves = np.stack([f(order * angle) for order in ENCODER_ORDERS for f in (np.cos, np.sin)])
        groups["ripple"] = waves
    # One pass of the low-pass: designing it anew for each group takes longer than filtering
    columns = path.thin(np.concatenate(list(groups.values())) * here).T
    ends = np.cumsum([len(group) for group in groups.values()])
    return dict(zip(groups, np.split(columns, ends[:-1], axis=1), strict=True))


LOAD_POWER = {
    "load": 1,
    "load_squared": 2,
    "load_cubed": 3,
    "load_speed": 1,
    "load_memory": 1,
    "load_reversal": 1,
}
"""Power of the torque that a group is multiplied by; others stand alone."""

FUNCTION_GROUPS = (
    *("offset", "load", "load_squared", "load_cubed", "viscous", "stribeck", "load_speed"),
    *("inertia", "memory", "load_memory", "ripple", "reversal", "load_reversal"),
)
"""All groups of functions, by the number that run files know them by."""


def size_of(group: str) -> int:
    """Return how many columns a group has."""
    sizes = {"load_speed": 2, "inertia": 1, "ripple": 2 * len(ENCODER_ORDERS)}
    return SPLINE_COUNT.get(group) or sizes.get(group, len(PRESLIDING_LENGTHS))


def _since_reversal(path: ShaftPath, scales: Scales) -> Array:
    """Return exp(-way since the last reversal / length), one row a length, (k, m)."""
    speed, place = path.fine_speed, path.fine_position
    sign = np.where(np.abs(speed) >= scales.standstill, np.sign(speed), 0.0)
    decided = np.flatnonzero(sign)
    lengths = np.array(scales.lengths)[:, None]
    if not len(decided):
        return np.zeros((len(lengths), len(speed)))
    turned = decided[1:][np.diff(sign[decided]) != 0]
    before = decided[:-1][np.diff(sign[decided]) != 0]
    # Where the direction changes between two decided samples, the extreme is the reversal.
    start = place.copy()
    start[:] = np.nan
    for first, last in zip(before, turned, strict=True):
        part = place[first : last + 1]
        extreme = int(np.argmax(part) if sign[first] > 0 else np.argmin(part))
        start[first + extreme] = part[extreme]
    known = np.flatnonzero(np.isfinite(start))
    if not len(known):
        return np.zeros((len(lengths), len(speed)))
    latest = np.searchsorted(known, np.arange(len(place)), side="right") - 1
    way = np.abs(place - start[known[np.maximum(latest, 0)]])
    way[latest < 0] = math.inf  # what was before the recording is not known: as if long ago
    return np.exp(-way / lengths)
