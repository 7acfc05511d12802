"""`rigtool info`: a run file on one screen."""

from __future__ import annotations

from collections.abc import Iterable
from itertools import groupby
from typing import TYPE_CHECKING, Any

import click

from rigtool.cli.options import debug_option, example, json_option

if TYPE_CHECKING:
    from rigtool.runfile import Recording, Run, Table


@click.command(
    epilog=example(
        "rigtool info kt.h5", "rigtool info kt.h5 --json", "rigtool info kt.h5 --plot kt.svg"
    )
)
@click.argument("path", metavar="RUN.h5")
@json_option
@click.option("--plot", metavar="FILE", help="Draw its default plot: .png, .svg or .pdf.")
@click.option("--overwrite", is_flag=True, help="Replace a plot that exists.")
@debug_option
def command(path: str, as_json: bool, plot: str | None, overwrite: bool) -> None:
    """Show what a run file holds.

    Who made it, when and from what; results with units and uncertainty; recorded signals with
    rate and duration; tables and remarks.
    """
    from rigtool.cli.printing import to_json
    from rigtool.runfile import open_run

    with open_run(path) as run:
        if as_json:
            text = to_json(
                run.results,
                run.tables,
                run.provenance,
                run.notes,
                command=run.command,
                rig=run.rig,
                recordings={name: _recording(item) for name, item in run.recordings.items()},
            )
        else:
            text = "\n".join(_screen(run))
        if plot is not None:
            from rigtool.report.default_plot import write_default_plot

            write_default_plot(run, plot, overwrite=overwrite)
    click.echo(text)


def _recording(recording: Recording) -> dict[str, Any]:
    return {
        "size": recording.size,
        "rate": _rate(recording),
        "duration": recording.duration(),
        "channels": recording.units,
        "conditions": {
            name: {"value": item.value, "unit": item.unit}
            for name, item in recording.conditions.items()
        },
    }


def _rate(recording: Recording) -> float | None:
    """Return the rate at the start, Hz; None for fewer than two samples.

    The median interval, since a recording may pause, between temperatures for instance.
    """
    import numpy as np

    if recording.size < 2:
        return None
    interval = float(np.median(np.diff(recording.read("time", 0, min(recording.size, 8192)))))
    return 1 / interval if interval > 0 else None


def _screen(run: Run) -> list[str]:
    from rigtool.cli.printing import result_lines

    origin = run.provenance
    seed = "" if origin["seed"] is None else f", seed {origin['seed']}"
    lines = [
        f"{run.path}: {run.command}" + (f" on {run.rig}" if run.rig else ""),
        f"made {origin['date']} by {origin['program']} {origin['version']}{seed}",
        *(
            f"from {item['path']} ({item['command']}, content {item['content_sha256'][:12]})"
            for item in origin["inputs"]
        ),
        *([f"imported from {origin['source']}"] if origin["source"] else []),
        f"content {run.content_sha256[:12]}",
    ]
    recordings = _recording_lines(run.recordings.values())
    tables = [_table_line(name, table) for name, table in run.tables.items()]
    for title, part in (
        ("Results", result_lines(run.results)),
        ("Recordings", recordings),
        ("Tables", tables),
        ("Notes", list(run.notes)),
    ):
        if part:
            lines += ["", title, *(f"  {line}" for line in part)]
    return lines


def _recording_lines(recordings: Iterable[Recording]) -> list[str]:
    """Return a line for each recording; channels are told once for those that share them."""
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
    rate = _rate(recording)
    how = "" if rate is None else f", {rate:.5g} Hz, {recording.duration():.4g} s"
    where = f" at {conditions}" if conditions else ""
    return f"{recording.name}{where}: {recording.size} samples{how}"


def _table_line(name: str, table: Table) -> str:
    axes = ", ".join(f"{axis} ({table[axis].size})" for axis in table.axes)
    others = ", ".join(
        f"{key} [{column.unit}]" for key, column in table.columns.items() if key not in table.axes
    )
    return f"{name}: {others} over {axes}"
