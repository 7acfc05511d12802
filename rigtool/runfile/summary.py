"""The summary of a run: lines for the terminal, and HTML for a notebook."""

from __future__ import annotations

import html
import textwrap
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
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


def folded(lines: Iterable[str], width: int | None) -> list[str]:
    """Return lines folded to a width, all of them as they are where that is None; what goes on is
    indented by four columns more."""
    if width is None:
        return list(lines)
    found = []
    for line in lines:
        indent = " " * (len(line) - len(line.lstrip()) + 4)
        folds = textwrap.TextWrapper(
            width, subsequent_indent=indent, break_long_words=False, break_on_hyphens=False
        )
        found += folds.wrap(line) or [""]
    return found


def budget_lines(name: str, quantity: Quantity, width: int | None = None) -> list[str]:
    """Return the uncertainty budget of a result as aligned lines, the largest share first.

    Where they are wider than `width` columns, names of components are folded, units have a column,
    and sensitivities are left out: contributions ("adds") over u.
    """
    head = f"{name}  {format_quantity(quantity, name)}"
    if quantity.u is None:
        return [f"{head}  (no uncertainty: {quantity.reason})"]
    if not quantity.budget:
        return [head, "  the run states this uncertainty as a whole, without its components"]
    dof = "inf" if quantity.dof is None else f"{quantity.dof:.3g}"
    rows = [("component", "value", "u", "sensitivity", "contribution", "dof", "share")]
    narrow = [("component", "value", "u", "unit", "adds", "dof", "share")]
    for line, share in budget_shares(quantity):
        value, u, unit = f"{line.value:.5g}", f"{line.u:.2g}", "" if line.unit == "1" else line.unit
        last = (
            f"{line.contribution:.2g}",
            "inf" if line.dof is None else f"{line.dof:.3g}",
            f"{100 * share:.1f} %",
        )
        own = f"{value} {unit}".rstrip(), f"{u} {unit}".rstrip()
        rows.append((line.name, *own, f"{line.sensitivity:.3g}", *last))
        narrow.append((line.name, value, u, unit, *last))
    together = ("together", f"{quantity.value:.5g}", "", "", f"{quantity.u:.2g}", dof, "")
    aligned = _aligned([*rows, together])
    if width is not None and max(map(len, aligned)) > width - 2:
        aligned = _narrow([*narrow, together], width - 2)
    return [f"{head}; contributions in {quantity.unit}", *(f"  {line}" for line in aligned)]


def _narrow(rows: Sequence[tuple[str, ...]], width: int) -> list[str]:
    """Return rows as lines of a width, their names folded between words as far as that needs."""
    others = max(map(len, _aligned([("", *row[1:]) for row in rows])))
    longest_word = max(len(word) for row in rows for word in row[0].split())
    names = [textwrap.wrap(row[0], max(width - others, longest_word)) for row in rows]
    none = [""] * (len(rows[0]) - 1)
    return _aligned(
        (part, *(none if number else row[1:]))
        for name, row in zip(names, rows, strict=True)
        for number, part in enumerate(name)
    )


def _aligned(rows: Iterable[tuple[str, ...]]) -> list[str]:
    """Return rows as lines, the first column at its left edge, the others at their right."""
    rows = list(rows)
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    return [
        "  ".join([row[0].ljust(widths[0]), *map(str.rjust, row[1:], widths[1:])]).rstrip()
        for row in rows
    ]


def budget_shares(quantity: Quantity) -> list[tuple[Component, float]]:
    """Return the lines of a budget with their shares of the variance, the largest first."""
    total = sum(line.contribution**2 for line in quantity.budget)
    shares = [(line, line.contribution**2 / (total or 1.0)) for line in quantity.budget]
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
