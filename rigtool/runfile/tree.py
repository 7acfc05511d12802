"""A run file as a tree in memory, read without trusting the file.

`load` reads everything but the samples of signals, once. What a file claims is checked before it is
read: a damaged or hostile file may hold links out of itself, loops, types that crash, or datasets
that claim more than any disk has. It uses h5py's low-level interface: a run has some hundred small
objects, and the high-level one takes five times as long.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
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
    """Read a group of a file with all below; raises `RunFileError` on what no run file holds."""
    return _Loader(file).group(file[path].id, path, 0)


def root_text(file: h5py.File, name: str) -> str | None:
    """Return a text attribute of a file of anybody's; None where it is not as rigtool writes it."""
    if name not in file.attrs:
        return None
    info = h5py.check_string_dtype(file.attrs.get_id(name).dtype)
    if info is None or info.length is None:
        return None
    value = file.attrs[name]
    return value.decode() if isinstance(value, bytes) else str(value)


def is_signal(path: str) -> bool:
    """Say whether the dataset of this path holds samples of a recording."""
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
        for name in h5py.Group(handle):
            if handle.links.get_info(name.encode()).type != h5py.h5l.TYPE_HARD:
                raise self._refuse(path, f"has a link {name!r} that leads elsewhere")
            below = f"{path.rstrip('/')}/{name}"
            member = h5py.h5o.open(handle, name.encode())
            if isinstance(member, h5py.h5g.GroupID):
                found.groups[name] = self.group(member, below, depth + 1)
            elif isinstance(member, h5py.h5d.DatasetID):
                found.values[name] = self._values(member, below)
            else:
                raise self._refuse(below, "is neither group nor dataset")
        return found

    def _values(self, handle: Any, path: str) -> Values:
        dtype = handle.dtype
        text = self._is_text(dtype, path)
        shape = handle.shape
        self._check(handle, path, shape, dtype, text)
        value = None
        if not is_signal(path):
            self._budget -= math.prod(shape)
            if self._budget < 0:
                limit = schema.MAX_TABLE_VALUES
                raise self._refuse(path, f"is beyond the {limit} values a file may hold in tables")
            array = np.empty(shape, dtype)
            handle.read(h5py.h5s.ALL, h5py.h5s.ALL, array)
            value = _decoded(array) if text else array
        kind = "str" if text else dtype.str
        return Values(path, self._attributes(handle, path), kind, shape, value)

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
            if isinstance(kind, h5py.h5t.TypeStringID) and not kind.is_variable_str():
                # A thousand files have some ten thousand of these: the short way pays.
                array = np.empty(shape, f"S{kind.get_size()}")
                attribute.read(array, kind)
                found[name.decode()] = _decoded(array)
                continue
            dtype = attribute.dtype
            text = self._is_text(dtype, path)
            array = np.empty(shape, dtype)
            attribute.read(array)
            found[name.decode()] = _decoded(array) if text else array.tolist()
        return found

    def _is_text(self, dtype: np.dtype[Any], path: str) -> bool:
        info = h5py.check_string_dtype(dtype)
        if info is not None and info.length is None:
            # It would be in a heap, which has no checksum: HDF5 can search a damaged one for ever.
            raise self._refuse(path, "has text of variable length")
        return info is not None

    def _check(self, handle: Any, path: str, shape: Any, dtype: np.dtype[Any], text: bool) -> None:
        """Refuse what no run file holds, from the dataset's header alone."""
        if shape is None or math.prod(shape) > schema.MAX_SAMPLES:
            raise self._refuse(path, f"claims shape {shape}, above {schema.MAX_SAMPLES} values")
        plist = handle.get_create_plist()
        layout = plist.get_layout()
        if layout == h5py.h5d.VIRTUAL or plist.get_external_count() > 0:
            raise self._refuse(path, "keeps its data in another file")
        for index in range(plist.get_nfilters()):
            if plist.get_filter(index)[0] not in _FILTERS:
                raise self._refuse(path, f"uses the filter {plist.get_filter(index)[3]!r}")
        if text:
            if shape != ():
                raise self._refuse(path, f"is an array of texts, {shape}")
            return
        if dtype not in schema.DTYPES.values():
            raise self._refuse(path, f"has the type {dtype}")
        chunk = math.prod(plist.get_chunk()) if layout == h5py.h5d.CHUNKED else 0
        if chunk * dtype.itemsize > schema.MAX_CHUNK_BYTES:
            raise self._refuse(path, f"has chunks above {schema.MAX_CHUNK_BYTES} bytes")
        # Not more than deflate can make out of the whole file, the last chunk being partly empty.
        most = schema.MAX_COMPRESSION * self._file_size + chunk * dtype.itemsize
        if math.prod(shape) * dtype.itemsize > most:
            raise self._refuse(path, f"claims shape {shape}, more than this file can hold")

    def _refuse(self, path: str, why: str) -> RunFileError:
        return RunFileError(
            f"{self._name}: {path} {why}: no run file of rigtool has that; the file is damaged or "
            "comes from elsewhere: restore it from a copy, or make it anew"
        )


def _decoded(array: NDArray[Any]) -> Any:
    """Return text, or a list of texts."""
    texts = [item.decode() for item in array.ravel().tolist()]
    return texts[0] if array.shape == () else texts
