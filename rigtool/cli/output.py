"""What a command prints: text with units and uncertainty, or one document of strict JSON.

`Output` holds the options `--json`, `--no-tables`, `-q`, `-v` and `--overwrite` of the command that
runs. Results go to stdout, all else to stderr.
"""

from __future__ import annotations

import contextlib
import sys
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import click

from rigtool.escapes import terminal

if TYPE_CHECKING:
    from rigtool.experiments.outcome import Outcome
    from rigtool.inputs import PathName
    from rigtool.quantity import Quantity
    from rigtool.report.formats import ReportTable
    from rigtool.runfile import Recording, Run, Table

JSON_VERSION = 1
"""Version of the JSON documents; raised when a key changes its meaning or is removed."""


def echo(text: str, *, err: bool = False, nl: bool = True) -> None:
    """Print text on stdout or stderr; control characters in it cannot steer the terminal.

    A stderr that takes nothing, as of a log on a full disk, ends no measurement.
    """
    with contextlib.suppress(*([OSError] if err else [])):
        click.echo(terminal(text), err=err, nl=nl)


def width() -> int | None:
    """Return the columns of the terminal that stdout is; None where it is none."""
    import shutil

    return shutil.get_terminal_size().columns if sys.stdout.isatty() else None


@dataclass
class Output:
    """How `command` prints; `printed` is true once its JSON document is on stdout.

    With `stream`, values go to stdout, and results to stderr.
    """

    json: bool = False
    tables: bool = True
    quiet: bool = False
    overwrite: bool = False
    stream: bool = False
    printed: bool = False
    command: str | None = None

    def line(self, text: str, *, nl: bool = True) -> None:
        """Print a line of results, unless the results are JSON or -q is given."""
        if not (self.json or self.quiet):
            echo(text, err=self.stream, nl=nl)

    def note(self, text: str) -> None:
        """Print a line beside the results, on stderr."""
        if not (self.json or self.quiet):
            echo(text, err=True)

    def written(self, path: PathName, what: str) -> None:
        """State which file was written, and what it is."""
        self.note(f"Written: {path}: {what}")

    def document(self, **contents: Any) -> None:
        """Print the JSON document of this command, where JSON is wanted.

        `contents` replace the values of the keys that every document has, and add keys.
        """
        if self.json:
            self.printed = True
            echo(self.text(contents))

    def text(self, contents: Mapping[str, Any]) -> str:
        """Return a JSON document with the keys that all have; NaN and infinity become null."""
        import json

        from rigtool import __version__

        document = {
            "schema": JSON_VERSION,
            "version": __version__,
            "command": self.command,
            "rig": None,
            "output": None,
            "results": {},
            "tables": {},
            "notes": [],
            **contents,
        }
        return json.dumps(_strict(document), indent=2, allow_nan=False)

    def run(self, run: Run, output: PathName | None) -> None:
        """Print the JSON document of a run; `output` is its file where this command wrote it."""
        if self.json:
            self.document(**run_document(run, output, tables=self.tables))

    def outcome(self, outcome: Outcome, output: str, *, dry: bool) -> None:
        """Print what a measuring command found and wrote; for a dry run, what would move."""
        from rigtool.runfile import open_run
        from rigtool.runfile.summary import result_lines

        if dry:
            self.document(notes=list(outcome.notes))
            for note in outcome.notes:
                self.line(note)
            return
        if self.quiet and not self.json:
            return
        with open_run(output) as run:
            self.run(run, output)
            self.written(output, described(run))
            for line in result_lines(outcome.results):
                self.line(line)
            if self.tables:
                self._tables(run)
        for note in outcome.notes:
            self.note(f"Note: {note}")

    def _tables(self, run: Run) -> None:
        """Print the tables that a run of measure-force is made for."""
        if run.command != "measure-force" or self.json:
            return
        from rigtool.report.formats import terminal_table
        from rigtool.report.tables import force_tables

        for table in force_tables(run, run.path.stem):
            self.line("\n" + terminal_table(table).rstrip())


def described(run: Run) -> str:
    """Return what a run is, in a few words: its command, its rig, its amount of signals."""
    rig = f" on {run.rig}" if run.rig else ""
    samples = sum(recording.size for recording in run.recordings.values())
    count = len(run.recordings)
    plural = "" if count == 1 else "s"
    recorded = f", {count} recording{plural}, {samples} samples" if count else ""
    return f"run of {run.command}{rig}{recorded}"


def run_document(run: Run, output: PathName | None, *, tables: bool = True) -> dict[str, Any]:
    """Return the contents of a run for JSON, the same whichever command prints them."""
    import json

    origin = dict(run.provenance)
    for name in ("recipe_resolved", "line"):  # stored as text of JSON
        with contextlib.suppress(TypeError, ValueError):
            origin[name] = json.loads(origin[name])
    return {
        "command": run.command,
        "rig": run.rig,
        "output": None if output is None else str(output),
        "results": {name: quantity_document(quantity) for name, quantity in run.results.items()},
        "tables": {name: _table(table) for name, table in run.tables.items()} if tables else {},
        "notes": list(run.notes),
        "recordings": {name: _recording(item) for name, item in run.recordings.items()},
        "provenance": origin,
    }


def table_document(table: ReportTable) -> dict[str, Any]:
    """Return a table of a report for JSON: its units, and a mapping for each row."""
    rows = []
    for cells in table.rows:
        row: dict[str, Any] = {}
        for column, cell in zip(table.columns, cells, strict=True):
            row[column.key] = cell.value
            if column.uncertain:
                row[f"{column.key}_u"] = cell.u
        rows.append(row)
    units = {column.key: column.si_unit for column in table.columns if column.si_unit}
    return {"title": table.title, "units": units, "rows": rows}


def quantity_document(quantity: Quantity) -> dict[str, Any]:
    """Return a quantity for JSON, with its budget where that is known."""
    from dataclasses import asdict

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


def _recording(recording: Recording) -> dict[str, Any]:
    return {
        "size": recording.size,
        "rate": recording.rate(),
        "duration": recording.duration(),
        "channels": recording.units,
        "conditions": {
            name: {"value": item.value, "unit": item.unit}
            for name, item in recording.conditions.items()
        },
    }


def _strict(value: Any) -> Any:
    import math

    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, dict):
        return {key: _strict(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_strict(item) for item in value]
    return value
