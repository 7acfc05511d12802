"""Figures 50 and 56: the learned table and the remaining disturbance [7.2.4.2]."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np

from rigtool.errors import RunFileError
from rigtool.report.figures import style
from rigtool.report.figures.axes import (
    COUNTS,
    MILLI,
    MOTOR_TORQUE,
    TORQUE,
    UP_AND_DOWN,
    counts,
    cycle_axis,
    thin,
    up_and_down,
)
from rigtool.report.figures.plots import plot

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from rigtool.runfile import Run, Table

PUBLISHED_SPEEDS_REV_PER_S = (1.0, 2.0)


@plot(
    50,
    "ilc-learn",
    "Content of the two-dimensional lookup table",
    "lookup",
    implementations=("B", "C", "D"),
)
def draw_lookup_table(run: Run, table: Table) -> Figure:
    """Fig. 50: content of the two-dimensional table, torque by position and speed."""
    from matplotlib.figure import Figure as NewFigure

    position, torque = thin(120, counts(run, table, "position"), MILLI * table["torque"])
    speeds = table["speed"]
    rows = np.arange(len(speeds))
    figure = NewFigure(figsize=(style.WIDTH, 4.2))
    axes: Any = figure.add_axes((0, 0, 1, 1), projection="3d")
    axes.plot_surface(
        *np.meshgrid(position, rows),
        torque,
        cmap=style.COLOUR_MAP,
        rcount=len(rows),
        ccount=80,
        antialiased=False,  # no light seams between facets
    )
    axes.view_init(elev=28, azim=-128)
    axes.set_box_aspect((1.4, 1.1, 0.8), zoom=0.98)
    axes.locator_params(axis="x", nbins=5)
    axes.set_xlabel(COUNTS, labelpad=6)
    axes.set_ylabel("speed [rad/s]", labelpad=8)
    shown = rows[:: max(1, -(-len(rows) // 6))]
    axes.set_yticks(shown, [f"{speeds[row]:.3g}".replace("-", "−") for row in shown])
    axes.zaxis.set_rotate_label(False)
    axes.set_zlabel(TORQUE, rotation=90)
    return figure


@plot(
    56,
    "ilc-learn",
    "Feed-forward and remaining disturbance",
    "residual_waveforms",
    implementations=("C", "D"),
)
def draw_residual(run: Run, table: Table) -> Figure:
    """Fig. 56: feed-forward from the table (blue) and remaining disturbance (green)."""
    speeds = np.asarray(table["speed"])
    ratio, end = _stroke(run)
    chosen = _two_speeds(speeds, ratio)
    figure, axes = style.panels(len(chosen), UP_AND_DOWN, [MOTOR_TORQUE] * len(chosen), 4.6)
    position = counts(run, table, "position")
    for panel, speed in zip(axes, chosen, strict=True):
        rising, falling = (int(np.argmin(np.abs(speeds - s))) for s in (speed, -speed))
        for name, colour, label in (
            ("table", style.BLUE, "feed-forward from the table"),
            ("residual", style.GREEN, "remaining disturbance"),
        ):
            x, up, down = thin(800, position, *(MILLI * table[name])[[rising, falling]])
            panel.plot(*up_and_down(x, up, down, end), color=colour, label=label)
        panel.set_title(f"{speed / ratio / (2 * math.pi):.3g} rev/s of the output", loc="right")
        cycle_axis(panel, end)
    style.legend_above(axes[0], 2)
    return figure


def _stroke(run: Run) -> tuple[float, float]:
    """Return the motor angle per output angle, and the end of a stroke in quad counts."""
    if run.recipe is None:
        raise RunFileError(f"{run.path}: holds no recipe, so its stroke is unknown: learn again")
    rig = run.recipe.rig
    return rig.angle_ratio, run.recipe.ilc_learn.angle / 360 * rig.encoder_counts * rig.angle_ratio


def _two_speeds(speeds: np.ndarray, ratio: float) -> list[float]:
    """Return the learned speeds, rad/s, closest to the thesis's 1 and 2 rev/s of the output."""
    positive = speeds[speeds > 0]
    wanted = [2 * math.pi * speed * ratio for speed in PUBLISHED_SPEEDS_REV_PER_S]
    found = {float(positive[np.argmin(np.abs(positive - speed))]) for speed in wanted}
    return sorted(found)
