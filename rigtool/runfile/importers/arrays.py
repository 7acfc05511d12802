"""Binary files: MATLAB .mat of all versions, NumPy .npy and .npz.

Columns given by number are those of one matrix, whose longer side is time; columns given by name
are variables of their own, `a.b` for the field b of a structure a.
"""

from __future__ import annotations

import math
import os
import re
import warnings
import zipfile
import zlib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Literal

import h5py
import numpy as np

from rigtool.errors import RigtoolError, RunFileError
from rigtool.inputs import open_input
from rigtool.runfile.importers.raw import (
    BINARY_REMEDY,
    MAX_NESTED,
    Array,
    ColumnKey,
    Raw,
    has_own_lines,
    missing_column,
    require_good,
    require_objects,
    require_size,
    unpacked_limit,
)
from rigtool.runfile.storage import open_file

_DIRECTORY_ENTRY = 46
"""Bytes that a member takes at least in the directory of a zip archive."""

_COLUMN = re.compile(r"(.+)\(:, ?(\d{1,9})\)")
"""A column of a matrix, as MATLAB writes it."""

_NESTED = (1, 2, 3)
"""Classes of MATLAB's cells, structures and objects."""


def read_arrays(
    path: Path, variable: str | None, columns: Sequence[ColumnKey], skip_bad: bool
) -> Raw:
    """Read columns of a binary file as numbers; raises the errors of `columns_of`."""
    return columns_of(path, load_arrays(path), variable, columns, skip_bad)


def columns_of(
    path: Path,
    arrays: dict[str, Any],
    variable: str | None,
    columns: Sequence[ColumnKey],
    skip_bad: bool,
) -> Raw:
    """Return columns (n,) of the arrays of a file.

    Raises `RunFileError` for what is missing or no array of numbers, and, unless `skip_bad`, for
    samples that are NaN or infinite.
    """
    found: dict[ColumnKey, Array] = {}
    for column in columns:
        part = _COLUMN.fullmatch(column) if isinstance(column, str) else None
        if isinstance(column, str) and (column in arrays or part is None):
            if column not in arrays:
                require_no_object(path, arrays, column)
                raise missing_column(path, column, list(arrays), len(arrays))
            found[column] = _vector(path, column, arrays[column])
        else:
            of, number = (variable, int(column)) if part is None else (part[1], int(part[2]))
            matrix = _matrix(path, arrays, of)
            if not 1 <= number <= matrix.shape[1]:
                raise missing_column(path, column, [], matrix.shape[1])
            found[column] = matrix[:, number - 1]
    lengths = {str(column): len(values) for column, values in found.items()}
    if len(set(lengths.values())) > 1:
        raise RunFileError(f"{path}: columns differ in length: {lengths}: they have no common time")
    count = next(iter(lengths.values()))
    if count == 0:
        raise RunFileError(f"{path}: its columns are empty")
    bad = {
        int(index) + 1: f"column {column!r} is {values[index]}"
        for column, values in found.items()
        for index in np.flatnonzero(
            np.isinf(values)
            if has_own_lines(int(np.isnan(values).sum()), count)
            else ~np.isfinite(values)
        )
    }
    if not skip_bad:
        require_good(path, "sample", bad)
    place = np.arange(count, dtype=np.int64)
    return Raw(found, place, place + 1, "sample").without(bad)


def require_no_object(path: Path, arrays: Mapping[str, Any], column: str) -> None:
    """Raise `RunFileError` for a column of an object of MATLAB: a table, a time, a string."""
    name = column.partition(".")[0]
    kind = arrays.get(name)
    if isinstance(kind, str):
        raise RunFileError(
            f"{path}: {name} is a {kind}, which only MATLAB reads: there, save its columns as "
            f"plain arrays, e.g. t = seconds({name}.Time); x = {name}.x; save('x.mat', 't', 'x')"
        )


def read_vector(path: Path, variable: str | None) -> Array:
    """Return the one series of numbers (n,) that a file holds, or that `variable` names."""
    arrays = load_arrays(path)
    name = _only(path, arrays, variable)
    return _vector(path, name or path.name, arrays[name])


def load_arrays(path: Path) -> dict[str, Any]:
    """Return what a file holds by name; the fields of structures as `a.b`.

    Nothing in it is executed (no pickles), no link is followed. Raises `RunFileError`.
    """
    with open_input(path, RunFileError) as stream:
        require_size(path, os.fstat(stream.fileno()).st_size)
        start = stream.read(6)
    try:
        if start == b"\x93NUMPY":
            return _fields("", np.load(path, allow_pickle=False))
        if start[:2] == b"PK":
            return _load_npz(path)
        if h5py.is_hdf5(path):
            return _load_hdf5(path)
        return _load_mat(path)
    except RigtoolError:
        raise
    except Exception as error:  # a damaged file makes these readers raise nearly anything
        raise RunFileError(
            f"{path}: is damaged, or no file of MATLAB or NumPy with plain arrays: {error}"
        ) from None


def _load_npz(path: Path) -> dict[str, Any]:
    _require_members(path)
    with zipfile.ZipFile(path) as archive:
        require_size(path, sum(item.file_size for item in archive.infolist()))
    with np.load(path, allow_pickle=False) as archive:
        return {
            key: value
            for name in archive.files
            for key, value in _fields(name, archive[name]).items()
        }


def _require_members(path: Path) -> None:
    """Refuse a zip archive by the size of its directory, before that is read.

    The size is 12 bytes after the last mark PK 5 6, and all ones in zip64 (APPNOTE 6.3.10, 4.3.16).
    """
    with path.open("rb") as stream:
        stream.seek(max(0, path.stat().st_size - 2**17))
        end = stream.read().rpartition(b"PK\5\6")[2]
    require_objects(path, int.from_bytes(end[8:12], "little") // _DIRECTORY_ENTRY)


def _load_mat(path: Path) -> dict[str, Any]:
    from scipy.io import loadmat

    _require_unpacked(path)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # the checks below decide what is usable
        contents = loadmat(str(path), simplify_cells=True)
    return _flat("", {name: value for name, value in contents.items() if name[:2] != "__"})


def _require_unpacked(path: Path) -> None:
    """Refuse a .mat of version 5 whose elements unpack to more than is read, or are too many.

    After a header of 128 bytes each element has its type and size, 4 bytes each; type 15 is zlib.
    An array begins with a tag of 8 bytes and flags, whose lowest byte is its class: 1 to 3 hold
    arrays in turn, which take longer than numbers (MAT-File Format, R2023b, 1-9, 1-16).
    """
    limit = unpacked_limit(path)
    unpacked, nested, count = 1, 0, 0
    with path.open("rb") as stream:
        head = stream.read(128)
        order: Literal["little", "big"] = "little" if head[126:] == b"IM" else "big"
        while len(tag := stream.read(8)) == 8:
            kind, size = (int.from_bytes(tag[i : i + 4], order) for i in (0, 4))
            data = stream.read(size)
            packed = zlib.decompressobj()
            before, first = unpacked, data
            while kind == 15 and data and unpacked <= limit:
                piece = packed.decompress(data, 2**20)
                first = piece[8:] if unpacked == before else first
                unpacked += len(piece)
                data = packed.unconsumed_tail
            require_size(path, unpacked)
            require_objects(path, count := count + 1)
            flags = int.from_bytes(first[8:12], order)
            nested += max(size, unpacked - before) if flags & 0xFF in _NESTED else 0
            if nested > MAX_NESTED:
                raise RunFileError(
                    f"{path}: has cells or structures of {nested} bytes, above {MAX_NESTED}: "
                    f"{BINARY_REMEDY}"
                )


def _load_hdf5(path: Path) -> dict[str, Any]:
    """Return the datasets of a .mat file of version 7.3; only those that are in the file itself."""
    found: dict[str, Any] = {}
    claimed, count = 1, 0

    def take(name: str, node: h5py.Group | h5py.Dataset) -> None:
        # visititems follows hard links only: it stays in this file and ends.
        nonlocal claimed, count
        require_objects(path, count := count + 1)
        if isinstance(node, h5py.Dataset) and not name.startswith("#") and not node.external:
            # HDF5 unpacks whole chunks, which may be larger than what they hold.
            claimed += max(node.size, math.prod(node.chunks or ())) * node.dtype.itemsize
            require_size(path, claimed)
            if "MATLAB_object_decode" in node.attrs:
                kind = node.attrs.get("MATLAB_class", b"object")
                found[name] = f"{kind.decode() if isinstance(kind, bytes) else kind} of MATLAB"
            elif not node.is_virtual and node.dtype.kind in "iufb":
                found[name.replace("/", ".")] = node[()]

    with open_file(path, "r") as file:
        file.visititems(take)
    return found


def _flat(prefix: str, values: Mapping[str, Any]) -> dict[str, Any]:
    found: dict[str, Any] = {}
    for name, value in values.items():
        if isinstance(value, Mapping):
            found |= _flat(f"{prefix}{name}.", value)
        elif isinstance(value, list) and all(isinstance(part, Mapping) for part in value):
            found |= _flat(prefix, {f"{name}({n})": part for n, part in enumerate(value, 1)})
        else:
            found[prefix + name] = value
    return found


def _fields(name: str, array: Any) -> dict[str, Any]:
    """Return an array under its name, or the fields of a structured one."""
    if array.dtype.names is None:
        return {name: np.asarray(array)}
    prefix = f"{name}." if name else ""
    return {prefix + field: np.asarray(array[field]) for field in array.dtype.names}


def _matrix(path: Path, arrays: dict[str, Any], variable: str | None) -> Array:
    """Return the matrix (samples, columns) that holds columns given by number."""
    name = _only(path, arrays, variable)
    matrix = _numbers(path, name, arrays[name])
    if matrix.ndim == 1:
        matrix = matrix[:, None]
    if matrix.ndim != 2:
        raise RunFileError(
            f"{path}: {name or 'its array'} has {matrix.ndim} dimensions, but must have 2"
        )
    return matrix.T if matrix.shape[0] < matrix.shape[1] else matrix


def _only(path: Path, arrays: dict[str, Any], variable: str | None) -> str:
    if variable is None:
        if len(arrays) != 1:
            raise RunFileError(
                f"{path}: holds {', '.join(arrays) or 'nothing'}: name one as `variable` in [file] "
                "of the mapping, or give columns by name"
            )
        return next(iter(arrays))
    if variable not in arrays:
        raise missing_column(path, variable, list(arrays), len(arrays))
    return variable


def _vector(path: Path, name: str, value: Any) -> Array:
    vector = np.squeeze(_numbers(path, name, value))
    if vector.ndim > 1:
        raise RunFileError(
            f"{path}: {name!r} has shape {vector.shape}, but must be one column: name it as "
            "`variable` and give columns by number"
        )
    return np.atleast_1d(vector)


def _numbers(path: Path, name: str, value: Any) -> Array:
    require_no_object(path, {name: value}, name)
    array = np.asarray(value)
    if array.dtype.kind not in "iufb":
        raise RunFileError(
            f"{path}: {name or 'its array'!r} holds {array.dtype}, not real numbers: map another"
        )
    return array.astype(np.float64)
