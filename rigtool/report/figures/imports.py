"""Figures of imported runs: what a map removes of a run that it was not learned from; two runs."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from rigtool.quantity import display_unit
from rigtool.report.figures import style
from rigtool.report.figures.plots import FIRST_OWN_NUMBER, MAP, plot

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from rigtool.runfile import Run, Table

ORDERS_SHOWN = 12
"""Strongest orders of the run that are drawn."""


@plot(
    FIRST_OWN_NUMBER + 16,
    "ilc-learn",
    "Map of the turn",
    "lookup",
    implementations=(MAP,),
    any_unit=True,
)
def draw_map(run: Run, table: Table) -> Figure:
    """Learned effort around the turn, a line for each speed."""
    signal = table.columns[table.signal]
    factor, unit = display_unit(signal.unit, float(np.abs(signal.values).max()))
    figure, axes = style.one_panel("position [deg]", f"{table.signal} [{unit}]")
    speeds = table["speed"]
    for speed, row, colour in zip(speeds, signal.values, style.colours(len(speeds)), strict=True):
        axes.plot(
            np.degrees(table["position"]), factor * row, color=colour, label=f"{speed:.3g} rad/s"
        )
    style.legend_above(axes)
    return figure


@plot(FIRST_OWN_NUMBER + 17, "ilc-check", "What a map removes", "held_out", any_unit=True)
def draw_held_out(run: Run, table: Table) -> Figure:
    """Amplitude by order with and without the map; the shares removed of orders and of records."""
    strong = np.sort(np.argsort(-table["amplitude"])[:ORDERS_SHOWN])
    factor, unit = display_unit(
        table.columns["amplitude"].unit, float(table["amplitude"].max(initial=0.0))
    )
    figure, axes = style.one_panel("", f"amplitude [{unit}]")
    places = np.arange(len(strong))
    for shift, name, colour, label in (
        (-0.2, "amplitude", style.ORANGE, "of the run"),
        (0.2, "remaining", style.BLUE, "had the map been added"),
    ):
        axes.bar(places + shift, factor * table[name][strong], 0.4, color=colour, label=label)
    floor = factor * table["remaining_noise_floor"][strong]
    axes.plot(places, floor, "_", color="k", markersize=16, label="scatter alone")
    axes.set_xticks(places, [f"{order:.0f}" for order in table["order"][strong]])
    axes.grid(visible=False, axis="x")
    record = run.results["record_variance_removed"].value
    part = 1 - (1 - run.results["removed"].value) ** 2
    axes.set_xlabel(
        "order of rotation\n"
        f"variance removed: {100 * part:.1f} % of what repeats, {100 * record:.1f} % of the raw "
        "record"
    )
    style.legend_above(axes)
    return figure


@plot(
    FIRST_OWN_NUMBER + 18, "stribeck", "Change between two runs", "paired_difference", any_unit=True
)
def draw_difference(run: Run, table: Table) -> Figure:
    """Difference of the efforts at the same points of one motion, and that of the fitted change."""
    factor, unit = display_unit(
        table.columns["difference"].unit, float(np.nanmax(np.abs(table["difference"])))
    )
    figure = style.empty()
    panels = figure.subplots(1, 2, sharey=True)
    for axes, along in zip(panels, ("time", "position"), strict=True):
        for name, colour, label in (
            ("difference", style.SKY, "measured"),
            ("model", style.ORANGE, "fitted change"),
        ):
            values = factor * table[name]
            axes.plot(table[along], values, ".", color=colour, ms=2, label=label, rasterized=True)
        axes.set_xlabel(f"{along} [{table.columns[along].unit}]")
    panels[0].set_ylabel(f"difference [{unit}]")
    style.legend_above(panels[0])
    return figure
