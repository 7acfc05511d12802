"""One recording on its way to the file: samples wait here until a chunk is complete."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from typing import Any

import h5py
import numpy as np
from numpy.typing import NDArray

from rigtool.errors import RigtoolError
from rigtool.runfile import schema, tree
from rigtool.runfile.model import RecordingSpec
from rigtool.runfile.objects import set_attribute


class Stream:
    """Samples of all channels of a recording.

    `waiting` samples are in memory, `written` ones were handed to HDF5. A `complete` recording
    takes no more.
    """

    def __init__(self, spec: RecordingSpec, file: h5py.File) -> None:
        self.path = f"/{schema.ENTRY}/{schema.RECORDINGS}/{spec.name}"
        self._file = file
        self._name = spec.name
        self.chunk = spec.chunk
        self._dtypes = {channel.name: schema.DTYPES[channel.dtype] for channel in spec.channels}
        self._pending: dict[str, list[NDArray[Any]]] = {name: [] for name in self._dtypes}
        self.waiting = 0
        self._digests = {name: hashlib.sha256() for name in self._dtypes}
        self.complete = False
        self.written = 0

    def append(self, block: Mapping[str, NDArray[Any]]) -> None:
        """Take samples; they wait until `write`.

        Raises `ValueError` for channels that do not fit, `RuntimeError` once it was read back.
        """
        if self.complete:
            raise RuntimeError(f"recording {self._name} was read back: it cannot grow any more")
        if set(block) != set(self._dtypes):
            raise ValueError(
                f"recording {self._name} has channels {sorted(self._dtypes)}, "
                f"a block came with {sorted(block)}"
            )
        arrays = {name: np.asarray(block[name]) for name in self._dtypes}
        shapes = {array.shape for array in arrays.values()}
        if len(shapes) != 1 or len(next(iter(shapes))) != 1:
            raise ValueError(f"channels of a block differ in shape: {shapes}")
        for name, array in arrays.items():
            self._pending[name].append(_converted(name, array, self._dtypes[name]))
        self.waiting += next(iter(shapes))[0]

    def size(self, count: int) -> int:
        """Return the bytes that so many samples of all channels need at most."""
        samples = -(-count // self.chunk) * self.chunk
        return sum(samples * dtype.itemsize for dtype in self._dtypes.values())

    def seal(self, file: h5py.File) -> None:
        """Store the hash of each channel's samples with it."""
        for name, digest in self._digests.items():
            dataset = h5py.h5d.open(file.id, f"{self.path}/{name}".encode())
            set_attribute(dataset, "sha256", digest.hexdigest())

    def write(self, count: int) -> None:
        """Hand the first `count` of the waiting samples to HDF5.

        What fails between two channels leaves all samples waiting: they can be written again.
        """
        joined = {name: np.concatenate(parts) for name, parts in self._pending.items()}
        for name, values in joined.items():
            tree.write_samples(self._file, f"{self.path}/{name}", self.written, values[:count])
        for name, values in joined.items():
            self._digests[name].update(values[:count].data)
            self._pending[name] = [values[count:].copy()]
        self.waiting -= count
        self.written += count


def _converted(name: str, array: NDArray[Any], dtype: np.dtype[Any]) -> NDArray[Any]:
    if dtype.kind in "iu" and array.size:
        limits = np.iinfo(dtype)
        if not (limits.min <= array.min() and array.max() <= limits.max):
            raise RigtoolError(
                f"channel {name}: {array.min()} to {array.max()} does not fit its type {dtype}"
            )
    return array.astype(dtype)
