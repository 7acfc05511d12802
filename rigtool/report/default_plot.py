"""Plots of the parts of a run: a table, a signal, a figure; by default the first of them."""

from __future__ import annotations

import itertools
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from rigtool.errors import RunFileError, UsageError, did_you_mean
from rigtool.escapes import figure as figure_text
from rigtool.inputs import PathName
from rigtool.quantity import display_unit
from rigtool.report.figures import PLOTS, style
from rigtool.runfile import Recording, Run, Table
from rigtool.runfile.opened import guard
from rigtool.runfile.outputs import replacing, require_output

PLOT_FORMATS = (".png", ".svg", ".pdf")

_BINS = 2000
_BLOCK = 2**17
_GAP = 5
"""Times of a usual bin, beyond which nothing was recorded."""
_MOST_LINES = 12
ROW_AXIS = "row"
"""Axis that numbers the rows of a table, and is no quantity."""

_MOST_MARKS = 100


def write_plot(run: Run, output: PathName, name: str | None = None, *, overwrite: bool) -> str:
    """Draw a part of a run into a file; return the name of the part.

    `name` is one of `plot_names`, or the bare name of a table or recording; None is the default.
    Raises `RunFileError` where there is nothing to draw, `UsageError` for a file or a name that
    cannot be.
    """
    kind = Path(output).suffix
    if kind not in PLOT_FORMATS:
        raise UsageError(f"{output}: cannot be drawn, use one of {', '.join(PLOT_FORMATS)}")
    output = require_output(output, overwrite=overwrite, inputs=[run.path])
    shown = chosen_name(run, name)
    with style.styled(), guard(run.path, f"what {shown} shows"):
        picture = style.save_figure(draw_plot(run, shown), kind[1:])
    with replacing(output) as new:
        new.write_bytes(picture)
    return shown


def plot_names(run: Run) -> list[str]:
    """Return what can be drawn of a run: tables, signals of recordings, figures of the report."""
    tables = [f"tables/{name}" for name, table in run.tables.items() if table[table.signal].size]
    signals = [
        f"recordings/{recording.name}/{channel}"
        for recording in run.recordings_named("")
        for channel in recording.units
        if channel != "time"
    ]
    return [*tables, *signals, *(f"figure-{n}" for n, one in PLOTS.items() if one.fits(run))]


def chosen_name(run: Run, name: str | None) -> str:
    """Return the one of `plot_names` that a name stands for; the first one for None.

    A bare name is that of a table, a recording or a signal; a recording stands for its first
    signal. Raises `RunFileError` and `UsageError` as `write_plot`.
    """
    names = plot_names(run)
    if not names:
        raise RunFileError(f"{run.path}: has neither tables nor signals to draw")
    if name is None:
        return names[0]
    for own in names:
        if name in (own, own.partition("/")[2], own.rpartition("/")[2]) or own.startswith(
            (f"{name}/", f"recordings/{name}/")
        ):
            return own
    known = [*names, *(part for own in names for part in own.split("/"))]
    hint = did_you_mean(name, known)
    choice = [own for own in names if not own.startswith("recordings/")]
    if run.recordings:
        choice.append(f"recordings/NAME/SIGNAL (`rigtool info {run.path}` lists them)")
    raise UsageError(
        f"{run.path}: has no part {name!r} to draw: choose one of {', '.join(choice)}"
        f"{hint and f'; {hint}'}"
    )


def draw_plot(run: Run, name: str) -> style.Figure:
    """Return the picture of one of `plot_names`."""
    kind, _, rest = name.partition("/")
    if not rest:
        return PLOTS[int(kind.removeprefix("figure-"))].draw(run)
    figure = style.empty(5.0, 8.0)
    axes = figure.add_subplot()
    if kind == "tables":
        _draw_table(axes, run.table(rest))
    else:
        recording, _, channel = rest.rpartition("/")
        _draw_recording(axes, run.recording(recording), channel)
    axes.set_title(figure_text(f"{run.command}: {rest}" + (f" ({run.rig})" if run.rig else "")))
    return figure


def _draw_table(axes: style.Axes, table: Table) -> None:
    """Draw the signal along the last axis, one line for each point of the other axes.

    Along whole numbers, such as loads, a few points stand alone. No line passes zero speed, where
    friction changes its sign. Rows that have a time are drawn over it.
    """
    if table.axes == (ROW_AXIS,) and "time" in table.columns:
        return _draw_rows(axes, table)
    signal = table.columns[table.signal]
    along = table.axes[-1]
    factor, unit = display_unit(signal.unit, _size(signal.values))
    lines = signal.values.reshape(-1, table.shape[-1]) * factor
    labels = _labels(table)
    scale, axis_unit = display_unit(table.columns[along].unit)
    places = np.asarray(table[along]) * scale
    few = places.size <= _MOST_MARKS
    numbered = few and table.columns[along].unit == "1" and not np.any(places % 1)
    if numbered:
        axes.locator_params("x", integer=True)
    drawn: dict[str, Any] = {"marker": "." if few else "", "lw": 0 if numbered else 1}
    zero = np.array([], dtype=int)
    if along == "speed":
        order = np.argsort(places, kind="stable")
        places, lines = places[order], lines[:, order]
        zero = np.flatnonzero(places[:-1] * places[1:] < 0) + 1
    shown = _spread(len(lines))
    for index, colour in zip(shown, style.colours(len(shown)), strict=True):
        x, y = np.insert(places, zero, 0.0), np.insert(lines[index], zero, np.nan)
        axes.plot(x, y, color=colour, label=labels[index], **drawn)
    if len(lines) > 1:
        axes.legend(fontsize="small")
    _scale(axes, places, along, signal.values)
    axes.set_xlabel(_label(along, axis_unit))
    axes.set_ylabel(_label(table.signal, unit))


def _draw_rows(axes: style.Axes, table: Table) -> None:
    """Draw the signal of rows over their time, one line for each recording."""
    signal = table.columns[table.signal]
    factor, unit = display_unit(signal.unit, _size(signal.values))
    own = table["recording"] if "recording" in table.columns else np.zeros(table.shape, dtype=int)
    numbers = np.unique(own)
    shown = numbers[_spread(len(numbers))]
    for number, colour in zip(shown, style.colours(len(shown)), strict=True):
        rows = own == number
        places, values = table["time"][rows], factor * signal.values[rows]
        axes.plot(places, values, lw=1, color=colour, label=f"recording {number}")
    if len(shown) > 1:
        axes.legend(fontsize="small")
    axes.set_xlabel(_label("time", table.columns["time"].unit))
    axes.set_ylabel(_label(table.signal, unit))


def _size(values: NDArray[Any]) -> float:
    """Return the largest magnitude of values, 0 where there is none."""
    finite = np.abs(values[np.isfinite(values)])
    return float(finite.max(initial=0.0))


def _scale(axes: style.Axes, places: NDArray[Any], along: str, values: NDArray[Any]) -> None:
    """Make the axes of a response over frequency logarithmic, where values allow it."""
    if along != "frequency" or not places.size or places.min() <= 0:
        return
    axes.set_xscale("log")
    if np.nanmin(values) > 0:
        axes.set_yscale("log")


def _labels(table: Table) -> list[str]:
    """Return the label of each line: its point on the leading axes."""
    leading = table.axes[:-1]
    points = itertools.product(*(table[axis] for axis in leading))
    units = [_shown(table.columns[axis].unit) for axis in leading]
    return [
        ", ".join(
            f"{axis} {value:.4g} {unit}".rstrip()
            for axis, value, unit in zip(leading, point, units, strict=True)
        )
        for point in points
    ]


def _spread(count: int) -> list[int]:
    """Return at most `_MOST_LINES` indices, the first and the last among them."""
    return sorted(set(np.linspace(0, count - 1, min(count, _MOST_LINES)).round().astype(int)))


def _draw_recording(axes: style.Axes, recording: Recording, name: str) -> None:
    """Draw the lowest and highest value of each bin: no peak of a long recording is lost.

    Nothing is drawn across gaps of the time.
    """
    factor, shown = display_unit(recording.units[name])
    step = -(-recording.size // _BINS)
    block = step * max(1, _BLOCK // step)
    time, low, high = [], [], []
    for start in range(0, recording.size, block):
        stop = min(start + block, recording.size)
        values = recording.read(name, start, stop) * factor
        bins = np.arange(0, values.size, step)
        time.append(recording.read("time", start, stop)[::step])
        low.append(np.minimum.reduceat(values, bins))
        high.append(np.maximum.reduceat(values, bins))
    times, lows, highs = (np.concatenate(part) for part in (time, low, high))
    steps = np.diff(times, prepend=times[0])
    gaps = np.flatnonzero(steps > _GAP * np.median(steps))
    lows, highs = (np.insert(part, gaps, np.nan) for part in (lows, highs))
    axes.fill_between(np.insert(times, gaps, times[gaps]), lows, highs, lw=1, color=style.BLUE)
    axes.set_xlabel(_label("time", recording.units["time"]))
    axes.set_ylabel(_label(name, shown))


def _label(name: str, unit: str) -> str:
    text = name.replace("_", " ")
    return f"{text} [{_shown(unit)}]" if _shown(unit) else text


def _shown(unit: str) -> str:
    return "" if unit == "1" else unit
