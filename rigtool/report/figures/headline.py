"""The figure that opens a report: measured against applied torque, and the errors below."""

from __future__ import annotations

from typing import Any

import numpy as np

from rigtool.report.figures import style
from rigtool.report.figures.axes import MILLI
from rigtool.report.figures.plots import HEADLINE, plot
from rigtool.report.requirements import COVERAGE_FACTOR
from rigtool.report.tables import UNCORRECTED_TABLE, correction_of
from rigtool.runfile import Run, Table


@plot(HEADLINE, "measure-force", "Measured against applied torque", "loads")
def draw_headline(run: Run, loads: Table) -> style.Figure:
    """Mean readings over applied torque, uncorrected and corrected, with k = 2 bars.

    Below, the errors in percent; the band is the recipe's requirement.
    """
    correction = correction_of(run)
    ways = {f"correction {correction}" if correction != "none" else "measured": loads}
    if UNCORRECTED_TABLE in run.tables:
        ways = {"without correction": run.table(UNCORRECTED_TABLE), **ways}
    figure, (above, below) = style.panels(
        2,
        "applied torque at the output [mN m]",
        ["measured [mN m]", "error [%]"],
        1.5 * style.HEIGHT,
        height_ratios=[3, 2],
    )
    required = None if run.recipe is None else run.recipe.requirements.force_error
    if required is not None:
        below.axhspan(-100 * required, 100 * required, color=style.BAND, zorder=0, label="required")
    largest = 0.0
    for colour, marker, (label, table) in zip(
        (style.ORANGE, style.BLUE)[-len(ways) :], "so", ways.items(), strict=False
    ):
        applied = table["applied_torque"]
        rows = (applied > 0) & np.isfinite(table["mean_torque"])
        x, bar = MILLI * applied[rows], COVERAGE_FACTOR * table["mean_torque_u"][rows]
        drawn: dict[str, Any] = {"fmt": marker, "color": colour}
        name = f"{label}, k = {COVERAGE_FACTOR:g}"
        style.points(above, x, MILLI * table["mean_torque"][rows], MILLI * bar, name, **drawn)
        percent = 100 * bar / applied[rows]
        style.points(below, x, table["error_percent"][rows], percent, "", **drawn)
        largest = max(largest, float(x.max(initial=0.0)))
    above.plot([0, largest], [0, largest], color=style.GREY, linewidth=0.8, label="equal")
    below.axhline(0, color=style.GREY, linewidth=0.8)
    style.legend_above(above, 4)
    if required is not None:
        below.legend(loc="best")
    return figure
