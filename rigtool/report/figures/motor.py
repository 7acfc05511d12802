"""Figures 20, 22, 30, 32, 34: motor constant, breakaway, torque against speed [7.1.1-7.2.2]."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from rigtool.report.figures import style
from rigtool.report.figures.axes import MILLI, counts
from rigtool.report.figures.plots import plot

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from rigtool.runfile import Run, Table


@plot(20, "calibrate-kt", "Motor constant as function of motor temperature", "torque_constant")
def draw_motor_constant(run: Run, table: Table) -> Figure:
    """Fig. 20: motor constant against motor temperature, with the fitted line."""
    degc, constant = table["temperature"], table["torque_constant"]
    figure, axes = style.one_panel("motor temperature [°C]", "motor constant [mN m/A]")
    axes.errorbar(
        degc,
        MILLI * constant,
        MILLI * table["u"],
        fmt="o",
        markersize=4,
        capsize=3,
        color=style.BLUE,
        label="measured, with standard uncertainty",
    )
    at_20 = run.result("torque_constant").value
    slope = run.result("torque_constant_temperature_coefficient").value
    line = np.array([degc.min(), degc.max()])
    axes.plot(
        line,
        MILLI * at_20 * (1 + slope * (line - 20)),
        color=style.ORANGE,
        label=f"{MILLI * at_20:.2f} mN m/A at 20 °C, {100 * slope:+.3f} %/K".replace("-", "−"),
    )
    style.legend_above(axes, 2)
    return figure


@plot(22, "stribeck", "Static friction: one slow ramp of torque", "breakaway_ramp")
def draw_breakaway(run: Run, table: Table) -> Figure:
    """Fig. 22: one slow ramp of torque, and the rotor position during it."""
    labels = ["torque [mN m]", "rotor position [quad counts]"]
    figure, (torque, position) = style.panels(2, "time [s]", labels, 4.2)
    torque.plot(table["time"], MILLI * table["torque"], color=style.BLUE)
    position.plot(table["time"], counts(run, table, "position"), color=style.ORANGE)
    return figure


@plot(30, "stribeck", "Torque-speed curve without compensation", "torque_speed")
def draw_torque_speed(run: Run, table: Table) -> Figure:
    """Fig. 30: torque against speed without compensation."""
    figure, axes = _torque_speed(table, table)
    if "friction_model" in run.tables:
        model = run.table("friction_model")
        axes.plot(
            model["speed"],
            MILLI * model["torque"],
            color=style.ORANGE,
            linestyle="--",
            label="friction model",
        )
        style.legend_above(axes)
    return figure


@plot(
    32,
    "stribeck",
    "Torque-speed curve with Coulomb friction compensation",
    "torque_speed",
    "torque_speed_coulomb",
)
def draw_torque_speed_coulomb(run: Run, whole: Table, table: Table) -> Figure:
    """Fig. 32: the same with Coulomb compensation; the dashed line is the viscous friction."""
    figure, axes = _torque_speed(whole, table)
    viscous = run.result("viscous_friction").value
    ends = table["speed"][[0, -1]]
    axes.plot(
        ends,
        MILLI * viscous * ends,
        color=style.ORANGE,
        linestyle="--",
        label=f"viscous friction {viscous:.3g} N m s/rad".replace("e-05", "e−5"),
    )
    style.legend_above(axes)
    return figure


@plot(
    34,
    "stribeck",
    "Torque-speed curve with Coulomb and viscous friction compensation",
    "torque_speed",
    "torque_speed_viscous",
)
def draw_torque_speed_viscous(run: Run, whole: Table, table: Table) -> Figure:
    """Fig. 34: the same with Coulomb and viscous compensation: flat."""
    return _torque_speed(whole, table)[0]


def _torque_speed(whole: Table, table: Table) -> tuple[Figure, Axes]:
    figure, axes = style.one_panel("motor speed [rad/s]", "torque [mN m]")
    axes.plot(table["speed"], MILLI * table["torque"], color=style.BLUE, label="measured")
    # One scale for all three figures shows the effect of the compensation.
    highest = MILLI * np.nanmax(np.abs(whole["torque"]))
    axes.set_ylim(-1.1 * highest, 1.1 * highest)
    return figure, axes
