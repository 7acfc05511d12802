"""The summary of a run: lines for the terminal, and HTML for a notebook."""

from __future__ import annotations

import html
from collections import Counter
from collections.abc import Iterable, Mapping
from itertools import groupby

from rigtool.quantity import Component, Quantity, format_quantity
from rigtool.runfile.model import Table
from rigtool.runfile.recording import Recording


def result_lines(results: Mapping[str, Quantity]) -> list[str]:
    """Return one aligned line a result: name, value with uncertainty and unit, or the reason.

    A reason that several results share stands once, below them.
    """
    width = max(map(len, results), default=0)
    reasons = Counter(item.reason for item in results.values() if item.u is None)
    shared = [reason for reason, count in reasons.items() if count > 1]
    lines = []
    for name, quantity in results.items():
        line = f"{name:{width}}  {format_quantity(quantity, name)}"
        if quantity.reason in shared:
            line += f"  (no uncertainty [{shared.index(quantity.reason) + 1}])"
        elif quantity.u is None:
            line += f"  (no uncertainty: {quantity.reason})"
        lines.append(line)
    return [*lines, *(f"[{index}] {reason}" for index, reason in enumerate(shared, 1))]


def budget_lines(name: str, quantity: Quantity) -> list[str]:
    """Return the uncertainty budget of a result as aligned lines, the largest share first."""
    head = f"{name}  {format_quantity(quantity, name)}"
    if quantity.u is None:
        return [f"{head}  (no uncertainty: {quantity.reason})"]
    if not quantity.budget:
        return [head, "  the run states this uncertainty as a whole, without its components"]
    rows = [("component", "value", "u", "sensitivity", "contribution", "dof", "share")]
    for line, share in budget_shares(quantity):
        unit = "" if line.unit == "1" else f" {line.unit}"
        rows.append(
            (
                line.name,
                f"{line.value:.5g}{unit}",
                f"{line.u:.2g}{unit}",
                f"{line.sensitivity:.3g}",
                f"{line.contribution:.2g}",
                "inf" if line.dof is None else f"{line.dof:.3g}",
                f"{share:.1%}",
            )
        )
    dof = "inf" if quantity.dof is None else f"{quantity.dof:.3g}"
    rows.append(("together", f"{quantity.value:.5g}", "", "", f"{quantity.u:.2g}", dof, ""))
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    aligned = [
        "  ".join([row[0].ljust(widths[0]), *map(str.rjust, row[1:], widths[1:])]).rstrip()
        for row in rows
    ]
    return [f"{head}; contributions in {quantity.unit}", *(f"  {line}" for line in aligned)]


def budget_shares(quantity: Quantity) -> list[tuple[Component, float]]:
    """Return the lines of a budget with their shares of the variance, the largest first."""
    total = sum(line.contribution**2 for line in quantity.budget)
    shares = [(line, line.contribution**2 / total) for line in quantity.budget]
    return sorted(shares, key=lambda item: -item[1])


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
