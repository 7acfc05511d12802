"""What the thesis states, from `published.toml`: the only way to a published value."""

from __future__ import annotations

import tomllib
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
        """Return the row for this load, None where the thesis has none within a per cent."""
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


@cache
def published_table(attachment: str) -> PublishedTable:
    """Return Table 8 for the attachment "instrument", Table 9 for "pulley"."""
    data = dict(_published()["tables"][attachment])
    head = {name: data.pop(name) for name in ("number", "section", "title")}
    return PublishedTable(**head, columns={name: tuple(map(float, c)) for name, c in data.items()})


def published_value(command: str, result: str, attachment: str | None) -> PublishedValue | None:
    """Return what the thesis states for a result of a command, None where it is silent.

    `attachment` is what the run was made with; values that belong to another one are left out.
    """
    found = _published()["results"].get(command, {}).get(result)
    if found is None or found.get("attachment", attachment) != attachment:
        return None
    return PublishedValue(float(found["value"]), found["section"])


def published_entry(path: str) -> Any:
    """Return what stands at a dotted path of `published.toml`: a value with section, or a list.

    Raises `KeyError` where the thesis is silent.
    """
    entry: Any = _published()
    for name in path.split("."):
        entry = entry[name]
    return entry


@cache
def _published() -> dict[str, Any]:
    return tomllib.loads(files("rigtool.report").joinpath("published.toml").read_text("utf-8"))
