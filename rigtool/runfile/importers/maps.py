"""Maps: values around a turn, without time, at equal steps or with their angles."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np

from rigtool.errors import RunFileError
from rigtool.recipe.mapping import Mapping
from rigtool.recipe.units import UNITS, ZEROS
from rigtool.runfile.importers.arrays import read_arrays, read_vector
from rigtool.runfile.importers.convert import stem
from rigtool.runfile.importers.plan import is_binary
from rigtool.runfile.importers.raw import Array, ColumnKey
from rigtool.runfile.importers.text import read_text
from rigtool.runfile.model import Column, Table


def read_map(source: Path, mapping: Mapping) -> tuple[Table, list[str]]:
    """Return the map that a file holds, and notes; `RunFileError` for a bad file."""
    assert mapping.map is not None
    signal = mapping.map.signal
    factor, unit = UNITS[mapping.map.unit]
    position, values, asked = _around(source, mapping)
    table = Table(
        ("position",),
        {
            "position": Column(position, "rad", "of the rotor"),
            signal: Column(values * factor + ZEROS.get(mapping.map.unit, 0.0), unit),
        },
        signal,
        f"{signal} around a turn, {stem(source)}",
    )
    if len(position) == asked:
        return table, []
    return table, [f"{len(position)} of {asked} steps around the turn were sampled"]


def _around(source: Path, mapping: Mapping) -> tuple[Array, Array, int]:
    """Return rising angles (n,) within a turn, rad, values (n,), and the number before any was
    left out.

    Several values at one angle become their mean.
    """
    known = mapping.map
    assert known is not None
    column: ColumnKey = 1 if known.column is None else known.column
    columns = [column] if known.angle is None else [column, known.angle.column]
    if not is_binary(source):
        raw = read_text(source, mapping, skip_bad=False, columns=columns)[0].columns
    elif known.column is None:
        raw = {column: read_vector(source, mapping.file.variable)}
    else:
        raw = read_arrays(source, mapping.file.variable, columns, skip_bad=False).columns
    values = raw[column]
    count = len(values)
    angle = np.arange(count) * (2 * math.pi / count)
    if known.angle is not None:
        counts = known.angle.counts_per_turn
        factor = UNITS[known.angle.unit][0] if counts is None else 2 * math.pi / counts
        angle = known.angle.scale * raw[known.angle.column] + known.angle.offset
        angle = np.mod(angle * (known.angle.sign * factor), 2 * math.pi)
    sampled = np.isfinite(values) & np.isfinite(angle)
    if known.missing is not None:
        sampled &= values != known.missing
    if np.count_nonzero(sampled) < 2:
        raise RunFileError(
            f"{source}: holds {np.count_nonzero(sampled)} values, at least 2 are needed"
        )
    position, place = np.unique(angle[sampled], return_inverse=True)
    means: Array = np.bincount(place, values[sampled]) / np.bincount(place)
    return position, means, count
