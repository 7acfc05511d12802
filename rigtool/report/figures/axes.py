"""Axes of the figures: quad counts, up-and-down cycles, a limited number of points."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rigtool.numerics.arrays import Array
from rigtool.report.figures import style
from rigtool.runfile import Run, Table

MILLI = 1e3
COUNTS_LABEL = "encoder position [quad counts]"
UP_AND_DOWN = "encoder position, up and down [quad counts]"
TORQUE_LABEL = "torque [mN m]"
OUTPUT_TORQUE = "torque at the output [mN m]"
MOTOR_TORQUE = "torque at the motor [mN m]"


def counts(run: Run, table: Table) -> Array:
    """Return the motor positions of a table, stored in quad counts or rad, in quad counts."""
    values = np.asarray(table["position"], dtype=np.float64)
    if table.columns["position"].unit != "rad":
        return values
    turn = 4000 if run.recipe is None else run.recipe.rig.encoder_counts
    return values * turn / (2 * math.pi)


def thin(points: int, *arrays: NDArray[Any]) -> list[NDArray[Any]]:
    """Return every n-th point of the last axis, about `points` of them at most."""
    step = max(1, math.ceil(arrays[0].shape[-1] / points))
    return [array[..., ::step] for array in arrays]


def full_cycle(position: Array, rising: Array, falling: Array, end: float) -> tuple[Array, Array]:
    """Join curves over one stroke to the full cycle of the thesis: 0 to `end` and back [8.1].

    A gap (NaN) remains where the curves do not reach the end.
    """
    return (
        np.concatenate([position, [end], 2 * end - position[::-1]]),
        np.concatenate([rising, [math.nan], falling[::-1]]),
    )


def cycle_axis(axes: style.Axes, end: float) -> None:
    """Set the abscissa to one up-and-down, 0 to 2 `end`, with a tick every quarter stroke."""
    axes.set_xlim(0, 2 * end)
    axes.set_xticks(np.linspace(0, 2 * end, 9).round())


def fit_height(axes: style.Axes, *curves: Array, margin: float = 0.08) -> None:
    """Set the ordinate to the range of these curves; other curves may leave the plot."""
    low = min(float(np.nanmin(curve)) for curve in curves)
    high = max(float(np.nanmax(curve)) for curve in curves)
    room = margin * (high - low)
    axes.set_ylim(low - room, high + room)
