"""A recording of an open run file: its signals are read on demand, and checked when they are read.

Checksums of samples (fletcher32) are verified by HDF5; any fault raises `RunFileError`.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from itertools import pairwise
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from rigtool.errors import RunFileError
from rigtool.inputs import PathName
from rigtool.numerics.arrays import Array
from rigtool.quantity import HOTTEST_DEGC, Quantity
from rigtool.runfile import schema, tree
from rigtool.runfile.model import Channel, Column, dataset, description_of
from rigtool.runfile.opened import OpenFile, SharedFile, guard
from rigtool.signals import units_of

if TYPE_CHECKING:
    import pandas as pd
    import xarray as xr

MOST_HZ = 1e9
"""Sampling rate that no bench of a motor has, Hz."""

BLOCK_SAMPLES = 16 * schema.CHUNK
"""Samples that `Recording.blocks` reads at a time: HDF5 opens each signal anew for a block."""


class Recording:
    """Signals recorded together; nothing is read before `read` asks for it.

    In a run that was killed, channels may differ by the chunk that was being written; the shortest
    counts.
    """

    def __init__(self, file: OpenFile | SharedFile, group: tree.Group, path: PathName) -> None:
        self._file = file
        self._group = group
        self._path = Path(path)
        self.name = group.name
        self.channels: tuple[Channel, ...] = tuple(
            Channel(
                name,
                tree.text_of(item.attributes, "units"),
                item.kind[1:],
                description_of(item.attributes),
            )
            for name, item in group.values.items()
        )
        self.conditions: Mapping[str, Quantity] = MappingProxyType(_conditions(group))
        self.size = _common_size(group)

    @property
    def path(self) -> Path:
        """The run file that holds it."""
        return self._path

    @property
    def units(self) -> dict[str, str]:
        """Unit of each channel."""
        return {channel.name: channel.unit for channel in self.channels}

    def has(self, channel: str) -> bool:
        """Return whether a channel was recorded."""
        return any(item.name == channel for item in self.channels)

    def read(self, channel: str, start: int = 0, stop: int | None = None) -> Array:
        """Return samples start..stop (stop excluded) of a channel as f8, in its unit.

        Raises `RunFileError` where the channel is missing, damaged, in a unit that no channel of
        its name has, or holds NaN, infinity or numbers beyond `schema.LARGEST_NUMBER`, or
        `HOTTEST_DEGC`, or is a time of samples closer than any are.
        """
        values = self.read_stored(channel, start, stop).astype(np.float64, copy=False)
        bad, limit = self._unusable(channel, values)
        if bad.size:
            raise RunFileError(
                f"{self._path}: channel {channel!r} of recording {self.name!r} holds {bad.size} "
                f"value{'s' if bad.size > 1 else ''} that {'are' if bad.size > 1 else 'is'} NaN, "
                f"infinite or beyond {limit:g} {self.units[channel]}, the first at sample "
                f"{start + bad[0]}; record it again, or leave that part out"
            )
        duration = values[-1] - values[0] if channel == schema.TIME and values.size else 0.0
        if 0 < duration < (values.size - 1) / MOST_HZ:
            raise RunFileError(
                f"{self._path}: recording {self.name!r} has samples at more than {MOST_HZ:g} Hz: "
                "its time is not in s; record or import it again"
            )
        return values

    def blocks(
        self,
        *channels: str,
        start: int = 0,
        stop: int | None = None,
        finite: bool = True,
        size: int = BLOCK_SAMPLES,
    ) -> Iterator[tuple[Array, ...]]:
        """Read samples start..stop of several channels together, `size` samples at a time.

        Memory does not grow with the recording; raises as `read` does, but gives NaN where `finite`
        is false.
        """
        stop = self.size if stop is None else min(stop, self.size)
        # Blocks end where chunks do: none is decompressed twice.
        edges = [start, *range(start - start % size + size, stop, size), stop]

        def read(begin: int, end: int) -> tuple[Array, ...]:
            if finite:
                return tuple(self.read(channel, begin, end) for channel in channels)
            stored = [
                self.read_stored(channel, begin, end).astype(np.float64, copy=False)
                for channel in channels
            ]
            for channel, values in zip(channels, stored, strict=True):
                values[self._unusable(channel, values)[0]] = np.nan
            return tuple(stored)

        if len(edges) == 2:  # no thread for what is short
            if start < stop:
                yield read(start, stop)
            return
        # HDF5 decompresses the next block while the caller works on this one.
        with ThreadPoolExecutor(1) as worker:
            coming = worker.submit(read, *edges[:2])
            for begin, end in pairwise(edges[1:]):
                block, coming = coming.result(), worker.submit(read, begin, end)
                yield block
            yield coming.result()

    def read_stored(
        self, channel: str, start: int = 0, stop: int | None = None
    ) -> NDArray[np.generic]:
        """Return samples as they are stored: in their own type, NaN included.

        Raises `RunFileError` where the channel is missing or damaged.
        """
        if not self.has(channel):
            raise RunFileError(
                f"{self._path}: recording {self.name!r} has no channel {channel!r}, only "
                f"{', '.join(item.name for item in self.channels)}; record it, or import it with "
                "this channel mapped"
            )
        with guard(self._path, f"channel {channel!r} of recording {self.name!r}"):
            signal = self._group.values[channel]
            with self._file.use() as file:
                return tree.read_samples(file, signal, start, self.size if stop is None else stop)

    def sha256(self, channel: str) -> str | None:
        """Return the stored hash of a channel's samples; None in an unfinished run."""
        return self._group.values[channel].attributes.get("sha256")

    def condition(self, name: str) -> float:
        """Return the value of a condition, in its unit.

        Raises `RunFileError` where it is missing, NaN, beyond `schema.LARGEST_NUMBER` or in a unit
        that no such quantity has.
        """
        if name not in self.conditions:
            raise RunFileError(
                f"{self._path}: recording {self.name!r} has no condition {name!r}, only "
                f"{', '.join(self.conditions) or 'nothing'}; record it again with this version"
            )
        value = self.conditions[name].value
        self._require_unit(f"condition {name!r}", name, self.conditions[name].unit)
        if not abs(value) <= schema.LARGEST_NUMBER:
            raise RunFileError(
                f"{self._path}: condition {name!r} of recording {self.name!r} is {value}; a number "
                f"up to {schema.LARGEST_NUMBER:g} is needed: record it again"
            )
        return value

    def _require_unit(self, what: str, name: str, unit: str) -> None:
        if (known := units_of(name)) and unit not in known:
            raise RunFileError(
                f"{self._path}: {what} of recording {self.name!r} is in {unit!r}; "
                f"{' or '.join(known)} is needed: convert it, or import it with its unit"
            )

    def duration(self) -> float:
        """Return the time from the first to the last sample, s; 0 where there is none."""
        if self.size == 0:
            return 0.0
        first = self.read(schema.TIME, 0, 1)[0]
        return float(self.read(schema.TIME, self.size - 1)[0] - first)

    def rate(self) -> float | None:
        """Return the rate at the start, Hz; None for fewer than two samples.

        The median interval, since a recording may pause, between temperatures for instance.
        """
        if self.size < 2:
            return None
        intervals = np.sort(np.diff(self.read(schema.TIME, 0, min(self.size, BLOCK_SAMPLES))))
        # `np.median` imports masked arrays, a tenth of the time of `rigtool info`.
        interval = float(intervals[(len(intervals) - 1) // 2] + intervals[len(intervals) // 2]) / 2
        return 1 / interval if interval > 0 else None

    def to_pandas(self, start: int = 0, stop: int | None = None) -> pd.DataFrame:
        """Return samples start..stop (stop excluded), a column a channel, in their own types.

        Units are in `attrs["units"]`. Raises as `read_stored` does.
        """
        import pandas as pd

        frame = pd.DataFrame({name: self.read_stored(name, start, stop) for name in self.units})
        frame.attrs["units"] = self.units
        return frame

    def to_xarray(self) -> xr.Dataset:
        """Return the channels over `time`; attributes `units` and `long_name` as in the file.

        Raises `UsageError` where xarray is missing, else as `read_stored` does.
        """
        columns = {
            channel.name: Column(self.read_stored(channel.name), channel.unit, channel.description)
            for channel in self.channels
        }
        return dataset((schema.TIME,), columns)

    def _unusable(self, channel: str, values: Array) -> tuple[NDArray[np.intp], float]:
        """Return where values are NaN or larger than a signal of this unit is, and that limit."""
        unit = self.units[channel]
        self._require_unit(f"channel {channel!r}", channel, unit)
        limit = HOTTEST_DEGC if unit == "degC" else schema.LARGEST_NUMBER
        # One pass without a temporary array, mostly: no square is larger than the sum of all.
        with np.errstate(over="ignore", invalid="ignore"):
            if np.dot(values, values) <= limit**2:
                return np.empty(0, np.intp), limit
        return np.flatnonzero(~(np.abs(values) <= limit)), limit


def _common_size(recording: tree.Group) -> int:
    time = recording.values[schema.TIME]
    shapes = {item.shape for item in recording.values.values()}
    finished = "sha256" in time.attributes
    if {len(shape) for shape in shapes} != {1} or (finished and len(shapes) > 1):
        raise ValueError(f"channels of {recording.name} have no common length")
    return min(shape[0] for shape in shapes)


def _conditions(recording: tree.Group) -> dict[str, Quantity]:
    if schema.CONDITIONS not in recording.groups:
        return {}
    conditions = recording.groups[schema.CONDITIONS]
    return {
        name: Quantity(
            conditions.number(name),
            tree.text_of(item.attributes, "units"),
            reason="as set, not measured",
        )
        for name, item in conditions.values.items()
    }
