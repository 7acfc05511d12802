"""Tables of a report, and their formats: Markdown, CSV, LaTeX, terminal.

Cells hold text in display units; CSV is for programs and holds full numbers in SI units.
"""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Iterator
from dataclasses import dataclass
from textwrap import wrap

from rigtool import escapes
from rigtool.quantity import format_number
from rigtool.runfile import Table

MISSING_TEXT = "–"
"""Text of a cell without a value."""

MILLI = 1e3
"""From N to mN, from N m to mN m."""


@dataclass(frozen=True)
class ReportColumn:
    """A column: `title` and `unit` for people, `key` and `si_unit` for CSV.

    With `uncertain`, CSV has a further column `<key>_u`; with `wraps`, long texts take several
    lines on a page.
    """

    key: str
    title: str
    unit: str = ""
    si_unit: str = ""
    uncertain: bool = False
    numeric: bool = True
    wraps: bool = False


@dataclass(frozen=True)
class Cell:
    """A cell: its text, and its value: SI number, text, or None where there is none."""

    text: str
    value: float | str | None
    u: float | None = None


NO_VALUE = Cell(MISSING_TEXT, None)


@dataclass(frozen=True)
class ReportTable:
    """A table of the report; `name` is the stem of its files, `note` a line below it."""

    name: str
    title: str
    columns: tuple[ReportColumn, ...]
    rows: tuple[tuple[Cell, ...], ...]
    note: str = ""


def number_cell(value: float | None, form: str, factor: float = MILLI) -> Cell:
    """Return the cell of a number in SI units, shown times `factor`; zero has no sign."""
    if value is None or not math.isfinite(value):
        return NO_VALUE
    text = format(value * factor, form)
    return Cell(text.lstrip("+-") if float(text) == 0 else text, value)


def mean_cell(mean: float, u: float) -> Cell:
    """Return the cell of a torque, N m, with its standard uncertainty."""
    if not math.isfinite(mean):
        return NO_VALUE
    return Cell(format_number(mean * MILLI, u * MILLI), mean, u)


def records(table: Table) -> Iterator[dict[str, float]]:
    """Yield the rows of a table with one axis, by the names of its columns."""
    for index in range(table.shape[0]):
        yield {name: float(table[name][index]) for name in table.columns}


def markdown_table(table: ReportTable) -> str:
    """Write a pipe table under its title."""
    titles = [f"{c.title} [{c.unit}]" if c.unit else c.title for c in table.columns]
    heads = [escapes.markdown(title) for title in titles]
    rules = ["---:" if column.numeric else ":---" for column in table.columns]
    rows = [[escapes.markdown(cell.text) for cell in row] for row in table.rows]
    lines = [f"| {' | '.join(cells)} |" for cells in (heads, rules, *rows)]
    note = f"\n{escapes.markdown(table.note)}\n" if table.note else ""
    return f"**{escapes.markdown(table.title)}**\n\n" + "\n".join(lines) + "\n" + note


def csv_table(table: ReportTable) -> str:
    """Write numbers in SI units with all digits, below a header `key [unit]`."""
    stream = io.StringIO()
    writer = csv.writer(stream, lineterminator="\n")
    header = []
    for column in table.columns:
        unit = f" [{column.si_unit}]" if column.si_unit else ""
        header.append(column.key + unit)
        if column.uncertain:
            header.append(f"{column.key}_u{unit}")
    writer.writerow(header)
    for row in table.rows:
        fields = []
        for column, cell in zip(table.columns, row, strict=True):
            fields.append(_plain(cell.value))
            if column.uncertain:
                fields.append(_plain(cell.u))
        writer.writerow(fields)
    return stream.getvalue()


def latex_table(table: ReportTable) -> str:
    """Write a table environment with caption and label; its tabular needs no package."""
    alignment = "".join("r" if column.numeric else "l" for column in table.columns)
    titles = " & ".join(escapes.latex(column.title) for column in table.columns)
    units = " & ".join(escapes.latex(f"[{c.unit}]") if c.unit else "" for c in table.columns)
    body = [" & ".join(escapes.latex(cell.text) for cell in row) for row in table.rows]
    lines = [
        r"\begin{table}",
        r"  \centering",
        rf"  \caption{{{escapes.latex(table.title)}}}",
        rf"  \label{{tab:{escapes.latex_label(table.name)}}}",
        rf"  \begin{{tabular}}{{{alignment}}}",
        r"    \hline",
        rf"    {titles} \\",
        rf"    {units} \\",
        r"    \hline",
        *(rf"    {line} \\" for line in body),
        r"    \hline",
        r"  \end{tabular}",
        *([rf"  \par {escapes.latex(table.note)}"] if table.note else []),
        r"\end{table}",
    ]
    return "\n".join(lines) + "\n"


def terminal_table(table: ReportTable) -> str:
    """Write aligned text: title, two lines of header, a rule, rows."""
    grid = [
        [column.title for column in table.columns],
        [f"[{column.unit}]" if column.unit else "" for column in table.columns],
        *([cell.text for cell in row] for row in table.rows),
    ]
    widths = [max(len(line[i]) for line in grid) for i in range(len(table.columns))]
    lines = [
        "  ".join(
            text.rjust(width) if column.numeric else text.ljust(width)
            for text, width, column in zip(line, widths, table.columns, strict=True)
        ).rstrip()
        for line in grid
    ]
    rule = "-" * (sum(widths) + 2 * (len(widths) - 1))
    note = wrap(table.note, max(80, len(rule)))
    return "\n".join([table.title, "", *lines[:2], rule, *lines[2:], *note]) + "\n"


def _plain(value: float | str | None) -> str:
    if value is None or (isinstance(value, float) and not math.isfinite(value)):
        return ""
    return escapes.csv_text(value) if isinstance(value, str) else repr(float(value))
