"""Checking every hash of a run and of all runs that it was made from."""

from __future__ import annotations

import hashlib
import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rigtool.errors import RigtoolError
from rigtool.inputs import PathName
from rigtool.runfile import provenance
from rigtool.runfile.reader import Run, open_run
from rigtool.runfile.recording import BLOCK_SAMPLES, Recording


@dataclass(frozen=True)
class ChainLink:
    """One file of a chain: its distance from the first file, and its problem if it has one."""

    path: Path
    depth: int
    command: str
    problem: str | None = None
    remark: str | None = None


def verify(path: PathName) -> list[ChainLink]:
    """Check a run file and, through its inputs, everything that it was made from.

    A file is whole if its hashes fit its content and the samples of each signal fit theirs. A link
    holds if the input is still there (where it was, or beside the file) with the bytes it had; an
    input that was made anew with the same content holds too, with a remark.
    """
    links: list[ChainLink] = []
    followed: set[Path] = set()
    waiting = [_Expected(Path(path))]  # explicit: a chain may be deeper than Python's stack
    while waiting:
        item = waiting.pop()
        link, origin = _check(item)
        links.append(link)
        # Most runs share a calibration, whose inputs are listed once. This also ends the loop of a
        # file that names itself.
        if origin is None or (name := link.path.resolve()) in followed:
            continue
        followed.add(name)
        beside, depth = link.path.parent, item.depth + 1
        if origin["source"] is not None:
            links.append(_source(Path(origin["source"]), beside, depth, origin["source_sha256"]))
        waiting += [
            _Expected(Path(noted["path"]), depth, noted, beside)
            for noted in reversed(origin["inputs"])
        ]
    return links


@dataclass(frozen=True)
class _Expected:
    """A file to check: what the run that was made from it noted, and the folder of that run."""

    path: Path
    depth: int = 0
    noted: dict[str, Any] | None = None
    beside: Path | None = None


def _check(item: _Expected) -> tuple[ChainLink, dict[str, Any] | None]:
    """Return a link, and the provenance of the run, None where it is not readable."""
    command = "" if item.noted is None else item.noted["command"]
    found = _find(item.path, item.beside)
    if found is None:
        missing = "is not there, nor beside the file made from it"
        return ChainLink(item.path, item.depth, command, missing), None
    try:
        with open_run(found) as run:
            problem = _damage(run)
            remark = None
            if problem is None and item.noted is not None:
                problem, remark = _compare(found, run, item.noted)
            return ChainLink(found, item.depth, run.command, problem, remark), run.provenance
    except RigtoolError as error:
        problem = str(error).removeprefix(f"{found}: ")
        return ChainLink(found, item.depth, command, problem), None


def _find(path: Path, beside: Path | None) -> Path | None:
    """Return where a file is: at its path, or where the file made from it is."""
    places = [path] if beside is None else [path, beside / path.name]
    # Not Path.exists, which raises for names that the system does not admit.
    return next((place for place in places if os.path.exists(place)), None if beside else path)


def _source(path: Path, beside: Path, depth: int, sha256: str) -> ChainLink:
    """Return the link to a file that was imported. The imported run is whole without it."""
    found = _find(path, beside)
    if found is None:
        return ChainLink(path, depth, "source", remark="is not there any more")
    try:
        same = provenance.file_sha256(found) == sha256
    except RigtoolError as error:
        return ChainLink(found, depth, "source", str(error).removeprefix(f"{found}: "))
    problem = None if same else "is another file than the one that was imported"
    return ChainLink(found, depth, "source", problem)


def _damage(run: Run) -> str | None:
    for recording in run.recordings.values():
        for channel in recording.units:
            if _samples_sha256(recording, channel) != recording.sha256(channel):
                return f"samples of {recording.name}/{channel} do not fit their hash"
    return None


def _samples_sha256(recording: Recording, channel: str) -> str:
    digest = hashlib.sha256()
    for start in range(0, recording.size, BLOCK_SAMPLES):
        stop = min(start + BLOCK_SAMPLES, recording.size)
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
