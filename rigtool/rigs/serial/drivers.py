"""Which drivers there are, and what each module of one offers.

A driver's module has

    BAUD_RATE: int                                    the usual one
    BAUD_RATES: tuple[int, ...]                       where devices differ, all to try
    def probe(line: Line) -> str | None               who answers, None where nobody it knows does;
                                                      asks only, moves and changes nothing
    def make_drive(line: Line, recipe: Recipe) -> Drive    not connected yet

The target, which runs whole motions by itself, has `make_rig` instead of `make_drive`.
"""

from __future__ import annotations

import importlib
import importlib.util
from types import ModuleType

from rigtool.errors import HardwareError

MODULES = {
    "odrive": "rigtool.rigs.serial.odrive.driver",
    "moteus": "rigtool.rigs.serial.moteus.driver",
    "target": "rigtool.rigs.serial.target.driver",
    "maxon": "rigtool.rigs.serial.maxon.driver",
}
"""Modules by name, in the order in which they are asked who is there: those that ask in lines of
text first, because others leave them half a line; the one that takes longest last."""


def driver_module(name: str) -> ModuleType:
    """Import the module of a driver; `HardwareError` where there is none."""
    try:
        return importlib.import_module(MODULES[name])
    except ModuleNotFoundError as error:
        if error.name != MODULES[name]:
            raise
        raise HardwareError(f"this rigtool has no driver for {name} yet") from None


def available() -> list[str]:
    """Return the names of the drivers there are."""
    return [name for name, module in MODULES.items() if importlib.util.find_spec(module)]
