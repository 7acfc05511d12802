"""Figures 58-63: force measured with the instrument or on the pulley [chapter 8]; the headline."""

from __future__ import annotations

from statistics import NormalDist
from typing import Any

import numpy as np

from rigtool.numerics.arrays import Array, Mask
from rigtool.report.figures import style
from rigtool.report.figures.axes import (
    MILLI,
    MOTOR_TORQUE,
    OUTPUT_TORQUE,
    UP_AND_DOWN,
    counts,
    cycle_axis,
    fit_height,
    full_cycle,
    thin,
)
from rigtool.report.figures.plots import HEADLINE, plot
from rigtool.report.requirements import COVERAGE_FACTOR
from rigtool.report.tables import UNCORRECTED_TABLE, correction_of
from rigtool.runfile import Run, Table

MAX_POINTS = 175
"""Points of each cycle where all cycles are drawn."""

PROBABILITY_TICKS = (0.01, 0.05, 0.1, 0.25, 0.5, 0.75, 0.9, 0.95, 0.99)


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


@plot(58, "measure-force", "Feed-forward signal at the measuring speed", "feedforward")
def draw_feedforward(run: Run, table: Table) -> style.Figure:
    """Fig. 58: feed-forward from the learned table over one up-and-down."""
    figure, axes = style.one_panel(UP_AND_DOWN, MOTOR_TORQUE)
    position = counts(run, table)
    axes.plot(position, MILLI * table["torque"], color=style.BLUE)
    cycle_axis(axes, position[-1] / 2)
    return figure


@plot(59, "measure-force", "Variation over the cycles without load", "cycles_no_load")
def draw_variation(run: Run, table: Table) -> style.Figure:
    """Fig. 59: the torque that remains without load, all cycles in one plot."""
    figure, axes = style.one_panel(UP_AND_DOWN, OUTPUT_TORQUE)
    position, torque = counts(run, table), MILLI * table["torque"]
    # After the low-pass at 5 Hz there is no detail between these points.
    drawn = thin(MAX_POINTS, position, torque)
    axes.plot(drawn[0], drawn[1].T, color=style.BLUE, linewidth=0.6, alpha=0.5)
    cycle_axis(axes, position[-1] / 2)
    straight = _straight(run, axes, position)
    fit_height(axes, torque[:, straight])
    return figure


@plot(
    60, "measure-force", "Normal probability plot of the readings without load", "probability_plot"
)
def draw_probability_plot(run: Run, table: Table) -> style.Figure:
    """Fig. 60: normal probability plot of the readings without load."""
    quantile, value = table["quantile"], MILLI * table["value"]
    figure, axes = style.one_panel("torque without load [mN m]", "probability")
    axes.plot(value, quantile, "+", color=style.BLUE, label="readings")
    # The customary line of probability plots, through the quartiles.
    lower, upper = np.interp([0.25, 0.75], np.linspace(0, 1, value.size), value)
    quartile = NormalDist().inv_cdf(0.75)
    ends = np.array([quantile[0], quantile[-1]])
    line = (lower + upper) / 2 + ends * (upper - lower) / (2 * quartile)
    axes.plot(line, ends, color=style.ORANGE, linestyle="--", label="normal distribution")
    places = [NormalDist().inv_cdf(p) for p in PROBABILITY_TICKS]
    axes.set_yticks(places, [f"{p:g}" for p in PROBABILITY_TICKS])
    style.legend_above(axes)
    return figure


@plot(61, "measure-force", "Feed-forward and remaining disturbance of one cycle", "feedforward")
def draw_remaining(run: Run, table: Table) -> style.Figure:
    """Fig. 61: feed-forward (blue) and remaining disturbance (green) of one cycle."""
    figure, axes = style.one_panel(UP_AND_DOWN, MOTOR_TORQUE)
    position = counts(run, table)
    axes.plot(position, MILLI * table["torque"], color=style.BLUE, label="feed-forward")
    axes.plot(position, MILLI * table["residual"], color=style.GREEN, label="remaining disturbance")
    style.legend_above(axes)
    cycle_axis(axes, position[-1] / 2)
    _straight(run, axes, position)
    return figure


@plot(62, "measure-force", "High torque: the peak is shifted", "shift")
def draw_shift(run: Run, table: Table) -> style.Figure:
    """Fig. 62: a high load, whose peak is late because the instrument is compliant."""
    figure, axes, middle = _lifted(run, table)
    if "peak_shift_counts" in run.results:
        late = run.results["peak_shift_counts"].value
        top = axes.get_ylim()[1]
        for x, label in ((middle, f"{middle:.0f}"), (middle + late, f"{middle + late:.0f}")):
            axes.axvline(x, color=style.GREY, linewidth=0.8, linestyle=":")
            axes.text(x, top, f" {label}", va="top", color=style.GREY)
    return figure


@plot(63, "measure-force", "Lifting and lowering a mass", "hysteresis")
def draw_lifting_lowering(run: Run, table: Table) -> style.Figure:
    """Fig. 63: a mass lifted and lowered; the difference is friction that grows with load."""
    figure, axes, middle = _lifted(run, table)
    for name, x in (("lifting_torque", middle), ("lowering_torque", 3 * middle)):
        if name in run.results:
            height = MILLI * run.results[name].value
            right = x + 0.4 * middle
            axes.plot([x - 0.4 * middle, right], [height] * 2, ":", color=style.GREY)
            axes.text(right, height, f" {height:.1f} mN m", va="center", color=style.GREY)
    return figure


def _lifted(run: Run, table: Table) -> tuple[style.Figure, style.Axes, float]:
    """Draw a load lifted and lowered; also return the middle of the stroke, quad counts."""
    stroke = counts(run, table)
    end = float(stroke[-1])
    figure, axes = style.one_panel(UP_AND_DOWN, OUTPUT_TORQUE)
    measured = full_cycle(stroke, MILLI * table["lifting"], MILLI * table["lowering"], end)
    applied = full_cycle(stroke, MILLI * table["applied"], MILLI * table["applied"], end)
    axes.plot(*measured, color=style.BLUE, label="measured, mean of the cycles")
    label = "applied by the load, were the instrument stiff"
    axes.plot(*applied, "--", color=style.ORANGE, label=label)
    for x, label in ((end / 2, "lifting"), (1.5 * end, "lowering")):
        axes.annotate(
            label, (x, 0), ha="center", va="bottom", xytext=(0, 4), textcoords="offset points"
        )
    style.legend_above(axes, 2)
    cycle_axis(axes, end)
    straight = _straight(run, axes, stroke)
    curves = [MILLI * table[name][straight] for name in ("lifting", "lowering")]
    fit_height(axes, *curves, MILLI * table["applied"], margin=0.1)
    return figure, axes, end / 2


def _straight(run: Run, axes: style.Axes, position: Array) -> Mask:
    """Return where the motion has constant speed, (n,); draw grey bands where it reverses.

    In the bands, friction reverses and inertia acts; the figures do not show these.
    """
    if run.recipe is None:
        return np.ones(position.size, dtype=bool)
    settings, rig = run.recipe.measure_force, run.recipe.rig
    per_degree = rig.encoder_counts * rig.angle_ratio / 360
    end, turn = settings.angle * per_degree, settings.turn_angle * per_degree
    for low, high in ((0, turn), (end - turn, end + turn), (2 * end - turn, 2 * end)):
        axes.axvspan(low, high, color=style.BAND, linewidth=0, zorder=0)
    within = np.where(position > end, 2 * end - position, position)
    return (within >= turn) & (within <= end - turn)
