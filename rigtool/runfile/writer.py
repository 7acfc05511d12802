"""Writing run files: samples stream to `<path>.part`, results follow, then one atomic replace.

While recording, `<path>.part` is in SWMR mode and only ever grows by whole chunks, so that whatever
was flushed outlives the process (`rigtool recover`). Results are written into a copy of it: until
that copy takes the final name, neither the recorded signals nor an earlier output are touched.
"""

from __future__ import annotations

import contextlib
import os
import shutil
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Self

import h5py
from numpy.typing import NDArray

from rigtool.errors import RigtoolError, UsageError
from rigtool.inputs import PathName
from rigtool.interrupts import held, raise_swallowed
from rigtool.quantity import Quantity
from rigtool.runfile import layout, provenance, schema, storage, tree
from rigtool.runfile.model import RecordingSpec, Table
from rigtool.runfile.opened import OpenFile, open_hdf5
from rigtool.runfile.outputs import own_file, require_output
from rigtool.runfile.reader import Run
from rigtool.runfile.recording import Recording
from rigtool.runfile.stream import Stream
from rigtool.runfile.superblock import clear_times

if TYPE_CHECKING:
    from rigtool.recipe import Recipe

HEADROOM_BYTES = 2**18
"""Bytes reserved for what HDF5 itself writes beside the data."""

SYNC_INTERVAL = 0.25
"""Seconds of wall-clock between two fsyncs. A rig fills a chunk a second, so each chunk is synced;
a simulation, a thousand times faster, is not slowed down by the disk."""


class RunWriter:
    """Writes one run; use as a context manager and end with `finish`.

    Refuses an existing `path` (or the remains of an interrupted run) with `UsageError` unless
    `overwrite`. Where anything fails nothing appears under `path`, and recorded samples stay in
    `<path>.part`. With `origin`, a run that was interrupted and is written anew, its provenance is
    kept instead of that of the running program, and no part stays after a failure, nor with
    `copied`, where the signals exist elsewhere. `rig` names the rig where no recipe does; `source`
    is the file of another program that is imported; `sources` are files that the output must not
    replace, beside inputs.
    """

    def __init__(
        self,
        path: PathName,
        *,
        command: str,
        recipe: Recipe | None = None,
        recipe_text: str | None = None,
        recordings: Sequence[RecordingSpec] = (),
        inputs: Sequence[Run] = (),
        seed: int | None = None,
        overwrite: bool = False,
        argv: Sequence[str] | None = None,
        origin: Run | None = None,
        rig: str | None = None,
        source: provenance.Source | None = None,
        copied: bool = False,
        sources: Sequence[PathName] = (),
    ) -> None:
        self.path = Path(path)
        self._overwrite = overwrite
        self._require_free([*(run.path for run in inputs), *sources])
        self._command = command
        self._specs = tuple(recordings)
        self._is_copy = copied or origin is not None
        if origin is not None:
            self._rig = origin.rig
            self._provenance = provenance.restore(origin.provenance)
        else:
            self._rig = rig if recipe is None else recipe.rig.name
            self._provenance = provenance.collect(
                recipe_text=recipe_text,
                recipe_resolved=None if recipe is None else recipe.resolved(),
                seed=seed,
                inputs=[_describe_input(run) for run in inputs],
                argv=argv,
                source=source,
            )
        self._streams: dict[str, Stream] = {}
        self._file: h5py.File | None = None
        self._recorded: Run | None = None
        self._inode = 0
        self._marks = contextlib.ExitStack()
        self._synced = -SYNC_INTERVAL
        self._unsynced = 0
        self._finished = False
        self._line: str | None = None

    def __enter__(self) -> Self:
        with storage.storage_errors(self.path):
            try:
                with held():
                    self._start()
            except BaseException:
                self._abandon()
                raise
        return self

    def __exit__(self, kind: object, error: BaseException | None, trace: object) -> None:
        if self._finished:
            return
        kept = self._abandon()
        if error is None:
            raise RuntimeError(f"{self.path}: the run was left without finish()")
        if kept:
            error.add_note(kept)

    def channel_names(self, recording: str) -> tuple[str, ...]:
        """Return the names of the channels that a recording takes."""
        spec = next(spec for spec in self._specs if spec.name == recording)
        return tuple(channel.name for channel in spec.channels)

    def append(self, recording: str, block: Mapping[str, NDArray[Any]]) -> None:
        """Add samples to a recording: one array for each of its channels, all of one length.

        Whole chunks go to the file, the rest waits. Raises `RigtoolError` where the disk refuses,
        `RuntimeError` once the recordings were read back.
        """
        if self._file is None or self._recorded is not None:
            raise RuntimeError("nothing can be appended once the recordings were read back")
        stream = self._streams[recording]
        with held():
            stream.append(block)
            if stream.waiting >= stream.chunk:
                with storage.storage_errors(self.path):
                    self._write(stream, stream.waiting - stream.waiting % stream.chunk)
                    self._sync()
        raise_swallowed()

    def note_line(self, report: str) -> None:
        """Keep with the run what happened on the serial line of its rig: JSON, from the rig."""
        self._line = report

    def recording(self, name: str) -> Recording:
        """Return what was recorded under this name; it is complete then and cannot grow."""
        if self._recorded is not None:
            return self._recorded.recording(name)
        stream = self._streams[name]
        with storage.storage_errors(self.path), held():
            self._complete(stream)
            self._sync()
            file = self._file
        return Recording(OpenFile(file), tree.read_tree(file, stream.path), self.path)

    def recorded(self) -> Run:
        """Return all recordings, complete and readable; the run has no results yet."""
        if self._recorded is None:
            with storage.storage_errors(self.path):
                self._close_streams()
                file = open_hdf5(self.part)
                self._recorded = Run(OpenFile(file), tree.read_tree(file), self.path)
        return self._recorded

    def finish(
        self,
        results: Mapping[str, Quantity],
        tables: Mapping[str, Table],
        notes: Sequence[str] = (),
    ) -> None:
        """Write results, tables (the first is what a viewer shows) and remarks; take the name."""
        raise_swallowed()
        with storage.storage_errors(self.path), own_file(self.path) as new:
            self._close_streams()
            self._close_recorded()
            # Signals are safe in the .part until the new file is whole: a kill, a full disk or
            # an unwritable result while it is being completed costs nothing.
            self._require_own_part()
            shutil.copyfile(self.part, new)
            with storage.open_file(new, "r+", libver=schema.LIBVER) as file:
                self._reserve(file, layout.footer_size(tables, notes) + self._head_size())
                for stream in self._streams.values():
                    stream.seal(file)
                layout.write_footer(file, results, tables, notes)
                provenance.note_line(file, self._line)
                provenance.seal(file)
                storage.flush(file)
            clear_times(new)
            storage.sync_path(new)
            with held():
                self._require_own_part()
                os.replace(new, self.path)
                self._finished = True
                self._marks.close()
                self.part.unlink()
                storage.sync_path(self.path.parent)

    def _require_free(self, inputs: Sequence[PathName]) -> None:
        """Refuse an output, or a part beside it, that would be lost."""
        self.path = require_output(self.path, overwrite=self._overwrite, inputs=inputs)
        if self.path.suffix == ".toml":
            raise UsageError(
                f"{self.path}: .toml is for recipes, no command would read this run: name it .h5"
            )
        self.part = self.path.with_name(self.path.name + ".part")
        if not self.part.exists() and not self.part.is_symlink():
            return
        if not self._overwrite:
            raise UsageError(
                f"{self.part}: is left from a run that was interrupted, or is being written now: "
                f"`rigtool recover {self.part}` brings back its signals, --overwrite discards it"
            )
        if self.part.is_symlink() or not _is_hdf5_or_empty(self.part):
            raise UsageError(f"{self.part}: is no part of a run of rigtool: move it away")
        if any(os.path.exists(name) and self.part.samefile(name) for name in inputs):
            raise UsageError(f"{self.part}: is an input of this run: give the output another name")
        storage.require_unlocked(self.part)

    def _owns_part(self) -> bool:
        # Someone else may have started the same output with --overwrite meanwhile.
        return self.part.exists() and self.part.stat().st_ino == self._inode

    def _require_own_part(self) -> None:
        if not self._owns_part():
            raise RigtoolError(
                f"{self.part}: was replaced by another program while this run was going on; "
                "run one at a time, or give each its own output"
            )

    def _start(self) -> None:
        """Create the .part with all that is known before the first sample.

        The file has its lock before it has its name: of runs that begin at one moment one goes on.
        """
        storage.require_unlocked(self.part, remove=True)  # `_require_free` looked at it
        with own_file(self.path) as new:
            with new.open("r+b") as stream:
                self._inode = os.fstat(stream.fileno()).st_ino
                storage.reserve(stream.fileno(), self._head_size())
            self._file = file = storage.open_file(
                new, "w", libver=schema.LIBVER, **schema.PAGE_SETTINGS
            )
            storage.lock(file.id.get_vfd_handle())
            self._reserve(file, self._head_size())
            storage.take_free_name(new, self.part)
        layout.write_head(file, self._command, self._rig, self._specs, self._provenance)
        for spec in self._specs:
            self._streams[spec.name] = Stream(spec, file)
        if self._specs:
            file.swmr_mode = True

    def _head_size(self) -> int:
        channels = sum(len(spec.channels) + len(spec.conditions) for spec in self._specs)
        origin = self._provenance
        texts = (origin.recipe, origin.recipe_resolved, origin.mapping)
        return HEADROOM_BYTES + 4096 * channels + 4 * sum(len(text or "") for text in texts)

    def _reserve(self, file: h5py.File, size: int) -> None:
        storage.reserve(file.id.get_vfd_handle(), file.id.get_filesize() + size)

    def _write(self, stream: Stream, count: int) -> None:
        assert self._file is not None
        size = stream.size(count)
        try:
            self._reserve(self._file, self._unsynced + size + HEADROOM_BYTES)
        except OSError:
            # What waits in HDF5's memory was counted uncompressed: write it, and look again.
            self._sync(force=True)
            self._reserve(self._file, size + HEADROOM_BYTES)
        stream.write(count)
        self._unsynced += size

    def _complete(self, stream: Stream) -> None:
        # The remaining samples go into a last, partly filled chunk.
        if stream.waiting:
            self._write(stream, stream.waiting)
        stream.complete = True

    def _sync(self, force: bool = False) -> None:
        assert self._file is not None
        now = time.monotonic()
        if force or now - self._synced >= SYNC_INTERVAL:
            storage.flush(self._file)
            os.fsync(self._file.id.get_vfd_handle())
            self._synced = time.monotonic()
            self._unsynced = 0

    def _close_recorded(self) -> None:
        if self._recorded is not None:
            self._recorded.close()

    def _close_file(self) -> None:
        if self._file is not None:
            self._file.close()

    def _close_streams(self) -> None:
        if self._file is None:
            return
        with held():
            for stream in self._streams.values():
                self._complete(stream)
            self._sync(force=True)
            file, self._file = self._file, None
            file.close()
            # What is analysed is kept from other runs, too.
            self._marks.enter_context(storage.marked(self.part))

    def _abandon(self) -> str:
        """Close everything after an error; return a note on the remains.

        Whatever the error left behind, this goes on to the end: samples that are in the file stay.
        """
        with held():
            return self._abandoned()

    def _abandoned(self) -> str:
        for close in (self._close_recorded, self._close_streams, self._close_file):
            with contextlib.suppress(Exception):
                close()
        self._file = None
        self._marks.close()
        samples = sum(stream.written for stream in self._streams.values())
        if not self._owns_part():
            return f"{samples} samples that were recorded are lost" if samples else ""
        if samples == 0 or self._is_copy:
            self.part.unlink()
            return ""
        return (
            f"{samples} samples that were recorded are kept in {self.part}; "
            f"`rigtool recover {self.part}` makes a run file of them"
        )


def _is_hdf5_or_empty(path: Path) -> bool:
    """Return whether a file may be what a writer left: HDF5, or killed before it wrote anything."""
    with path.open("rb") as stream:
        return stream.read(8) in (b"\x89HDF\r\n\x1a\n", bytes(8), b"")


def _describe_input(run: Run) -> provenance.Input:
    return provenance.Input(
        path=str(run.path),
        command=run.command,
        sha256=provenance.file_sha256(run.path),
        content_sha256=run.content_sha256,
    )
