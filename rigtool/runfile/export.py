"""A run in other formats: CSV and Parquet for one part of it, MATLAB and netCDF for the whole."""

from __future__ import annotations

import os
import shutil
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from rigtool.errors import RunFileError, UsageError
from rigtool.quantity import Quantity
from rigtool.runfile import frames, schema
from rigtool.runfile.model import Table
from rigtool.runfile.outputs import replacing, require_output
from rigtool.runfile.reader import Run
from rigtool.runfile.recording import Recording

_MAT_LIMIT = 2**31
"""Bytes of a variable in a MATLAB file of version 5."""


def export(run: Run, output: str | os.PathLike[str], part: str | None, overwrite: bool) -> None:
    """Write a run in the format that the name of `output` ends with: .csv, .parquet, .mat or .nc.

    `part` chooses what a .csv or .parquet shall hold: `results`, `recordings/NAME` or
    `tables/NAME`, or the bare name. Raises `UsageError` where the choice is open, or the output
    exists.
    """
    output = Path(output)
    formats: dict[str, Callable[[Path], None]] = {
        ".csv": lambda path: frames.write_csv(frames.choose(run, part), path),
        ".parquet": lambda path: frames.write_parquet(frames.choose(run, part), path),
        ".mat": lambda path: _write_mat(run, path),
        # A run file is a netCDF-4 file: HDF5 with dimension scales.
        ".nc": lambda path: _copy(run, path),
    }
    write = formats.get(output.suffix)
    if write is None:
        raise UsageError(
            f"{output}: cannot be told what to write by its ending {output.suffix!r}: use one of "
            f"{', '.join(formats)}"
        )
    if part is not None and output.suffix not in (".csv", ".parquet"):
        raise UsageError(f"{output}: holds the whole run; --part is for .csv and .parquet")
    write_new(output, overwrite, write, [run.path])


def write_new(
    output: Path, overwrite: bool, write: Callable[[Path], None], inputs: Sequence[Path] = ()
) -> None:
    """Let `write` make a file beside `output`, that takes its name when it is whole.

    Raises `UsageError` where the output exists, unless `overwrite`.
    """
    output = require_output(output, overwrite=overwrite, inputs=inputs)
    with replacing(output) as new:
        write(new)


def _copy(run: Run, path: Path) -> None:
    shutil.copyfile(run.path, path)


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
