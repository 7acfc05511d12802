"""Drives that are switched off and restored whatever happens, and those with states of CiA 402."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable
from typing import Generic, TypeVar

from rigtool.errors import HardwareError, RecipeError
from rigtool.recipe.serial import Limits
from rigtool.rigs.serial.cia402 import objects as od
from rigtool.rigs.serial.cia402.objects import Entry, Objects, find
from rigtool.rigs.serial.drive import RPM, TURN, Mode, persist
from rigtool.rigs.serial.line import Line, LineLost

Place = TypeVar("Place")

RESTORE_ATTEMPTS = 3

STATE_READINGS = 50
STATE_PAUSE = 0.01
"""How often, and how far apart [s], a state is asked for that a drive is to reach."""

DISABLE, SHUT_DOWN, SWITCH_ON, ENABLE = 0x0000, 0x0006, 0x0007, 0x000F
"""Control words."""

STATE_BITS = 0x6F
READY, SWITCHED_ON, ENABLED = 0x21, 0x23, 0x27
OPERATING, FAULT = 0x04, 0x08
"""States in a status word, and two of its bits."""

SPEED_UNITS = {0xB44700: RPM, 0xB40300: TURN, 0x100300: 1.0}
"""rad/s in a unit of 60A9, less its power of ten: turns a minute, turns a second, rad/s."""


class RestoredDrive(ABC, Generic[Place]):
    """A drive whose settings, each at a `Place`, are restored; positions come in quad counts."""

    def __init__(self, line: Line, encoder_counts: int) -> None:
        self.line = line
        self._encoder_counts = encoder_counts
        self._count = 2 * math.pi / encoder_counts
        self._before: dict[Place, int] = {}

    @abstractmethod
    def _switch_off(self) -> bool:
        """Switch the power stage off with few attempts; return whether it is off."""

    @abstractmethod
    def _read_setting(self, place: Place) -> int:
        """Return a setting."""

    @abstractmethod
    def _write_setting(self, place: Place, value: int) -> None:
        """Change a setting."""

    def halt(self) -> None:
        """Switch the power stage off, in any state; `HardwareError` where it is not known to be."""
        try:
            # Late answers belong to older questions.
            persist(self._require_off, before_again=self.line.settle)
        except HardwareError as problem:
            raise HardwareError(
                f"{self.line.port}: the drive was not switched off ({problem})"
            ) from None

    def _require_off(self) -> None:
        if not self._switch_off():
            raise HardwareError("it reports that it is still on")

    def restore(self) -> None:
        """Restore the changed settings, the last first; try refused ones again.

        Raises `HardwareError` where it is refused each time, `LineLost` where nothing answers.
        """
        problem: HardwareError | None = None
        for _ in range(RESTORE_ATTEMPTS):
            for place, value in reversed(list(self._before.items())):
                try:
                    self._write_setting(place, value)
                    del self._before[place]
                except LineLost:
                    raise
                except HardwareError as error:
                    problem = error
        if self._before and problem is not None:
            raise problem

    def _remember(self, place: Place) -> int:
        """Return the value that a setting had at first."""
        if place not in self._before:
            self._before[place] = self._read_setting(place)
        return self._before[place]

    def _change(self, place: Place, value: int, name: str) -> None:
        """Change a setting that is remembered, and see that it is changed."""
        self._write_setting(place, value)
        found = self._read_setting(place)
        if found != value:
            raise HardwareError(
                f"{self.line.port}: its {name} was set to {value}, and the drive has {found}:"
                " set it with its maker's program"
            )

    def _require_encoder(self, counts: int | None) -> None:
        """Compare the drive's counts a turn with the recipe's; None where not known."""
        if counts and counts != self._encoder_counts:
            raise RecipeError(
                f"rig.encoder_counts is {self._encoder_counts}, the drive on {self.line.port} is "
                f"set to {counts} counts a turn: correct the one that is wrong"
            )


class StateDrive(RestoredDrive[Entry]):
    """A drive with the objects and states of CiA 402."""

    def __init__(self, objects: Objects, encoder_counts: int) -> None:
        super().__init__(objects.line, encoder_counts)
        self._objects = objects
        self._mode: Mode = "velocity"
        self._speed_unit = RPM

    @abstractmethod
    def _limits(self, limits: Limits) -> list[tuple[Entry, int]]:
        """Return the objects that limit current and speed, with the values they are to have."""

    def _set_limits(self, limits: Limits) -> list[str]:
        """Set limits, none wider than it is; return those that the drive lacks, in words."""
        self._remember(od.MODE)
        gaps = []
        for entry, value in self._limits(limits):
            if find(self._objects, entry) is None:
                gaps.append(f"has no {entry.name}")
            else:
                self._tighten(entry, value, min)
        for entry, bound, choose in (
            (od.LOWEST, limits.position[0], max),
            (od.HIGHEST, limits.position[1], min),
        ):
            counts = min(max(round(bound / self._count), -(2**31)), 2**31 - 1)
            if find(self._objects, entry) is not None:
                self._tighten(entry, counts, choose)
        return [*gaps, "may not watch position when it follows speeds and currents"]

    def _tighten(self, entry: Entry, value: int, choose: Callable[[int, int], int]) -> None:
        """Set an object to the tighter of a value and its original value."""
        name = f"{entry.name} ({entry.index:04X}:{entry.sub:02X})"
        self._change(entry, choose(self._remember(entry), value), name)

    def _read_speed_unit(self) -> tuple[int, float] | None:
        """Return the unit of speed of a drive as power of ten and rad/s; None where it has none."""
        unit = find(self._objects, od.SPEED_UNIT)
        if unit is None:
            return None
        power = unit >> 24
        power -= 256 if power > 127 else 0
        if unit & 0xFFFFFF not in SPEED_UNITS:
            raise HardwareError(
                f"{self.line.port}: the drive's unit of speed (60A9) is {unit:#010x}: set it to rpm"
                " or mrpm with its maker's program"
            )
        return power, SPEED_UNITS[unit & 0xFFFFFF] * 10.0**power

    # -- states

    def _switch_on_states(self, mode: int, targets: tuple[tuple[Entry, int], ...]) -> None:
        """Go through the states until operation is enabled, in a mode, with these set points."""
        self._require_no_fault(self._objects.read(od.STATUS))
        self._reach(SHUT_DOWN, READY)
        self._objects.write(od.MODE, mode)
        for entry, value in targets:
            self._objects.write(entry, value)
        self._reach(SWITCH_ON, SWITCHED_ON)
        self._reach(ENABLE, ENABLED)

    def _switch_off(self) -> bool:
        self._objects.write(od.CONTROL, DISABLE)
        return not self._objects.read(od.STATUS) & OPERATING

    def _reach(self, control: int, state: int) -> None:
        """Write a control word, and wait for the state that follows."""
        self._objects.write(od.CONTROL, control)
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

    def _require_on(self, status: int) -> None:
        """Raise `HardwareError` for the status of a drive that is not switched on."""
        if status & STATE_BITS != ENABLED:
            self._require_no_fault(status)
            raise HardwareError(
                f"{self.line.port}: the drive is switched off (status {status:#06x}) though it was "
                "switched on: it was reset, lost its supply, or its enable input was opened"
            )

    def _require_no_fault(self, status: int) -> None:
        if status & FAULT:
            code = self._objects.read(od.ERROR_CODE)
            raise HardwareError(
                f"{self.line.port}: the drive reports the fault {code:#06x} (status {status:#06x}):"
                " look it up in its firmware specification, remove the cause, clear it with its "
                "maker's program"
            )

    def _read_setting(self, place: Entry) -> int:
        return self._objects.read(place)

    def _write_setting(self, place: Entry, value: int) -> None:
        self._objects.write(place, value)


def identity(objects: Objects, family: str) -> str:
    """Return family, product code and serial number in a line."""
    product, serial = find(objects, od.PRODUCT), find(objects, od.SERIAL)
    parts = [family]
    if product is not None:
        parts.append(f"product {product:#010x}")
    if serial is not None:
        parts.append(f"serial {serial:#x}")
    return ", ".join(parts)
