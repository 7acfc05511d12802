"""Figures 70 and 75: leaf springs of the motor, torque of eccentric pulleys [App. E, J]."""

from __future__ import annotations

import math

from rigtool.report.figures import style
from rigtool.report.figures.plots import plot
from rigtool.runfile import Run, Table


@plot(70, "suspension", "Spring constant of the motor's suspension", "spring_curve")
def draw_spring_curve(run: Run, table: Table) -> style.Figure:
    """Fig. 70: force against deflection, with the line whose slope is the spring constant."""
    stiffness = run.result("spring_constant")
    figure, axes = style.one_panel("deflection [mm]", "force [N]")
    axes.plot(1e3 * table["deflection"], table["force"], "o", markersize=4, label="measured")
    label = f"{stiffness.value / 1e3:.2f} kN/m"
    axes.plot(1e3 * table["line"], table["force"], color=style.ORANGE, label=label)
    style.legend_above(axes, 2)
    return figure


@plot(75, "suspension", "Disturbance torque due to pulley eccentricity", "eccentric_torque")
def draw_eccentric_torque(run: Run, table: Table) -> style.Figure:
    """Fig. 75: torque of the moving mass over a turn, at the slowest speed."""
    slowest = int(abs(table["speed"]).argmin())
    turning = table["speed"][slowest] / (2 * math.pi)
    figure, axes = style.one_panel("angle [deg]", f"torque at {turning:.3g} rev/s [nN m]")
    axes.plot(table["angle"] * 180 / math.pi, 1e9 * table["inertia"][slowest], color=style.BLUE)
    axes.set_xticks(range(0, 361, 45))
    return figure
