"""EPOS4 and EPOS2 on a serial line: limits, set points and samples, object by object."""

from __future__ import annotations

import math
from typing import ClassVar

from rigtool.errors import HardwareError
from rigtool.recipe.serial import Limits
from rigtool.rigs.serial.cia402 import objects as od
from rigtool.rigs.serial.cia402.objects import Entry, find
from rigtool.rigs.serial.cia402.states import StateDrive, identity
from rigtool.rigs.serial.drive import RPM, Abilities, Mode, Sample, SetPoint
from rigtool.rigs.serial.maxon import objects as epos
from rigtool.rigs.serial.maxon.drive import NO_WATCHDOG, MaxonDrive
from rigtool.rigs.serial.maxon.frames import LockStepFrames
from rigtool.rigs.serial.maxon.objects import EposObjects

NOMINAL_TOLERANCE = 0.02
"""Part by which rated torque over torque constant may differ from the nominal current."""

FRAME_TIMEOUT = 0.05
"""Time after which an EPOS2 is to give up a frame that does not go on, s."""


class EposDrive(StateDrive, MaxonDrive[Entry]):
    """The common part of EPOS4 and EPOS2."""

    family: str
    modes: ClassVar[dict[Mode, int]]
    current_entry: Entry
    demand_entry: Entry
    encoder_entry: Entry
    targets: tuple[Entry, ...]

    def __init__(self, objects: EposObjects, encoder_counts: int) -> None:
        super().__init__(objects, encoder_counts)
        self._frames = objects.frames
        self._device_type = 0
        self._reports_demand = True

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
        found = identity(self._objects, f"maxon {self.family}")
        self._require_no_fault(self._objects.read(od.STATUS))
        self._require_encoder(4 * (find(self._objects, self.encoder_entry) or 0))
        self._reports_demand = find(self._objects, self.demand_entry) is not None
        return found

    def configure(self, limits: Limits, watchdog: float) -> list[str]:
        """Set limits of current, speed and position, none of them wider than they are."""
        return [NO_WATCHDOG, *self._set_limits(limits)]

    def _switch_on(self, mode: Mode) -> None:
        self._mode = mode
        self._switch_on_states(self.modes[mode], tuple((entry, 0) for entry in self.targets))

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


class Epos4Facts(StateDrive):
    """What an EPOS4 has beside CiA 402, on each of its connections."""

    _rated_current = 1.0

    def _limits(self, limits: Limits) -> list[tuple[Entry, int]]:
        return [
            (epos.CURRENT_LIMIT_4, int(limits.current * 1e3)),
            (od.MAX_MOTOR_SPEED, max(1, int(limits.speed / self._speed_unit))),
        ]

    def _read_rated_current(self) -> float:
        """Return the current of rated torque, A: torques are sent in thousandths of that."""
        rated = self._objects.read(od.RATED_TORQUE)
        constant = self._objects.read(epos.TORQUE_CONSTANT)
        nominal = self._objects.read(epos.NOMINAL_CURRENT) * 1e-3
        current = rated / constant if constant else 0.0
        if not current or abs(current - nominal) > NOMINAL_TOLERANCE * nominal:
            raise HardwareError(
                f"{self.line.port}: rated torque {rated} uN m (6076) and torque constant {constant}"
                f" uN m/A (3001:05) make {current:.4g} A, the nominal current (3001:01) is "
                f"{nominal:.4g} A: enter the motor's data in EPOS Studio"
            )
        return current

    def _read_torque_and_speed(self) -> str:
        """Read the current of rated torque and the unit of speed; return the step of speeds."""
        self._rated_current = self._read_rated_current()
        power, self._speed_unit = self._read_speed_unit() or (0, RPM)
        return f"speeds in steps of {10.0**power:g} rpm"


class Epos4Drive(Epos4Facts, EposDrive):
    """EPOS4: cyclic synchronous velocity (9) and torque (10), torque offset as feed-forward."""

    family = "EPOS4"
    modes: ClassVar[dict[Mode, int]] = {"velocity": 9, "current": 10}
    current_entry, demand_entry = epos.CURRENT_4, epos.CURRENT_DEMAND_4
    encoder_entry = epos.ENCODER_4
    targets = (od.TARGET_SPEED, od.TARGET_TORQUE, od.TORQUE_OFFSET)
    _feeds_forward = True
    _offset = 0

    def connect(self) -> str:
        """Identify the drive; read its torque constant and unit of speed."""
        return f"{super().connect()}, {self._read_torque_and_speed()}"

    def _switch_on(self, mode: Mode) -> None:
        super()._switch_on(mode)
        self._offset = 0

    def _set(self, setpoint: SetPoint) -> None:
        torque = round(1e3 * setpoint.current / self._rated_current)
        if self._mode == "current":
            self._objects.write(od.TARGET_TORQUE, torque)
            return
        if torque != self._offset:
            self._objects.write(od.TORQUE_OFFSET, torque)
            self._offset = torque
        self._objects.write(od.TARGET_SPEED, round(setpoint.speed / self._speed_unit))


class Epos2Drive(EposDrive):
    """EPOS2: velocity mode (-2) and current mode (-3), in whole rpm and mA."""

    family = "EPOS2"
    modes: ClassVar[dict[Mode, int]] = {"velocity": -2, "current": -3}
    current_entry, demand_entry = epos.CURRENT_2, epos.CURRENT_DEMAND_2
    encoder_entry = epos.ENCODER_2
    targets = (epos.SPEED_TARGET_2, epos.CURRENT_TARGET_2)

    def configure(self, limits: Limits, watchdog: float) -> list[str]:
        """Set limits; shorten the time after which the drive gives up half a frame."""
        frames = self._frames
        if (
            isinstance(frames, LockStepFrames)
            and find(self._objects, epos.FRAME_TIMEOUT_2) is not None
        ):
            self._tighten(epos.FRAME_TIMEOUT_2, round(FRAME_TIMEOUT * 1e3), min)
            frames.frame_timeout = FRAME_TIMEOUT
        return super().configure(limits, watchdog)

    def _limits(self, limits: Limits) -> list[tuple[Entry, int]]:
        speed = max(1, int(limits.speed / RPM))
        return [
            (epos.CURRENT_LIMIT_2, int(limits.current * 1e3)),
            (od.MAX_PROFILE_SPEED, speed),
            (epos.CURRENT_MODE_SPEED_2, speed),
        ]

    def _set(self, setpoint: SetPoint) -> None:
        if self._mode == "current":
            self._objects.write(epos.CURRENT_TARGET_2, round(setpoint.current * 1e3))
        else:
            self._objects.write(epos.SPEED_TARGET_2, round(setpoint.speed / RPM))
