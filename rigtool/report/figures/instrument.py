"""Figures of a real instrument, measured against a sensor at its jaw."""

from __future__ import annotations

import numpy as np

from rigtool.experiments.force_filter.motion_states import STATE_NAMES, State
from rigtool.numerics.arrays import Mask
from rigtool.report.figures import style
from rigtool.report.figures.axes import MILLI
from rigtool.report.figures.plots import FIRST_OWN_NUMBER, plot
from rigtool.runfile import Run, Table


@plot(
    FIRST_OWN_NUMBER + 1,
    "measure-force",
    "Hysteresis: effort of the motor against torque at the load",
    "force",
    "loads",
)
def draw_hysteresis(run: Run, table: Table, loads: Table) -> style.Figure:
    """Loop of the motor's effort against the sensor's torque."""
    from matplotlib import colormaps

    effort = table.columns["effort"]
    name = "current" if effort.unit == "A" else "torque"
    figure, axes = style.one_panel(
        "torque at the load, sensor [mN m]", f"{name} of the motor [{effort.unit}]", 4.2
    )
    recordings = sorted(
        _recordings(table), key=lambda rows: abs(float(np.mean(table["reference"][rows])))
    )
    shades = [colormaps[style.COLOUR_MAP](value) for value in np.linspace(0, 0.9, len(recordings))]
    for shade, rows in zip(shades, recordings, strict=True):
        axes.plot(MILLI * table["reference"][rows], effort.values[rows], color=shade, linewidth=0.5)
    return figure


@plot(
    FIRST_OWN_NUMBER + 2,
    "measure-force",
    "Error by load: median and 95 % of the samples of each run",
    "force",
    "loads",
)
def draw_error_by_level(run: Run, table: Table, loads: Table) -> style.Figure:
    """Errors of single samples over the torque of their run, against and with the load."""
    error = MILLI * (table["torque"] - table["reference"])
    figure, axes = style.one_panel("torque at the load, sensor [mN m]", "error [mN m]", 3.6)
    for state, colour in ((State.WITH, style.SKY), (State.AGAINST, style.BLUE)):
        rows = []
        for own in _recordings(table):
            mask = own & (table["state"] == state)
            if not mask.any():
                continue
            low, mid, high = np.percentile(error[mask], [2.5, 50, 97.5])
            rows.append((MILLI * np.mean(table["reference"][mask]), low, mid, high))
        if not rows:
            continue
        torque, low, mid, high = np.array(rows).T
        axes.errorbar(
            torque,
            mid,
            [mid - low, high - mid],
            fmt="o",
            ms=3,
            lw=0.8,
            color=colour,
            label=STATE_NAMES[state],
        )
    axes.axhline(0, color=style.GREY, linewidth=0.8)
    style.legend_above(axes)
    return figure


def _recordings(table: Table) -> list[Mask]:
    """Return the rows of each recording."""
    number = table["recording"]
    return [number == own for own in np.unique(number)]
