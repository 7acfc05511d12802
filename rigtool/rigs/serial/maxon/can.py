"""maxon EPOS4 on a CAN bus: CiA 402, with the objects of its maker; docs/bench-canopen.md."""

from __future__ import annotations

from rigtool.recipe import Recipe
from rigtool.rigs.serial.cia402.drive import CanDrive
from rigtool.rigs.serial.cia402.driver import BIT_RATES, make_can_drive
from rigtool.rigs.serial.cia402.driver import probe as asked
from rigtool.rigs.serial.cia402.objects import find
from rigtool.rigs.serial.drive import Drive
from rigtool.rigs.serial.drivers import Driver
from rigtool.rigs.serial.line import Line
from rigtool.rigs.serial.maxon import objects as epos
from rigtool.rigs.serial.maxon.epos import Epos4Facts


class Epos4CanDrive(Epos4Facts, CanDrive):
    """Current and its set point are in mA, and torques refer to the drive's torque constant."""

    family, vendor = "maxon EPOS4", 0xFB
    current_entry, demand_entry = epos.CURRENT_4, epos.CURRENT_DEMAND_4
    _current_unit = 1e-3

    def _read_units(self) -> str:
        self._require_encoder(4 * (find(self._objects, epos.ENCODER_4) or 0))
        return self._read_torque_and_speed()


def probe(line: Line) -> str | None:
    """Return the identity of the EPOS4 at node 1, None for another device."""
    return asked(line, Epos4CanDrive)


def make_drive(line: Line, recipe: Recipe) -> Drive:
    """Return the drive that a recipe's [serial] names, not connected yet."""
    return make_can_drive(Epos4CanDrive, line, recipe)


DRIVER = Driver(probe, BIT_RATES, make_drive, can=True)
