"""Reading run files: everything is checked before it is used.

`open_run` verifies schema, structure and the file's own hashes; signals are read on demand, their
checksums (fletcher32) by HDF5. Whatever is wrong becomes a `RunFileError` that says what to do.
"""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from functools import cached_property, lru_cache
from itertools import pairwise
from pathlib import Path
from types import MappingProxyType, TracebackType
from typing import TYPE_CHECKING, Any, Self

import numpy as np
from numpy.typing import NDArray

from rigtool.errors import RigtoolError, RunFileError
from rigtool.quantity import Quantity
from rigtool.runfile import provenance, schema, tree
from rigtool.runfile.model import Channel, Column, Table
from rigtool.runfile.opened import DAMAGED, OpenFile, SharedFile, guard, require_schema

if TYPE_CHECKING:
    from rigtool.recipe import Recipe

BLOCK = 8 * schema.CHUNK
"""Samples that `Recording.blocks` reads at a time: what fits a processor's cache."""


class Recording:
    """Signals recorded together; nothing is read before `read` asks for it.

    In a run that was killed, channels may differ by the chunk that was being written; the shortest
    counts.
    """

    def __init__(
        self, file: OpenFile | SharedFile, group: tree.Group, path: str | os.PathLike[str]
    ) -> None:
        self._file = file
        self._group = group
        self._path = Path(path)
        self.name = group.name
        self.channels: tuple[Channel, ...] = tuple(
            Channel(name, item.attributes["units"], item.kind[1:], _description(item))
            for name, item in group.values.items()
        )
        self.conditions: Mapping[str, Quantity] = MappingProxyType(_conditions(group))
        self.size = _common_size(group)

    @property
    def units(self) -> dict[str, str]:
        """Unit of each channel."""
        return {channel.name: channel.unit for channel in self.channels}

    def has(self, channel: str) -> bool:
        """Say whether a channel was recorded."""
        return any(item.name == channel for item in self.channels)

    def read(self, channel: str, start: int = 0, stop: int | None = None) -> NDArray[np.float64]:
        """Return samples start..stop (stop excluded) of a channel as f8, in its unit.

        Raises `RunFileError` where the channel is missing, damaged, or holds NaN or infinity.
        """
        values = self.read_stored(channel, start, stop).astype(np.float64, copy=False)
        self._require_finite(channel, values, start)
        return values

    def blocks(
        self, *channels: str, start: int = 0, stop: int | None = None
    ) -> Iterator[tuple[NDArray[np.float64], ...]]:
        """Read samples start..stop of several channels together, `BLOCK` samples at a time.

        Memory does not grow with the recording; raises as `read` does.
        """
        stop = self.size if stop is None else min(stop, self.size)
        # Blocks end where chunks do: none is decompressed twice.
        edges = [start, *range(start - start % BLOCK + BLOCK, stop, BLOCK), stop]

        def read(begin: int, end: int) -> tuple[NDArray[np.float64], ...]:
            return tuple(self.read(channel, begin, end) for channel in channels)

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
        """Return the value of a condition, in its unit; `RunFileError` where it is missing."""
        if name not in self.conditions:
            raise RunFileError(
                f"{self._path}: recording {self.name!r} does not say its {name!r}, only "
                f"{', '.join(self.conditions) or 'nothing'}; record it again with this version"
            )
        return self.conditions[name].value

    def duration(self) -> float:
        """Return the time from the first to the last sample, s; 0 where there is none."""
        if self.size == 0:
            return 0.0
        first = self.read(schema.TIME, 0, 1)[0]
        return float(self.read(schema.TIME, self.size - 1)[0] - first)

    def _require_finite(self, channel: str, values: NDArray[np.float64], start: int) -> None:
        # One pass without a temporary array: a sum is finite only if all its terms are.
        with np.errstate(over="ignore", invalid="ignore"):
            if np.isfinite(np.sum(values)):
                return
        bad = np.flatnonzero(~np.isfinite(values))
        if bad.size == 0:
            return
        raise RunFileError(
            f"{self._path}: channel {channel!r} of recording {self.name!r} holds {bad.size} "
            f"value{'s' if bad.size > 1 else ''} that {'are' if bad.size > 1 else 'is'} NaN or "
            f"infinite, the first at sample {start + bad[0]}; record it again, or leave that part "
            "out"
        )


class Run:
    """An open run file; use as a context manager. Made by `open_run`."""

    def __init__(
        self, file: OpenFile | SharedFile, root: tree.Group, path: str | os.PathLike[str]
    ) -> None:
        self._file = file
        self.path = Path(path)
        entry = root.group(schema.ENTRY)
        self.provenance: dict[str, Any] = provenance.read(entry.group(schema.PROVENANCE))
        self.command = entry.text("command")
        self.rig: str | None = entry.text("rig") if "rig" in entry.values else None
        self.notes: tuple[str, ...] = tuple(
            entry.text("notes").splitlines() if "notes" in entry.values else ()
        )
        recordings = {
            name: Recording(file, group, self.path)
            for name, group in _members(entry, schema.RECORDINGS).items()
        }
        tables = {name: _table(group) for name, group in _members(entry, schema.TABLES).items()}
        self.recordings: Mapping[str, Recording] = MappingProxyType(recordings)
        self.results: Mapping[str, Quantity] = MappingProxyType(_results(entry))
        self.tables: Mapping[str, Table] = MappingProxyType(tables)

    @cached_property
    def recipe(self) -> Recipe | None:
        """The recipe of the run with all defaults filled in, None where it had none.

        Raises `RunFileError` where it does not fit this version.
        """
        resolved = self.provenance["recipe_resolved"]
        try:
            return None if resolved is None else _recipe(resolved)
        except RigtoolError as error:
            raise RunFileError(f"{self.path}: {error}") from error

    @property
    def content_sha256(self) -> str:
        """Hash of the content; two runs of one recipe and seed share it."""
        return str(self.provenance["content_sha256"])

    def require_command(self, *commands: str) -> None:
        """Raise `RunFileError` unless the run was made by one of these commands."""
        if self.command not in commands:
            raise RunFileError(
                f"{self.path}: is a run of {self.command}, needed is one of "
                f"{' or '.join(commands)}: give another file"
            )

    def recording(self, name: str) -> Recording:
        """Return a recording; raises `RunFileError` where it is missing or empty."""
        found = self.recordings.get(name)
        if found is None or found.size == 0:
            there = ", ".join(key for key, item in self.recordings.items() if item.size)
            raise RunFileError(
                f"{self.path}: has no recording {name!r}, only {there or 'results'}; give the "
                f"run file in which {self.command} recorded its signals"
            )
        return found

    def recordings_named(self, prefix: str) -> list[Recording]:
        """Return the recordings whose name begins so and that hold samples, in file order."""
        return [r for n, r in self.recordings.items() if n.startswith(prefix) and r.size]

    def table(self, name: str) -> Table:
        """Return a table; raises `RunFileError` where it is missing."""
        if name not in self.tables:
            raise RunFileError(
                f"{self.path}: has no table {name!r}, only {', '.join(self.tables) or 'none'}; "
                f"run {self.command} again with this version"
            )
        return self.tables[name]

    def result(self, name: str) -> Quantity:
        """Return a result; raises `RunFileError` where it is missing."""
        if name not in self.results:
            raise RunFileError(
                f"{self.path}: has no result {name!r}, only {', '.join(self.results) or 'none'}; "
                f"run {self.command} again with this version"
            )
        return self.results[name]

    def close(self) -> None:
        """Close the file; its recordings cannot be read any more."""
        self._file.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()


def open_run(path: str | os.PathLike[str]) -> Run:
    """Open a run file and check it; raises `RunFileError` that says what is wrong and what to do.

    Schema version, structure, and the hashes of everything but the samples of signals are checked
    here; samples are when they are read.
    """
    shared = SharedFile(path)
    try:
        with guard(path, "the file"), shared.use() as file:
            require_schema(file, path)
            root = tree.load(file)
            run = Run(shared, root, path)
            _require_hashes(root, run.provenance, path)
            return run
    except BaseException:
        shared.close()
        raise


def _require_hashes(
    root: tree.Group, stored: Mapping[str, Any], path: str | os.PathLike[str]
) -> None:
    if "record_sha256" not in stored:
        raise RunFileError(
            f"{path}: the run was never finished; `rigtool recover {path}` brings back what it "
            "recorded"
        )
    content = provenance.content_sha256(root)
    record = provenance.record_sha256(root, content)
    if (stored.get("content_sha256"), stored["record_sha256"]) != (content, record):
        raise RunFileError(
            f"{path}: does not match its own hash: it is damaged or was edited; {DAMAGED}"
        )


@lru_cache(maxsize=8)
def _recipe(resolved: str) -> Recipe:
    """Check a recipe once, however many runs were made from it; its models never change."""
    from rigtool.recipe import recipe_from_resolved

    return recipe_from_resolved(resolved)


def _members(entry: tree.Group, name: str) -> dict[str, tree.Group]:
    return entry.groups[name].groups if name in entry.groups else {}


def _description(item: tree.Group | tree.Values) -> str:
    return str(item.attributes.get("long_name", ""))


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
    return {
        name: Quantity(float(item.value), item.attributes["units"], reason="as set, not measured")
        for name, item in recording.groups[schema.CONDITIONS].values.items()
    }


def _results(entry: tree.Group) -> dict[str, Quantity]:
    if schema.RESULTS not in entry.groups:
        return {}
    return {
        name: Quantity(
            float(item.value),
            item.attributes["units"],
            item.attributes.get("standard_uncertainty"),
            item.attributes.get("degrees_of_freedom"),
            item.attributes.get("reason"),
        )
        for name, item in entry.groups[schema.RESULTS].values.items()
    }


def _table(group: tree.Group) -> Table:
    columns = {
        name: Column(item.value, item.attributes["units"], _description(item))
        for name, item in group.values.items()
    }
    attributes = group.attributes
    return Table(tuple(attributes["axes"]), columns, attributes["signal"], _description(group))
