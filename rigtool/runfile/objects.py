"""The kinds of objects in a run file, apart from arrays.

Text has a fixed length and is stored in headers, which HDF5 protects by a checksum. Text of
variable length would be in a heap without one: HDF5 follows a damaged heap without end.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache
from typing import Any

import h5py
import numpy as np

from rigtool.runfile import schema

_COMPACT_LIMIT = 2**15
"""Bytes that fit well into an object's header, which ends at 64 KiB."""


def make_group(parent: h5py.Group, name: str, nx_class: str) -> h5py.Group:
    """Create a group; its members keep their order, which is the order of a report."""
    group = parent.create_group(name, track_order=True)
    set_attribute(group, "NX_class", nx_class)
    return group


def set_attribute(
    node: h5py.Group | h5py.Dataset,
    name: str,
    value: str | float | Sequence[str] | Sequence[float],
) -> None:
    """Write an attribute: a text, a number (f8), or a list of texts or of numbers."""
    if isinstance(value, float):
        node.attrs[name] = value
        return
    if isinstance(value, str):
        texts = np.array(value.encode())
    elif isinstance(value[0], float):
        node.attrs[name] = np.array(value, dtype=schema.DTYPES["f8"])
        return
    else:
        texts = np.array([str(text).encode() for text in value])
    node.attrs.create(name, texts, dtype=_text_type(texts.dtype.itemsize))


def make_text(parent: h5py.Group, name: str, value: str) -> None:
    """Create a dataset with one text."""
    data = value.encode()
    kind = h5py.h5t.py_create(_text_type(len(data)), logical=True)
    handle = _create_scalar(parent, name, kind, len(data) <= _COMPACT_LIMIT)
    handle.write(h5py.h5s.ALL, h5py.h5s.ALL, np.array(data, f"S{kind.get_size()}"), kind)


def make_number(parent: h5py.Group, name: str, value: float, unit: str) -> h5py.Dataset:
    """Create a dataset with one number."""
    kind = h5py.h5t.py_create(schema.DTYPES["f8"])
    dataset = h5py.Dataset(_create_scalar(parent, name, kind, True))
    dataset[()] = value
    set_attribute(dataset, "units", unit)
    return dataset


def _text_type(length: int) -> np.dtype[Any]:
    dtype: np.dtype[Any] = h5py.string_dtype("utf-8", max(1, length))
    return dtype


def _create_scalar(parent: h5py.Group, name: str, kind: Any, compact: bool) -> Any:
    """Create a dataset of one value; h5py's own interface takes several times as long."""
    space = h5py.h5s.create(h5py.h5s.SCALAR)
    return h5py.h5d.create(parent.id, name.encode(), kind, space, _scalar_plist(compact))


@cache
def _scalar_plist(compact: bool) -> Any:
    plist = h5py.h5p.create(h5py.h5p.DATASET_CREATE)
    plist.set_obj_track_times(False)
    if compact:
        plist.set_layout(h5py.h5d.COMPACT)
    return plist
