"""One table, four ways to write it: Markdown, CSV, LaTeX, terminal.

Texts are made once, in display units; CSV is for programs and gets full numbers in SI units.
"""

from __future__ import annotations

import csv
import io
import math
from dataclasses import dataclass

MISSING = "–"
"""What stands where there is no value."""


@dataclass(frozen=True)
class Column:
    """A column: `title` and `unit` as shown, `key` and `si_unit` as CSV calls them.

    With `uncertain`, CSV has another column `<key>_u` beside it; `wraps` allows long texts to take
    several lines on a page.
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
    """A value as shown and as it is: SI number, text, or None where there is none."""

    text: str
    value: float | str | None
    u: float | None = None


NO_VALUE = Cell(MISSING, None)


@dataclass(frozen=True)
class ReportTable:
    """A table ready to be written; `name` is the stem of its files, `note` stands below it."""

    name: str
    title: str
    columns: tuple[Column, ...]
    rows: tuple[tuple[Cell, ...], ...]
    note: str = ""


def markdown(table: ReportTable) -> str:
    """Write a pipe table under its title."""
    heads = [_head(column).replace("|", r"\|") for column in table.columns]
    rules = ["---:" if column.numeric else ":---" for column in table.columns]
    rows = [[cell.text.replace("|", r"\|") for cell in row] for row in table.rows]
    lines = [f"| {' | '.join(cells)} |" for cells in (heads, rules, *rows)]
    note = f"\n{table.note}\n" if table.note else ""
    return f"**{table.title}**\n\n" + "\n".join(lines) + "\n" + note


def csv_text(table: ReportTable) -> str:
    """Write numbers in SI units with all their digits, one header line `key [unit]`."""
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


def latex(table: ReportTable) -> str:
    """Write a tabular that needs no package, in a table environment with caption and label."""
    alignment = "".join("r" if column.numeric else "l" for column in table.columns)
    titles = " & ".join(_latex(column.title) for column in table.columns)
    units = " & ".join(_latex(f"[{c.unit}]") if c.unit else "" for c in table.columns)
    body = [" & ".join(_latex(cell.text) for cell in row) for row in table.rows]
    lines = [
        r"\begin{table}",
        r"  \centering",
        rf"  \caption{{{_latex(table.title)}}}",
        rf"  \label{{tab:{table.name}}}",
        rf"  \begin{{tabular}}{{{alignment}}}",
        r"    \hline",
        rf"    {titles} \\",
        rf"    {units} \\",
        r"    \hline",
        *(rf"    {line} \\" for line in body),
        r"    \hline",
        r"  \end{tabular}",
        *([rf"  \par {_latex(table.note)}"] if table.note else []),
        r"\end{table}",
    ]
    return "\n".join(lines) + "\n"


def terminal(table: ReportTable) -> str:
    """Write aligned text: title, two lines of head, a rule, rows."""
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
    note = [table.note] if table.note else []
    return "\n".join([table.title, "", *lines[:2], rule, *lines[2:], *note]) + "\n"


def _head(column: Column) -> str:
    return f"{column.title} [{column.unit}]" if column.unit else column.title


def _plain(value: float | str | None) -> str:
    if value is None or (isinstance(value, float) and not math.isfinite(value)):
        return ""
    return value if isinstance(value, str) else repr(float(value))


_LATEX = str.maketrans(
    {
        "\\": r"\textbackslash{}",
        "%": r"\%",
        "&": r"\&",
        "#": r"\#",
        "_": r"\_",
        "$": r"\$",
        "{": r"\{",
        "}": r"\}",
        "~": r"\textasciitilde{}",
        "^": r"\textasciicircum{}",
        "–": "--",
    }
)


def _latex(text: str) -> str:
    escaped = text.translate(_LATEX)
    # A hyphen is no minus sign.
    return f"${escaped}$" if text[:1] in "+-" and text[1:2].isdigit() else escaped
