"""The summary of a run: lines for the terminal, and HTML for a notebook."""

from __future__ import annotations

import html
from collections.abc import Iterable, Mapping
from itertools import groupby

from rigtool.quantity import Quantity, format_quantity
from rigtool.runfile.model import Table
from rigtool.runfile.recording import Recording


def result_lines(results: Mapping[str, Quantity]) -> list[str]:
    """Return one aligned line a result: name, value with uncertainty and unit, or the reason."""
    width = max(map(len, results), default=0)
    lines = []
    for name, quantity in results.items():
        line = f"{name:{width}}  {format_quantity(quantity)}"
        if quantity.u is None:
            line += f"  (no uncertainty: {quantity.reason})"
        lines.append(line)
    return lines


def recording_lines(recordings: Iterable[Recording]) -> list[str]:
    """Return a line for each recording, and one with the channels of those that share them."""
    lines = []
    for units, group in groupby(recordings, key=lambda item: item.units):
        lines += [_recording_line(item) for item in group]
        lines.append("  with " + ", ".join(f"{name} [{unit}]" for name, unit in units.items()))
    return lines


def _recording_line(recording: Recording) -> str:
    conditions = ", ".join(
        f"{name} {item.value:.4g} {'' if item.unit == '1' else item.unit}".rstrip()
        for name, item in recording.conditions.items()
    )
    rate = recording.rate()
    how = "" if rate is None else f", {rate:.5g} Hz, {recording.duration():.4g} s"
    where = f" at {conditions}" if conditions else ""
    return f"{recording.name}{where}: {recording.size} samples{how}"


def table_line(name: str, table: Table) -> str:
    """Return a line with a table's columns and units, and its axes with their lengths."""
    axes = ", ".join(f"{axis} ({table[axis].size})" for axis in table.axes)
    others = ", ".join(
        f"{key} [{column.unit}]" for key, column in table.columns.items() if key not in table.axes
    )
    return f"{name}: {others} over {axes}"


def html_of(lines: Iterable[str]) -> str:
    """Return lines as preformatted HTML, escaped."""
    text = html.escape("\n".join(lines))
    return f"<pre>{text}</pre>"
