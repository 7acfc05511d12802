"""Straight lines, levels and branches of staircases, without a model of friction [7.1.1]."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from rigtool.errors import InsufficientDataError
from rigtool.experiments.torque_constant.staircases.measured_levels import common_levels
from rigtool.experiments.torque_constant.staircases.model import Stairs, mean_of
from rigtool.numerics.arrays import TINY, Array

DEFLECTION_U = 0.02
"""Standard uncertainty of the angle by which an arm gives way, where it was not recorded, rad."""


def lines_through(stairs: Stairs, values: Array) -> Array:
    """Return the slope (m,) of a straight line through values (m, p) over current, each over A."""
    off = (stairs.current - mean_of(stairs.current, stairs.weight)[:, None]) * stairs.weight
    return np.sum(off * values, axis=1) / np.sum(off**2, axis=1)


def off_trend(stairs: Stairs, rise: Array) -> Array:
    """Return by how much the straight line through each staircase is steeper than their trend with
    the temperature, `rise` (m,) in K about the mean: relative, (m,)."""
    steep = lines_through(stairs, stairs.torque)
    steep = steep / steep.mean() - 1
    return steep - rise * float(rise @ steep) / max(float(rise @ rise), TINY)


def deflection(stairs: Stairs) -> tuple[float, float]:
    """Return the angle by which the arm gives way from zero to the largest current, rad, and its u:
    what the rotor's positions lie off a line, and a count of its encoder at both ends. It is zero
    and uncertain where they are unknown."""
    if np.any(np.isnan(stairs.position)):
        return 0.0, DEFLECTION_U
    line = lines_through(stairs, stairs.position)
    middle = mean_of(stairs.position, stairs.weight) - line * mean_of(stairs.current, stairs.weight)
    off = stairs.position - middle[:, None] - line[:, None] * stairs.current
    square = float(np.sum(stairs.weight * off**2) / np.sum(stairs.weight)) + stairs.count**2 / 6
    return float(np.mean(line)) * float(np.ptp(stairs.setpoint)), math.sqrt(square)


def straight_slope(stairs: Stairs) -> float:
    """Return the slope of one straight line through all plateaus, N m/A."""
    used = stairs.weight > 0
    return float(np.polyfit(stairs.current[used], stairs.torque[used], 1)[0])


def levels(stairs: Stairs) -> tuple[Array, NDArray[np.int_]]:
    """Return the levels of current (l,) in A and the level of each plateau (m, p)."""
    known, level = np.unique(common_levels(stairs.setpoint.ravel()), return_inverse=True)
    return known, level.reshape(stairs.setpoint.shape).astype(np.int_)


def by_level(level: NDArray[np.int_], values: Array, weight: Array) -> tuple[Array, Array]:
    """Return the weighted mean of values (m, p) by level (l,), and the sums of their weights.

    A level without any has NaN.
    """
    size = int(level.max()) + 1
    count = np.bincount(level.ravel(), weights=weight.ravel(), minlength=size)
    total = np.bincount(level.ravel(), weights=(values * weight).ravel(), minlength=size)
    mean = np.where(count > 0, total / np.maximum(count, 1), np.nan)
    return mean, np.asarray(count, dtype=np.float64)


def branches(stairs: Stairs, off_line: Array) -> tuple[Array, Array, Array]:
    """Return levels of current and the mean torque off the line on either branch, (l,)."""
    current, level = levels(stairs)
    step = np.diff(stairs.setpoint, prepend=np.nan)
    rising, _ = by_level(level, off_line, stairs.weight * (step > 0))
    falling, _ = by_level(level, off_line, stairs.weight * (step < 0))
    # Both branches meet where the current turns.
    rising = np.where(np.isnan(rising), falling, rising)
    return current, rising, np.where(np.isnan(falling), rising, falling)


def hysteresis(stairs: Stairs, off_line: Array) -> tuple[float, float, int]:
    """Return falling minus rising in the middle third of the span, its u, N m, and its dof.

    `off_line` (m, p) in N m is the torque off the line. Raises `InsufficientDataError` without
    plateaus there.
    """
    low, high = stairs.setpoint.min(), stairs.setpoint.max()
    middle = stairs.weight * (np.abs(stairs.setpoint - (low + high) / 2) <= (high - low) / 5.9)
    step = np.diff(stairs.setpoint, prepend=np.nan)
    up, down = middle * (step > 0), middle * (step < 0)
    usable = (up.sum(axis=1) > 0) & (down.sum(axis=1) > 0)
    if not usable.any():
        raise InsufficientDataError(
            "no plateau lies in the middle third of the current's span: use more steps"
        )
    difference = (mean_of(off_line[usable], down[usable])) - mean_of(off_line[usable], up[usable])
    count = len(difference)
    u = float(np.std(difference, ddof=1)) / math.sqrt(count) if count > 1 else math.nan
    return float(np.mean(difference)), u, count - 1
