"""A drive of CiA 402 on a CAN bus: set points and samples by PDO, its heartbeat as watchdog.

A sample is one exchange: the host's heartbeat, a PDO with control word and set point, a SYNC, and
the PDOs with which the drive answers that. Where heartbeats stop, the drive disables its voltage
(1016, 6007).
"""

from __future__ import annotations

import contextlib
import math

from rigtool.errors import HardwareError, RecipeError
from rigtool.recipe.serial import Limits
from rigtool.rigs.serial.cia402 import objects as od
from rigtool.rigs.serial.cia402.network import (
    AT_ONCE,
    HOST_NODE,
    INVALID,
    ON_SYNC,
    RECEIVE,
    TRANSMIT,
    CanObjects,
    Pdo,
    spread,
)
from rigtool.rigs.serial.cia402.objects import Entry, find
from rigtool.rigs.serial.cia402.states import DISABLE, ENABLE, FAULT, StateDrive, identity
from rigtool.rigs.serial.drive import RPM, Abilities, Mode, Sample, SetPoint
from rigtool.rigs.serial.line import LineLost, LineTimeout, RequestRefused

DEVICE_PROFILE = 402
"""Lower half of 1000, the device type."""

MODES: dict[Mode, tuple[int, ...]] = {"velocity": (9, 3), "current": (10, 4), "position": (8,)}
"""Modes of CiA 402, the cyclic ones first; bit n-1 of 6502 states whether a drive has mode n."""

TARGETS: dict[Mode, Entry] = {
    "velocity": od.TARGET_SPEED,
    "current": od.TARGET_TORQUE,
    "position": od.TARGET_POSITION,
}

HEARD_NOTHING = 0x8130
"""Error code of a drive that misses the host's heartbeat: its watchdog."""

RESET_FAULT = 0x0080
DISABLE_VOLTAGE = 2
"""Value of 6007: what a drive does where the host falls silent."""

PDOS = 4


class CanDrive(StateDrive):
    """A drive with the objects of CiA 402 alone; makers' drives are subclasses.

    `speed_unit_rpm` counts where the drive has no object 60A9.
    """

    family = "CiA 402 drive"
    vendor: int | None = None
    current_entry, demand_entry = od.TORQUE_CURRENT, od.TORQUE_DEMAND
    _current_unit = 1.0

    _objects: CanObjects

    def __init__(
        self,
        objects: CanObjects,
        encoder_counts: int,
        *,
        emergency_stop: bool,
        speed_unit_rpm: float | None = None,
    ) -> None:
        super().__init__(objects, encoder_counts)
        self._emergency_stop, self._speed_unit_rpm = emergency_stop, speed_unit_rpm
        self._modes: dict[Mode, int] = {}
        self._rated_current = 1.0
        self._watches = self._feeds_forward = self._reports_demand = False
        self._silence = 0
        self._pdos: dict[int, Pdo] = {}
        self._wanted: dict[int, list[Entry]] = {}
        self._commands: dict[Mode, tuple[int, list[Entry]]] = {}

    # -- identity

    def connect(self) -> str:
        """Identify the drive, clear its watchdog's fault; nothing moves.

        Raises `HardwareError` for another fault or device, or where it has no mode or rated
        current; `RecipeError` where only the recipe can state what the drive does not.
        """
        kind = self._objects.read(od.DEVICE_TYPE)
        if kind & 0xFFFF != DEVICE_PROFILE:
            raise HardwareError(
                f"{self.line.port}: node {self._objects.node} is no drive of CiA 402: its device "
                f"type (1000) is {kind:#010x}"
            )
        found = identity(self._objects, f"{self.family}, node {self._objects.node}")
        self._clear_watchdog()
        self._require_no_fault(self._objects.read(od.STATUS))
        self._find_modes()
        self._reports_demand = find(self._objects, self.demand_entry) is not None
        self._watches = find(self._objects, od.CONSUMER_HEARTBEAT) is not None
        if not self._watches and not self._emergency_stop:
            raise RecipeError(
                f"{self.line.port}: this drive watches no heartbeat (1016): where computer or "
                "cable fail, the motor follows its last set point. Wire an emergency stop within "
                "reach, try it, and set serial.emergency_stop = true"
            )
        offset = find(self._objects, od.TORQUE_OFFSET) is not None
        self._feeds_forward = offset and self._modes.get("velocity", 9) in (8, 9)
        return f"{found}, {self._read_units()}"

    def _clear_watchdog(self) -> None:
        """Clear the fault that the end of an earlier session left: its heartbeat ended."""
        if not self._objects.read(od.STATUS) & FAULT:
            return
        if self._objects.read(od.ERROR_CODE) == HEARD_NOTHING:
            with contextlib.suppress(LineTimeout):
                self._objects.reset_communication()
            self._objects.write(od.CONTROL, DISABLE)
            self._objects.write(od.CONTROL, RESET_FAULT)
            self._objects.write(od.CONTROL, DISABLE)

    def _find_modes(self) -> None:
        supported = find(self._objects, od.SUPPORTED_MODES)
        self._modes = {}
        for mode, numbers in MODES.items():
            for number in numbers:
                if supported is None or supported >> (number - 1) & 1:
                    self._modes.setdefault(mode, number)
        if "velocity" in self._modes:  # a set point of position stands still between two messages
            self._modes.pop("position", None)
        if not self._modes:
            raise HardwareError(
                f"{self.line.port}: the drive has none of the modes 9, 3, 10, 4 and 8 (6502 is "
                f"{supported or 0:#x})"
            )

    def _read_units(self) -> str:
        """Read what a count, a speed and a torque of the drive are; return it in words."""
        counts, turns = find(self._objects, od.FEED), find(self._objects, od.FEED_TURNS)
        if not counts or not turns:
            counts = find(self._objects, od.INCREMENTS)
            turns = find(self._objects, od.INCREMENTS_TURNS)
        self._require_encoder(counts // turns if counts and turns else None)
        self._rated_current = self._objects.read(od.RATED_CURRENT) * 1e-3
        if not self._rated_current:
            raise HardwareError(
                f"{self.line.port}: the drive's rated current (6075) is 0: enter the motor's data"
            )
        self._current_unit = self._rated_current * 1e-3
        found = self._read_speed_unit()
        if found is None and self._speed_unit_rpm is None:
            raise RecipeError(
                f"{self.line.port}: the drive does not state its unit of speed (60A9): set "
                "serial.speed_unit_rpm to what its manual states for 60FF"
            )
        self._speed_unit = found[1] if found else (self._speed_unit_rpm or 1.0) * RPM
        return f"speeds in steps of {self._speed_unit / RPM:.4g} rpm"

    @property
    def abilities(self) -> Abilities:
        """Abilities of the drive; known after `connect`."""
        channels = {"current", "current_setpoint"} if self._reports_demand else {"current"}
        return Abilities(
            frozenset(self._modes), self._feeds_forward, frozenset(channels), self._watches
        )

    # -- settings

    def configure(self, limits: Limits, watchdog: float) -> list[str]:
        """Set limits, watchdog and PDOs; the watchdog counts from `enable` to `halt`."""
        self._objects.change_state("PRE-OPERATIONAL")
        self._silence = min(max(1, round(watchdog * 1e3)), 0xFFFF)
        gaps = self._set_limits(limits)
        if not self._watches:
            gaps.append("watches no heartbeat: a lost cable leaves it at its last set point")
        elif find(self._objects, od.WHEN_SILENT) is None:
            gaps.append("does not state its reaction where heartbeats stop (6007): try it")
        else:
            self._remember(od.WHEN_SILENT)
            self._change(od.WHEN_SILENT, DISABLE_VOLTAGE, "reaction to silence (6007)")
        if self._watches:
            self._remember(od.CONSUMER_HEARTBEAT)
        self._set_pdos()
        self._objects.change_state("OPERATIONAL")
        for mode, number in self._modes.items():
            if number in (3, 4):
                gaps.append(f"has no cyclic mode for {mode}: its profiles (6083, 6087) smooth it")
        return gaps

    def _set_pdos(self) -> None:
        """Map samples and set points; silence the other PDOs of the drive."""
        for number in range(PDOS):
            for first in (RECEIVE, TRANSMIT):
                with contextlib.suppress(RequestRefused):
                    pdo = self._objects.read_pdo(first + number)
                    self._pdos.setdefault(pdo.index, pdo)
        entries = [od.POSITION, self.current_entry, od.STATUS]
        entries += [self.demand_entry] if self._reports_demand else []
        self._wanted, self._commands = {}, {}
        for number, carried in enumerate(spread(self._objects, entries)):
            self._wanted[self._objects.map(TRANSMIT, number, ON_SYNC, carried)] = carried
        for index, pdo in self._pdos.items():
            if index >= TRANSMIT + len(self._wanted) and not pdo.identifier & INVALID:
                self._objects.write(
                    Entry(index, 1, "I", "identifier of a PDO"), pdo.identifier | INVALID
                )
        for number, mode in enumerate(self._modes):
            carried = [od.CONTROL, TARGETS[mode]]
            if mode != "current" and self._feeds_forward:
                carried.append(od.TORQUE_OFFSET)
            identifier = self._objects.map(RECEIVE, number, AT_ONCE, carried)
            self._commands[mode] = (identifier, carried)

    def _limits(self, limits: Limits) -> list[tuple[Entry, int]]:
        share = min(int(1e3 * limits.current / self._rated_current), 0xFFFF)
        return [
            (od.MAX_CURRENT, share),
            (od.MAX_TORQUE, share),
            (od.MAX_MOTOR_SPEED, max(1, int(limits.speed / RPM))),
        ]

    def restore(self) -> None:
        """Restore the settings that `configure` changed."""
        if self._pdos:
            self._objects.change_state("PRE-OPERATIONAL")
        for index, pdo in list(self._pdos.items()):
            self._objects.write_pdo(pdo)
            del self._pdos[index]
        super().restore()

    # -- motion

    def enable(self, mode: Mode) -> None:
        """Switch on in this mode, at rest where the shaft is, once the drive watches the host.

        Raises `HardwareError` where it does not.
        """
        self._mode = mode
        here = self._objects.read(od.POSITION) if mode == "position" else 0
        targets = [(TARGETS[mode], here)]
        if self._feeds_forward:
            targets.append((od.TORQUE_OFFSET, 0))
        if self._watches:
            self._objects.write(od.CONSUMER_HEARTBEAT, HOST_NODE << 16 | self._silence)
        self._objects.alive = True
        self._switch_on_states(self._modes[mode], tuple(targets))
        shown = find(self._objects, od.MODE_SHOWN)
        if shown not in (None, self._modes[mode]):
            raise HardwareError(
                f"{self.line.port}: the drive is in mode {shown}, not in {self._modes[mode]}"
            )

    def _switch_off(self) -> bool:
        off = super()._switch_off()
        if off and self._objects.alive:
            if self._watches:
                self._objects.write(od.CONSUMER_HEARTBEAT, 0)
            self._objects.alive = False
        return off

    def step(self, setpoint: SetPoint) -> Sample:
        """Send a set point and measure, in one exchange."""
        identifier, carried = self._commands[self._mode]
        torque = round(1e3 * setpoint.current / self._rated_current)
        values = {
            od.CONTROL: ENABLE,
            od.TARGET_SPEED: round(setpoint.speed / self._speed_unit),
            od.TARGET_POSITION: round(setpoint.position / self._count),
            od.TARGET_TORQUE: torque,
            od.TORQUE_OFFSET: torque,
        }
        request = self._objects.frame(identifier, {entry: values[entry] for entry in carried})
        sample, status = self._measure(request)
        self._require_on(status)
        return sample

    def read(self) -> Sample:
        """Measure; nothing moves."""
        return self._measure(b"")[0]

    def _measure(self, request: bytes) -> tuple[Sample, int]:
        try:
            values, asked, answered = self._objects.sample(request, self._wanted)
        except LineLost:
            self._require_no_fault(self._objects.read(od.STATUS, retries=0))  # PDOs end with one
            raise
        sample = Sample(
            (asked + answered) / 2,
            values[od.POSITION] * self._count,
            current=values[self.current_entry] * self._current_unit,
            current_setpoint=values.get(self.demand_entry, math.nan) * self._current_unit,
        )
        return sample, values[od.STATUS]

    def _require_no_fault(self, status: int) -> None:
        if status & FAULT and self._objects.read(od.ERROR_CODE) == HEARD_NOTHING:
            raise HardwareError(
                f"{self.line.port}: the drive stopped: its watchdog heard nothing for "
                f"{self._silence} ms; raise serial.watchdog, or find what delays the line"
            )
        super()._require_no_fault(status)
