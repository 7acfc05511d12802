"""Figures 42 to 48, 51, 52, 54: learning run by run, and the remains over speed [7.2.4.2]."""

from __future__ import annotations

import math
from functools import partial

import numpy as np

from rigtool.numerics.arrays import Array
from rigtool.report.figures import style
from rigtool.report.figures.axes import MILLI, MOTOR_TORQUE, fit_height
from rigtool.report.figures.plots import plot
from rigtool.runfile import Run, Table

MAX_POINTS = 4000
"""Points of a curve over the sweep: more than its picture has columns."""

SPEED_LABEL = "motor speed [rev/s]"
FROM_TABLE = "feed-forward from the table"
CONTROLLER_LABEL = "controller"


@plot(42, "ilc-learn", "Amplitude and phase tables by speed", "tuning")
def draw_tuning(run: Run, table: Table) -> style.Figure:
    """Fig. 42: amplitude and phase tables, with twice their standard uncertainty."""
    speed = _rev_per_s(table["speed"])
    figure, axes = style.panels(2, SPEED_LABEL, ["amplitude [1]", "shift [deg]"], 4.2)
    for panel, name, scale in zip(axes, ("amplitude", "shift"), (1.0, 180 / math.pi), strict=True):
        panel.errorbar(
            speed,
            scale * table[name],
            yerr=2 * scale * table[f"{name}_u"],
            marker="o",
            markersize=3,
            capsize=2,
        )
    return figure


@plot(
    44,
    "ilc-learn",
    "Disturbance as function of the number of learning runs",
    "iterations",
    implementations=("A", "standard"),
)
def draw_iterations(run: Run, table: Table) -> style.Figure:
    """Fig. 44: amplitudes of the repeating and the non-repeating part, run by run."""
    unit = table.columns["rms"].unit
    figure, axes = style.one_panel("learning runs made before [1]", f"rms [m{unit}]")
    axes.errorbar(
        table["iteration"],
        MILLI * table["rms"],
        yerr=2 * MILLI * table["rms_u"],
        marker="o",
        capsize=2,
        label="repeats",
    )
    axes.plot(
        table["iteration"],
        MILLI * table["non_repeatable_rms"],
        marker="s",
        linestyle="--",
        label="does not repeat, single cycle",
    )
    axes.set_xticks(table["iteration"])
    axes.set_ylim(bottom=0)
    style.legend_above(axes, 2)
    return figure


def torque_over_speed(variant: str, feedforward: bool, run: Run, swept: Table) -> style.Figure:
    """Draw the controller's torque over the speed, on the ordinate of the one without table.

    `variant` names the column of the sweep; `feedforward` adds the torque of the table.
    """
    speed, torque = _envelope(_rev_per_s(swept["speed"]), MILLI * swept[variant])
    figure, axes = style.one_panel(SPEED_LABEL, MOTOR_TORQUE)
    axes.plot(speed, torque, color=style.BLUE, linewidth=0.6, label=CONTROLLER_LABEL)
    if feedforward:
        fed = _envelope(_rev_per_s(swept["speed"]), MILLI * swept["table"])
        axes.plot(*fed, color=style.GREEN, linewidth=0.6, alpha=0.8, label=FROM_TABLE)
        style.legend_above(axes, 2)
    fit_height(axes, MILLI * swept["off"], torque)
    axes.set_xlim(speed[0], speed[-1])
    return figure


for number, implementation, variant, feedforward, title in (
    (46, "A", "off", False, "No repetitive disturbance compensation"),
    (47, "A", "plain", False, "Implementation A, amplitude and phase tables not active"),
    (48, "A", "on", False, "Implementation A, amplitude and phase tables active"),
    (51, "B", "off", True, "Disturbance and feed-forward from the table"),
    (52, "B", "plain", False, "Implementation B, torque over speed"),
    (54, "B", "on", True, "Implementation B with amplitude table, torque over speed"),
):
    draw = partial(torque_over_speed, variant, feedforward)
    plot(number, "ilc-learn", title, "sweep", implementations=(implementation,))(draw)


def _envelope(speed: Array, torque: Array) -> tuple[Array, Array]:
    """Return the lowest and the highest torque of each section of a curve (n,), in turn."""
    width = max(1, 2 * len(speed) // MAX_POINTS)
    used = len(speed) - len(speed) % width
    places, stretches = speed[:used:width], torque[:used].reshape(-1, width)
    ends = np.stack([stretches.min(axis=1), stretches.max(axis=1)], axis=1)
    return np.repeat(places, 2), ends.ravel()


def _rev_per_s(speed: Array) -> Array:
    return np.asarray(speed, dtype=np.float64) / (2 * math.pi)
