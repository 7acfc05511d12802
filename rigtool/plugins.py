"""Additions of other packages, found by the entry points of their metadata.

    [project.entry-points."rigtool.commands"]
    heating = "rigtool_heating.command:command"

A group is looked up when it is needed, and an entry point is imported when it is used. An entry
point that cannot be used is reported in one line, with its name.
"""

from __future__ import annotations

import sys
from contextlib import redirect_stdout
from functools import cache
from typing import TYPE_CHECKING, TypeVar

from rigtool.errors import RigtoolError
from rigtool.escapes import terminal

if TYPE_CHECKING:
    from importlib.metadata import EntryPoint

Plugin = TypeVar("Plugin")


@cache
def plugins(group: str, taken: frozenset[str] = frozenset()) -> dict[str, EntryPoint]:
    """Return the entry points of a group by name, in alphabetical order.

    A name that is `taken`, by rigtool itself or by a package before, is left out with a warning.
    """
    from importlib.metadata import entry_points

    found: dict[str, EntryPoint] = {}
    for entry in sorted(entry_points(group=group), key=lambda entry: (entry.name, package(entry))):
        if entry.name in taken or entry.name in found:
            owner = package(found[entry.name]) if entry.name in found else "rigtool"
            warn(f"{describe(entry)} is left out: {owner} has one of that name")
        else:
            found[entry.name] = entry
    return found


def load_entry_point(entry: EntryPoint, kind: type[Plugin]) -> Plugin:
    """Import the object that an entry point names; `RigtoolError` where it is not of its kind."""
    try:
        with redirect_stdout(sys.stderr):  # stdout may be a document of JSON
            plugin = entry.load()
    except (Exception, SystemExit) as error:  # a package of anybody's may raise anything
        what = f"{type(error).__name__}: {' '.join(str(error).split())}"
        raise RigtoolError(
            f"{describe(entry)} cannot be imported: {what}: repair or remove that package"
        ) from error
    if not isinstance(plugin, kind):
        raise RigtoolError(
            f"{describe(entry)} is of type {type(plugin).__name__}, but must be {kind.__name__}: "
            "repair or remove that package"
        )
    return plugin


@cache
def load_all(
    group: str, kind: type[Plugin], taken: frozenset[str] = frozenset()
) -> dict[str, Plugin]:
    """Return the objects of a group by name; a broken one is left out with a warning."""
    found = {}
    for name, entry in plugins(group, taken).items():
        try:
            found[name] = load_entry_point(entry, kind)
        except RigtoolError as error:
            warn(str(error))
    return found


def describe(entry: EntryPoint) -> str:
    """Return an entry point's kind, name and package: "command heating of rigtool-heating"."""
    what = entry.group.removeprefix("rigtool.").removesuffix("s")
    return f"{what} {entry.name} of {package(entry)}"


def package(entry: EntryPoint) -> str:
    """Return the name of the package that an entry point comes from."""
    return entry.value if entry.dist is None else entry.dist.name


def summary(entry: EntryPoint) -> str:
    """Return the one-line description of an entry point's package, and its name."""
    said = "" if entry.dist is None else entry.dist.metadata.json.get("summary", "")
    return f"{said} [{package(entry)}]".strip()


def warn(message: str) -> None:
    """Write one line of warning to stderr."""
    import logging

    logging.getLogger("rigtool").warning("Warning: %s", terminal(message))
