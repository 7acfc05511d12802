"""Figures 50 and 56: the learned table and the remaining disturbance [7.2.4.2]."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from rigtool.errors import RunFileError
from rigtool.report.figures import style
from rigtool.report.figures.axes import (
    COUNTS_LABEL,
    MILLI,
    MOTOR_TORQUE,
    TORQUE_LABEL,
    UP_AND_DOWN,
    counts,
    cycle_axis,
    full_cycle,
    thin,
)
from rigtool.report.figures.plots import FIRST_OWN_NUMBER, plot
from rigtool.runfile import Run, Table

PUBLISHED_SPEEDS_REV_PER_S = (1.0, 2.0)


@plot(
    50,
    "ilc-learn",
    "Content of the two-dimensional lookup table",
    "lookup",
    implementations=("B", "C", "D"),
)
def draw_lookup_table(run: Run, table: Table) -> style.Figure:
    """Fig. 50: content of the two-dimensional table, torque by position and speed, as two views."""
    position, torque = thin(120, counts(run, table), MILLI * table["torque"])
    speeds = table["speed"]
    figure = style.empty(6.4)
    axes: Any = figure.add_axes((0, 0.42, 1, 0.58), projection="3d")
    axes.plot_surface(
        *np.meshgrid(position, speeds),
        torque,
        cmap=style.COLOUR_MAP,
        rcount=len(speeds),
        ccount=80,
        antialiased=False,  # no light seams between facets
    )
    axes.view_init(elev=28, azim=-128)
    axes.set_box_aspect((1.4, 1.1, 0.8), zoom=0.98)
    axes.locator_params(axis="both", nbins=5)
    axes.set_xlabel(COUNTS_LABEL, labelpad=6)
    axes.set_ylabel("speed [rad/s]", labelpad=8)
    axes.zaxis.set_rotate_label(False)
    axes.set_zlabel(TORQUE_LABEL, rotation=90)
    flat = figure.add_axes((0.1, 0.08, 0.86, 0.3))
    drawn = flat.pcolormesh(position, speeds, torque, cmap=style.COLOUR_MAP, rasterized=True)
    flat.grid(visible=False)
    flat.set_xlabel(COUNTS_LABEL)
    flat.set_ylabel("speed [rad/s]")
    figure.colorbar(drawn, ax=flat, label=TORQUE_LABEL, pad=0.02)
    return figure


@plot(
    FIRST_OWN_NUMBER + 11, "ilc-learn", "Disturbance before and after learning", "residual_by_speed"
)
def draw_residual_by_speed(run: Run, table: Table) -> style.Figure:
    """Disturbance by speed: before, with the table on, and what does not repeat."""
    figure, axes = style.one_panel("motor speed [rad/s]", "rms [mN m]")
    speed = table["speed"]
    for name, colour, marker, label in (
        ("before_rms", style.ORANGE, "s", "before learning"),
        ("residual_rms", style.BLUE, "o", "with the table"),
        ("non_repeatable_rms", style.GREY, "_", "does not repeat, single move"),
    ):
        axes.plot(speed, MILLI * table[name], marker, color=colour, markersize=5, label=label)
    axes.set_yscale("log")
    style.legend_above(axes)
    return figure


@plot(FIRST_OWN_NUMBER + 12, "ilc-check", "Health of the learned table", "table_health")
def draw_health(run: Run, table: Table) -> style.Figure:
    """Mismatch of the table by speed beside the scatter of one move, and the change of the mean."""
    labels = ["rms [mN m]", "change of mean [mN m]"]
    figure, (size, mean) = style.panels(2, "motor speed [rad/s]", labels, 4.2)
    speed = table["speed"]
    label = "scatter of a single move"
    size.plot(
        speed, MILLI * table["mismatch_rms"], "o", color=style.BLUE, label="error of the table"
    )
    size.plot(speed, MILLI * table["non_repeatable_rms"], "D", mfc="none", color="k", label=label)
    size.set_ylim(bottom=0)
    mean.plot(speed, MILLI * table["mean_change"], "o", color=style.BLUE)
    mean.axhline(0, color=style.GREY, linewidth=0.8)
    style.legend_above(size)
    return figure


@plot(
    56,
    "ilc-learn",
    "Feed-forward and remaining disturbance",
    "residual_waveforms",
    implementations=("C", "D"),
)
def draw_residual(run: Run, table: Table) -> style.Figure:
    """Fig. 56: feed-forward from the table (blue) and remaining disturbance (green)."""
    speeds = np.asarray(table["speed"])
    ratio, end = _stroke(run)
    chosen = _two_speeds(speeds, ratio)
    figure, axes = style.panels(len(chosen), UP_AND_DOWN, [MOTOR_TORQUE] * len(chosen), 4.6)
    position = counts(run, table)
    for panel, speed in zip(axes, chosen, strict=True):
        rising, falling = (int(np.argmin(np.abs(speeds - s))) for s in (speed, -speed))
        for name, colour, label in (
            ("table", style.BLUE, "feed-forward from the table"),
            ("residual", style.GREEN, "remaining disturbance"),
        ):
            x, up, down = thin(800, position, *(MILLI * table[name])[[rising, falling]])
            panel.plot(*full_cycle(x, up, down, end), color=colour, label=label)
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
