"""A run in other formats: CSV and Parquet for one part of it, MATLAB and netCDF for the whole.

A part is written in blocks of rows: a recording of any length needs the memory of one block.
"""

from __future__ import annotations

import csv
import json
import shutil
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from rigtool.errors import RunFileError, UsageError, did_you_mean
from rigtool.escapes import csv_text
from rigtool.inputs import PathName
from rigtool.quantity import Quantity
from rigtool.runfile import schema
from rigtool.runfile.model import Table
from rigtool.runfile.opened import CHANGED_MEANWHILE
from rigtool.runfile.outputs import replacing, require_output
from rigtool.runfile.reader import Run, open_run
from rigtool.runfile.recording import Recording

if TYPE_CHECKING:
    import pandas as pd

EXPORT_ROWS = 16 * schema.CHUNK
"""Rows of a block, whole chunks; a row group of a .parquet."""

RESULT_COLUMNS = ("name", "value", "unit", "u", "dof", "reason")

_MAT_LIMIT = 2**31
"""Bytes of a variable in a MATLAB file of version 5."""


def export(run: Run, output: PathName, part: str | None, overwrite: bool) -> None:
    """Write a run in the format that the name of `output` ends with: .csv, .parquet, .mat or .nc.

    `part` selects the contents of a .csv or .parquet: `results`, `recordings/NAME` or
    `tables/NAME`, or the bare name. Raises `UsageError` where the choice is open, or the output
    exists.
    """
    output = Path(output)
    formats: dict[str, Callable[[Path], None]] = {
        ".csv": lambda path: write_csv(choose(run, part), path),
        ".parquet": lambda path: write_parquet(choose(run, part), path),
        ".mat": lambda path: _write_mat(run, path),
        # A run file is a netCDF-4 file: HDF5 with dimension scales.
        ".nc": lambda path: _copy(run, path),
    }
    write = formats.get(output.suffix)
    if write is None:
        raise UsageError(
            f"{output}: its suffix {output.suffix!r} names no format: use one of "
            f"{', '.join(formats)}"
        )
    if part is not None and output.suffix not in (".csv", ".parquet"):
        raise UsageError(f"{output}: holds the whole run; --part is for .csv and .parquet")
    write_new(output, overwrite, write, [run.path])


def write_new(
    output: Path, overwrite: bool, write: Callable[[Path], object], inputs: Sequence[Path] = ()
) -> None:
    """Let `write` make a file beside `output`; the file takes the name of `output` when it is
    complete.

    Raises `UsageError` where the output exists, unless `overwrite`.
    """
    output = require_output(output, overwrite=overwrite, inputs=inputs)
    with replacing(output) as new:
        write(new)


@dataclass(frozen=True)
class ExportedPart:
    """Columns with their units ("" for text, and for columns with a column of units)."""

    units: dict[str, str]
    blocks: Iterator[pd.DataFrame]


def run_parts(run: Run) -> dict[str, Recording | Table | Mapping[str, Quantity]]:
    """Return the parts of a run by name: `results`, `recordings/NAME`, `tables/NAME`."""
    parts: dict[str, Recording | Table | Mapping[str, Quantity]] = {}
    if run.results:
        parts[schema.RESULTS] = run.results
    parts.update({f"{schema.RECORDINGS}/{name}": item for name, item in run.recordings.items()})
    parts.update({f"{schema.TABLES}/{name}": table for name, table in run.tables.items()})
    return parts


def choose(run: Run, part: str | None) -> ExportedPart:
    """Return a part of a run by its name: `results`, `recordings/NAME`, `tables/NAME`, or NAME.

    Raises `UsageError` where the choice is open.
    """
    parts = run_parts(run)
    found = [
        name for name in parts if part is None or name == part or name.rpartition("/")[2] == part
    ]
    if len(found) != 1:
        what = "holds more than one thing" if part is None else f"has no single part {part!r}"
        hint = "" if part is None else did_you_mean(part, parts)
        raise UsageError(
            f"{run.path}: {what}: choose by --part from {', '.join(parts) or 'none'}"
            f"{hint and f'; {hint}'}"
        )
    chosen = parts[found[0]]
    if isinstance(chosen, Recording):
        return ExportedPart(dict(chosen.units), _recording(chosen))
    if isinstance(chosen, Table):
        return ExportedPart(
            {n: c.unit for n, c in chosen.columns.items()}, iter([chosen.to_pandas()])
        )
    return ExportedPart(dict.fromkeys(RESULT_COLUMNS, ""), iter([_results(chosen)]))


def _recording(recording: Recording) -> Iterator[pd.DataFrame]:
    for start in range(0, max(recording.size, 1), EXPORT_ROWS):
        stop = min(start + EXPORT_ROWS, recording.size)
        yield recording.to_pandas(start, stop)


def _results(results: Mapping[str, Quantity]) -> pd.DataFrame:
    import pandas as pd

    rows = [(name, q.value, q.unit, q.u, q.dof, q.reason) for name, q in results.items()]
    frame = pd.DataFrame(rows, columns=list(RESULT_COLUMNS))
    return frame.astype({"u": "f8", "dof": "f8"})


def write_csv(frame: ExportedPart, path: Path) -> None:
    """Write comma-separated text with a head `name [unit]`."""
    with path.open("w", newline="", encoding="utf-8") as stream:
        head = [f"{name} [{unit}]" if unit else name for name, unit in frame.units.items()]
        csv.writer(stream, lineterminator="\n").writerow(head)
        for block in frame.blocks:
            texts = block.select_dtypes(["object", "string"]).columns
            block = block.assign(**{name: block[name].map(csv_text, "ignore") for name in texts})
            block.to_csv(stream, header=False, index=False, lineterminator="\n")


def write_parquet(frame: ExportedPart, path: Path) -> None:
    """Write Apache Parquet, a row group a block.

    Units are metadata `units` of each field, and where pandas looks: `DataFrame.attrs["units"]`.
    Raises `UsageError` where pyarrow is missing.
    """
    try:
        import pyarrow as pa
        from pyarrow import parquet
    except ImportError:
        raise UsageError(
            "a .parquet needs the package pyarrow, that is not installed: "
            "`pip install rigtool[parquet]`, or write a .csv"
        ) from None
    first = next(frame.blocks)
    plain: Any = pa.Schema.from_pandas(first, preserve_index=False)
    fields = [field.with_metadata({"units": frame.units[field.name]}) for field in plain]
    attributes = {"PANDAS_ATTRS": json.dumps({"units": frame.units})}
    described = pa.schema(fields, metadata={**plain.metadata, **attributes})
    with parquet.ParquetWriter(path, described) as writer:
        writer.write_table(pa.Table.from_pandas(first, schema=described, preserve_index=False))
        for block in frame.blocks:
            writer.write_table(pa.Table.from_pandas(block, schema=described, preserve_index=False))


def _copy(run: Run, path: Path) -> None:
    shutil.copyfile(run.path, path)
    try:
        with open_run(path) as copy:
            same = copy.content_sha256 == run.content_sha256
    except RunFileError:
        same = False
    if not same:
        raise RunFileError(f"{run.path}: {CHANGED_MEANWHILE}")


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
