"""Figures 20, 22, 30, 32, 34: torque constant, breakaway, torque against speed [7.1.1-7.2.2]."""

from __future__ import annotations

import numpy as np

from rigtool.numerics.arrays import Array
from rigtool.report.figures import style
from rigtool.report.figures.axes import MILLI, counts
from rigtool.report.figures.plots import FIRST_OWN_NUMBER, plot
from rigtool.runfile import Run, Table


@plot(20, "calibrate-kt", "Torque constant as function of motor temperature", "torque_constant")
def draw_torque_constant(run: Run, table: Table) -> style.Figure:
    """Fig. 20: torque constant against motor temperature, with the fitted line."""
    degc, constant = table["temperature"], table["torque_constant"]
    figure, axes = style.one_panel("motor temperature [°C]", "torque constant [mN m/A]")
    style.points(axes, degc, MILLI * constant, 2 * MILLI * table["u"], "measured, k = 2")
    at_20 = run.result("torque_constant").value
    slope = run.result("torque_constant_temperature_coefficient").value
    ends = np.array([degc.min(), degc.max()])
    axes.plot(
        ends,
        MILLI * _line_of(run, ends),
        color=style.ORANGE,
        label=f"{MILLI * at_20:.2f} mN m/A at 20 °C, {100 * slope:+.3f} %/K".replace("-", "−"),
    )
    style.legend_above(axes, 2)
    return figure


@plot(22, "stribeck", "Static friction: one slow ramp of torque", "breakaway_ramp")
def draw_breakaway(run: Run, table: Table) -> style.Figure:
    """Fig. 22: one slow ramp of torque, the rotor position during it, and where it breaks away."""
    labels = ["torque [mN m]", "rotor position [quad counts]"]
    figure, (torque, position) = style.panels(2, "time [s]", labels, 4.2)
    torque.plot(table["time"], MILLI * table["torque"], color=style.BLUE)
    position.plot(table["time"], counts(run, table), color=style.ORANGE)
    if (found := _breakaway_of(run, table)) is not None:
        time, level = found
        for axes in (torque, position):
            axes.axvline(time, color=style.GREY, linestyle=":")
        torque.plot([time], [MILLI * level], "o", color=style.ORANGE, label="breakaway")
        text = f"breakaway at {MILLI * abs(level):.2f} mN m"
        torque.annotate(
            text,
            (time, MILLI * level),
            (-8, 0),
            textcoords="offset points",
            ha="right",
            va="center",
        )
    return figure


def _breakaway_of(run: Run, table: Table) -> tuple[float, float] | None:
    """Return time, s, and torque, N m, at which the shaft of a ramp breaks away."""
    from rigtool.errors import InsufficientDataError
    from rigtool.experiments.friction.breakaway import find_ramps

    if run.recipe is None:
        return None
    time, torque = table["time"], table["torque"]
    threshold = run.recipe.stribeck.breakaway_angle
    try:
        ramps = find_ramps(time=time, angle=table["position"], torque=torque, threshold=threshold)
    except InsufficientDataError:
        return None
    found = [ramp for ramp in ramps if np.isfinite(ramp.torque)]
    if not found:
        return None
    place = int(np.argmin(np.abs(np.abs(torque) - found[0].torque)))
    return float(time[place]), float(torque[place])


@plot(30, "stribeck", "Torque-speed curve without compensation", "torque_speed")
def draw_torque_speed(run: Run, table: Table) -> style.Figure:
    """Fig. 30: torque against speed without compensation."""
    figure, axes = _torque_speed(table, table)
    if "friction_model" in run.tables:
        model = run.table("friction_model")
        _branches(axes, model["speed"], MILLI * model["torque"], "friction model")
    style.legend_above(axes)
    return figure


@plot(
    32,
    "stribeck",
    "Torque-speed curve with Coulomb friction compensation",
    "torque_speed",
    "torque_speed_coulomb",
)
def draw_torque_speed_coulomb(run: Run, whole: Table, table: Table) -> style.Figure:
    """Fig. 32: the same with Coulomb compensation; the dashed line is the viscous friction."""
    figure, axes = _torque_speed(whole, table)
    viscous = run.result("viscous_friction").value
    label = f"viscous friction {1e6 * viscous:.3g} µN m s/rad"
    _branches(axes, table["speed"], MILLI * viscous * table["speed"], label)
    style.legend_above(axes)
    return figure


@plot(
    34,
    "stribeck",
    "Torque-speed curve with Coulomb and viscous friction compensation",
    "torque_speed",
    "torque_speed_viscous",
)
def draw_torque_speed_viscous(run: Run, whole: Table, table: Table) -> style.Figure:
    """Fig. 34: the same with Coulomb and viscous compensation: flat."""
    figure, axes = _torque_speed(whole, table)
    style.legend_above(axes)
    return figure


def _torque_speed(whole: Table, table: Table) -> tuple[style.Figure, style.Axes]:
    """Draw torque by speed with its expanded uncertainty, on the ordinate of the whole curve."""
    figure, axes = style.one_panel("motor speed [rad/s]", "torque [mN m]")
    bar, label = None, "measured"
    if "u" in table.columns:
        bar, label = 2 * MILLI * table["u"], "measured, k = 2 where a speed has two turns"
    style.points(axes, table["speed"], MILLI * table["torque"], bar, label)
    # One scale for all three figures shows the effect of the compensation.
    highest = MILLI * np.nanmax(np.abs(whole["torque"]))
    axes.set_ylim(-1.1 * highest, 1.1 * highest)
    return figure, axes


def _branches(axes: style.Axes, speed: Array, torque: Array, label: str | None) -> None:
    """Draw a curve of each direction; none goes through zero speed, where friction reverses."""
    for own in (speed > 0, speed < 0):
        if own.any():
            axes.plot(speed[own], torque[own], "--", color=style.ORANGE, label=label)
            label = None


STRIBECK_ZONE = 5.0
"""The Stribeck zone is drawn up to this multiple of the Stribeck velocity."""


@plot(FIRST_OWN_NUMBER + 6, "calibrate-kt", "Residuals of the torque constant", "torque_constant")
def draw_constant_residuals(run: Run, table: Table) -> style.Figure:
    """Measured constant over the fitted line, by temperature, with expanded uncertainty."""
    degc, line = table["temperature"], _line_of(run, table["temperature"])
    figure, axes = style.one_panel("motor temperature [°C]", "measured / fitted − 1 [%]")
    off, u = 100 * (table["torque_constant"] / line - 1), 200 * table["u"] / line
    style.points(axes, degc, off, u, "residual; k = 2, what all points share included")
    axes.axhline(0, color=style.GREY, linewidth=0.8)
    style.legend_above(axes)
    return figure


def _line_of(run: Run, degc: Array) -> Array:
    """Return the fitted torque constant at temperatures, N m/A."""
    at_20 = run.result("torque_constant").value
    slope = run.result("torque_constant_temperature_coefficient").value
    return np.asarray(at_20 * (1 + slope * (degc - 20)))


@plot(FIRST_OWN_NUMBER + 7, "calibrate-kt", "Linearity of the amplifier", "linearity")
def draw_linearity(run: Run, table: Table) -> style.Figure:
    """Deviation of the measured current from the line through its set points."""
    figure, axes = style.one_panel("current set point [A]", "deviation from the line [µA]")
    style.points(axes, table["current_setpoint"], 1e6 * table["deviation"], None, "deviation")
    axes.axhline(0, color=style.GREY, linewidth=0.8)
    return figure


@plot(FIRST_OWN_NUMBER + 8, "calibrate-kt", "Hysteresis of the staircase", "hysteresis")
def draw_staircase_hysteresis(run: Run, table: Table) -> style.Figure:
    """Torque on the way up and on the way down, each less the mean of both."""
    figure, axes = style.one_panel("current [A]", "torque less mean of both ways [mN m]")
    middle = (table["rising"] + table["falling"]) / 2
    for name, colour in (("rising", style.BLUE), ("falling", style.ORANGE)):
        off = MILLI * (table[name] - middle)
        axes.plot(table["current"], off, "o-", markersize=3, color=colour, label=f"{name} current")
    axes.axhline(0, color=style.GREY, linewidth=0.8)
    style.legend_above(axes)
    return figure


@plot(FIRST_OWN_NUMBER + 9, "stribeck", "Breakaway torque by rotor position", "breakaway")
def draw_breakaway_by_position(run: Run, table: Table) -> style.Figure:
    """Breakaway torque around the turn in both directions, with radial load, too."""
    figure, axes = style.one_panel("rotor position [deg]", "breakaway torque [mN m]")
    degrees = np.degrees(table["position"])
    for name, colour, marker, label in (
        ("positive", style.BLUE, "o", "positive direction"),
        ("negative", style.ORANGE, "s", "negative direction"),
        ("loaded_positive", style.SKY, "^", "positive, radial load"),
        ("loaded_negative", style.YELLOW, "v", "negative, radial load"),
    ):
        if name in table.columns:
            torque = MILLI * table[name]
            axes.plot(degrees, torque, marker, color=colour, markersize=4, label=label)
    axes.set_xlim(0, 360)
    axes.set_xticks(range(0, 361, 45))
    axes.set_ylim(bottom=0)
    style.legend_above(axes, 2)
    return figure


@plot(
    FIRST_OWN_NUMBER + 10,
    "stribeck",
    "Friction at constant speeds, in the Stribeck zone where one was found",
    "holds",
)
def draw_stribeck_zone(run: Run, table: Table) -> style.Figure:
    """Torque at constant low speeds with its uncertainty, and the model; a panel a direction."""
    speed, torque = table["speed"], MILLI * table["torque"]
    velocity = run.results.get("stribeck_velocity")
    zone = STRIBECK_ZONE * velocity.value if velocity is not None else float("nan")
    if not np.isfinite(zone):
        zone = float(np.abs(speed).max()) / 4
    zone = max(zone, float(np.sort(np.abs(speed))[: min(12, len(speed))].max()))
    figure = style.empty()
    for axes, sign in zip(figure.subplots(1, 2), (-1, 1), strict=True):
        own = (sign * speed > 0) & (np.abs(speed) <= zone)
        u = 2 * MILLI * table["u"][own]
        style.points(axes, speed[own], torque[own], u, "constant speeds, k = 2")
        if "friction_model" in run.tables:
            model = run.table("friction_model")
            near = (sign * model["speed"] > 0) & (np.abs(model["speed"]) <= zone)
            shown = MILLI * model["torque"][near]
            axes.plot(model["speed"][near], shown, "--", color=style.ORANGE, label="friction model")
        axes.set_xlabel("motor speed [rad/s]")
        axes.locator_params(axis="x", nbins=4)
    figure.axes[0].set_ylabel("torque [mN m]")
    style.legend_above(figure.axes[0], 1)
    return figure
