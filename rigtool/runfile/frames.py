"""One part of a run as a table for other programs: a recording, a table, or all results.

Blocks of rows, so that a recording of any length needs the memory of one block.
"""

from __future__ import annotations

import csv
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rigtool.errors import UsageError
from rigtool.quantity import Quantity
from rigtool.runfile import schema
from rigtool.runfile.model import Table
from rigtool.runfile.reader import Run
from rigtool.runfile.recording import Recording

if TYPE_CHECKING:
    import pandas as pd

BLOCK = 16 * schema.CHUNK
"""Rows of a block, whole chunks; a row group of a .parquet."""

RESULT_COLUMNS = ("name", "value", "unit", "u", "dof", "reason")


@dataclass(frozen=True)
class Frame:
    """Columns with their units ("" for text, or where a column says it) and blocks of rows."""

    units: dict[str, str]
    blocks: Iterator[pd.DataFrame]


def choose(run: Run, part: str | None) -> Frame:
    """Return a part of a run by its name: `results`, `recordings/NAME`, `tables/NAME`, or NAME.

    Raises `UsageError` where the choice is open.
    """
    parts: dict[str, Recording | Table | Mapping[str, Quantity]] = {}
    if run.results:
        parts[schema.RESULTS] = run.results
    parts.update({f"{schema.RECORDINGS}/{name}": item for name, item in run.recordings.items()})
    parts.update({f"{schema.TABLES}/{name}": table for name, table in run.tables.items()})
    found = [
        name for name in parts if part is None or name == part or name.rpartition("/")[2] == part
    ]
    if len(found) != 1:
        what = "holds more than one thing" if part is None else f"has {len(found)} parts {part!r}"
        raise UsageError(f"{run.path}: {what}: choose by --part from {', '.join(parts) or 'none'}")
    chosen = parts[found[0]]
    if isinstance(chosen, Recording):
        return Frame(dict(chosen.units), _recording(chosen))
    if isinstance(chosen, Table):
        return Frame({n: c.unit for n, c in chosen.columns.items()}, iter([chosen.to_pandas()]))
    return Frame(dict.fromkeys(RESULT_COLUMNS, ""), iter([_results(chosen)]))


def _recording(recording: Recording) -> Iterator[pd.DataFrame]:
    for start in range(0, max(recording.size, 1), BLOCK):
        stop = min(start + BLOCK, recording.size)
        yield recording.to_pandas(start, stop)


def _results(results: Mapping[str, Quantity]) -> pd.DataFrame:
    import pandas as pd

    rows = [(name, q.value, q.unit, q.u, q.dof, q.reason) for name, q in results.items()]
    frame = pd.DataFrame(rows, columns=list(RESULT_COLUMNS))
    return frame.astype({"u": "f8", "dof": "f8"})


def write_csv(frame: Frame, path: Path) -> None:
    """Write comma-separated text with a head `name [unit]`."""
    with path.open("w", newline="", encoding="utf-8") as stream:
        head = [f"{name} [{unit}]" if unit else name for name, unit in frame.units.items()]
        csv.writer(stream, lineterminator="\n").writerow(head)
        for block in frame.blocks:
            block.to_csv(stream, header=False, index=False, lineterminator="\n")


def write_parquet(frame: Frame, path: Path) -> None:
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
    first.attrs["units"] = frame.units
    plain: Any = pa.Schema.from_pandas(first, preserve_index=False)
    fields = [field.with_metadata({"units": frame.units[field.name]}) for field in plain]
    described = pa.schema(fields, metadata=plain.metadata)
    with parquet.ParquetWriter(path, described) as writer:
        writer.write_table(pa.Table.from_pandas(first, schema=described, preserve_index=False))
        for block in frame.blocks:
            writer.write_table(pa.Table.from_pandas(block, schema=described, preserve_index=False))
