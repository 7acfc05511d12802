"""Reading run files: everything is checked before it is used.

`open_run` verifies schema, structure and the file's own hashes; signals are read on demand, their
checksums (fletcher32) by HDF5. Any fault raises `RunFileError` with a remedy.
"""

from __future__ import annotations

import logging
import math
from collections.abc import Mapping
from functools import cached_property, lru_cache
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, Self

import numpy as np

from rigtool.errors import RigtoolError, RunFileError
from rigtool.inputs import PathName
from rigtool.quantity import Component, Quantity
from rigtool.runfile import provenance, schema, tree
from rigtool.runfile.model import Column, Table, description_of
from rigtool.runfile.opened import DAMAGED_REMEDY, OpenFile, SharedFile, guard, require_schema
from rigtool.runfile.recording import Recording
from rigtool.runfile.summary import html_of, recording_lines, result_lines, table_line

if TYPE_CHECKING:
    from rigtool.recipe import Recipe

_log = logging.getLogger("rigtool")


class Run:
    """An open run file; use as a context manager. Made by `open_run`."""

    def __init__(self, file: OpenFile | SharedFile, root: tree.Group, path: PathName) -> None:
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
        self._tables: Mapping[str, Table] | None = _tables(entry)
        self.recordings: Mapping[str, Recording] = MappingProxyType(recordings)
        self.results: Mapping[str, Quantity] = MappingProxyType(_results(entry))

    @property
    def tables(self) -> Mapping[str, Table]:
        """The tables by name; read again once they were forgotten."""
        if self._tables is None:
            with guard(self.path, "the file"), self._file.use() as file:
                self._tables = _tables(tree.read_tree(file, f"/{schema.ENTRY}"))
        return self._tables

    def forget_tables(self) -> None:
        """Free the memory of the tables until they are used: an hour of force over time has 70 MB
        of them, and an analysis of its signals uses none."""
        self._tables = None

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
                f"{self.path}: was written by {self.command}; a run of {' or '.join(commands)} "
                "is needed: give another file"
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

    def recordings_of(self, kind: str) -> list[Recording]:
        """Return the recordings `kind_000` and on; raises `RunFileError` where there are none."""
        return self.recordings_named(f"{kind}_") or [self.recording(f"{kind}_000")]

    def table(self, name: str, *axes: str, **units: str) -> Table:
        """Return a table. Where axes are named, it is over these; columns that are named hold
        numbers in this unit. Raises `RunFileError` for anything else.
        """
        found = self.tables.get(name)
        if found is None:
            raise RunFileError(
                f"{self.path}: has no table {name!r}, only {', '.join(self.tables) or 'none'}; "
                f"run {self.command} again with this version"
            )
        if axes and found.axes != axes:
            raise self._unusable(f"table {name} is over {found.axes}", f"over {axes}")
        for column, unit in units.items():
            if column not in found.axes and found[column].shape != found.shape:
                what = f"column {column} of table {name} has shape {found[column].shape}"
                raise self._unusable(what, found.shape)
            if not all(found.shape) or not np.all(np.abs(found[column]) <= schema.LARGEST_NUMBER):
                limit = f"numbers up to {schema.LARGEST_NUMBER:g} everywhere"
                raise self._unusable(f"column {column} of table {name} lacks numbers", limit)
            if (stored := found.columns[column].unit) != unit:
                raise self._unusable(f"column {column} of table {name} is in {stored!r}", unit)
        return found

    def result(self, name: str, unit: str | None = None) -> Quantity:
        """Return a result, to compute with it where its `unit` is given.

        Raises `RunFileError` where it is missing, in another unit, or no number.
        """
        found = self.results.get(name)
        if found is None:
            raise RunFileError(
                f"{self.path}: has no result {name!r}, only {', '.join(self.results) or 'none'}; "
                f"run {self.command} again with this version"
            )
        if unit is not None and found.unit != unit:
            raise self._unusable(f"result {name} is in {found.unit!r}", unit)
        if unit is not None and not max(abs(found.value), found.u or 0.0) <= schema.LARGEST_NUMBER:
            limit = f"numbers up to {schema.LARGEST_NUMBER:g}"
            raise self._unusable(f"result {name} is {found.value:g} with u {found.u}", limit)
        return found

    def _unusable(self, what: str, needed: object) -> RunFileError:
        return RunFileError(
            f"{self.path}: {what}; {needed} is needed: give a run that {self.command} wrote on a "
            "rotary axis, or make it anew"
        )

    def summary(self) -> list[str]:
        """Return the lines of `rigtool info`: origin, results, recordings, tables and notes."""
        origin = self.provenance
        seed = "" if origin["seed"] is None else f", virtual rig with seed {origin['seed']}"
        lines = [
            f"{self.path}: {self.command}" + (f" on {self.rig}" if self.rig else ""),
            f"made {origin['date']} by {origin['program']} {origin['version']}{seed}",
            *(
                f"from {item['path']} ({item['command']}, content {item['content_sha256'][:12]})"
                for item in origin["inputs"]
            ),
            *([f"imported from {origin['source']}"] if origin["source"] else []),
            f"content hash {self.content_sha256[:12]}",
        ]
        for title, part in (
            ("Results", result_lines(self.results)),
            ("Recordings", recording_lines(self.recordings.values())),
            ("Tables", [table_line(name, table) for name, table in self.tables.items()]),
            ("Notes", list(self.notes)),
        ):
            if part:
                lines += ["", title, *(f"  {line}" for line in part)]
        return lines

    def _repr_html_(self) -> str:
        return html_of(self.summary())

    def close(self) -> None:
        """Close the file; its recordings cannot be read any more."""
        self._file.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *error: object) -> None:
        self.close()


def open_run(path: PathName) -> Run:
    """Open a run file and check it; raises `RunFileError` with the fault and a remedy.

    Schema version, structure, and the hashes of everything but the samples of signals are checked
    here; samples are when they are read.
    """
    shared = SharedFile(path)
    try:
        with guard(path, "the file"), shared.use() as file:
            require_schema(file, path)
            root = tree.read_tree(file)
            run = Run(shared, root, path)
            _require_hashes(root, run.provenance, path)
            _log.info("read %s, run of %s", path, run.command)
            return run
    except BaseException:
        shared.close()
        raise


def _require_hashes(root: tree.Group, stored: Mapping[str, Any], path: PathName) -> None:
    if "record_sha256" not in stored:
        raise RunFileError(
            f"{path}: the run was never finished; `rigtool recover {path}` brings back what it "
            "recorded"
        )
    content = provenance.content_sha256(root)
    record = provenance.record_sha256(root, content)
    if (stored.get("content_sha256"), stored["record_sha256"]) != (content, record):
        raise RunFileError(
            f"{path}: does not match its own hash: it is damaged or was edited; {DAMAGED_REMEDY}"
        )


@lru_cache(maxsize=8)
def _recipe(resolved: str) -> Recipe:
    """Check a recipe once, however many runs were made from it; its models never change."""
    from rigtool.recipe import recipe_from_resolved

    return recipe_from_resolved(resolved)


def _members(entry: tree.Group, name: str) -> dict[str, tree.Group]:
    return entry.groups[name].groups if name in entry.groups else {}


def _results(entry: tree.Group) -> dict[str, Quantity]:
    if schema.RESULTS not in entry.groups:
        return {}
    results = entry.groups[schema.RESULTS]
    return {
        name: Quantity(
            results.number(name),
            tree.text_of(item.attributes, "units"),
            tree.number_of(item.attributes, "standard_uncertainty"),
            tree.number_of(item.attributes, "degrees_of_freedom"),
            tree.text_of(item.attributes, "reason") if "reason" in item.attributes else None,
            _budget(item.attributes),
        )
        for name, item in results.values.items()
    }


def _budget(attributes: Mapping[str, Any]) -> tuple[Component, ...]:
    if "budget_name" not in attributes:
        return ()
    columns = [
        tree.list_of(attributes, f"budget_{name}", str if name in schema.BUDGET_TEXTS else float)
        for name in schema.BUDGET
    ]
    return tuple(
        Component(name, value, unit, u, None if math.isinf(dof) else dof, sensitivity)
        for name, value, unit, u, dof, sensitivity in zip(*columns, strict=True)
    )


def _tables(entry: tree.Group) -> Mapping[str, Table]:
    tables = {name: _table(group) for name, group in _members(entry, schema.TABLES).items()}
    return MappingProxyType(tables)


def _table(group: tree.Group) -> Table:
    columns = {
        name: Column(
            item.value, tree.text_of(item.attributes, "units"), description_of(item.attributes)
        )
        for name, item in group.values.items()
    }
    attributes = group.attributes
    signal = tree.text_of(attributes, "signal")
    return Table(tuple(attributes["axes"]), columns, signal, description_of(attributes))
