"""The outcome of an analysis, as a run file stores it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from rigtool.quantity import Quantity
from rigtool.runfile import Table
from rigtool.runfile.summary import html_of, result_lines


@dataclass(frozen=True)
class Outcome:
    """Results, tables, and the notes on them, as `rigtool info` shows them."""

    results: Mapping[str, Quantity]
    tables: Mapping[str, Table] = field(default_factory=dict)
    notes: tuple[str, ...] = ()

    def _repr_html_(self) -> str:
        return html_of([*result_lines(self.results), *(f"Note: {note}" for note in self.notes)])
