"""Motions of `measure-force --record`: strokes, a sine, a hold, or a path from a file."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace
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
    `RecipeError` for a file that is no path, and for a path that ends before `seconds` s.
    """
    settings, ratio = recipe.measure_force, recipe.rig.angle_ratio
    high, own = math.radians(settings.angle) * ratio, settings.motion
    if own.kind == "hold":
        return None, SpeedProfile((0.0, seconds), (0.0, 0.0))
    if own.kind == "path":
        assert own.file is not None
        time, angle = path_of(Path(own.file))
        lasts = float(time[-1] - time[0])
        if lasts * (1 + AT_THE_EDGE) < seconds:
            raise RecipeError(
                f"{seconds:g} s are to be recorded, the path of measure_force.motion.file "
                f"{own.file} lasts {lasts:.4g} s: give --record {lasts:.4g} at most, or a longer "
                "path"
            )
        require_time(0.0, lasts, own.time_max)
        return float(angle[0]) * ratio, path(time, angle * ratio)
    if own.kind == "sine":
        require_time(0.0, 1 / own.frequency_hz, own.time_max)
        periods = math.ceil(seconds * own.frequency_hz)
        time = np.arange(periods * SINE_PIECES + 1) / (SINE_PIECES * own.frequency_hz)
        speed = high * math.pi * own.frequency_hz * np.sin(2 * math.pi * own.frequency_hz * time)
        return 0.0, SpeedProfile(tuple(time.tolist()), tuple(speed.tolist()))
    fastest = recipe.rig.motor_speed(settings.speed_rev_per_s)
    stroke = Triangle.of_output(settings.angle, settings.turn_angle, ratio, fastest, 1)
    require_time(0.0, stroke.duration, own.time_max)
    return 0.0, replace(stroke, cycles=math.ceil(seconds / stroke.duration))


def path(time: Array, angle: Array) -> SpeedProfile:
    """Return the motion through angles (n,) at times (n,) s, at rest at both ends.

    Monotone between two points (F. N. Fritsch and R. E. Carlson, SIAM J. Numer. Anal. 17(2)
    238-246, 1980), so that no angle is beyond those; speeds run linearly within pieces of it.
    """
    from scipy.interpolate import CubicHermiteSpline, PchipInterpolator

    time = time - time[0]
    slope = PchipInterpolator(time, angle)(time, 1)
    slope[[0, -1]] = 0.0
    fine = np.interp(
        np.arange((len(time) - 1) * PATH_PIECES + 1) / PATH_PIECES, np.arange(len(time)), time
    )
    speed = CubicHermiteSpline(time, angle, slope)(fine, 1)
    return SpeedProfile(tuple(fine.tolist()), tuple(speed.tolist()))


def path_of(file: Path) -> tuple[Array, Array]:
    """Return times s and angles rad of the output from a file of these `PATH_COLUMNS`.

    Raises `RecipeError` for a file that cannot be read, or is no path.
    """
    try:
        with open_input(file, RecipeError) as stream:
            time, angle = _points(stream.read().decode("utf-8-sig"))
    except RecipeError as error:
        raise RecipeError(f"measure_force.motion.file {error}") from None
    except UnicodeDecodeError as error:
        raise RecipeError(
            f"measure_force.motion.file {file}: byte {error.start} is not UTF-8; give a text, "
            "saved in UTF-8"
        ) from None
    except ValueError as error:
        raise RecipeError(
            f"measure_force.motion.file {file}: cannot be used as a path: {error}"
        ) from None
    return time, np.radians(angle)


def _points(text: str) -> Array:
    """Return times and angles, (2, n), of a file's text; `ValueError` where it holds none."""
    head, *lines = text.splitlines() or [""]
    if tuple(name.strip() for name in head.split(",")) != PATH_COLUMNS:
        raise ValueError(f"its first line must be {','.join(PATH_COLUMNS)}, it is {head[:60]!r}")
    points: list[tuple[float, float]] = []
    for number, line in enumerate(lines, 2):
        if not line.strip():
            continue
        try:
            time, angle = map(float, line.split(","))
        except ValueError:
            time = angle = math.nan
        if not (math.isfinite(time) and math.isfinite(angle)):
            raise ValueError(f"line {number}, {line[:60]!r}, must be two numbers, time and angle")
        if points and time <= points[-1][0]:
            raise ValueError(f"line {number}: {time:g} s follows {points[-1][0]:g} s: must rise")
        points.append((time, angle))
    if len(points) < 2:
        raise ValueError(f"{len(points)} points, two at least are needed")
    return np.array(points).T


def require_time(least: float, seconds: float, longest: float) -> None:
    """Raise `RecipeError` for a recording that cannot be read, or a motion that does not end in
    time. All s: what the filter needs at `least`, the recording, and the `longest` one."""
    if not least <= seconds:
        raise RecipeError(
            f"{seconds:.4g} s are recorded, the filter needs {least:.4g} s at "
            "measure_force.motion.bandwidth_hz: record for longer, or a longer motion"
        )
    if not seconds <= longest:
        raise RecipeError(
            f"a cycle of measure_force.motion, or its path, lasts {seconds:.4g} s, "
            f"measure_force.motion.time_max is {longest:g} s: move faster"
        )


def require_learned(start: float | None, motion: Motion, reach: Reach, here: float) -> None:
    """Raise `RecipeError` where a motion is faster or wider than what was learned.

    `here` rad is where the rotor is.
    """
    begin = here if start is None else start
    fastest, lowest, highest = 0.0, math.inf, -math.inf
    for time in _looked_at(motion):
        position, speed, _ = motion.setpoint(time)
        fastest = max(fastest, float(np.abs(speed).max()))
        lowest = min(lowest, begin + float(position.min()))
        highest = max(highest, begin + float(position.max()))
    if fastest > reach.speed * (1 + AT_THE_EDGE):
        raise RecipeError(
            f"the motion of measure_force.motion reaches {fastest:.4g} rad/s at the motor, the "
            f"tables were learned up to {reach.speed:.4g} rad/s: move slower, or learn at higher "
            "ilc_learn.speeds_rev_per_s"
        )
    low, high = reach.angle
    margin = AT_THE_EDGE * (high - low)
    if lowest < low - margin or highest > high + margin:
        raise RecipeError(
            f"the motion of measure_force.motion covers {round(lowest, 6) + 0.0:.4g} to "
            f"{highest:.4g} rad of the motor, the tables were learned from {low:.4g} to "
            f"{high:.4g} rad: move within that, or learn with a larger angle"
        )


def _looked_at(motion: Motion) -> Iterator[Array]:
    """Yield the times, s, at which a motion is looked at: one in a millisecond, and all points of a
    profile, where its speed is highest however short it lasts."""
    size = max(1000, round(1000 * motion.duration))
    points = np.asarray(motion.times if isinstance(motion, SpeedProfile) else ())
    for first in range(0, size, POINTS_AT_ONCE):
        rows = np.arange(first, min(first + POINTS_AT_ONCE, size), dtype=np.float64)
        yield rows * (motion.duration / (size - 1))
    for first in range(0, len(points), POINTS_AT_ONCE):
        yield points[first : first + POINTS_AT_ONCE]
