"""The driver of CiA 402 drives on a CAN bus; docs/bench-canopen.md."""

from __future__ import annotations

from rigtool.recipe import Recipe
from rigtool.rigs.serial.cia402 import objects as od
from rigtool.rigs.serial.cia402.drive import DEVICE_PROFILE, CanDrive
from rigtool.rigs.serial.cia402.network import CanObjects
from rigtool.rigs.serial.cia402.objects import find
from rigtool.rigs.serial.cia402.states import identity
from rigtool.rigs.serial.drive import Drive
from rigtool.rigs.serial.drivers import Driver
from rigtool.rigs.serial.line import Line

BIT_RATES = (1_000_000,)
"""Bit rate where the port names none, bit/s."""

USUAL_NODE = 1
"""Address for `serial.node` = 0, the default of the recipe."""


def probe(line: Line, kind: type[CanDrive] = CanDrive) -> str | None:
    """Return the identity of the drive at node 1, None for another device or maker."""
    objects = CanObjects(line, USUAL_NODE)
    if objects.read(od.DEVICE_TYPE) & 0xFFFF != DEVICE_PROFILE:
        return None
    if kind.vendor is not None and find(objects, od.VENDOR) != kind.vendor:
        return None
    return identity(objects, f"{kind.family}, node {USUAL_NODE}")


def make_drive(line: Line, recipe: Recipe, kind: type[CanDrive] = CanDrive) -> Drive:
    """Return the drive of this kind that a recipe's [serial] names, not connected yet."""
    settings = recipe.line
    return kind(
        CanObjects(line, settings.node or USUAL_NODE, settings.eds),
        recipe.rig.encoder_counts,
        emergency_stop=settings.emergency_stop,
        speed_unit_rpm=settings.speed_unit_rpm,
    )


DRIVER = Driver(probe, BIT_RATES, make_drive, can=True)
