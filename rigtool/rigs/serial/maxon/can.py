"""maxon EPOS4 on a CAN bus: CiA 402, with the objects of its maker; docs/bench-canopen.md."""

from __future__ import annotations

from functools import partial

from rigtool.rigs.serial.cia402.drive import CanDrive
from rigtool.rigs.serial.cia402.driver import BIT_RATES, make_drive, probe
from rigtool.rigs.serial.cia402.objects import find
from rigtool.rigs.serial.drivers import Driver
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


DRIVER = Driver(
    partial(probe, kind=Epos4CanDrive), BIT_RATES, partial(make_drive, kind=Epos4CanDrive), can=True
)
