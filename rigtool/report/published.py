"""Published values: those of the thesis, and those of other groups on the same data.

No other module reads `published.toml` and `published_instruments.toml`.
"""

from __future__ import annotations

import tomllib
from collections.abc import Collection
from dataclasses import dataclass
from functools import cache
from importlib.resources import files
from typing import Any


@dataclass(frozen=True)
class PublishedTable:
    """Table 8 or 9 of the thesis: columns by name, SI units, `error_percent` in percent."""

    number: int
    section: str
    title: str
    columns: dict[str, tuple[float, ...]]

    def row(self, applied_force: float, applied_torque: float) -> dict[str, float] | None:
        """Return the row for this load, None where the thesis has none within one per cent."""
        forces, torques = self.columns["applied_force"], self.columns["applied_torque"]
        for index, (force, torque) in enumerate(zip(forces, torques, strict=True)):
            if abs(applied_force - force) < 0.01 * force and (
                abs(applied_torque - torque) < 0.01 * torque
            ):
                return {name: values[index] for name, values in self.columns.items()}
        return None


@dataclass(frozen=True)
class PublishedValue:
    """One number of the thesis, SI, with the section that states it."""

    value: float
    section: str


def is_of_thesis(rig: str | None) -> bool:
    """Return whether a rig is the thesis's, by its name: only then published numbers are shown."""
    return bool(rig == published()["rig"])


@cache
def published_table(attachment: str) -> PublishedTable:
    """Return Table 8 for the attachment "instrument", Table 9 for "pulley"."""
    data = dict(published()["tables"][attachment])
    head = {name: data.pop(name) for name in ("number", "section", "title")}
    return PublishedTable(**head, columns={name: tuple(map(float, c)) for name, c in data.items()})


def published_value(command: str, result: str, attachment: str | None) -> PublishedValue | None:
    """Return the value that the thesis states for a result of a command, None where it has none.

    `attachment` is that of the run; values that belong to another attachment do not count.
    """
    found = published()["results"].get(command, {}).get(result)
    if found is None or found.get("attachment", attachment) != attachment:
        return None
    return PublishedValue(float(found["value"]), found["section"])


def published_accuracy(rig: str, folders: Collection[str]) -> list[dict[str, Any]]:
    """Return the errors that others reached with the data of a rig, whose name begins alike.

    A row of a single instrument counts only where the runs are in the `folders` named after it.
    """
    reference = _reference("published_instruments.toml")
    return [
        row
        for name, entry in reference.items()
        if rig.startswith(name)
        for row in entry["rows"]
        if row.get("folder") is None or row["folder"] in folders
    ]


def published() -> dict[str, Any]:
    """Return all that the thesis states, as in `published.toml`."""
    return _reference("published.toml")


@cache
def _reference(file: str) -> dict[str, Any]:
    return tomllib.loads(files("rigtool.report").joinpath(file).read_text("utf-8"))
