"""The kinds of objects in a run file.

All is written through h5py's low-level interface: its other one takes twice as long. Text has a
fixed length and is stored in headers, which HDF5 protects by a checksum. Text of variable length
would be in a heap without one: HDF5 follows a damaged heap without end.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache, lru_cache
from typing import Any

import h5py
import numpy as np

from rigtool.numerics.arrays import Array
from rigtool.runfile import schema

_COMPACT_LIMIT = 2**15
"""Bytes that fit well into an object's header, which ends at 64 KiB."""


def make_group(parent: h5py.Group, name: str, nx_class: str) -> h5py.Group:
    """Create a group; its members keep their order, which is the order of a report."""
    group = parent.create_group(name, track_order=True)
    set_attribute(group, "NX_class", nx_class)
    return group


def set_attribute(
    node: h5py.HLObject | Any,
    name: str,
    value: str | float | Array | Sequence[str] | Sequence[float],
) -> None:
    """Write an attribute of an object, or of its low-level identifier: a text, a number (f8), an
    array of numbers, or a list of texts or of numbers."""
    if isinstance(value, str):
        values = np.array(value.encode())
    elif isinstance(value, float | np.ndarray):
        values = np.asarray(value)
    elif isinstance(value[0], float):
        values = np.array(value, schema.DTYPES["f8"])
    else:
        values = np.array([str(text).encode() for text in value])
    if values.dtype.kind == "S":
        values = values.astype(f"S{max(1, values.dtype.itemsize)}")
    handle = node.id if isinstance(node, h5py.HLObject) else node
    raw, kind = name.encode(), _kind(values.dtype)
    if h5py.h5a.exists(handle, raw):
        h5py.h5a.delete(handle, raw)
    space = h5py.h5s.create_simple(values.shape)
    h5py.h5a.create(handle, raw, kind, space).write(values, kind)


def make_text(parent: h5py.Group, name: str, value: str) -> None:
    """Create a dataset with one text."""
    data = value.encode()
    kind = _kind(np.dtype(f"S{max(1, len(data))}"))
    handle = _create_scalar(parent, name, kind, len(data) <= _COMPACT_LIMIT)
    handle.write(h5py.h5s.ALL, h5py.h5s.ALL, np.array(data, f"S{kind.get_size()}"), kind)


def make_number(parent: h5py.Group, name: str, value: float, unit: str) -> Any:
    """Create a dataset with one number; return its low-level identifier."""
    kind = _kind(schema.DTYPES["f8"])
    handle = _create_scalar(parent, name, kind, True)
    handle.write(h5py.h5s.ALL, h5py.h5s.ALL, np.array(value, schema.DTYPES["f8"]), kind)
    set_attribute(handle, "units", unit)
    return handle


def make_array(parent: h5py.Group, name: str, values: Array, chunk: tuple[int, ...] | None) -> Any:
    """Create a dataset with these values, in packed chunks if a chunk is given; return its
    low-level identifier. Without values, (0,), it can grow."""
    most = (h5py.h5s.UNLIMITED,) if chunk and not values.size else None
    space = h5py.h5s.create_simple(values.shape, most)
    plist = _scalar_plist(False) if chunk is None else _packed_plist(values.dtype, chunk)
    handle = h5py.h5d.create(parent.id, name.encode(), _kind(values.dtype), space, plist)
    if values.size:
        handle.write(h5py.h5s.ALL, h5py.h5s.ALL, np.asarray(values, order="C"))
    return handle


@cache
def _kind(dtype: np.dtype[Any]) -> Any:
    """Return the type in the file: text is of this fixed length."""
    if dtype.kind == "S":
        dtype = h5py.string_dtype("utf-8", dtype.itemsize)
    return h5py.h5t.py_create(dtype, logical=True)


def _create_scalar(parent: h5py.Group, name: str, kind: Any, compact: bool) -> Any:
    """Create a dataset of one value."""
    space = h5py.h5s.create(h5py.h5s.SCALAR)
    return h5py.h5d.create(parent.id, name.encode(), kind, space, _scalar_plist(compact))


@cache
def _scalar_plist(compact: bool) -> Any:
    plist = h5py.h5p.create(h5py.h5p.DATASET_CREATE)
    plist.set_obj_track_times(False)
    if compact:
        plist.set_layout(h5py.h5d.COMPACT)
    return plist


@lru_cache(200)
def _packed_plist(dtype: np.dtype[Any], chunk: tuple[int, ...]) -> Any:
    plist = h5py.h5p.create(h5py.h5p.DATASET_CREATE)
    plist.set_chunk(chunk)
    plist.set_shuffle()
    plist.set_deflate(schema.DEFLATE_LEVEL)
    plist.set_fletcher32()
    # A chunk that a damaged file has lost reads as NaN, which no analysis accepts.
    if dtype.kind == "f":
        plist.set_fill_value(np.array(np.nan))
    plist.set_obj_track_times(False)
    return plist
