"""EPOS4 and EPOS2: the states of CiA 402, limits, set points and samples, object by object."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import ClassVar

from rigtool.errors import HardwareError
from rigtool.recipe.serial import Limits
from rigtool.rigs.serial.drive import Abilities, Mode, Sample, SetPoint
from rigtool.rigs.serial.maxon import objects as od
from rigtool.rigs.serial.maxon.drive import (
    NO_WATCHDOG,
    RPM,
    STATE_PAUSE,
    STATE_READINGS,
    MaxonDrive,
)
from rigtool.rigs.serial.maxon.frames import LockStepFrames
from rigtool.rigs.serial.maxon.objects import Entry, Objects

DISABLE, SHUT_DOWN, SWITCH_ON = 0x0000, 0x0006, 0x000F
STATE_BITS = 0x6F
READY, ENABLED = 0x21, 0x27
OPERATING, FAULT = 0x04, 0x08

RPM_UNIT = 0xB44700
"""Turns a minute, in the lower 24 bit of the unit of speed; above them is a power of ten."""

NOMINAL_TOLERANCE = 0.02
"""Part by which rated torque over torque constant may differ from the nominal current."""

FRAME_TIMEOUT = 0.05
"""Time after which an EPOS2 is to give up a frame that does not go on, s."""


class EposDrive(MaxonDrive[Entry]):
    """The common part of EPOS4 and EPOS2."""

    family: str
    modes: ClassVar[dict[Mode, int]]
    current_entry: Entry
    demand_entry: Entry
    encoder_entry: Entry
    targets: tuple[Entry, ...]

    def __init__(self, objects: Objects, encoder_counts: int) -> None:
        super().__init__(objects.frames.line, encoder_counts)
        self._objects = objects
        self._mode: Mode = "velocity"
        self._device_type = 0
        self._reports_demand = True
        self._speed_unit = RPM

    @staticmethod
    def identity(objects: Objects, family: str) -> str:
        """Return family, product code and serial number in a line."""
        product, serial = objects.find(od.PRODUCT), objects.find(od.SERIAL)
        parts = [f"maxon {family}"]
        if product is not None:
            parts.append(f"product {product:#010x}")
        if serial is not None:
            parts.append(f"serial {serial:#x}")
        return ", ".join(parts)

    @property
    def abilities(self) -> Abilities:
        """Current and speed; feed-forward where the family has a torque offset."""
        channels = {"current", "current_setpoint"} if self._reports_demand else {"current"}
        return Abilities(
            modes=frozenset(self.modes),
            feedforward=self._feeds_forward,
            channels=frozenset(channels),
            watchdog=False,
        )

    _feeds_forward = False

    def connect(self) -> str:
        """Identify the drive and compare its encoder with the recipe's."""
        self._device_type = self._objects.read(od.DEVICE_TYPE)
        identity = self.identity(self._objects, self.family)
        self._require_no_fault(self._objects.read(od.STATUS))
        self._require_encoder(self._objects.find(self.encoder_entry))
        self._reports_demand = self._objects.find(self.demand_entry) is not None
        return identity

    def configure(self, limits: Limits, watchdog: float) -> list[str]:
        """Set limits of current, speed and position, none of them wider than they are."""
        self._remember(od.MODE)
        gaps = [NO_WATCHDOG]
        for entry, value in self._limits(limits):
            if not self._lower(entry, value):
                gaps.append(f"has no {entry.name}")
        for entry, bound, choose in (
            (od.LOWEST, limits.position[0], max),
            (od.HIGHEST, limits.position[1], min),
        ):
            counts = min(max(round(bound / self._count), -(2**31)), 2**31 - 1)
            self._tighten(entry, counts, choose)
        gaps.append("may not watch position when it follows speeds and currents")
        return gaps

    def _limits(self, limits: Limits) -> list[tuple[Entry, int]]:
        """Return the objects that limit current and speed, with the values they are to have."""
        raise NotImplementedError

    def _switch_on(self, mode: Mode) -> None:
        self._require_no_fault(self._objects.read(od.STATUS))
        self._objects.write(od.CONTROL, SHUT_DOWN)
        self._await(READY)
        self._objects.write(od.MODE, self.modes[mode])
        for entry in self.targets:
            self._objects.write(entry, 0)
        self._mode = mode
        self._objects.write(od.CONTROL, SWITCH_ON)
        self._await(ENABLED)

    # -- one sample

    def _measure(self) -> tuple[Sample, int]:
        current = self._objects.read(self.current_entry)
        asked = self.line.now()
        position = self._objects.read(od.POSITION)
        answered = self.line.now()
        demand = self._objects.read(self.demand_entry) * 1e-3 if self._reports_demand else math.nan
        sample = Sample(
            (asked + answered) / 2,
            position * self._count,
            current=current * 1e-3,
            current_setpoint=demand,
        )
        return sample, self._objects.read(od.STATUS)

    def _confirm(self) -> None:
        if self._objects.read(od.DEVICE_TYPE) != self._device_type:
            self.line.counts.damaged += 1
            self.line.counts.retries += 1
            self.line.settle()

    def _require_on(self, status: int) -> None:
        if status & STATE_BITS != ENABLED:
            self._require_no_fault(status)
            raise HardwareError(
                f"{self.line.port}: the drive is switched off (status {status:#06x}) though it was "
                "switched on: it was reset, lost its supply, or its enable input was opened"
            )

    # -- states and settings

    def _switch_off(self) -> bool:
        self._objects.write(od.CONTROL, DISABLE)
        return not self._objects.read(od.STATUS) & OPERATING

    def _await(self, state: int) -> None:
        status = 0
        for _ in range(STATE_READINGS):
            status = self._objects.read(od.STATUS)
            if status & STATE_BITS == state:
                return
            self._require_no_fault(status)
            self.line.pause(STATE_PAUSE)
        raise HardwareError(
            f"{self.line.port}: the drive stays in the state {status:#06x}: are its enable input "
            "and its safe torque off (STO) closed, and is its supply on?"
        )

    def _require_no_fault(self, status: int) -> None:
        if status & FAULT:
            code = self._objects.read(od.ERROR_CODE)
            raise HardwareError(
                f"{self.line.port}: the drive reports the fault {code:#06x} (status {status:#06x}):"
                " look it up in its firmware specification, remove the cause, clear it in EPOS "
                "Studio"
            )

    def _read_setting(self, place: Entry) -> int:
        return self._objects.read(place)

    def _write_setting(self, place: Entry, value: int) -> None:
        self._objects.write(place, value)

    def _lower(self, entry: Entry, value: int) -> bool:
        """Lower a limit; return whether the drive has it."""
        if self._objects.find(entry) is None:
            return False
        self._tighten(entry, value, min)
        return True

    def _tighten(self, entry: Entry, value: int, choose: Callable[[int, int], int]) -> None:
        """Set an object to the tighter of a value and its original value."""
        self._remember(entry)
        name = f"{entry.name} ({entry.index:04X}:{entry.sub:02X})"
        self._change(entry, choose(self._before[entry], value), name)


class Epos4Drive(EposDrive):
    """EPOS4: cyclic synchronous velocity (9) and torque (10), torque offset as feed-forward."""

    family = "EPOS4"
    modes: ClassVar[dict[Mode, int]] = {"velocity": 9, "current": 10}
    current_entry, demand_entry = od.CURRENT_4, od.CURRENT_DEMAND_4
    encoder_entry = od.ENCODER_4
    targets = (od.TARGET_SPEED_4, od.TARGET_TORQUE, od.TORQUE_OFFSET)
    _feeds_forward = True

    def __init__(self, objects: Objects, encoder_counts: int) -> None:
        super().__init__(objects, encoder_counts)
        self._rated_current = 1.0
        self._offset = 0

    def connect(self) -> str:
        """Identify the drive; read its torque constant and unit of speed."""
        identity = super().connect()
        self._rated_current = self._read_rated_current()
        power = self._read_power_of_ten()
        self._speed_unit = RPM * 10.0**power
        return f"{identity}, speeds in steps of {10.0**power:g} rpm"

    def _switch_on(self, mode: Mode) -> None:
        super()._switch_on(mode)
        self._offset = 0

    def _limits(self, limits: Limits) -> list[tuple[Entry, int]]:
        return [
            (od.CURRENT_LIMIT_4, int(limits.current * 1e3)),
            (od.MAX_MOTOR_SPEED, max(1, int(limits.speed / self._speed_unit))),
        ]

    def _set(self, setpoint: SetPoint) -> None:
        torque = round(1e3 * setpoint.current / self._rated_current)
        if self._mode == "current":
            self._objects.write(od.TARGET_TORQUE, torque)
            return
        if torque != self._offset:
            self._objects.write(od.TORQUE_OFFSET, torque)
            self._offset = torque
        self._objects.write(od.TARGET_SPEED_4, round(setpoint.speed / self._speed_unit))

    def _read_rated_current(self) -> float:
        """Return the current of rated torque, A: torques are sent in thousandths of that."""
        rated = self._objects.read(od.RATED_TORQUE)
        constant = self._objects.read(od.TORQUE_CONSTANT)
        nominal = self._objects.read(od.NOMINAL_CURRENT) * 1e-3
        current = rated / constant if constant else 0.0
        if not current or abs(current - nominal) > NOMINAL_TOLERANCE * nominal:
            raise HardwareError(
                f"{self.line.port}: rated torque {rated} uN m (6076) and torque constant {constant}"
                f" uN m/A (3001:05) make {current:.4g} A, the nominal current (3001:01) is "
                f"{nominal:.4g} A: enter the motor's data in EPOS Studio"
            )
        return current

    def _read_power_of_ten(self) -> int:
        unit = self._objects.find(od.SPEED_UNIT)
        if unit is None:
            return 0
        if unit & 0xFFFFFF != RPM_UNIT:
            raise HardwareError(
                f"{self.line.port}: the drive's unit of speed (60A9) is {unit:#010x}: set it to rpm"
                " or mrpm in EPOS Studio"
            )
        power = unit >> 24
        return power - 256 if power > 127 else power


class Epos2Drive(EposDrive):
    """EPOS2: velocity mode (-2) and current mode (-3), in whole rpm and mA."""

    family = "EPOS2"
    modes: ClassVar[dict[Mode, int]] = {"velocity": -2, "current": -3}
    current_entry, demand_entry = od.CURRENT_2, od.CURRENT_DEMAND_2
    encoder_entry = od.ENCODER_2
    targets = (od.SPEED_TARGET_2, od.CURRENT_TARGET_2)

    def configure(self, limits: Limits, watchdog: float) -> list[str]:
        """Set limits; shorten the time after which the drive gives up half a frame."""
        frames = self._objects.frames
        if (
            isinstance(frames, LockStepFrames)
            and self._objects.find(od.FRAME_TIMEOUT_2) is not None
        ):
            self._tighten(od.FRAME_TIMEOUT_2, round(FRAME_TIMEOUT * 1e3), min)
            frames.frame_timeout = FRAME_TIMEOUT
        return super().configure(limits, watchdog)

    def _limits(self, limits: Limits) -> list[tuple[Entry, int]]:
        speed = max(1, int(limits.speed / RPM))
        return [
            (od.CURRENT_LIMIT_2, int(limits.current * 1e3)),
            (od.MAX_PROFILE_SPEED, speed),
            (od.CURRENT_MODE_SPEED_2, speed),
        ]

    def _set(self, setpoint: SetPoint) -> None:
        if self._mode == "current":
            self._objects.write(od.CURRENT_TARGET_2, round(setpoint.current * 1e3))
        else:
            self._objects.write(od.SPEED_TARGET_2, round(setpoint.speed / RPM))
