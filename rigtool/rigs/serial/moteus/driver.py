"""The moteus driver: probes a line, makes the drive."""

from __future__ import annotations

import contextlib

from rigtool.errors import HardwareError
from rigtool.recipe import Recipe
from rigtool.rigs.serial.drivers import Driver
from rigtool.rigs.serial.line import Line
from rigtool.rigs.serial.moteus.drive import Moteus, read_identity
from rigtool.rigs.serial.moteus.link import Link
from rigtool.rigs.serial.moteus.table import MoteusTable

USUAL_NODE = 1
"""Address that a drive leaves the factory with; 0, the default of the recipe, means this one."""

PROBED_NODES = range(1, 5)


def probe(line: Line) -> str | None:
    """Return the identity of the moteus that answers, None for another device."""
    return first_answer(line, Link)


def first_answer(line: Line, kind: type[Link]) -> str | None:
    """Return the identity of the first drive that answers by such a link."""
    for node in PROBED_NODES:
        link = kind(line, node)
        with contextlib.suppress(HardwareError):
            return read_identity(link)
        if line.counts.bytes_received == 0:
            return None
    return None


def make_drive(line: Line, recipe: Recipe) -> Moteus:
    """Return the drive that a recipe's [serial] names, not connected yet."""
    return Moteus(Link(line, recipe.line.node or USUAL_NODE))


DRIVER = Driver(probe, (921600,), make_drive, table_store=MoteusTable)
