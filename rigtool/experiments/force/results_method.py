"""Errors that the method of `measure-force` adds to a reading.

The low-pass carries the ends of the stroke into the reading; a drive reports its current in steps;
a loop that is driven by single set points may sample a moment that differs from the rest of its
period. Each error is estimated from the signals and included in the uncertainty; where it is too
large, there is no reading.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from rigtool.errors import InsufficientDataError
from rigtool.experiments.between_set_points import (
    RESOLUTION_SAMPLES,
    SET_POINT_REMEDY,
    UNSAMPLED_LIMIT,
    UnsampledCurrent,
    setpoint_resolution,
)
from rigtool.experiments.force.cycles import Cycle, readings
from rigtool.experiments.force.results import applied_torque
from rigtool.numerics.arrays import TINY, Array
from rigtool.recipe import Recipe
from rigtool.rigs.motion import Triangle
from rigtool.runfile import Recording, Run

MAX_SPEED_DEVIATION = 0.3
"""Part by which the speed at the reading, low-passed as the torque, may differ from its set point:
with more, the reading shows the ends of the stroke rather than the angle of the reading."""

MAX_CYCLES_IN_PERIOD = 0.5
"""Up-and-downs in a period of the low-pass: with more, it removes the strokes themselves."""

NOTED_PART_OF_LOAD = 0.01
"""Part of the smallest load from which on the current that samples miss gets a note."""


ENDS_IN_READING = (
    "the ends of the stroke are in the reading; set speed_rev_per_s lower, lowpass_hz higher, or "
    "measure_angle to the middle of the stroke (in a soft loop the rotor lags behind the load and "
    "moves the middle)"
)

LEAPS = (
    "the rotor sticks and leaps there, as ripple or friction holds it against a soft loop; take a "
    "stiffer [rig.controller], or raise speed_rev_per_s"
)

STRAIGHT = 0.9
"""Part of the speed of a stroke from which on its set point counts as straight."""

TURNS_BACK = 0.01
"""Part of its way that the rotor may go back on straight strokes: on drawn rigs with 0.3 % loads
were right, with 2 to 13 % too large by up to a fifth of the friction."""


def require_slow_strokes(recipe: Recipe, motion: Triangle) -> None:
    """Raise `InsufficientDataError` where the strokes are too fast for the low-pass."""
    cutoff, rate = recipe.measure_force.lowpass_hz, 0.5 / motion.stroke_time
    if rate > MAX_CYCLES_IN_PERIOD * cutoff:
        raise InsufficientDataError(
            f"loads go up and down {rate:.3g} times a second, and the low-pass of {cutoff:g} Hz "
            f"lets {MAX_CYCLES_IN_PERIOD * cutoff:.3g} pass: set measure_force.speed_rev_per_s "
            "lower, or lowpass_hz higher"
        )


def lacking_torque(
    run: Run, recipe: Recipe, torque_constant: float, forces: Sequence[float]
) -> tuple[float, tuple[str, ...]]:
    """Return the torque that the samples of the rig's loop lack, N m at the output, and remarks.

    Raises `InsufficientDataError` where that is too much against the largest of the `forces`, N.
    """
    rig, settings = recipe.rig, recipe.measure_force
    speed = rig.motor_speed(settings.speed_rev_per_s)
    current = UnsampledCurrent.of([run]).at(speed)
    lacking = abs(rig.torque_factor * torque_constant * current)
    angle = math.radians(settings.measure_angle)
    applied = [abs(float(applied_torque(recipe, force, angle))) for force in forces if force]
    limit = UNSAMPLED_LIMIT * max(applied, default=0.0)
    text = (
        f"current between set points differs from that of the samples by {current * 1e3:.3g} mA "
        f"with its uncertainty, {lacking * 1e3:.3g} mN m at the output"
    )
    if lacking > limit:
        raise InsufficientDataError(
            f"{text}: more than {limit * 1e3:.3g} mN m, {100 * UNSAMPLED_LIMIT:.0f} % of the "
            f"largest load; {SET_POINT_REMEDY}"
        )
    if lacking > NOTED_PART_OF_LOAD * min(applied, default=0.0):
        return lacking, (f"{text}, which is in the uncertainty of each load: {SET_POINT_REMEDY}",)
    return lacking, ()


def ways(encoder: Array, setpoint: Array, straight: float) -> Array:
    """Return how far the rotor goes forwards and back against its set point, counts (2,).

    Of samples (n,) between which the `setpoint` moves by at least `straight`, in the same unit.
    """
    asked = np.diff(setpoint)
    moved = (np.diff(encoder) * np.sign(asked))[np.abs(asked) >= straight]
    return np.array([moved[moved > 0].sum(), -moved[moved < 0].sum()])


def require_no_turning_back(way: Array, counts: int) -> None:
    """Raise `InsufficientDataError` where the rotor turns back on straight strokes, by its `ways`.

    Friction of a shaft that stops and turns back is no constant: it differs with the load, so that
    the reading without load does not take it off.
    """
    back = float(way[1] / max(way.sum(), TINY))
    if back > TURNS_BACK:
        raise InsufficientDataError(
            f"the rotor turns back on its strokes, {100 * back:.2g} % of its "
            f"way (limit: {100 * TURNS_BACK:.0f} %): the loop shakes it, by the steps of the "
            f"encoder ({counts} a turn) or by noise, and its friction then differs with the load; "
            "take an encoder with more counts, a softer [rig.controller], or raise speed_rev_per_s"
        )


def unsteady_torque(
    angle: Array, torque: Array, fed: Array, *, rate: float, cycles: list[Cycle], recipe: Recipe
) -> float:
    """Return the error that the low-pass brings from the ends of a stroke, N m at the output.

    `angle`, `torque` and the torque that was `fed` forward for the inertia (n,) are those of the
    output, low-passed, at `rate` Hz. Where the shaft turns around within the low-pass's memory,
    part of that is in the reading. Speed v and acceleration a go through the same low-pass; over
    the whole recording torque follows them by friction F, which reverses with the speed, and an
    apparent inertia J:

        T + fed = c + F v / v_wanted + J a,   in the reading:  F |1 - v / v_wanted| + |J a - fed|

    J is fitted to the samples: where set points of speed come in steps, a current that is
    sampled right after each step is larger than its mean while the shaft accelerates. Raises
    `InsufficientDataError` where v at the reading is off by more than `MAX_SPEED_DEVIATION`.
    """
    settings = recipe.measure_force
    place = math.radians(settings.measure_angle)
    speed = np.gradient(angle) * rate
    wanted = 2 * math.pi * settings.speed_rev_per_s
    found = float(readings(angle, speed, cycles, place).mean())
    part = abs(1 - found / wanted)
    if part > MAX_SPEED_DEVIATION:
        # Ends of a stroke, where the rotor turns around, only ever lower the speed.
        reason = ENDS_IN_READING if found < wanted else LEAPS
        raise InsufficientDataError(
            f"the output passes {settings.measure_angle:g} deg at {found:.3g} rad/s in the mean "
            f"over what a low-pass of {settings.lowpass_hz:g} Hz remembers, its set point is "
            f"{wanted:.3g} rad/s (limit: {100 * MAX_SPEED_DEVIATION:.0f} % off): {reason}"
        )
    acceleration = np.gradient(speed) * rate
    speed /= wanted
    friction, inertia = _slopes(speed, acceleration, torque + fed)
    acceleration *= inertia
    acceleration -= fed
    lagging = readings(angle, acceleration, cycles, place).mean()
    return part * abs(friction) + abs(float(lagging))


def _slopes(first: Array, second: Array, values: Array) -> tuple[float, float]:
    """Return the least-squares slopes of values (n,) over two others, beside a constant.

    By the normal equations: two columns need no copies of a long recording.
    """
    a, b = first - first.mean(), second - second.mean()
    gram = np.array([[a @ a, a @ b], [a @ b, b @ b]])
    slopes = np.linalg.lstsq(gram, np.array([a @ values, b @ values]))[0]
    return float(slopes[0]), float(slopes[1])


def resolution_u(recording: Recording, recipe: Recipe, torque_constant: float) -> float:
    """Return the standard uncertainty by the steps of reported current, N m at the output."""
    asked = recording.read("current_setpoint", 0, min(recording.size, RESOLUTION_SAMPLES))
    step = setpoint_resolution(asked, recipe.measure_force.record_every)
    return recipe.rig.torque_factor * torque_constant * step / math.sqrt(12)
