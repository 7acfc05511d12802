"""Figures 70 and 75: leaf springs of the motor, torque of pulleys out of centre [App. E, J]."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

from rigtool.report.figures import style

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from rigtool.runfile import Run


def spring_curve(run: Run) -> Figure:
    """Fig. 70: force against deflection, with the line whose slope is the spring constant."""
    table, stiffness = run.table("spring_curve"), run.result("spring_constant")
    figure, axes = style.one_panel("deflection [mm]", "force [N]")
    axes.plot(1e3 * table["deflection"], table["force"], "o", markersize=4, label="measured")
    label = f"{stiffness.value / 1e3:.2f} kN/m"
    axes.plot(1e3 * table["line"], table["force"], color=style.ORANGE, label=label)
    style.legend_above(axes, 2)
    return figure


def eccentric_torque(run: Run) -> Figure:
    """Fig. 75: torque of the moving mass over a turn, at each speed, and that of the springs."""
    table = run.table("eccentric_torque")
    speeds = table["speed"]
    labels = [f"at {speed / (2 * math.pi):.3g} rev/s" for speed in speeds]
    count = len(speeds) + 1
    figure, panels = style.panels(count, "angle [deg]", ["torque [nN m]"] * count, 1.7 * count)
    degrees = table["angle"] * 180 / math.pi
    for panel, torque, label in zip(panels, table["inertia"], labels, strict=False):
        panel.plot(degrees, 1e9 * torque, color=style.BLUE, label=f"moving mass {label}")
    panels[-1].plot(degrees, 1e9 * table["spring"][0], color=style.ORANGE, label="leaf springs")
    for panel in panels:
        style.legend_above(panel)
    panels[-1].set_xticks(range(0, 361, 45))
    return figure
