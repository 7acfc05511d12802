"""A run file as a tree in memory, read without trusting the file.

`read_tree` reads everything except the samples of signals, once. Claims of the file are checked
before anything is read: a damaged or hostile file may hold external links, loops, types that crash
a reader, or datasets that claim more than any disk holds. The low-level interface of h5py is used:
a run has some hundred small objects, for which the high-level one takes five times as long.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping
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

    def number(self, name: str) -> float:
        """Return the one number of a dataset in this group; raises ValueError for anything else."""
        found = self.values[name]
        if not isinstance(found.value, np.ndarray) or found.shape != ():
            raise ValueError(f"{found.path} must be one number")
        return float(found.value)

    def text(self, name: str) -> str:
        """Return the text of a dataset in this group; raises ValueError where there is none."""
        found = self.values.get(name)
        if found is None or not isinstance(found.value, str):
            raise ValueError(f"{self.path} lacks the text {name!r}")
        return found.value


def text_of(attributes: Mapping[str, Any], name: str) -> str:
    """Return an attribute that is a text; raises ValueError where it is missing or none."""
    found = attributes.get(name)
    if not isinstance(found, str):
        raise ValueError(f"the attribute {name!r} must be a text, got {found!r:.100}")
    return found


def number_of(attributes: Mapping[str, Any], name: str) -> float | None:
    """Return an attribute that is a number, None where it is missing; raises ValueError."""
    found = attributes.get(name)
    if found is not None and not isinstance(found, int | float):
        raise ValueError(f"the attribute {name!r} must be a number, got {found!r:.100}")
    return found


def list_of(attributes: Mapping[str, Any], name: str, kind: type) -> list[Any]:
    """Return an attribute that is a list of one kind; raises ValueError where it is none."""
    found = attributes.get(name)
    if not isinstance(found, list) or not all(isinstance(item, kind) for item in found):
        raise ValueError(f"the attribute {name!r} must be a list of {kind.__name__}")
    return found


def read_tree(file: h5py.File, path: str = "/") -> Group:
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


def write_samples(file: h5py.File, path: str, start: int, samples: NDArray[np.generic]) -> None:
    """Write samples of the signal at `path` from `start` on; it ends with them.

    h5py's low-level interface takes three quarters of the time of a slice of a `h5py.Dataset`.
    """
    dataset = h5py.h5d.open(file.id, path.encode())
    dataset.set_extent((start + len(samples),))
    chosen = dataset.get_space()
    chosen.select_hyperslab((start,), samples.shape)
    dataset.write(h5py.h5s.create_simple(samples.shape), chosen, samples)


def root_text(file: h5py.File, name: str) -> str | None:
    """Return a text attribute of any HDF5 file; None where it is not as rigtool writes it."""
    if not h5py.h5a.exists(file.id, name.encode()):
        return None
    attribute = h5py.h5a.open(file.id, name.encode())
    kind = attribute.get_type()
    fixed = isinstance(kind, h5py.h5t.TypeStringID) and not kind.is_variable_str()
    if not fixed or attribute.shape != () or kind.get_size() > _MAX_ROOT_TEXT:
        return None
    array = np.empty((), f"S{kind.get_size()}")
    attribute.read(array, kind)
    return str(_decoded(array))


_BOOKKEEPING = {b"CLASS", b"NAME", b"DIMENSION_LIST", b"REFERENCE_LIST"}
"""Attributes with which HDF5 ties dimension scales to datasets; they hold references."""

_MAX_DEPTH = 6
_MAX_ROOT_TEXT = 1000
_NAME = re.compile(r"[A-Za-z0-9_]{1,100}")
_FILTERS = {h5py.h5z.FILTER_DEFLATE, h5py.h5z.FILTER_SHUFFLE, h5py.h5z.FILTER_FLETCHER32}


class _Loader:
    def __init__(self, file: h5py.File) -> None:
        self._name = file.filename
        self._file_size = file.id.get_filesize()
        self._left = {
            "objects and attributes": schema.MAX_OBJECTS,
            "values in tables": schema.MAX_TABLE_VALUES,
            "bytes of text": schema.MAX_TEXT_BYTES,
            "bytes of samples": max(
                schema.MAX_SAMPLE_BYTES, schema.MAX_EXPANSION * self._file_size
            ),
        }

    def _spend(self, what: str, amount: int, path: str) -> None:
        self._left[what] -= amount
        if self._left[what] < 0:
            raise self._refuse(path, f"is beyond the {what} that a file may hold")

    def group(self, handle: Any, path: str, depth: int) -> Group:
        self._spend("objects and attributes", 1, path)
        if depth > _MAX_DEPTH:
            raise self._refuse(path, "is nested too deeply")
        if len(handle) > schema.MAX_MEMBERS:
            raise self._refuse(path, f"has {len(handle)} members, above {schema.MAX_MEMBERS}")
        found = Group(path, self._attributes(handle, path), {}, {})
        for raw, kind in self._links(handle):
            name = raw.decode("utf-8", "backslashreplace")
            if not _NAME.fullmatch(name):
                raise self._refuse(path, f"has the member {name!r}")
            if kind != h5py.h5l.TYPE_HARD:
                raise self._refuse(path, f"has a link {name!r} that leads elsewhere")
            below = f"{path.rstrip('/')}/{name}"
            member = h5py.h5o.open(handle, raw)
            if h5py.h5o.get_info(member).rc > 1:
                raise self._refuse(below, "is linked from more than one place")
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
        self._spend("objects and attributes", 1, path)
        kind, shape = handle.get_type(), handle.shape
        dtype = self._dtype(kind, path)
        self._check(handle, path, shape, kind, dtype)
        attributes = self._attributes(handle, path)
        parts = path.split("/")
        of_signal = len(parts) == 5 and parts[1:3] == [schema.ENTRY, schema.RECORDINGS]
        if of_signal and dtype is not None:
            self._spend("bytes of samples", math.prod(shape) * dtype.itemsize, path)
            return Values(path, attributes, dtype.str, shape, None)
        read = partial(handle.read, h5py.h5s.ALL, h5py.h5s.ALL)
        value = self._value(read, shape, kind, dtype, path)
        if dtype is None:
            return Values(path, attributes, "str", shape, _decoded(value))
        return Values(path, attributes, dtype.str, shape, value)

    def _attributes(self, handle: Any, path: str) -> dict[str, Any]:
        names: list[bytes] = []
        h5py.h5a.iterate(handle, names.append)
        found = {}
        for name in names:
            self._spend("objects and attributes", 1, path)
            if name in _BOOKKEEPING:
                continue
            attribute = h5py.h5a.open(handle, name)
            shape, kind = attribute.shape, attribute.get_type()
            where = f"{path}, attribute {name.decode('utf-8', 'backslashreplace')!r},"
            dtype = self._dtype(kind, where)
            if shape is None or math.prod(shape) > schema.MAX_ATTRIBUTE_VALUES:
                raise self._refuse(where, f"has the shape {shape}")
            value = self._value(attribute.read, shape, kind, dtype, where)
            found[name.decode()] = _decoded(value) if dtype is None else value.tolist()
        return found

    def _dtype(self, kind: Any, path: str) -> np.dtype[Any] | None:
        """Return the type of numbers that a run file holds, None for text of fixed length.

        Any other type is refused before a value of it is read: HDF5 or h5py crash on some of them.
        """
        if isinstance(kind, h5py.h5t.TypeStringID):
            if kind.is_variable_str():
                # Such text is in a heap without checksum: HDF5 may search a damaged one for ever.
                raise self._refuse(path, "has text of variable length")
            return None
        if isinstance(kind, h5py.h5t.TypeIntegerID | h5py.h5t.TypeFloatID):
            found: np.dtype[Any] = kind.dtype
            if found in schema.DTYPES.values():
                return found
            raise self._refuse(path, f"has the type {found}")
        raise self._refuse(path, "has a type that is neither number nor text")

    def _value(
        self,
        read: Callable[..., None],
        shape: tuple[int, ...],
        kind: Any,
        dtype: np.dtype[Any] | None,
        path: str,
    ) -> NDArray[Any]:
        """Read values within the budgets; given its type, h5py does not look it up again."""
        count = math.prod(shape)
        if dtype is None:
            size = kind.get_size()
            if count * size > self._file_size:
                raise self._refuse(path, f"claims {count * size} bytes, more than this file has")
            self._spend("bytes of text", count * size, path)
            dtype = np.dtype(f"S{size}")
        else:
            self._spend("values in tables", count, path)
        array = np.empty(shape, dtype)
        read(array, kind)
        return array

    def _check(
        self,
        handle: Any,
        path: str,
        shape: tuple[int, ...] | None,
        kind: Any,
        dtype: np.dtype[Any] | None,
    ) -> None:
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
        if dtype is None and shape != ():
            raise self._refuse(path, f"is an array of texts, {shape}")
        size = kind.get_size()
        chunk = size * math.prod(plist.get_chunk()) if layout == h5py.h5d.CHUNKED else 0
        if chunk > schema.MAX_CHUNK_BYTES:
            raise self._refuse(path, f"has chunks above {schema.MAX_CHUNK_BYTES} bytes")
        # What was never written costs nothing in the file. At most there is what deflate can
        # unpack from what was, plus a partly empty last chunk.
        claimed = math.prod(shape) * size
        if claimed <= max(chunk, self._file_size):
            return
        if claimed > schema.MAX_COMPRESSION * handle.get_storage_size() + chunk:
            raise self._refuse(path, f"claims shape {shape}, more than this file can hold")

    def _refuse(self, path: str, why: str) -> RunFileError:
        return RunFileError(
            f"{self._name}: {path} {why}: no run file of rigtool has that; the file is damaged or "
            "comes from elsewhere: restore it from a copy, or make it anew"
        )


def _decoded(array: NDArray[Any]) -> Any:
    """Return text, or a list of texts."""
    if array.shape == ():
        return array.item().decode()
    return [item.decode() for item in array.ravel().tolist()]
