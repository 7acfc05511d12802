"""Motions of `measure-force --record`: strokes, a sine, a hold, or a path from a file."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np

from rigtool.errors import RecipeError
from rigtool.experiments.force_filter.motion_states import Reach
from rigtool.inputs import open_input
from rigtool.numerics.arrays import Array
from rigtool.recipe import Recipe
from rigtool.rigs.motion import Motion, SpeedProfile, Triangle

SINE_PIECES = 32
"""Pieces of constant acceleration in a period of the sine."""

PATH_PIECES = 32
"""Pieces of constant acceleration between two points of a path, whose speed is a parabola."""

PATH_COLUMNS = ("time_s", "angle_deg")
"""Columns of a path's file."""

POINTS_AT_ONCE = 65536
"""Points of a motion that are looked at at once: an hour has 3.6 million, in 600 MB."""

AT_THE_EDGE = 1e-3
"""Relative excess of speed and range of angles that rounding of a recipe's numbers explains."""


def path_from_start(recipe: Recipe, seconds: float) -> tuple[float | None, Motion]:
    """Return where a motion starts, rad of the rotor, None where the rotor is, and the motion.

    Strokes and sine last for whole cycles, `seconds` s at least; a path as its file states. Raises
    `RecipeError` for a file that is no path.
    """
    settings, ratio = recipe.measure_force, recipe.rig.angle_ratio
    high, own = math.radians(settings.angle) * ratio, settings.motion
    if own.kind == "hold":
        return None, SpeedProfile((0.0, seconds), (0.0, 0.0))
    if own.kind == "path":
        assert own.file is not None
        time, angle = path_of(Path(own.file))
        return float(angle[0]) * ratio, path(time, angle * ratio)
    if own.kind == "sine":
        periods = math.ceil(seconds * own.frequency_hz)
        time = np.arange(periods * SINE_PIECES + 1) / (SINE_PIECES * own.frequency_hz)
        speed = high * math.pi * own.frequency_hz * np.sin(2 * math.pi * own.frequency_hz * time)
        return 0.0, SpeedProfile(tuple(time.tolist()), tuple(speed.tolist()))
    stroke = Triangle(
        low=0.0,
        high=high,
        speed=2 * math.pi * settings.speed_rev_per_s * ratio,
        turn_angle=math.radians(settings.turn_angle) * ratio,
        cycles=1,
    )
    cycles = math.ceil(seconds / stroke.duration)
    return 0.0, Triangle(stroke.low, stroke.high, stroke.speed, stroke.turn_angle, cycles)


def path(time: Array, angle: Array) -> SpeedProfile:
    """Return the motion through angles (n,) at times (n,) s, at rest at both ends.

    A cubic spline, with speeds that run linearly within pieces of it.
    """
    from scipy.interpolate import CubicSpline

    spline = CubicSpline(time - time[0], angle, bc_type="clamped")
    fine = np.interp(
        np.arange((len(time) - 1) * PATH_PIECES + 1) / PATH_PIECES, np.arange(len(time)), spline.x
    )
    speed = spline(fine, 1)
    speed[[0, -1]] = 0.0
    return SpeedProfile(tuple(fine.tolist()), tuple(speed.tolist()))


def path_of(file: Path) -> tuple[Array, Array]:
    """Return times s and angles rad of the output from a file of these `PATH_COLUMNS`.

    Raises `RecipeError` for a file that cannot be read, or is no path.
    """
    try:
        with open_input(file, RecipeError) as stream:
            time, angle = _numbers(stream.read().decode("utf-8"))
    except RecipeError as error:
        raise RecipeError(f"measure_force.motion.file {error}") from None
    except ValueError as error:
        raise RecipeError(
            f"measure_force.motion.file {file}: cannot be used as a path: {error}"
        ) from None
    if len(time) < 2 or not np.isfinite([time, angle]).all() or np.diff(time).min() <= 0:
        raise RecipeError(
            f"measure_force.motion.file {file}: needs two points at least, numbers only, and times "
            "that rise"
        )
    return time, np.radians(angle)


def _numbers(text: str) -> Array:
    head, *lines = text.splitlines() or [""]
    if tuple(name.strip() for name in head.split(",")) != PATH_COLUMNS:
        raise ValueError(f"its first line must be {','.join(PATH_COLUMNS)}")
    rows = [[float(field) for field in line.split(",")] for line in lines if line.strip()]
    return np.array(rows, dtype=np.float64).reshape(len(rows), len(PATH_COLUMNS)).T


def require_learned(start: float | None, motion: Motion, reach: Reach, here: float) -> None:
    """Raise `RecipeError` where a motion is faster or wider than what was learned.

    `here` rad is where the rotor is.
    """
    begin, size = here if start is None else start, max(1000, round(1000 * motion.duration))
    fastest, lowest, highest = 0.0, math.inf, -math.inf
    for first in range(0, size, POINTS_AT_ONCE):
        rows = np.arange(first, min(first + POINTS_AT_ONCE, size), dtype=np.float64)
        time: Array = np.multiply(rows, motion.duration / (size - 1), dtype=np.float64)
        position, speed, _ = motion.setpoint(time)
        fastest = max(fastest, float(np.abs(speed).max()))
        lowest = min(lowest, begin + float(position.min()))
        highest = max(highest, begin + float(position.max()))
    if fastest > reach.speed * (1 + AT_THE_EDGE):
        raise RecipeError(
            f"the motion of measure_force.motion reaches {fastest:.4g} rad/s at the motor, the "
            f"tables were learned up to {reach.speed:.4g} rad/s: move slower, or learn at higher "
            "ilc_learn.loads.speeds_rev_per_s"
        )
    low, high = reach.angle
    margin = AT_THE_EDGE * (high - low)
    if lowest < low - margin or highest > high + margin:
        raise RecipeError(
            f"the motion of measure_force.motion covers {lowest:.4g} to "
            f"{highest:.4g} rad of the motor, the tables were learned from {low:.4g} to "
            f"{high:.4g} rad: move within that, or learn with a larger angle"
        )
