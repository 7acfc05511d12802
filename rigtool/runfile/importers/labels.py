"""Lines whose numbers each follow their name: `pos:1.5,cur:0.2`, `pos=1.5 cur=0.2`, JSON."""

from __future__ import annotations

import re

from rigtool.runfile.importers.header import Lines
from rigtool.runfile.importers.marks import Marks

_LABELLED = re.compile(
    r"([^\W\d]\w*)[\"']?\s*(?:\(\d+\)|:\s*\d+>)?\s*[:=]\s*(?:np\.\w+\()?"
    r"[\"']?([+-]?[\d.][\w.+-]*+(?!>)|nan\b|null\b)"
)
"""A name, a number behind it as some programs count their registers, and its value.

Also as Python prints dictionaries: `'a': np.float64(0.5)`, `<Register.POSITION: 1>: 0.5`.
"""


def names_in(lines: Lines) -> list[str]:
    """Return the names that numbers follow, in a line in the middle; none where it has no such."""
    middle = lines.text[len(lines.text) // 2] if lines.text else ""
    return list(dict.fromkeys(name for name, _ in _LABELLED.findall(middle)))


def labelled(lines: Lines, wanted: set[str]) -> tuple[list[str], Lines, Marks] | None:
    """Return the names, and the values in columns, where a line in the middle names all wanted.

    What stands before the first line with names is left out. A line without one of them has a blank
    there.
    """
    names = names_in(lines)
    if not wanted or not wanted <= set(names):
        return None
    rows = [dict(_LABELLED.findall(line)) for line in lines.text]
    first = next(at for at, row in enumerate(rows) if wanted & row.keys())
    text = [",".join(row.get(name, "") for name in names) for row in rows]
    return names, Lines(text, lines.number, lines.whole).after(first), Marks(",", ".")
