"""A run in other formats: CSV for one part of it, MATLAB and netCDF for the whole."""

from __future__ import annotations

import csv
import os
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any, TextIO

import numpy as np

from rigtool.errors import RunFileError, UsageError
from rigtool.quantity import Quantity
from rigtool.runfile import schema
from rigtool.runfile.model import Table
from rigtool.runfile.reader import Recording, Run
from rigtool.runfile.storage import storage_errors

_MAT_LIMIT = 2**31
"""Bytes of a variable in a MATLAB file of version 5."""


def export(run: Run, output: str | os.PathLike[str], part: str | None, overwrite: bool) -> None:
    """Write a run in the format that the name of `output` ends with: .csv, .mat or .nc.

    `part` chooses what a .csv shall hold: `results`, `recordings/NAME` or `tables/NAME`, or the
    bare name. Raises `UsageError` where the choice is open, or the output exists.
    """
    output = Path(output)
    formats: dict[str, Callable[[Path], None]] = {
        ".csv": lambda path: _write_csv(run, path, part),
        ".mat": lambda path: _write_mat(run, path),
        # A run file is a netCDF-4 file: HDF5 with dimension scales.
        ".nc": lambda path: _copy(run, path),
    }
    write = formats.get(output.suffix)
    if write is None:
        raise UsageError(
            f"{output}: cannot be told what to write by its ending {output.suffix!r}: use one of "
            f"{', '.join(formats)} (.parquet would need another package; pandas reads the .csv)"
        )
    if part is not None and output.suffix != ".csv":
        raise UsageError(f"{output}: holds the whole run; --part is for .csv")
    if output.exists() and not overwrite:
        raise UsageError(f"{output}: exists already: give another name, or --overwrite")
    beside = output.with_name(output.name + ".tmp")
    with storage_errors(output):
        try:
            write(beside)
            os.replace(beside, output)
        finally:
            beside.unlink(missing_ok=True)


def _copy(run: Run, path: Path) -> None:
    shutil.copyfile(run.path, path)


def _write_csv(run: Run, path: Path, part: str | None) -> None:
    chosen = _choose(run, part)
    with path.open("w", newline="", encoding="utf-8") as stream:
        if isinstance(chosen, Recording):
            _write_recording(chosen, stream)
        elif isinstance(chosen, Table):
            _write_table(chosen, stream)
        else:
            _write_results(chosen, stream)


def _choose(run: Run, part: str | None) -> Recording | Table | dict[str, Quantity]:
    parts: dict[str, Recording | Table | dict[str, Quantity]] = {}
    if run.results:
        parts[schema.RESULTS] = dict(run.results)
    parts.update({f"{schema.RECORDINGS}/{name}": item for name, item in run.recordings.items()})
    parts.update({f"{schema.TABLES}/{name}": table for name, table in run.tables.items()})
    found = [
        name for name in parts if part is None or name == part or name.rpartition("/")[2] == part
    ]
    if len(found) != 1:
        what = "holds more than one thing" if part is None else f"has {len(found)} parts {part!r}"
        raise UsageError(f"{run.path}: {what}: choose by --part from {', '.join(parts) or 'none'}")
    return parts[found[0]]


def _write_results(results: dict[str, Quantity], stream: TextIO) -> None:
    writer = csv.writer(stream, lineterminator="\n")
    writer.writerow(["name", "value", "unit", "u", "dof", "reason"])
    for name, q in results.items():
        writer.writerow([name, q.value, q.unit, q.u, q.dof, q.reason])


def _write_recording(recording: Recording, stream: TextIO) -> None:
    import pandas as pd

    head = [f"{name} [{unit}]" for name, unit in recording.units.items()]
    csv.writer(stream, lineterminator="\n").writerow(head)
    for start in range(0, recording.size, schema.CHUNK):
        stop = min(start + schema.CHUNK, recording.size)
        block = {name: recording.read_stored(name, start, stop) for name in recording.units}
        pd.DataFrame(block).to_csv(stream, header=False, index=False, lineterminator="\n")


def _write_table(table: Table, stream: TextIO) -> None:
    """Write one line for each point of the axes; columns with fewer axes repeat."""
    import pandas as pd

    head = [f"{name} [{column.unit}]" for name, column in table.columns.items()]
    csv.writer(stream, lineterminator="\n").writerow(head)
    columns = {}
    for name, column in table.columns.items():
        if name in table.axes:
            shape = [1] * len(table.shape)
            shape[table.axes.index(name)] = -1
        else:
            shape = [*column.values.shape, *[1] * (len(table.shape) - column.values.ndim)]
        columns[name] = np.broadcast_to(column.values.reshape(shape), table.shape).ravel()
    pd.DataFrame(columns).to_csv(stream, header=False, index=False, lineterminator="\n")


def _write_mat(run: Run, path: Path) -> None:
    from scipy.io import savemat

    size = sum(8 * item.size * len(item.channels) for item in run.recordings.values())
    if size >= _MAT_LIMIT:
        raise RunFileError(
            f"{run.path}: {size} bytes of signals are beyond the {_MAT_LIMIT} of a .mat file: "
            "MATLAB reads the run file itself by h5read"
        )
    contents = {
        "command": run.command,
        "rig": run.rig or "",
        "notes": np.array(run.notes, dtype=object),
        schema.RESULTS: {name: _mat_result(q) for name, q in run.results.items()},
        schema.TABLES: {name: _mat_table(table) for name, table in run.tables.items()},
        schema.RECORDINGS: {name: _mat_recording(r) for name, r in run.recordings.items()},
    }
    savemat(
        str(path),
        contents,
        appendmat=False,
        long_field_names=True,
        do_compression=True,
        oned_as="column",
    )


def _mat_result(q: Quantity) -> dict[str, Any]:
    nan = float("nan")
    u, dof = (nan if number is None else number for number in (q.u, q.dof))
    return {"value": q.value, "unit": q.unit, "u": u, "dof": dof, "reason": q.reason or ""}


def _mat_table(table: Table) -> dict[str, Any]:
    columns = {name: column.values for name, column in table.columns.items()}
    units = {name: column.unit for name, column in table.columns.items()}
    return {"columns": columns, "units": units, "axes": np.array(table.axes, dtype=object)}


def _mat_recording(recording: Recording) -> dict[str, Any]:
    signals = {name: recording.read_stored(name) for name in recording.units}
    conditions = {name: q.value for name, q in recording.conditions.items()}
    return {"signals": signals, "units": recording.units, "conditions": conditions}
