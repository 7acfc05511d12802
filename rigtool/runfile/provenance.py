"""The provenance of a run, and the hashes that prove it.

`content_sha256` covers names, attributes and arrays of a run, not its provenance: two runs of one
recipe and seed share it. `record_sha256` covers the provenance and `content_sha256`. Signals enter
by the SHA-256 of their samples, an attribute of each, so that both are checked without reading
them.
"""

from __future__ import annotations

import hashlib
import json
import os
import platform
import shlex
import sys
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from datetime import UTC, datetime
from functools import cache
from typing import Any

import h5py

from rigtool.errors import RigtoolError, RunFileError
from rigtool.inputs import PathName, open_input
from rigtool.runfile import schema, tree
from rigtool.runfile.objects import make_group, make_text

RECORDED_PACKAGES = ("numpy", "scipy", "pandas", "h5py", "numba", "pydantic")

_ENCODER = json.JSONEncoder(sort_keys=True)

_HASHES = ("content_sha256", "record_sha256")
_ALWAYS = ("program", "version", "date", "argv", "python", "platform", "packages")
_PROVENANCE = f"/{schema.ENTRY}/{schema.PROVENANCE}"


@dataclass(frozen=True)
class Input:
    """A run file from which another one was made."""

    path: str
    command: str
    sha256: str
    content_sha256: str


@dataclass(frozen=True)
class Source:
    """A file of another program that was imported, and the text of its mapping."""

    path: str
    sha256: str
    mapping: str | None


@dataclass(frozen=True)
class Provenance:
    """Program, date, command line, inputs and recipe of a run; in `packages`, one a line.

    `line` is JSON: the events on the serial line of a rig, written after the signals.
    """

    program: str
    version: str
    date: str
    argv: str
    python: str
    platform: str
    packages: str
    recipe: str | None
    recipe_resolved: str | None
    seed: str | None
    inputs: tuple[Input, ...]
    source: str | None = None
    source_sha256: str | None = None
    mapping: str | None = None
    line: str | None = None


def collect(
    *,
    recipe_text: str | None,
    recipe_resolved: str | None,
    seed: int | None,
    inputs: Sequence[Input],
    argv: Sequence[str] | None = None,
    source: Source | None = None,
) -> Provenance:
    """Describe the running program and what it works on; the date honours SOURCE_DATE_EPOCH."""
    return Provenance(
        program="rigtool",
        version=_version("rigtool"),
        date=_now(),
        # The folder of the program is irrelevant to the run.
        argv=shlex.join(_printable(item) for item in argv or ["rigtool", *sys.argv[1:]]),
        python=platform.python_version(),
        platform=platform.platform(),
        packages="\n".join(f"{name} {_version(name)}" for name in RECORDED_PACKAGES),
        recipe=recipe_text,
        recipe_resolved=recipe_resolved,
        seed=None if seed is None else str(seed),
        inputs=tuple(inputs),
        source=None if source is None else _printable(source.path),
        source_sha256=None if source is None else source.sha256,
        mapping=None if source is None else source.mapping,
    )


@cache
def _version(package: str) -> str:
    """Return the version that is installed: it stays the same while a program runs."""
    from importlib.metadata import version

    return version(package)


def write(group: h5py.Group, provenance: Provenance) -> None:
    """Write provenance into its group, without fields that are None."""
    for name, value in asdict(provenance).items():
        if name != "inputs" and value is not None:
            make_text(group, name, value)
    if provenance.inputs:
        parent = make_group(group, schema.INPUTS, "NXcollection")
    for index, item in enumerate(provenance.inputs):
        source = make_group(parent, f"{index:04d}", "NXcollection")
        for name, value in asdict(item).items():
            make_text(source, name, value)


def read(group: tree.Group) -> dict[str, Any]:
    """Return all fields of provenance, hashes included; absent ones are None. Raises ValueError
    where a mandatory field is missing or not a text.
    """
    fields = (*Provenance.__dataclass_fields__, *_HASHES)
    found: dict[str, Any] = {
        name: group.text(name) for name in fields if name in group.values or name in _ALWAYS
    }
    found = dict.fromkeys(Provenance.__dataclass_fields__) | found
    found["argv"] = shlex.split(found["argv"])
    found["packages"] = dict(line.split(" ") for line in found["packages"].splitlines())
    inputs = group.groups[schema.INPUTS].groups if schema.INPUTS in group.groups else {}
    found["inputs"] = [
        {name: item.text(name) for name in Input.__dataclass_fields__} for item in inputs.values()
    ]
    return found


def restore(fields: Mapping[str, Any]) -> Provenance:
    """Return the provenance whose fields `read` returned."""
    known = {name: fields[name] for name in Provenance.__dataclass_fields__}
    known["argv"] = shlex.join(fields["argv"])
    known["packages"] = "\n".join(" ".join(item) for item in fields["packages"].items())
    known["inputs"] = tuple(Input(**item) for item in fields["inputs"])
    return Provenance(**known)


def note_line(file: h5py.File, report: str | None) -> None:
    """Write the report of the serial line into a run that is complete except for its hashes."""
    if report is not None:
        make_text(file[schema.ENTRY][schema.PROVENANCE], "line", report)


def seal(file: h5py.File) -> None:
    """Write both hashes into a run that is complete."""
    root = tree.read_tree(file)
    content = content_sha256(root)
    record = record_sha256(root, content)
    group = file[schema.ENTRY][schema.PROVENANCE]
    for name, value in zip(_HASHES, (content, record), strict=True):
        make_text(group, name, value)


def content_sha256(root: tree.Group) -> str:
    """Hash everything except the provenance; see the docstring of this module."""
    return hashlib.sha256(_describe(root, {_PROVENANCE})).hexdigest()


def record_sha256(root: tree.Group, content: str) -> str:
    """Hash the provenance, its two hashes left out, together with the hash of the content."""
    group = root.group(schema.ENTRY).group(schema.PROVENANCE)
    hashes = {f"{_PROVENANCE}/{name}" for name in _HASHES}
    return hashlib.sha256(content.encode() + _describe(group, hashes)).hexdigest()


def file_sha256(path: PathName) -> str:
    """Hash a file byte by byte; raises `RunFileError` where it cannot be read, or is a device."""
    with open_input(path, RunFileError) as stream:
        return hashlib.file_digest(stream, "sha256").hexdigest()


def _describe(group: tree.Group, left_out: set[str]) -> bytes:
    """Return a group and all below as text: a line of JSON for each object, sorted by name.

    A line has path and attributes; a dataset's also type, shape and the SHA-256 of its values.
    """
    lines = [_line(group.path, group.attributes)]
    members: dict[str, tree.Group | tree.Values] = {**group.groups, **group.values}
    for _, item in sorted(members.items()):
        if item.path in left_out:
            continue
        if isinstance(item, tree.Group):
            lines.append(_describe(item, left_out))
        else:
            digest = item.attributes.get("sha256") if item.value is None else _sha256(item)
            lines.append(_line(item.path, item.attributes, item.kind, item.shape, digest))
    return b"".join(lines)


def _line(*parts: Any) -> bytes:
    return _ENCODER.encode(parts).encode() + b"\n"


def _sha256(item: tree.Values) -> str:
    values = json.dumps(item.value).encode() if item.kind == "str" else item.value.tobytes()
    return hashlib.sha256(values).hexdigest()


def _printable(argument: str) -> str:
    # Names of files need not be UTF-8; text in the file has to be.
    return argument.encode("utf-8", "backslashreplace").decode()


def _now() -> str:
    epoch = os.environ.get("SOURCE_DATE_EPOCH")
    if epoch is None:
        return datetime.now(UTC).isoformat(timespec="seconds")
    try:
        return datetime.fromtimestamp(int(epoch), UTC).isoformat(timespec="seconds")
    except (ValueError, OverflowError, OSError):
        raise RigtoolError(
            f"SOURCE_DATE_EPOCH={epoch!r} is not a number of seconds since 1970: unset it"
        ) from None
