"""DES 70/10: commands by op code, parameters in its RAM. Source: programs of others only."""

from __future__ import annotations

import struct
from dataclasses import replace

from rigtool.errors import HardwareError
from rigtool.recipe.serial import Limits
from rigtool.rigs.serial.drive import RPM, Abilities, Mode, Sample, SetPoint, unwrapped
from rigtool.rigs.serial.maxon.drive import NO_WATCHDOG, MaxonDrive
from rigtool.rigs.serial.maxon.frames import LockStepFrames

ENABLE, READ, WRITE, SET_SPEED, SET_CURRENT = 0x05, 0x14, 0x15, 0x21, 0x22

CONFIGURATION, PEAK_CURRENT, CONTINUOUS_CURRENT, MAX_SPEED = 1, 14, 15, 17
ENCODER, MAX_SPEED_CURRENT_MODE = 20, 44
STATUS, CURRENT, CURRENT_SETPOINT, ROTOR, SPEED = 128, 130, 131, 132, 134

ANALOG_SETPOINT, CURRENT_REGULATOR = 1 << 0, 1 << 2
SPEED_BY_SOFTWARE, CURRENT_BY_SOFTWARE = 1 << 8, 1 << 10
STATUS_ERROR, STATUS_ENABLED = 1 << 9, 1 << 10

LARGEST_PARAMETER = 0x7FFF
"""Largest value of a parameter."""


def read_status(frames: LockStepFrames) -> int:
    """Return the status word of a DES."""
    answer = frames.command(READ, struct.pack("<HH", STATUS, 0), 2, 1)
    return int.from_bytes(answer, "little")


class DesDrive(MaxonDrive[int]):
    """Its rotor position counts within a turn: turns are counted here, with the measured speed."""

    abilities = Abilities(
        modes=frozenset({"velocity", "current"}),
        feedforward=False,
        channels=frozenset({"current", "current_setpoint"}),
        watchdog=False,
    )

    def __init__(self, frames: LockStepFrames, encoder_counts: int) -> None:
        super().__init__(frames.line, encoder_counts)
        self._frames = frames
        self._mode: Mode = "velocity"
        self._last: Sample | None = None

    def connect(self) -> str:
        """See that the drive reports no error and has the recipe's encoder."""
        self._last = None
        self._require_no_error(self._read(STATUS))
        self._require_encoder(4 * self._read(ENCODER))
        return "maxon DES 70/10"

    def configure(self, limits: Limits, watchdog: float) -> list[str]:
        """Set limits of current and speed in RAM, none wider than they are, and put them into
        effect."""
        self._require_obedience()
        current = min(int(limits.current * 1e3), LARGEST_PARAMETER)
        speed = min(max(1, int(limits.speed / RPM)), LARGEST_PARAMETER)
        for number, value in (
            (PEAK_CURRENT, current),
            (CONTINUOUS_CURRENT, current),
            (MAX_SPEED, speed),
            (MAX_SPEED_CURRENT_MODE, speed),
        ):
            self._remember(number)
            self._change(number, min(self._before[number], value), f"parameter {number}")
        self._remember(CONFIGURATION)
        self._change(CONFIGURATION, self._configuration("velocity"), "configuration")
        return [NO_WATCHDOG, "has no limit of position"]

    def _switch_on(self, mode: Mode) -> None:
        self._require_no_error(self._read(STATUS))
        self._command(ENABLE, 0)
        self._remember(CONFIGURATION)
        self._change(CONFIGURATION, self._configuration(mode), "configuration")
        self._mode = mode
        self._set(SetPoint())
        self._command(ENABLE, 1)
        self._set(SetPoint())
        self._require_on(self._read(STATUS))

    # -- one sample

    def _measure(self) -> tuple[Sample, int]:
        asked = self.line.now()
        counts = self._read(ROTOR)
        answered = self.line.now()
        speed = self._read(SPEED, signed=True) * RPM
        moment = (asked + answered) / 2
        position = self._unwrap(counts * self._count, speed, moment)
        current = self._read(CURRENT, signed=True) * 1e-3
        setpoint = self._read(CURRENT_SETPOINT, signed=True) * 1e-3
        return Sample(moment, position, speed, current, setpoint), self._read(STATUS)

    def _unwrap(self, angle: float, speed: float, moment: float) -> float:
        """Return the position nearest to the one that the speed since the last sample predicts."""
        if self._last is not None:
            angle, _ = unwrapped(angle, speed, moment, self._last)
        self._last = Sample(moment, angle, speed)
        return angle

    def _confirm(self) -> None:
        self._read(STATUS)

    def _set(self, setpoint: SetPoint) -> None:
        if self._mode == "current":
            self._command(SET_CURRENT, round(setpoint.current * 1e3))
        else:
            self._command(SET_SPEED, round(setpoint.speed / RPM))

    # -- states and parameters

    def _switch_off(self) -> bool:
        self._command(ENABLE, 0, retries=1)
        if self._last is not None:  # it comes to rest unseen
            self._last = replace(self._last, speed=0.0)
        return not self._read(STATUS, retries=1) & STATUS_ENABLED

    def _require_obedience(self) -> None:
        """See that software can switch the drive off, before anything else is changed."""
        self._command(ENABLE, 0)
        status = self._read(STATUS)
        if status & STATUS_ENABLED:
            raise HardwareError(
                f"{self.line.port}: the drive stays on (status {status:#06x}) though software "
                "switched it off: its enable input decides; configure it so that software does"
            )

    def _require_on(self, status: int) -> None:
        self._require_no_error(status)
        if not status & STATUS_ENABLED:
            raise HardwareError(
                f"{self.line.port}: the drive is switched off (status {status:#06x}) though it was "
                "switched on: it was reset, lost its supply, or its enable input decides, not "
                "software"
            )

    def _require_no_error(self, status: int) -> None:
        if status & STATUS_ERROR:
            raise HardwareError(
                f"{self.line.port}: the drive reports an error (status {status:#06x}): look it up "
                "with its blinking code, remove the cause, switch it off and on"
            )

    def _configuration(self, mode: Mode) -> int:
        """Return the word that makes the drive follow this line, within limits set by it."""
        word = self._before[CONFIGURATION] & ~(ANALOG_SETPOINT | CURRENT_REGULATOR)
        word |= SPEED_BY_SOFTWARE | CURRENT_BY_SOFTWARE
        return word | CURRENT_REGULATOR if mode == "current" else word

    def _read_setting(self, place: int) -> int:
        return self._read(place)

    def _write_setting(self, place: int, value: int) -> None:
        self._frames.command(WRITE, struct.pack("<HHH", place, 0, value), None)

    def _read(self, number: int, *, signed: bool = False, retries: int | None = None) -> int:
        """Return a parameter or a status variable of 16 bit."""
        answer = self._frames.command(READ, struct.pack("<HH", number, 0), 2, retries)
        return int.from_bytes(answer, "little", signed=signed)

    def _command(self, opcode: int, value: int, retries: int | None = None) -> None:
        try:
            data = struct.pack("<h", value)
        except struct.error:
            raise HardwareError(
                f"{self.line.port}: a set point of {value} mA or rpm is beyond the drive's 16 bit"
            ) from None
        self._frames.command(opcode, data, None, retries)
