"""A run file as a tree in memory, read without trusting the file.

`load` reads everything except the samples of signals, once. Claims of the file are checked before
anything is read: a damaged or hostile file may hold external links, loops, types that crash a
reader, or datasets that claim more than any disk holds. The low-level interface of h5py is used: a
run has some hundred small objects, for which the high-level one takes five times as long.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any

import h5py
import numpy as np
from numpy.typing import NDArray

from rigtool.errors import RunFileError
from rigtool.runfile import schema


@dataclass(frozen=True)
class Values:
    """A dataset: `kind` is 'str' or a numpy type; `value` is None for the samples of a signal."""

    path: str
    attributes: dict[str, Any]
    kind: str
    shape: tuple[int, ...]
    value: Any


@dataclass(frozen=True)
class Group:
    """A group with its members in the order in which they were written."""

    path: str
    attributes: dict[str, Any]
    groups: dict[str, Group]
    values: dict[str, Values]

    @property
    def name(self) -> str:
        """The last part of the path."""
        return self.path.rpartition("/")[2]

    def group(self, name: str) -> Group:
        """Return a group in this one; raises ValueError where it is missing."""
        if name not in self.groups:
            raise ValueError(f"{self.path} lacks the group {name!r}")
        return self.groups[name]

    def text(self, name: str) -> str:
        """Return the text of a dataset in this group; raises ValueError where there is none."""
        found = self.values.get(name)
        if found is None or not isinstance(found.value, str):
            raise ValueError(f"{self.path} lacks the text {name!r}")
        return found.value


def load(file: h5py.File, path: str = "/") -> Group:
    """Read a group of a file and all below; `RunFileError` for anything that no run file holds."""
    return _Loader(file).group(file[path].id, path, 0)


def read_samples(file: h5py.File, signal: Values, start: int, stop: int) -> NDArray[np.generic]:
    """Return samples start..stop (stop excluded) of a signal as they are stored.

    The dataset does not stay open: with a thousand open files, HDF5 would search all open objects
    whenever one of them closes.
    """
    count = max(0, min(stop, signal.shape[0]) - start)
    samples = np.empty(count, signal.kind)
    if count:
        dataset = h5py.h5d.open(file.id, signal.path.encode())
        if (count,) == dataset.shape:
            dataset.read(h5py.h5s.ALL, h5py.h5s.ALL, samples)
        else:
            chosen = h5py.h5s.create_simple(signal.shape)
            chosen.select_hyperslab((start,), (count,))
            dataset.read(h5py.h5s.create_simple((count,)), chosen, samples)
    return samples


def root_text(file: h5py.File, name: str) -> str | None:
    """Return a text attribute of any HDF5 file; None where it is not as rigtool writes it."""
    if not h5py.h5a.exists(file.id, name.encode()):
        return None
    attribute = h5py.h5a.open(file.id, name.encode())
    kind = attribute.get_type()
    fixed = isinstance(kind, h5py.h5t.TypeStringID) and not kind.is_variable_str()
    if not fixed or attribute.shape != ():
        return None
    return str(_decoded(_read(attribute.read, (), kind)))


def is_signal(path: str) -> bool:
    """Return whether the dataset of this path holds samples of a recording."""
    parts = path.split("/")
    return len(parts) == 5 and parts[1:3] == [schema.ENTRY, schema.RECORDINGS]


_BOOKKEEPING = {b"CLASS", b"NAME", b"DIMENSION_LIST", b"REFERENCE_LIST"}
"""Attributes with which HDF5 ties dimension scales to datasets; they hold references."""

_MAX_DEPTH = 6
_FILTERS = {h5py.h5z.FILTER_DEFLATE, h5py.h5z.FILTER_SHUFFLE, h5py.h5z.FILTER_FLETCHER32}


class _Loader:
    def __init__(self, file: h5py.File) -> None:
        self._name = file.filename
        self._file_size = file.id.get_filesize()
        self._budget = schema.MAX_TABLE_VALUES

    def group(self, handle: Any, path: str, depth: int) -> Group:
        if depth > _MAX_DEPTH:
            raise self._refuse(path, "is nested too deeply")
        if len(handle) > schema.MAX_MEMBERS:
            raise self._refuse(path, f"has {len(handle)} members, above {schema.MAX_MEMBERS}")
        found = Group(path, self._attributes(handle, path), {}, {})
        for raw, kind in self._links(handle):
            name = raw.decode()
            if kind != h5py.h5l.TYPE_HARD:
                raise self._refuse(path, f"has a link {name!r} that leads elsewhere")
            below = f"{path.rstrip('/')}/{name}"
            member = h5py.h5o.open(handle, raw)
            if isinstance(member, h5py.h5g.GroupID):
                found.groups[name] = self.group(member, below, depth + 1)
            elif isinstance(member, h5py.h5d.DatasetID):
                found.values[name] = self._values(member, below)
            else:
                raise self._refuse(below, "is neither group nor dataset")
        return found

    def _links(self, handle: Any) -> list[tuple[bytes, int]]:
        """Return name and type of the members of a group, in the order they were written."""
        found: list[tuple[bytes, int]] = []
        ordered = handle.get_create_plist().get_link_creation_order() & h5py.h5p.CRT_ORDER_TRACKED
        handle.links.iterate(
            lambda name, info: found.append((name, info.type)),
            info=True,
            idx_type=h5py.h5.INDEX_CRT_ORDER if ordered else h5py.h5.INDEX_NAME,
        )
        return found

    def _values(self, handle: Any, path: str) -> Values:
        kind = handle.get_type()
        text = self._is_text(kind, path)
        dtype = None if text else kind.dtype
        shape = handle.shape
        self._check(handle, path, shape, dtype)
        attributes = self._attributes(handle, path)
        if is_signal(path) and dtype is not None:
            return Values(path, attributes, dtype.str, shape, None)
        self._budget -= math.prod(shape)
        if self._budget < 0:
            limit = schema.MAX_TABLE_VALUES
            raise self._refuse(path, f"is beyond the {limit} values a file may hold in tables")
        read = partial(handle.read, h5py.h5s.ALL, h5py.h5s.ALL)
        if dtype is None:
            return Values(path, attributes, "str", shape, _decoded(_read(read, shape, kind)))
        array = np.empty(shape, dtype)
        read(array)
        return Values(path, attributes, dtype.str, shape, array)

    def _attributes(self, handle: Any, path: str) -> dict[str, Any]:
        names: list[bytes] = []
        h5py.h5a.iterate(handle, names.append)
        found = {}
        for name in names:
            if name in _BOOKKEEPING:
                continue
            attribute = h5py.h5a.open(handle, name)
            shape, kind = attribute.shape, attribute.get_type()
            if math.prod(shape) > schema.MAX_ATTRIBUTE_VALUES:
                raise self._refuse(path, f"has an attribute {name!r} of shape {shape}")
            if self._is_text(kind, path):
                found[name.decode()] = _decoded(_read(attribute.read, shape, kind))
                continue
            array = np.empty(shape, kind.dtype)
            attribute.read(array, kind)
            found[name.decode()] = array.tolist()
        return found

    def _is_text(self, kind: Any, path: str) -> bool:
        if not isinstance(kind, h5py.h5t.TypeStringID):
            return False
        if kind.is_variable_str():
            # Such text is in a heap without checksum: HDF5 may search a damaged one for ever.
            raise self._refuse(path, "has text of variable length")
        return True

    def _check(self, handle: Any, path: str, shape: Any, dtype: np.dtype[Any] | None) -> None:
        """Refuse a dataset that no run file holds, by its header; dtype is None for text."""
        if shape is None or math.prod(shape) > schema.MAX_SAMPLES:
            raise self._refuse(path, f"claims shape {shape}, above {schema.MAX_SAMPLES} values")
        plist = handle.get_create_plist()
        layout = plist.get_layout()
        if layout == h5py.h5d.VIRTUAL or plist.get_external_count() > 0:
            raise self._refuse(path, "keeps its data in another file")
        for index in range(plist.get_nfilters()):
            if plist.get_filter(index)[0] not in _FILTERS:
                raise self._refuse(path, f"uses the filter {plist.get_filter(index)[3]!r}")
        if dtype is None:
            if shape != ():
                raise self._refuse(path, f"is an array of texts, {shape}")
            return
        if dtype not in schema.DTYPES.values():
            raise self._refuse(path, f"has the type {dtype}")
        chunk = math.prod(plist.get_chunk()) if layout == h5py.h5d.CHUNKED else 0
        if chunk * dtype.itemsize > schema.MAX_CHUNK_BYTES:
            raise self._refuse(path, f"has chunks above {schema.MAX_CHUNK_BYTES} bytes")
        # At most what deflate can unpack from the whole file, plus a partly empty last chunk.
        most = schema.MAX_COMPRESSION * self._file_size + chunk * dtype.itemsize
        if math.prod(shape) * dtype.itemsize > most:
            raise self._refuse(path, f"claims shape {shape}, more than this file can hold")

    def _refuse(self, path: str, why: str) -> RunFileError:
        return RunFileError(
            f"{self._name}: {path} {why}: no run file of rigtool has that; the file is damaged or "
            "comes from elsewhere: restore it from a copy, or make it anew"
        )


def _read(read: Callable[..., None], shape: tuple[int, ...], kind: Any) -> NDArray[np.bytes_]:
    """Read text of a fixed length; given its type, h5py does not look it up again."""
    array = np.empty(shape, f"S{kind.get_size()}")
    read(array, kind)
    return array


def _decoded(array: NDArray[Any]) -> Any:
    """Return text, or a list of texts."""
    if array.shape == ():
        return array.item().decode()
    return [item.decode() for item in array.ravel().tolist()]
