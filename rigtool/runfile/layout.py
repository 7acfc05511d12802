"""Putting a run into HDF5: groups, datasets and attributes as docs/run-file-format.md lists them.

Two conventions live side by side: NeXus (`signal`, `axes`, `<axis>_indices`) and netCDF dimension
scales (an axis is a dataset of the same group, named like its dimension).
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import h5py
import numpy as np

from rigtool.quantity import Quantity
from rigtool.runfile import provenance, schema
from rigtool.runfile.model import RecordingSpec, Table
from rigtool.runfile.objects import make_array, make_group, make_number, make_text, set_attribute
from rigtool.signals import is_name


def write_head(
    file: h5py.File,
    command: str,
    rig: str | None,
    recordings: Sequence[RecordingSpec],
    origin: provenance.Provenance,
) -> None:
    """Write everything that is known before the first sample."""
    set_attribute(file, "NX_class", "NXroot")
    set_attribute(file, "default", schema.ENTRY)
    set_attribute(file, "creator", "rigtool")
    set_attribute(file, "schema", schema.SCHEMA)
    set_attribute(file, "schema_version", schema.version_text())
    entry = make_group(file, schema.ENTRY, "NXentry")
    make_text(entry, "title", command if rig is None else f"{command} on {rig}")
    make_text(entry, "command", command)
    if rig is not None:
        make_text(entry, "rig", rig)
    provenance.write(make_group(entry, schema.PROVENANCE, "NXprocess"), origin)
    if recordings:
        parent = make_group(entry, schema.RECORDINGS, "NXcollection")
        for spec in recordings:
            _write_recording(parent, spec)
        _point_to(entry, recordings[0].name, schema.RECORDINGS)


def write_footer(
    file: h5py.File,
    results: Mapping[str, Quantity],
    tables: Mapping[str, Table],
    notes: Sequence[str],
) -> None:
    """Write what the analysis found; the first table becomes the default plot."""
    entry = file[schema.ENTRY]
    if notes:
        make_text(entry, "notes", "".join(" ".join(note.splitlines()) + "\n" for note in notes))
    if results:
        parent = make_group(entry, schema.RESULTS, "NXcollection")
        for name, quantity in results.items():
            _write_result(parent, name, quantity)
    if tables:
        parent = make_group(entry, schema.TABLES, "NXcollection")
        for name, table in tables.items():
            _write_table(parent, name, table)
        _point_to(entry, next(iter(tables)), schema.TABLES)


def footer_size(tables: Mapping[str, Table], notes: Sequence[str]) -> int:
    """Return the bytes that these need at most, on top of the file's own bookkeeping."""
    columns = [column.values for table in tables.values() for column in table.columns.values()]
    return sum(2 * values.nbytes + 8192 for values in columns) + 4 * sum(map(len, notes))


def _point_to(entry: h5py.Group, name: str, parent: str) -> None:
    set_attribute(entry[parent], "default", name)
    set_attribute(entry, "default", parent)


def _write_result(parent: h5py.Group, name: str, quantity: Quantity) -> None:
    if not is_name(name):
        raise ValueError(f"result name {name!r}: use letters, digits and underscores")
    dataset = make_number(parent, name, quantity.value, quantity.unit)
    if quantity.u is not None:
        set_attribute(dataset, "standard_uncertainty", float(quantity.u))
    if quantity.dof is not None:
        set_attribute(dataset, "degrees_of_freedom", float(quantity.dof))
    if quantity.reason is not None:
        set_attribute(dataset, "reason", quantity.reason)
    if quantity.budget:
        for name in schema.BUDGET:
            column = [getattr(line, name) for line in quantity.budget]
            if name not in schema.BUDGET_TEXTS:
                column = [math.inf if number is None else float(number) for number in column]
            set_attribute(dataset, f"budget_{name}", column)


def _write_recording(parent: h5py.Group, spec: RecordingSpec) -> None:
    others = [channel.name for channel in spec.channels if channel.name != schema.TIME]
    group = make_group(parent, spec.name, "NXdata")
    _describe_plot(group, (schema.TIME,), spec.signal, [n for n in others if n != spec.signal])
    datasets = {}
    for channel in spec.channels:
        none = np.empty(0, schema.DTYPES[channel.dtype])
        dataset = datasets[channel.name] = make_array(group, channel.name, none, (spec.chunk,))
        set_attribute(dataset, "units", channel.unit)
        set_attribute(dataset, "long_name", channel.description)
    _attach_axes(datasets, (schema.TIME,))
    if spec.conditions:
        conditions = make_group(group, schema.CONDITIONS, "NXcollection")
        for name, (value, unit) in spec.conditions.items():
            make_number(conditions, name, value, unit)


def _write_table(parent: h5py.Group, name: str, table: Table) -> None:
    if not is_name(name):
        raise ValueError(f"table name {name!r}: use letters, digits and underscores")
    group = make_group(parent, name, "NXdata")
    same_shape = [
        key
        for key, column in table.columns.items()
        if key not in (*table.axes, table.signal) and column.values.shape == table.shape
    ]
    _describe_plot(group, table.axes, table.signal, same_shape)
    if table.description:
        set_attribute(group, "long_name", table.description)
    datasets = {}
    for key, column in table.columns.items():
        values = column.values
        chunks = _chunks(values.shape) if values.size else None
        dataset = datasets[key] = make_array(group, key, values, chunks)
        set_attribute(dataset, "units", column.unit)
        if column.description:
            set_attribute(dataset, "long_name", column.description)
    _attach_axes(datasets, table.axes)


def _chunks(shape: tuple[int, ...]) -> tuple[int, ...]:
    """Return a chunk of at most `schema.CHUNK` values, along the last axes first."""
    chunk: list[int] = []
    for length in reversed(shape):
        room = max(1, schema.CHUNK // math.prod(chunk))
        chunk.insert(0, min(length, room))
    return tuple(chunk)


def _describe_plot(
    group: h5py.Group, axes: tuple[str, ...], signal: str, others: Sequence[str]
) -> None:
    set_attribute(group, "signal", signal)
    set_attribute(group, "axes", list(axes))
    for index, axis in enumerate(axes):
        set_attribute(group, f"{axis}_indices", np.array([index], dtype=np.int32))
    if others:
        set_attribute(group, "auxiliary_signals", list(others))


def _attach_axes(datasets: Mapping[str, Any], axes: tuple[str, ...]) -> None:
    """Make axes the scales of the others; low-level identifiers by name."""
    for axis in axes:
        h5py.h5ds.set_scale(datasets[axis], axis.encode())
    for name, dataset in datasets.items():
        if name not in axes:
            for index in range(dataset.rank):
                h5py.h5ds.attach_scale(dataset, datasets[axes[index]], index)
