"""Results on stdout: text with units and uncertainty, or strict JSON."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from typing import TYPE_CHECKING, Any

import click

from rigtool.escapes import terminal
from rigtool.quantity import Quantity
from rigtool.runfile import Table, open_run
from rigtool.runfile.summary import result_lines

if TYPE_CHECKING:
    from pathlib import Path

    from rigtool.experiments.outcome import Outcome
    from rigtool.experiments.running.options import CommonOptions


def print_outcome(outcome: Outcome, output: str | Path, options: CommonOptions) -> None:
    """Print the results of a command on stdout, its notes and `output` on stderr.

    Where stdout was a stream of values, all goes to stderr.
    """
    if options.dry_run:
        for note in outcome.notes:
            click.echo(terminal(note), err=options.stream)
        return
    if options.json:
        with open_run(output) as run:
            origin = run.provenance
        click.echo(to_json(outcome.results, outcome.tables, origin, outcome.notes))
        return
    if options.quiet:
        return
    for line in result_lines(outcome.results):
        click.echo(terminal(line), err=options.stream)
    for note in outcome.notes:
        click.echo(terminal(f"Note: {note}"), err=True)
    click.echo(terminal(f"Written: {output}"), err=True)


def to_json(
    results: Mapping[str, Quantity],
    tables: Mapping[str, Table],
    provenance: Mapping[str, Any],
    notes: Sequence[str],
    **more: Any,
) -> str:
    """Return a run as JSON."""
    document = {
        "results": {name: quantity_json(quantity) for name, quantity in results.items()},
        "tables": {name: _table(table) for name, table in tables.items()},
        "provenance": dict(provenance),
        "notes": list(notes),
        **more,
    }
    return json_text(document)


def json_text(document: Mapping[str, Any]) -> str:
    """Return JSON by RFC 8259: NaN and infinity become null."""
    return json.dumps(_strict(dict(document)), indent=2, allow_nan=False)


def quantity_json(quantity: Quantity) -> dict[str, Any]:
    """Return a result as JSON holds it, with its budget where that is known."""
    found: dict[str, Any] = {
        "value": quantity.value,
        "unit": quantity.unit,
        "u": quantity.u,
        "dof": quantity.dof,
    }
    if quantity.reason is not None:
        found["reason"] = quantity.reason
    if quantity.budget:
        found["budget"] = [asdict(line) for line in quantity.budget]
    return found


def _table(table: Table) -> dict[str, Any]:
    return {
        "description": table.description,
        "axes": list(table.axes),
        "signal": table.signal,
        "columns": {
            name: {
                "unit": column.unit,
                "description": column.description,
                "values": column.values.tolist(),
            }
            for name, column in table.columns.items()
        },
    }


def _strict(value: Any) -> Any:
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, dict):
        return {key: _strict(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_strict(item) for item in value]
    return value
