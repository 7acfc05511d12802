"""ODrive over CANSimple, firmware 0.5 and 0.6, on a CAN bus; docs/bench-odrive.md.

A sample is one exchange: the set point, and remote frames that ask for position and current. The
bus reads no settings: the torque constant set in the drive comes from the recipe and is compared
with the current that the drive makes of a torque; the drive's watchdog is seen to run out before
anything moves.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Mapping, Sequence

from rigtool.errors import HardwareError, RecipeError
from rigtool.recipe import Recipe
from rigtool.recipe.serial import Limits
from rigtool.rigs.serial.drive import TURN, Abilities, Mode, Sample, SetPoint
from rigtool.rigs.serial.drivers import Driver
from rigtool.rigs.serial.line import DamagedReply, Line, LineLost, LineTimeout
from rigtool.rigs.serial.odrive.driver import (
    CLOSED_LOOP,
    IDLE,
    PASSTHROUGH,
    STATE_ATTEMPTS,
    TEMPERATURE_EVERY,
)
from rigtool.rigs.serial.odrive.text import DIALECT_05, DIALECT_06, Dialect, describe_errors
from rigtool.rigs.serial.transport.can_frames import CanFrame, encode

BIT_RATES = (250_000,)
"""Of an ODrive as it is delivered, bit/s."""

VERSION, HEARTBEAT, ERROR, SET_STATE, ESTIMATES = 0x00, 0x01, 0x03, 0x07, 0x09
SET_MODES, SET_SPEED, SET_TORQUE, SET_LIMITS = 0x0B, 0x0D, 0x0E, 0x0F
CURRENTS, TEMPERATURES, CLEAR_ERRORS = 0x14, 0x15, 0x18
"""Commands: the lower five bits of an identifier; above them is the node."""

FORMATS = {
    VERSION: "<8B",
    HEARTBEAT: "<IBBBB",
    ERROR: "<II",
    ESTIMATES: "<ff",
    CURRENTS: "<ff",
    TEMPERATURES: "<ff",
}

CONTROL_MODES: dict[Mode, int] = {"current": 1, "velocity": 2}

HEARTBEAT_TIMEOUT = 1.0
"""Longest time between two heartbeats of a drive, s; 0.1 s as it is delivered."""

LISTENING_TIME = 0.3
"""Time for which a bus is listened to for heartbeats, s."""

HEARTBEATS_PER_ATTEMPT = 50
"""Heartbeats, at most, in which a state is to be reached before it is requested again."""

AGREES, LEAST = 0.02, 0.05
"""Part by which the set point of current may differ from what was asked, and from which current
on, A, it is compared."""


class CanODrive:
    """One axis of an ODrive at a node of the bus; `torque_constant` as it is set there.

    It is negative where the drive's direction is -1: current is reported as that of the motor.
    """

    def __init__(
        self, line: Line, node: int, torque_constant: float, watchdog: float, *, unwatched: bool
    ) -> None:
        self._line, self._node = line, node
        self._torque_constant = abs(torque_constant)
        self._direction = math.copysign(1.0, torque_constant)
        self._silence, self._unwatched = watchdog, unwatched
        self._new = self._has_thermistor = self._watches = False
        self._mode: Mode = "velocity"
        self._heartbeat: tuple[float, ...] = ()
        self._temperature = math.nan
        self._samples = 0
        self._asked = math.nan

    # -- frames

    def _frame(self, command: int, data: bytes = b"", *, remote: bool = False) -> bytes:
        return encode(CanFrame(self._node << 5 | command, data, remote=remote))

    def _take_in(self, timeout: float | None = None) -> tuple[int, tuple[float, ...]]:
        """Return command and values of the next frame of this node; keep its heartbeats."""
        while True:
            frame = self._line.read_frame(timeout)
            command = frame.identifier & 0x1F
            if frame.identifier >> 5 != self._node or frame.remote or command not in FORMATS:
                continue
            try:
                values = struct.unpack(FORMATS[command], frame.data)
            except struct.error:
                raise DamagedReply(f"{self._line.port}: {frame}: has another length") from None
            if command == HEARTBEAT:
                self._heartbeat = values
            return command, values

    def _ask(
        self, commands: Sequence[int], before: bytes = b"", retries: int | None = None
    ) -> Mapping[int, tuple[float, ...]]:
        """Send frames, then ask for these values; see `Line.exchange`."""

        def receive() -> dict[int, tuple[float, ...]]:
            found: dict[int, tuple[float, ...]] = {}
            while not found.keys() >= set(commands):
                command, values = self._take_in()
                found[command] = values
            return found

        remote = b"".join(self._frame(command, remote=True) for command in commands)
        return self._line.exchange(before + remote, receive, retries=retries)

    def _state(self) -> int:
        """Return the state in the next heartbeat; raises `LineTimeout` where none comes."""
        with self._line.within(HEARTBEAT_TIMEOUT):
            while self._take_in(HEARTBEAT_TIMEOUT)[0] != HEARTBEAT:
                pass
        return int(self._heartbeat[1])

    # -- identity

    def connect(self) -> str:
        """Identify the drive, and see that its watchdog runs out; nothing moves.

        Raises `HardwareError` where nothing answers, or for a fault that its owner must examine;
        `RecipeError` for a drive without watchdog, unless an emergency stop is there.
        """
        try:
            self._state()
        except LineTimeout:
            raise HardwareError(
                f"{self._line.port}: no heartbeat of node {self._node} in {HEARTBEAT_TIMEOUT:g} s: "
                "check node, bit rate, termination, and heartbeat_rate_ms (0.6: "
                "heartbeat_msg_rate_ms)"
            ) from None
        name = self._read_version()
        self._require_no_fault()
        self._watches = self._runs_out()
        if not (self._watches or self._unwatched):
            raise RecipeError(
                f"{self._line.port}: the watchdog of node {self._node} did not run out in "
                f"{self._silence:g} s of silence: where computer or cable fail, the motor follows "
                "its last set point. Set config.enable_watchdog and watchdog_timeout in the drive "
                "and save, or wire an emergency stop, try it, and set serial.emergency_stop = true"
            )
        return f"{name}, node {self._node}"

    def _read_version(self) -> str:
        try:
            found = self._ask([VERSION], retries=1)[VERSION]
        except LineLost:  # 0.5 has no such question
            self._new = False
            return "ODrive, firmware 0.5"
        self._new = True
        self._has_thermistor = math.isfinite(self._ask([TEMPERATURES])[TEMPERATURES][1])
        version = ".".join(f"{int(part)}" for part in found[4:7])
        return f"ODrive v{found[1]:.0f}.{found[2]:.0f}, firmware {version}"

    def _runs_out(self) -> bool:
        """Be silent for as long as the recipe's watchdog; return whether the drive noticed."""
        self._clear_watchdog()
        end = self._line.now() + self._silence + HEARTBEAT_TIMEOUT / 2
        while self._line.now() < end:
            self._state()
            if int(self._heartbeat[0]) & self._dialect.watchdog_error:
                return True
        return False

    @property
    def _dialect(self) -> Dialect:
        return DIALECT_06 if self._new else DIALECT_05

    def _clear_watchdog(self) -> None:
        if int(self._heartbeat[0]) & self._dialect.watchdog_error:
            self._line.write(self._frame(CLEAR_ERRORS, b"\0" if self._new else b""))

    def _faults(self) -> list[str]:
        """Return the errors of the last heartbeat, less the watchdog's."""
        code = int(self._heartbeat[0]) & ~self._dialect.watchdog_error
        found = describe_errors(code, self._dialect.error_names)
        parts = ("motor", "encoder", "controller")  # 0.5 leaves the axis' own error at 0 for these
        if not self._new:
            for part, flags in zip(parts, self._heartbeat[2:], strict=True):
                found += [f"{part} error"] if int(flags) & 1 else []
        return found

    def _require_no_fault(self) -> None:
        if found := self._faults():
            raise HardwareError(
                f"{self._line.port}: node {self._node} reports {', '.join(found)}: find the cause "
                "with the maker's tool and clear it"
            )

    @property
    def abilities(self) -> Abilities:
        """Speeds and currents, with feed-forward; temperature where 0.6 has a thermistor."""
        channels = {"current", "current_setpoint"}
        if self._has_thermistor:
            channels.add("temperature")
        modes: frozenset[Mode] = frozenset(CONTROL_MODES)
        return Abilities(modes, True, frozenset(channels), self._watches)

    # -- settings and states

    def configure(self, limits: Limits, watchdog: float) -> list[str]:
        """Set limits of speed and current; the bus reads none, so none is restored."""
        data = struct.pack("<ff", limits.speed / TURN, limits.current)
        self._line.write(self._frame(SET_LIMITS, data))
        return [
            "has no limit of position",
            "keeps the recipe's limits of speed and current until it is switched off: CAN does "
            "not read what they were",
        ]

    def restore(self) -> None:
        """Nothing: CANSimple reads no setting that it could restore."""

    def enable(self, mode: Mode) -> None:
        """Close the loop in this mode, at rest; raises `HardwareError` where it does not close."""
        self._mode, self._asked = mode, math.nan
        self._state()
        self._require_no_fault()
        self._clear_watchdog()
        modes = struct.pack("<II", CONTROL_MODES[mode], PASSTHROUGH)
        self._line.write(self._frame(SET_MODES, modes) + self._command(SetPoint()))
        self._reach(CLOSED_LOOP, self._command(SetPoint()))

    def halt(self) -> None:
        """Make the axis idle; raises `HardwareError` where it does not become idle."""
        self._reach(IDLE, b"")

    def _reach(self, state: int, feed: bytes) -> None:
        """Request a state until a heartbeat reports it; feeds the watchdog."""
        request = self._frame(SET_STATE, struct.pack("<I", state))
        for attempt in range(STATE_ATTEMPTS * HEARTBEATS_PER_ATTEMPT):
            if attempt % HEARTBEATS_PER_ATTEMPT == 0:
                self._line.write(request)
                self._line.settle(0.0)  # heartbeats that have come are older
            if feed:
                self._line.write(feed)
            if self._state() == state:
                return
            if state == CLOSED_LOOP and self._faults():
                break
        found = ", ".join(self._faults()) or "no error"
        raise HardwareError(
            f"{self._line.port}: node {self._node} is in state {self._heartbeat[1]:.0f}, not in "
            f"{state} ({found}); are motor and encoder calibrated since it was switched on?"
        )

    # -- set points and samples

    def _command(self, setpoint: SetPoint) -> bytes:
        torque = setpoint.current * self._torque_constant
        if self._mode == "current":
            return self._frame(SET_TORQUE, struct.pack("<f", torque))
        return self._frame(SET_SPEED, struct.pack("<ff", setpoint.speed / TURN, torque))

    def step(self, setpoint: SetPoint) -> Sample:
        """Send a set point and measure; raises `HardwareError` where the loop is open."""
        sample = self._measure(self._command(setpoint))
        if self._heartbeat[1] != CLOSED_LOOP:
            found = describe_errors(int(self._heartbeat[0]), self._dialect.error_names)
            raise HardwareError(
                f"{self._line.port}: node {self._node} is in state {self._heartbeat[1]:.0f} "
                f"instead of its closed loop ({', '.join(found) or 'no error'}): watchdog, reset "
                "or a fault"
            )
        if self._mode == "current":
            self._require_constant(setpoint.current, sample.current_setpoint)
        return sample

    def read(self) -> Sample:
        """Measure; nothing moves."""
        return self._measure(b"")

    def _require_constant(self, asked: float, made: float) -> None:
        """Compare the current that a drive makes of a torque, once it is asked for again."""
        before, self._asked = self._asked, asked
        if asked == before and abs(asked) > LEAST and abs(made - asked) > AGREES * abs(asked):
            stated = self._direction * self._torque_constant
            constant = stated * asked / made if made else math.nan
            raise HardwareError(
                f"{self._line.port}: {asked:.4g} A were asked for and the drive's set point is "
                f"{made:.4g} A: its limit of current is below, or its torque constant is not "
                f"serial.drive_torque_constant = {stated:g} N m/A but {constant:.4g}"
            )

    def _measure(self, command: bytes) -> Sample:
        wanted = [ESTIMATES, CURRENTS]
        if self._has_thermistor and self._samples % TEMPERATURE_EVERY == 0:
            wanted.append(TEMPERATURES)
        self._samples += 1
        asked = self._line.now()
        found = self._ask(wanted, command)
        position, speed = found[ESTIMATES]
        if TEMPERATURES in found:
            self._temperature = found[TEMPERATURES][1]
        if not math.isfinite(position):
            raise HardwareError(
                f"{self._line.port}: node {self._node} does not know its position: is its encoder "
                "on?"
            )
        setpoint, current = (self._direction * value for value in found[CURRENTS])
        return Sample(
            (asked + self._line.now()) / 2,
            position * TURN,
            speed * TURN,
            current,
            setpoint,
            self._temperature,
        )


def probe(line: Line) -> str | None:
    """Return the node of an ODrive whose heartbeat is heard; nothing is sent."""
    end = line.now() + LISTENING_TIME
    while line.now() < end:
        frame = line.read_frame(LISTENING_TIME)
        if frame.identifier & 0x1F == HEARTBEAT and len(frame.data) == 8 and not frame.extended:
            return f"ODrive, node {frame.identifier >> 5}"
    return None


def make_drive(line: Line, recipe: Recipe) -> CanODrive:
    """Return the drive that a recipe's [serial] names; `RecipeError` without its constant."""
    settings = recipe.line
    if not settings.drive_torque_constant:
        raise RecipeError(
            "serial.drive_torque_constant is missing: an ODrive on a CAN bus takes torques and "
            "does not report motor.config.torque_constant (0.6: config.motor.torque_constant): "
            "state what is set there, negative where its direction is -1"
        )
    return CanODrive(
        line,
        settings.node,
        settings.drive_torque_constant,
        settings.watchdog,
        unwatched=settings.emergency_stop,
    )


DRIVER = Driver(probe, BIT_RATES, make_drive, can=True)
