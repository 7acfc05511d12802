"""Recovery of the signals of an interrupted run into a run file without results."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from rigtool.errors import RunFileError, UsageError
from rigtool.inputs import PathName
from rigtool.runfile import schema, tree
from rigtool.runfile.model import RecordingSpec
from rigtool.runfile.opened import OpenFile, guard, open_hdf5, require_file, require_schema
from rigtool.runfile.outputs import own_folder, require_output
from rigtool.runfile.reader import Run
from rigtool.runfile.recording import Recording
from rigtool.runfile.superblock import open_unclosed
from rigtool.runfile.writer import RunWriter


@dataclass(frozen=True)
class Recovered:
    """Samples brought back by recording, and the number of damaged ones."""

    output: Path
    samples: dict[str, int]
    lost: int


def recover(
    part: PathName,
    output: PathName | None = None,
    *,
    overwrite: bool = False,
) -> Recovered:
    """Copy the signals of an unfinished run into a run file; the part stays as it is.

    `output` is the name that the run would have had, unless given. A recording is copied up to its
    first damaged chunk. Raises `RunFileError` where nothing can be brought back and `UsageError`
    where `output` exists.
    """
    part = Path(part)
    require_file(part)
    if output is None and part.suffix != ".part":
        raise UsageError(f"{part}: its name does not end in .part, so give the output by -o")
    found = part.with_suffix("") if output is None else Path(output)
    output = require_output(found, overwrite=overwrite, inputs=[part])
    # The part may have the name that a writer of `output` would give to its own part.
    with _open_unfinished(part) as run, own_folder(output.parent) as folder:
        beside = folder / "recovered.h5"
        specs = [_spec(recording) for recording in run.recordings.values()]
        with RunWriter(beside, command=run.command, recordings=specs, origin=run) as writer:
            samples = {item.name: _copy(item, writer) for item in run.recordings.values()}
            if not any(samples.values()):
                raise RunFileError(f"{part}: holds no sample that is whole: nothing to recover")
            total = sum(samples.values())
            lost = sum(item.size for item in run.recordings.values()) - total
            writer.finish({}, {}, [f"recovered {total} samples of a run that was interrupted"])
        os.replace(beside, output)
    return Recovered(output, samples, lost)


def _open_unfinished(path: Path) -> Run:
    try:
        file = open_hdf5(path)
    except RunFileError:
        file = open_unclosed(path)
    try:
        with guard(path, "the file"):
            require_schema(file, path)
            run = Run(OpenFile(file), tree.read_tree(file), path)
    except RunFileError as error:
        file.close()
        raise RunFileError(
            f"{error}: nothing to recover, or the run was killed before its first sample"
        ) from error
    except BaseException:
        file.close()
        raise
    if "record_sha256" in run.provenance:
        run.close()
        raise RunFileError(f"{path}: is a finished run: there is nothing to recover, use it")
    return run


def _spec(recording: Recording) -> RecordingSpec:
    conditions = {name: (item.value, item.unit) for name, item in recording.conditions.items()}
    return RecordingSpec(recording.name, recording.channels, conditions)


def _copy(recording: Recording, writer: RunWriter) -> int:
    """Copy a recording up to its first damaged chunk of any size; return the samples copied."""
    start, step = 0, schema.CHUNK
    while start < recording.size:
        block = _whole(recording, start, min(start + step, recording.size))
        if block is not None:
            writer.append(recording.name, block)
            start += step
        elif step > schema.SMALLEST_CHUNK:
            step //= 2
        else:
            return start
    return recording.size


def _whole(recording: Recording, start: int, stop: int) -> dict[str, NDArray[np.generic]] | None:
    """Return these samples of all channels; None where one of them is damaged."""
    try:
        block = {
            item.name: recording.read_stored(item.name, start, stop) for item in recording.channels
        }
    except RunFileError:
        return None
    # A chunk that never reached the disk reads as NaN.
    return block if np.isfinite(block[schema.TIME]).all() else None
