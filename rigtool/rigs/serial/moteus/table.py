"""The cogging table of a moteus drive: 1024 codes of int8, and their scale in A.

In position mode the drive adds scale*code of Q current, code i at i/1024 of a turn of its
commutation encoder, linear between (mjbots/moteus fw/bldc_servo_control.h).
"""

from __future__ import annotations

import math

import numpy as np

from rigtool.errors import HardwareError
from rigtool.interrupts import held
from rigtool.rigs.serial.moteus import frames
from rigtool.rigs.serial.moteus.drive import Moteus
from rigtool.rigs.serial.moteus.registers import MODE, POSITION, STOPPED, TIMED_OUT
from rigtool.rigs.serial.table_store import DriveTable, EncoderZero

SCALE = "motor.cogging_dq_scale"
CODE = "motor.cogging_dq_comp."

HOMED, ENCODER = 0x00C, 0x050
"""Source of position 0; position of the first encoder, two registers an encoder."""

ZERO_READINGS = 32
"""Readings of position and encoder at standstill."""

PRINTED_STEP = 1e-6
"""Step of the numbers that the drive prints: it has six decimals."""


class MoteusTable:
    """A `TableStore`."""

    size, largest_code = 1024, 127
    scale_step = PRINTED_STEP

    def __init__(self, drive: Moteus) -> None:
        self._drive, self.link = drive, drive.link

    def connect(self) -> str:
        """Identify the drive.

        Raises `HardwareError` for one that runs, or whose position is not referenced to the rotor.
        """
        identity = self._drive.connect()
        state = self.link.query(frames.read(MODE) + frames.read(HOMED), (MODE, HOMED))
        if state[MODE] not in (STOPPED, TIMED_OUT):
            raise HardwareError(
                f"{identity}: is switched on, mode {state[MODE]:g}: stop its other program; a "
                "table is stored at standstill"
            )
        if state[HOMED] == 0:
            raise HardwareError(
                f"{identity}: its position is not referenced to the rotor, so after each start "
                "the table would be elsewhere: use an absolute encoder or an index"
            )
        return identity

    def zero(self) -> EncoderZero:
        """Measure the relation between the table's encoder and the position.

        Raises `HardwareError` for a direction other than 1 or -1.
        """
        source = int(self.link.number("motor_position.commutation_source"))
        sign = int(self.link.number("motor_position.output.sign"))
        if sign not in (1, -1):
            raise HardwareError(f"motor_position.output.sign is {sign}: must be 1 or -1")
        encoder = ENCODER + 2 * source
        question = frames.read(POSITION) + frames.read(encoder)
        ratio = self._drive.motor.ratio
        offsets = np.empty(ZERO_READINGS)
        for i in range(ZERO_READINGS):
            found = self.link.query(question, (POSITION, encoder))
            offsets[i] = found[encoder] - sign * found[POSITION] / ratio
        around = np.exp(2j * np.pi * offsets)
        middle = float(np.angle(around.mean()))
        scatter = float(np.std(np.angle(around * np.exp(-1j * middle)), ddof=1))
        return EncoderZero(sign, middle % (2 * math.pi), scatter / math.sqrt(ZERO_READINGS))

    def read(self) -> DriveTable:
        """Return the table in the drive's memory."""
        codes = [round(self.link.number(f"{CODE}{i}")) for i in range(self.size)]
        return DriveTable(np.array(codes, dtype=np.int64), self.link.number(SCALE))

    def store(self, table: DriveTable, before: DriveTable) -> None:
        """Set, compare, write to flash, load from there, compare; on failure restore."""
        try:
            self._set(table, before)
            self._require(table)
            self._keep()
            self._require(table)
        except BaseException as error:
            with held():
                error.add_note(self._bring_back(before))
            raise

    def _set(self, table: DriveTable, before: DriveTable | None) -> None:
        """Set the differing codes, with the table switched off meanwhile."""
        self.link.set(SCALE, "0")
        for i, code in enumerate(table.codes.tolist()):
            if before is None or code != before.codes[i]:
                self.link.set(f"{CODE}{i}", str(code))
        self.link.set(SCALE, f"{table.scale:.9g}")

    def _keep(self) -> None:
        self.link.command("conf write")
        self.link.command("conf load")

    def _require(self, table: DriveTable) -> None:
        found = self.read()
        wrong = np.flatnonzero(found.codes != table.codes)
        if wrong.size:
            i = wrong[0]
            raise HardwareError(
                f"read back, {wrong.size} of {self.size} codes differ, the first {CODE}{i}: "
                f"{found.codes[i]} instead of {table.codes[i]}"
            )
        if abs(found.scale - table.scale) > PRINTED_STEP / 2:
            raise HardwareError(f"read back, {SCALE} is {found.scale:g} instead of {table.scale:g}")

    def _bring_back(self, before: DriveTable) -> str:
        """Store the old table again; return the outcome in words."""
        try:
            self.link.line.settle()
            self.link.flush()
            self._set(before, None)
            self._keep()
            self._require(before)
        except HardwareError as failure:
            return (
                f"the old table could not be restored: {failure}. Set {SCALE} to 0 "
                "(moteus_tool, tview) before the drive is used"
            )
        return "the old table is restored"
