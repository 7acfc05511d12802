"""Checking every hash of a run and of all runs that it was made from."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rigtool.errors import RigtoolError
from rigtool.runfile import provenance, schema
from rigtool.runfile.reader import Run, open_run
from rigtool.runfile.recording import Recording

_BLOCK = 16 * schema.CHUNK


@dataclass(frozen=True)
class ChainLink:
    """One file of a chain: its distance from the first file, and its problem if it has one."""

    path: Path
    depth: int
    command: str
    problem: str | None = None
    remark: str | None = None


def verify(path: str | os.PathLike[str]) -> list[ChainLink]:
    """Check a run file and, through its inputs, everything that it was made from.

    A file is whole if its hashes fit its content and the samples of each signal fit theirs. A link
    holds if the input is still there (where it was, or beside the file) with the bytes it had; an
    input that was made anew with the same content holds too, with a remark.
    """
    return list(_follow(Path(path), 0, None, None, set()))


def _follow(
    path: Path,
    depth: int,
    expected: dict[str, Any] | None,
    beside: Path | None,
    followed: set[Path],
) -> Iterator[ChainLink]:
    command = "" if expected is None else expected["command"]
    found = _find(path, beside)
    if found is None:
        yield ChainLink(path, depth, command, "is not there, nor beside the file made from it")
        return
    try:
        with open_run(found) as run:
            problem = _damage(run)
            remark = None
            if problem is None and expected is not None:
                problem, remark = _compare(found, run, expected)
            yield ChainLink(found, depth, run.command, problem, remark)
            inputs, origin = run.provenance["inputs"], run.provenance
    except RigtoolError as error:
        yield ChainLink(found, depth, command, str(error).removeprefix(f"{found}: "))
        return
    # Most runs share a calibration, whose inputs are listed once. This also ends the loop of a
    # file that names itself.
    if found.resolve() in followed:
        return
    followed.add(found.resolve())
    if origin["source"] is not None:
        yield _source(Path(origin["source"]), found.parent, depth + 1, origin["source_sha256"])
    for item in inputs:
        yield from _follow(Path(item["path"]), depth + 1, item, found.parent, followed)


def _find(path: Path, beside: Path | None) -> Path | None:
    """Return where a file is: at its path, or where the file made from it is."""
    places = [path] if beside is None else [path, beside / path.name]
    return next((place for place in places if place.exists()), path if beside is None else None)


def _source(path: Path, beside: Path, depth: int, sha256: str) -> ChainLink:
    """Return the link to a file that was imported. The imported run is whole without it."""
    found = _find(path, beside)
    if found is None:
        return ChainLink(path, depth, "source", remark="is not there any more")
    if provenance.file_sha256(found) != sha256:
        return ChainLink(found, depth, "source", "is another file than the one that was imported")
    return ChainLink(found, depth, "source")


def _damage(run: Run) -> str | None:
    for recording in run.recordings.values():
        for channel in recording.units:
            if _samples_sha256(recording, channel) != recording.sha256(channel):
                return f"samples of {recording.name}/{channel} do not fit their hash"
    return None


def _samples_sha256(recording: Recording, channel: str) -> str:
    digest = hashlib.sha256()
    for start in range(0, recording.size, _BLOCK):
        stop = min(start + _BLOCK, recording.size)
        digest.update(recording.read_stored(channel, start, stop).tobytes())
    return digest.hexdigest()


def _compare(path: Path, run: Run, expected: dict[str, Any]) -> tuple[str | None, str | None]:
    """Return problem and remark of an input, against what the run made from it noted."""
    if provenance.file_sha256(path) == expected["sha256"]:
        return None, None
    if run.content_sha256 == expected["content_sha256"]:
        return None, "made anew since, with the same content"
    return (
        f"is another run than the one that was used (content {run.content_sha256[:12]}, "
        f"was {expected['content_sha256'][:12]})",
        None,
    )
