"""Force over time: torque with its interval, error against the reference, coverage by state."""

from __future__ import annotations

import itertools

import numpy as np

from rigtool.experiments.force_filter.accuracy import off_zero
from rigtool.experiments.force_filter.motion_states import STATE_NAMES, State
from rigtool.numerics.arrays import Array, Mask
from rigtool.report.figures import style
from rigtool.report.figures.axes import MILLI, OUTPUT_TORQUE
from rigtool.report.figures.plots import FIRST_OWN_NUMBER, plot
from rigtool.runfile import Run, Table

MAX_POINTS = 4000
"""Points of each curve over the whole time."""

GAP_STEPS = 1.5
"""Time between two rows, in that between points, from which on no curve joins them."""

AROUND_PEAK = 3.0
"""Time drawn before and after the largest torque, s."""

STATED_COVERAGE = 0.95
"""Coverage that the interval states."""


@plot(FIRST_OWN_NUMBER + 3, "measure-force", "Torque over time with its 95 % interval", "force")
def draw_over_time(run: Run, table: Table) -> style.Figure:
    """Torque and interval over the first recording; below, the error, where it has a reference."""
    time, signals = _first_recording(table)
    return _torque_and_error(*_drawn_points(time, signals))


@plot(FIRST_OWN_NUMBER + 4, "measure-force", "Torque around its largest value", "force")
def draw_around_peak(run: Run, table: Table) -> style.Figure:
    """The same within `AROUND_PEAK` of the largest torque."""
    time, signals = _first_recording(table)
    peak = time[off_zero(signals["low"], signals["high"]).argmax()]
    near: Mask = np.abs(time - peak) < AROUND_PEAK
    near_signals = {name: values[near] for name, values in signals.items()}
    return _torque_and_error(*_drawn_points(time[near], near_signals))


@plot(
    FIRST_OWN_NUMBER + 5,
    "measure-force",
    "Error and coverage by load and state of motion",
    "force_accuracy",
)
def draw_accuracy(run: Run, table: Table) -> style.Figure:
    """Root mean square of the error, and coverage of the 95 % interval, of each load and state."""
    seen = np.isfinite(table["rmse"]).any(axis=1)
    bands, states = MILLI * table["band"], table["state"]
    ranges = [f"{low:.2g} to {high:.2g}" for low, high in itertools.pairwise(bands)]
    ranges = np.array([*ranges, f"above {bands[-1]:.2g}"])[seen]
    figure, panels = style.panels(
        2, "torque of the reference [mN m]", ["error, rms [mN m]", "coverage"], 1.3 * style.HEIGHT
    )
    place, width = np.arange(len(ranges)), 0.8 / len(states)
    for index, state in enumerate(states):
        x = place + (index - (len(states) - 1) / 2) * width
        label = STATE_NAMES[State(state)]
        for axes, height in zip(panels, (MILLI * table["rmse"], table["coverage_95"]), strict=True):
            axes.bar(x, height[seen, index], 0.9 * width, color=style.CYCLE[index], label=label)
    panels[1].axhline(STATED_COVERAGE, color=style.GREY, linestyle=":", linewidth=0.8)
    panels[1].set_ylim(0, 1)
    panels[1].set_xticks(place, ranges)
    style.legend_above(panels[0], 2)
    return figure


def _first_recording(table: Table) -> tuple[Array, dict[str, Array]]:
    """Return time from the start of the recording, s, and its signals, mN m."""
    rows = table["recording"] == table["recording"][0]
    names = [name for name in ("torque", "low", "high", "reference") if name in table.columns]
    time = table["time"][rows]
    return time - time[0], {name: MILLI * table[name][rows] for name in names}


def _drawn_points(time: Array, signals: dict[str, Array]) -> tuple[Array, dict[str, Array]]:
    """Return `MAX_POINTS` points at most, and NaN where rows are missing.

    Where there are more rows, each point is that of several whose interval is farthest from zero,
    so that a short contact shows.
    """
    step = -(-time.size // MAX_POINTS)
    far = off_zero(signals["low"], signals["high"])
    rows = np.array([k + far[k : k + step].argmax() for k in range(0, time.size, step)], np.intp)
    steps = np.abs(np.diff(time))
    gaps = np.flatnonzero(steps > GAP_STEPS * step * np.median(steps)) if steps.size else rows[:0]
    missing = np.searchsorted(rows, gaps, side="right")
    points = {n: np.insert(values[rows], missing, np.nan) for n, values in signals.items()}
    return np.insert(time[rows], missing, time[gaps]), points


def _torque_and_error(time: Array, signals: dict[str, Array]) -> style.Figure:
    """Draw torque with its interval; below, its error with the same interval about zero."""
    judged = "reference" in signals and bool(np.isfinite(signals["reference"]).any())
    figure, panels = style.panels(
        1 + judged,
        "time [s]",
        [OUTPUT_TORQUE, "error [mN m]"][: 1 + judged],
        style.HEIGHT * (1.5 if judged else 1),
        height_ratios=[2, 1][: 1 + judged],
    )
    torque = signals["torque"]
    _band(panels[0], time, signals["low"], signals["high"])
    if judged:
        reference = signals["reference"]
        panels[0].plot(time, reference, color=style.ORANGE, label="reference")
        _band(panels[1], time, signals["low"] - torque, signals["high"] - torque)
        panels[1].plot(time, torque - reference, color=style.BLUE, linewidth=0.8)
    panels[0].plot(time, torque, color=style.BLUE, label="from motor current", linewidth=0.8)
    if time[-1] > time[0]:
        panels[0].set_xlim(time[0], time[-1])
    style.legend_above(panels[0])
    return figure


def _band(axes: style.Axes, time: Array, low: Array, high: Array) -> None:
    axes.fill_between(
        time, low, high, color=style.SKY, alpha=0.4, linewidth=0, label="95 % interval"
    )
