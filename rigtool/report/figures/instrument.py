"""Figures of a real instrument, measured against a sensor at its jaw."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from rigtool.report.figures import style
from rigtool.report.figures.axes import MILLI, Array
from rigtool.report.figures.plots import FIRST_OWN_NUMBER, plot

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from rigtool.runfile import Run, Table

RUNS_OVER_TIME = 3
"""Number of runs in the figure over time, from the lowest to the highest load."""

LEFT_OUT_AT_ENDS = 1.0
"""Time left out at both ends of a run, s."""


@plot(
    FIRST_OWN_NUMBER,
    "measure-force",
    "Torque at the load over time: from effort and motion, and by the sensor",
    "series",
    "levels",
)
def draw_by_time(run: Run, series: Table, levels: Table) -> Figure:
    """Measured and estimated torque over time, with the 95 % interval."""
    chosen = _chosen(series["reference"])
    figure, panels = style.panels(len(chosen), "time [s]", ["torque [mN m]"] * len(chosen), 6.2)
    time = series["time"]
    for axes, index in zip(panels, chosen, strict=True):
        torque, u = MILLI * series["torque"][index], 1.96 * MILLI * series["u"][index]
        axes.fill_between(
            time, torque - u, torque + u, color=style.SKY, alpha=0.5, linewidth=0, label="95 %"
        )
        axes.plot(time, torque, color=style.BLUE, label="from effort and motion")
        axes.plot(
            time, MILLI * series["reference"][index], color=style.ORANGE, label="sensor", lw=0.9
        )
        sensor = MILLI * series["reference"][index]
        middle = (time > LEFT_OUT_AT_ENDS) & (time < time[-1] - LEFT_OUT_AT_ENDS)
        low, high = np.nanmin(sensor[middle]), np.nanmax(sensor[middle])
        axes.set_ylim(low - 0.3 * (high - low) - 5, high + 0.3 * (high - low) + 5)
    style.legend_above(panels[0])
    return figure


@plot(
    FIRST_OWN_NUMBER + 1,
    "measure-force",
    "Hysteresis: effort of the motor against torque at the load",
    "series",
    "levels",
)
def draw_hysteresis(run: Run, series: Table, levels: Table) -> Figure:
    """Loop of the motor's effort against the sensor's torque."""
    effort = series.columns["effort"]
    name = "current" if effort.unit == "A" else "torque"
    figure, axes = style.one_panel(
        "torque at the load, sensor [mN m]", f"{name} of the motor [{effort.unit}]", 4.2
    )
    time = series["time"]
    middle = (time > LEFT_OUT_AT_ENDS) & (time < time[-1] - LEFT_OUT_AT_ENDS)
    load = np.nanmean(series["reference"], axis=1)
    order = np.argsort(np.abs(load))
    shades = _shades(len(order))
    for shade, index in zip(shades, order, strict=True):
        axes.plot(
            MILLI * series["reference"][index][middle],
            effort.values[index][middle],
            color=shade,
            linewidth=0.5,
        )
    return figure


@plot(
    FIRST_OWN_NUMBER + 2,
    "measure-force",
    "Error by load: median and 95 % of the samples of each run",
    "series",
    "levels",
)
def draw_error_by_level(run: Run, series: Table, levels: Table) -> Figure:
    """Errors of single samples over the torque of their run, against and with the load."""
    time, speed = series["time"], series["speed"]
    middle = (time > LEFT_OUT_AT_ENDS) & (time < time[-1] - LEFT_OUT_AT_ENDS)
    error = MILLI * (series["torque"] - series["reference"])
    figure, axes = style.one_panel("torque at the load, sensor [mN m]", "error [mN m]", 3.6)
    for sign, colour, label in (
        (-1, style.SKY, "with the load"),
        (1, style.BLUE, "against the load"),
    ):
        rows = []
        for index in range(len(error)):
            mask = middle & (sign * speed[index] > 0) & np.isfinite(error[index])
            if not mask.any():
                continue
            low, mid, high = np.percentile(error[index][mask], [2.5, 50, 97.5])
            rows.append((MILLI * np.mean(series["reference"][index][mask]), low, mid, high))
        if not rows:
            continue
        torque, low, mid, high = np.array(rows).T
        axes.errorbar(
            torque, mid, [mid - low, high - mid], fmt="o", ms=3, lw=0.8, color=colour, label=label
        )
    axes.axhline(0, color=style.GREY, linewidth=0.8)
    style.legend_above(axes)
    return figure


def _chosen(reference: Array) -> list[int]:
    """Return runs of the lowest, a middle and the highest load."""
    order = np.argsort(np.abs(np.nanmean(reference, axis=1)))
    places = np.unique(np.linspace(0, len(order) - 1, RUNS_OVER_TIME).round().astype(int))
    return [int(order[place]) for place in places]


def _shades(count: int) -> list[tuple[float, float, float, float]]:
    from matplotlib import colormaps

    return [colormaps[style.COLOUR_MAP](value) for value in np.linspace(0, 0.9, count)]
