"""Staircases that do not show a torque constant, and what they show instead [7.1.1]."""

from __future__ import annotations

import math

import numpy as np

from rigtool.errors import InsufficientDataError
from rigtool.experiments.torque_constant.staircases.levels import (
    branches,
    by_level,
    hysteresis,
    levels,
    lines_through,
    straight_slope,
)
from rigtool.experiments.torque_constant.staircases.model import Stairs, mean_of
from rigtool.experiments.torque_constant.staircases.plateaus import Plateaus
from rigtool.numerics.arrays import Array

MISFIT_LIMIT = 5e-3
"""Largest deviation of a level from the model, relative to the span of the torque."""

SLOPE_LIMIT = 0.25
"""Largest relative change of a straight line's slope by heat, or from staircase to staircase."""

LEAST_RISE, FEWEST_TOP_LEVELS = 0.5, 2
"""Slope of the top quarter of a staircase relative to its middle, and levels that show it."""

SURE = 4.0
"""Standard uncertainties by which a slope must be off to be refused."""

SHOWN = 10.0
"""Standard uncertainties from zero at which scatter leaves a straight line's slope to be fitted."""

LARGE_FRICTION = 0.03
"""Friction, relative to the span of the torque, that may change a slope by `FRICTION_SLOPE`."""

FRICTION_SLOPE, FRICTION_MISFIT = 0.5, 0.1
"""The same two limits where such friction shows: largest relative change of a slope, and largest
deviation of a level from the model, relative to friction. Of 11 drawn rigs with eight times the
usual friction that are beyond the others, 10 are within these, with constants within 1.6 u."""

FEWEST_STEPS, CLEAR_STEPS = 10, 40
"""Steps of the gauge in the span of the torque: fewest, and enough to show friction."""

DITHER, LEAST_ROUNDING = 0.1, 0.25
"""Noise in steps of the gauge from which it spreads readings over a step; least part of the error
of rounding that readings show where it does not."""


def require_resolution(plateaus: Plateaus) -> None:
    """Raise `InsufficientDataError` where the gauge is too coarse for a staircase's torque."""
    span, step = float(np.ptp(plateaus.torque)), float(plateaus.resolution.max())
    if span == 0:
        raise InsufficientDataError(
            f"the gauge reads {float(plateaus.torque[0]) * 1e3:.3g} mN m at the arm whatever the "
            "current: it is not connected, is saturated, does not touch the arm, or reads in steps "
            "larger than all torque of the staircase; look at the gauge, or take a finer one"
        )
    if step * FEWEST_STEPS > span:
        raise InsufficientDataError(
            f"the gauge reads in steps of {step * 1e3:.3g} mN m at the arm, the staircase has "
            f"{span * 1e3:.3g} mN m: fewer than {FEWEST_STEPS} steps; take a finer gauge, a "
            "shorter arm or a higher current_max"
        )


def require_shown(stairs: Stairs) -> None:
    """Raise `InsufficientDataError` where scatter about straight lines hides their slope."""
    slope, used = straight_slope(stairs), stairs.weight > 0
    middle = [mean_of(each, stairs.weight)[:, None] for each in (stairs.torque, stairs.current)]
    current = (stairs.current - middle[1]) * used
    left = (stairs.torque - middle[0]) * used - slope * current
    u = math.sqrt(float(np.sum(left**2) / np.sum(used) / np.sum(current**2)))
    if abs(slope) < SHOWN * u:
        raise InsufficientDataError(
            f"torque at the arm follows current by {slope:.2g} N m/A, with a standard uncertainty "
            f"of {u:.2g} by scatter, a tenth of it at most is needed: {_noisy(stairs)}"
        )


def _noisy(stairs: Stairs) -> str:
    return (
        f"readings of the gauge scatter by {stairs.noise:.2g} N m at the arm on a plateau; see to "
        "the gauge's cable and filter, raise current_max, or hold steps longer by "
        "calibrate_kt.step_time"
    )


def require_dithered(stairs: Stairs, residual: Array) -> None:
    """Raise `InsufficientDataError` where readings follow the gauge's steps instead of the torque.

    Rounding leaves q/sqrt(12) where torques lie anywhere within a step q (GUM F.2.2.1). Where each
    step of the current makes whole steps of the gauge and no noise spreads them, readings lie on a
    line whatever the torque is within a step, and all staircases are alike. `residual` (m, p) N m
    is what a fit of all staircases left.
    """
    q, used = stairs.resolution, stairs.weight > 0
    if stairs.noise > DITHER * q:
        return
    left = float(np.sqrt(np.mean(residual[used] ** 2)))
    if left < LEAST_ROUNDING * q / math.sqrt(12):
        raise InsufficientDataError(
            f"readings of the gauge, in steps of {q * 1e3:.3g} mN m at the arm, are {left / q:.2g} "
            f"steps off a line, where rounding leaves {1 / math.sqrt(12):.2g}: steps of current "
            "make whole steps of the gauge, which hide all changes of less; change current_max by "
            "some per cent, or take a finer gauge"
        )


def require_straight(
    stairs: Stairs, slope: Array, slope_u: Array, residual: Array, off_line: Array
) -> None:
    """Raise `InsufficientDataError` where torque is not a straight line over current.

    That is torque without friction and heat. `slope` and `slope_u` (m,) in N m/A are what a fit
    found, `residual` and `off_line` (m, p) in N m what it left of the torque, and what is beside
    its lines, friction included.
    """
    straight = straight_slope(stairs)
    if straight < 0:
        raise InsufficientDataError(
            f"torque changes by {straight:.3g} N m/A with current: reverse the sign of the "
            "gauge or of the current, so that positive current gives positive force"
        )
    _require_alike(stairs, slope_u)
    current, level = levels(stairs)
    mean, count = by_level(level, residual, stairs.weight)
    square, _ = by_level(level, residual**2, stairs.weight)
    u = np.sqrt(np.maximum(square - mean**2, 0) / np.maximum(count - 1, 1))
    _require_rise_to_top(stairs, u)
    change, friction = abs(float(np.mean(slope)) / straight - 1), _large(stairs, off_line)
    largest = FRICTION_SLOPE if friction else SLOPE_LIMIT
    if change > largest:
        raise InsufficientDataError(
            f"torque follows current by {straight:.3g} N m/A on the whole, but by "
            f"{np.mean(slope):.3g} N m/A once friction and heat are taken out; they may "
            f"change it by {100 * largest:.0f} %: {_too_much(stairs, off_line)}"
        )
    limit = max(MISFIT_LIMIT * float(np.ptp(stairs.torque)), stairs.resolution)
    limit = max(limit, FRICTION_MISFIT * friction)
    worst = int(np.argmax(np.abs(mean)))
    if abs(mean[worst]) > max(limit, 4 * u[worst]):
        first = f"{_large_friction(stairs, off_line)}; or " if friction else ""
        raise InsufficientDataError(
            f"torque at {current[worst]:.3g} A is {mean[worst] * 1e3:.3g} mN m off the line "
            f"through all currents, limit {limit * 1e3:.3g} mN m: "
            f"{first}gauge, amplifier or motor is not linear there, or the arm still swings; lower "
            "current_max, look for an end stop, or raise calibrate_kt.step_time and settle_time"
        )


def _require_alike(stairs: Stairs, slope_u: Array) -> None:
    """Raise where a staircase has a slope of its own: temperature and ripple change it by less."""
    lines = lines_through(stairs, stairs.torque)
    usual = float(np.median(lines))
    off = np.abs(lines - usual)
    worst = int(np.argmax(off - SURE * slope_u))
    if off[worst] > SLOPE_LIMIT * abs(usual) + SURE * slope_u[worst]:
        raise InsufficientDataError(
            f"staircase {worst} (of {len(lines)}, from 0) at {stairs.rotor_angle[worst]:.3g} rad, "
            f"{stairs.temperature[worst, 0]:.3g} degC: torque follows current by "
            f"{lines[worst]:.3g} N m/A, by {usual:.3g} in the middle of all; they may differ by "
            f"{100 * SLOPE_LIMIT:.0f} %: see to the gauge's cable and the arm's clamp, and measure "
            "again"
        )


def _require_rise_to_top(stairs: Stairs, level_u: Array) -> None:
    """Raise where the torque of rising staircases stops rising with the current.

    Friction makes it flat after each turn of the current, thus at the bottom. `level_u` (l,) is the
    standard uncertainty of the torque at each level, N m.
    """
    current, torque, _ = branches(stairs, stairs.torque)
    quarter = len(current) // 4
    if quarter < FEWEST_TOP_LEVELS:
        return
    below, top = slice(quarter, -quarter), slice(-quarter - 1, None)
    usual, last = (float(np.polyfit(current[a], torque[a], 1)[0]) for a in (below, top))
    spread = float(np.var(current[top])) * (quarter + 1)
    u = math.sqrt(float(np.mean(level_u**2)) / spread)
    if last < LEAST_RISE * usual - SURE * u:
        raise InsufficientDataError(
            f"torque rises with current by {usual:.3g} N m/A, from "
            f"{current[-quarter - 1]:.3g} A on by {last:.3g} N m/A, at least "
            f"{100 * LEAST_RISE:.0f} % of that is needed: the gauge is saturated, the arm at an "
            "end stop, or the amplifier at its limit; lower current_max"
        )


def _too_much(stairs: Stairs, off_line: Array) -> str:
    """Return why friction and heat may seem to change a slope by too much, and the remedy."""
    span = float(np.ptp(stairs.torque))
    if stairs.resolution * CLEAR_STEPS > span:
        return (
            f"the gauge reads in steps of {stairs.resolution * 1e3:.3g} mN m at the arm, too "
            f"coarse to separate friction from torque in a staircase of {span * 1e3:.3g} mN m; "
            "take a finer gauge, a shorter arm or a higher current_max"
        )
    if 2 * stairs.noise > span:
        return _noisy(stairs)
    return _large_friction(stairs, off_line) or (
        "torque is not linear in current; look for an end stop or a saturated gauge, or raise "
        "current_max"
    )


def _large(stairs: Stairs, off_line: Array) -> float:
    """Return friction in N m, or 0 where it is small beside the span of the torque."""
    friction = hysteresis(stairs, off_line)[0] / 2
    return friction if friction > LARGE_FRICTION * float(np.ptp(stairs.torque)) else 0.0


def _large_friction(stairs: Stairs, off_line: Array) -> str:
    """Return that friction is too large to be taken out, and the remedy, or nothing."""
    friction, span = _large(stairs, off_line), float(np.ptp(stairs.torque))
    if not friction:
        return ""
    return (
        f"friction of the shaft shows {friction * 1e3:.3g} mN m in a staircase of "
        f"{span * 1e3:.3g} mN m, too much to be taken out; raise current_max"
    )
