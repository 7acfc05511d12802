"""Drivers by name: those of rigtool, and those that other packages add by entry points.

    [project.entry-points."rigtool.drivers"]
    acme = "rigtool_acme.driver:DRIVER"

A driver is imported when a recipe names it, or when `rigtool devices` probes the ports.
"""

from __future__ import annotations

import importlib
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from rigtool.errors import RecipeError, did_you_mean
from rigtool.plugins import load_entry_point, plugins

if TYPE_CHECKING:
    from importlib.metadata import EntryPoint

    from rigtool.recipe import Recipe
    from rigtool.rigs.operator import Operator
    from rigtool.rigs.serial.drive import Drive
    from rigtool.rigs.serial.line import Line
    from rigtool.rigs.serial.rig import SerialRig
    from rigtool.rigs.serial.table_store import TableStore

DRIVER_MODULES = {
    "odrive": "rigtool.rigs.serial.odrive.driver",
    "moteus": "rigtool.rigs.serial.moteus.driver",
    "simplefoc": "rigtool.rigs.serial.hobby.simplefoc",
    "vesc": "rigtool.rigs.serial.hobby.vesc",
    "target": "rigtool.rigs.serial.target.driver",
    "maxon": "rigtool.rigs.serial.maxon.driver",
    "maxon-can": "rigtool.rigs.serial.maxon.can",
    "odrive-can": "rigtool.rigs.serial.odrive.can",
    "moteus-can": "rigtool.rigs.serial.moteus.can",
    "cia402": "rigtool.rigs.serial.cia402.driver",
}
"""Modules of rigtool's own drivers, each with its `DRIVER`, in the order in which `rigtool devices`
asks: those that ask in lines of text first, because others leave an incomplete line in the buffers
of these; the slowest last."""

DRIVER_ENTRY_POINTS = "rigtool.drivers"
"""Group of the entry points with which other packages add drivers: each a `Driver`."""

REPLAY_DRIVER = "replay"
"""Name that stands for a file of --spy in place of a driver."""


@dataclass(frozen=True)
class Driver:
    """A kind of drive, as rigtool uses it; either `make_drive` or `make_rig`.

    `probe(line)` returns the identity of the device, None for another kind; it only
    asks. `baud_rates` in bit/s has the usual one first, then others that devices may be set to.
    `make_drive(line, recipe)` returns a drive that takes set points from the host, not connected
    yet; `make_rig(recipe, torque_constant, use, operator)` the rig of a device that runs whole
    motions by itself. `table_store(drive)` is there where the drive keeps a table. A
    drive without watchdog goes on where computer or cable fail; `switch_off(line, node)` is called
    by the process beside rigtool where rigtool alone fails. A drive with `can` is on a CAN bus. A
    drive that takes currents only needs the host to close the loop, as `host_closes` states.
    """

    probe: Callable[[Line], str | None]
    baud_rates: tuple[int, ...]
    make_drive: Callable[[Line, Recipe], Drive] | None = None
    make_rig: Callable[[Recipe, float, str, Operator], SerialRig] | None = None
    table_store: Callable[[Any], TableStore] | None = None
    has_watchdog: bool = True
    can: bool = False
    host_closes: bool = False
    switch_off: Callable[[Line, int], None] | None = None


def driver(name: str) -> Driver:
    """Import and return the driver that a recipe names; `RecipeError` for an unknown one."""
    if name in DRIVER_MODULES:
        return importlib.import_module(DRIVER_MODULES[name]).DRIVER
    added = _added()
    if name not in added:
        known = [*driver_names(), REPLAY_DRIVER]
        raise RecipeError(
            f"serial.driver {name!r} is unknown: use one of {', '.join(known)}, or install the "
            f"package that adds it; {did_you_mean(name, known)}".removesuffix("; ")
        )
    return load_entry_point(added[name], Driver)


def driver_names() -> list[str]:
    """Return the names of all drivers, those of other packages last."""
    return [*DRIVER_MODULES, *_added()]


def _added() -> dict[str, EntryPoint]:
    """Return the drivers of other packages by name; those of rigtool cannot be replaced."""
    return plugins(DRIVER_ENTRY_POINTS, frozenset({*DRIVER_MODULES, REPLAY_DRIVER}))
