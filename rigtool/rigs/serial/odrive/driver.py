"""ODrive over its ASCII protocol, firmware 0.5 and 0.6: USB, or a UART of 460800 bit/s and more.

A set point, its echo and the measured values are one exchange.

During a motion the drive follows speeds (`v`), which the host corrects by the error of position
times the drive's own gain; at rest the drive holds the position itself (`p`). With positions as set
points, each would be a step of speed times period, and the error of the current measured there
would exceed friction: docs/bench-odrive.md has figures. The drive's filter (POS_FILTER) smooths
such steps, but discards the feed-forward of torque.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from operator import itemgetter

from rigtool.errors import HardwareError
from rigtool.recipe import Recipe
from rigtool.recipe.serial import Limits
from rigtool.rigs.serial.drive import TURN, Abilities, Mode, Sample, SetPoint, persist
from rigtool.rigs.serial.drivers import Driver
from rigtool.rigs.serial.hosted.loop import MAX_CORRECTION
from rigtool.rigs.serial.line import DamagedReply, Line
from rigtool.rigs.serial.odrive.settings import Settings, as_said
from rigtool.rigs.serial.odrive.text import (
    BUFFERED_FIRMWARE,
    DIALECT_05,
    Dialect,
    OdriveProtocol,
    agrees,
    describe_errors,
    identify,
    number,
)

IDLE, CLOSED_LOOP = 1, 8
CONTROL_MODES: dict[Mode, int] = {"current": 1, "velocity": 2, "position": 3}
COMMANDS = {1: ("c", "input_torque"), 2: ("v", "input_vel"), 3: ("p", "input_pos")}
"""The command of each control mode, and the property that it sets."""

WATCHDOG = "config.enable_watchdog"
CONTROL_MODE = "controller.config.control_mode"
PASSTHROUGH = 1
OTHER_MOTORS = {2: "a gimbal motor, whose current is not measured", 3: "an induction motor (ACIM)"}
"""Types of motor other than 0."""

HALT_ATTEMPTS = 2
"""Attempts to stop and to restore, each with the retries of the line."""

STATE_ATTEMPTS = 3
"""Requests for a state: one may be lost without an error."""

POLLS_PER_ATTEMPT = 20
"""Readings of the state, `POLL_INTERVAL` s apart, before it is requested again."""

POLL_INTERVAL = 0.005

TEMPERATURE_EVERY = 50
"""Samples for which one reading of the thermistor holds."""


class ODrive:
    """One axis of an ODrive; `period` is that of the set points, s."""

    def __init__(self, line: Line, axis: int, period: float) -> None:
        self._line, self._axis, self._period = line, axis, period
        self._protocol = OdriveProtocol(line)
        self._dialect: Dialect
        self._torque_constant = math.nan
        self._direction = 1.0
        self._thermistor: str | None = None
        self._temperature = math.nan
        self._samples = 0
        self._trip = 0.0
        self._gain = 0.0
        self._lets_go = math.inf
        self._last = Sample(0.0, 0.0)
        self._mode: Mode = "position"
        self._control_mode = 0
        self._settings = Settings(self._protocol, f"axis{axis}.")

    # -- identity

    def connect(self) -> str:
        """Identify the drive and read its settings; nothing changes.

        Raises `HardwareError` for an axis it does not have, a motor whose current it does not
        measure, or an error that its owner has to look at.
        """
        identity = identify(self._line)
        self._dialect = identity.dialect
        self._protocol.at_once = BUFFERED_FIRMWARE <= identity.firmware < (0, 6, 0)
        self._require_no_fault()
        if kind := self._number(self._dialect.motor_type):
            raise HardwareError(
                f"axis {self._axis} drives "
                f"{OTHER_MOTORS.get(int(kind), f'a motor of type {kind:g}')}: "
                "torque does not follow from its current by a constant"
            )
        self._torque_constant = self._number(self._dialect.torque_constant)
        if not self._torque_constant > 0:
            raise HardwareError(
                f"{self._name(self._dialect.torque_constant)} is {self._torque_constant:g} N m/A: "
                "set it in the drive to that of the motor"
            )
        self._gain = min(self._number("controller.config.pos_gain"), MAX_CORRECTION / self._period)
        found = self._protocol.get_first(*map(self._name, self._dialect.direction))
        if found is None and self._dialect is DIALECT_05:
            raise HardwareError(
                f"axis {self._axis} does not report its direction: update its firmware"
            )
        self._direction = -1.0 if found and number(found[1]) < 0 else 1.0
        self._find_thermistor()
        return f"{identity}, axis {self._axis}"

    @property
    def abilities(self) -> Abilities:
        """All modes; temperature where a thermistor is set up."""
        temperature = {"temperature"} if self._thermistor else set()
        return Abilities(
            frozenset({"position", "velocity", "current"}),
            True,
            frozenset({"current", "current_setpoint"} | temperature),
            moves_along=True,
            lets_go=self._lets_go,
        )

    def _find_thermistor(self) -> None:
        self._thermistor = None
        for name in self._dialect.thermistor:
            found = self._protocol.get_first(self._name(f"{name}.config.enabled"))
            if found and number(found[1]) == 1:
                self._thermistor = name

    def _require_no_fault(self) -> None:
        if self._has_fault():
            raise HardwareError(
                f"axis {self._axis} reports {self._describe_errors()}: find the cause with the "
                "maker's tool and clear it"
            )

    def _has_fault(self) -> bool:
        """Return whether there is an error other than the watchdog's, which rigtool clears."""
        codes = self._errors()
        main = codes.pop(self._dialect.errors[0])
        return bool(main & ~self._dialect.watchdog_error or any(codes.values()))

    def _errors(self) -> dict[str, int]:
        return {name: int(self._number(name)) for name in self._dialect.errors}

    def _describe_errors(self) -> str:
        found = []
        for name, code in self._errors().items():
            if name == self._dialect.errors[0]:
                found += describe_errors(code, self._dialect.error_names)
                continue
            if code:
                found.append(f"{name} {code:#x}")
        return ", ".join(found) or "no error"

    # -- settings

    def configure(self, limits: Limits, watchdog: float) -> list[str]:
        """Set limits and watchdog; a limit that is lower already stays."""
        settings = self._settings
        settings.begin()
        settings.lower(self._dialect.current_limit, limits.current)
        settings.lower("controller.config.vel_limit", limits.speed / TURN)
        for name in ("enable_vel_limit", "enable_overspeed_error"):
            settings.set(f"controller.config.{name}", 1)
        tolerance = self._protocol.get_first(self._name("controller.config.vel_limit_tolerance"))
        if tolerance and number(tolerance[1]) >= 1:  # 0 switches the error off
            highest = self._number("controller.config.vel_limit")
            self._lets_go = highest * number(tolerance[1]) * TURN
        settings.set(WATCHDOG, 0)
        settings.set("config.watchdog_timeout", watchdog)
        settings.set("controller.config.input_mode", PASSTHROUGH)
        settings.set("controller.config.circular_setpoints", 0)
        settings.remember(CONTROL_MODE)
        if self._thermistor is not None:
            prefix = f"{self._thermistor}.config.temp_limit"
            if settings.lower(f"{prefix}_upper", limits.temperature_degc):
                # where the drive begins to reduce current
                settings.lower(f"{prefix}_lower", limits.temperature_degc - 5.0)
        return ["has no limit of position"]

    def restore(self) -> None:
        """Restore the settings that `configure` changed."""
        persist(lambda: self._settings.restore(f"u {self._axis}"), HALT_ATTEMPTS)

    # -- states

    def enable(self, mode: Mode) -> None:
        """Close the loop in this mode, at rest where the shaft is.

        The watchdog counts whenever it is on, so it is on from here to `halt` only. Raises
        `HardwareError` where the loop does not close.
        """
        if self._state() == CLOSED_LOOP:
            if mode == self._mode:
                self._protocol.ask(
                    [self._state_question], itemgetter(0), commands=[f"u {self._axis}"]
                )
                return
            self.halt()
        self._mode, self._control_mode = mode, CONTROL_MODES[mode]
        self._require_no_fault()
        self._settings.require()
        self._protocol.put(self._name(CONTROL_MODE), str(self._control_mode))
        self._rest(self.read().position)
        for _ in range(STATE_ATTEMPTS):
            self._start_watchdog()
            if self._reach(CLOSED_LOOP):
                return
            if self._has_fault():
                break
        raise HardwareError(
            f"axis {self._axis} does not close its loop: {self._describe_errors()}; are motor "
            "and encoder calibrated since it was switched on?"
        )

    def _start_watchdog(self) -> None:
        """Switch the watchdog on; clear its earlier fault."""
        clear = ["sc"] if any(self._errors().values()) else []
        yes = as_said(self._protocol.get(self._name(WATCHDOG)), 1)
        self._protocol.put(self._name(WATCHDOG), yes, commands=[*clear, f"u {self._axis}"])

    def halt(self) -> None:
        """Make the axis idle; then switch the watchdog off and reset all set points.

        Raises `HardwareError` where it does not become idle.
        """
        persist(self._stop, HALT_ATTEMPTS)

    def _stop(self) -> None:
        if not self._reach(IDLE):
            raise HardwareError(
                f"axis {self._axis} does not become idle ({self._describe_errors()}): switch it off"
            )
        now = self._protocol.get(self._name(WATCHDOG))
        self._protocol.put(self._name(WATCHDOG), as_said(now, 0))
        self._rest(None)

    def _rest(self, position: float | None) -> None:
        """Set all inputs to standstill at this position."""
        for name in ("input_vel", "input_torque"):
            self._protocol.put(self._name(f"controller.{name}"), "0")
        if position is not None:
            self._protocol.put(self._name("controller.input_pos"), f"{position / TURN:.7f}")

    def _reach(self, state: int) -> bool:
        """Request a state until it is reached; return whether it was. Feeds the watchdog."""
        feed = f"u {self._axis}"
        for _ in range(STATE_ATTEMPTS):
            if self._state() == state:
                return True
            wanted = f"w {self._name('requested_state')} {state}"
            self._protocol.ask([self._state_question], itemgetter(0), commands=[feed, wanted])
            for _ in range(POLLS_PER_ATTEMPT):
                if self._protocol.ask([self._state_question], _state, commands=[feed]) == state:
                    return True
                self._line.pause(POLL_INTERVAL)
        return False

    @property
    def _state_question(self) -> str:
        return f"r {self._name('current_state')}"

    def _state(self) -> int:
        return self._protocol.ask([self._state_question], _state)

    # -- set points and samples

    def step(self, setpoint: SetPoint) -> Sample:
        """Send a set point, see that it arrived, and measure.

        Raises `HardwareError` where the loop is no longer closed.
        """
        control_mode, value, rest = self._command(setpoint)
        letter, echo = COMMANDS[control_mode]
        commands = [f"{letter} {self._axis} {value:.7f} {rest}"]
        echoes = [(f"controller.{echo}", value)]
        if control_mode != self._control_mode:  # for firmware 0.6
            commands.insert(0, f"w {self._name(CONTROL_MODE)} {control_mode}")
            echoes.append((CONTROL_MODE, control_mode))
        sample = self._measure(commands, echoes)
        self._control_mode = control_mode
        return sample

    def read(self) -> Sample:
        """Measure; nothing moves."""
        return self._measure()

    def _command(self, setpoint: SetPoint) -> tuple[int, float, str]:
        """Return control mode, set point and the words after it, in the units of the drive."""
        torque = setpoint.current * self._torque_constant
        if self._mode == "current":
            return CONTROL_MODES["current"], torque, ""
        if self._mode == "velocity":
            return CONTROL_MODES["velocity"], setpoint.speed / TURN, f"{torque:.7f}"
        if setpoint.speed == 0.0:
            return CONTROL_MODES["position"], setpoint.position / TURN, f"0 {torque:.7f}"
        # The set point at the time of the last sample: the motion went on since.
        wanted = setpoint.position - setpoint.speed * (self._line.now() - self._last.time)
        speed = setpoint.speed + self._gain * (wanted - self._last.position)
        return CONTROL_MODES["velocity"], speed / TURN, f"{torque:.7f}"

    def _measure(
        self, commands: Sequence[str] = (), echoes: Sequence[tuple[str, float]] = ()
    ) -> Sample:
        """Send commands, and measure; `echoes` are properties that the commands set."""
        questions = [
            f"f {self._axis}",
            f"r {self._name(self._dialect.current)}",
            f"r {self._name(self._dialect.current_setpoint)}",
            *[f"r {self._name(name)}" for name, _ in echoes],
        ]
        if self._thermistor and self._samples % TEMPERATURE_EVERY == 0:
            questions.append(f"r {self._name(self._thermistor)}.temperature")
        questions.append(self._state_question)  # an integer among numbers: none was skipped
        self._samples += 1

        def understand(replies: list[str]) -> tuple[float, list[float], int]:
            now = self._line.now()
            for (name, value), text in zip(echoes, replies[3:], strict=False):
                if not agrees(text, value):
                    raise DamagedReply(f"{name} is {text} after {commands[-1]!r}")
            measured = [*replies[:3], *replies[3 + len(echoes) : -1]]
            numbers = [number(word) for reply in measured for word in reply.split()]
            return now, numbers, _state(replies[-1:])

        start, retries = self._line.now(), self._line.counts.retries
        end, numbers, state = self._protocol.ask(questions, understand, commands=commands)
        if self._line.counts.retries == retries:
            self._trip = end - start
        if commands and state != CLOSED_LOOP:
            raise HardwareError(
                f"axis {self._axis} is in state {state} instead of its closed loop "
                f"({self._describe_errors()}): watchdog, reset or a fault"
            )
        # position and current were measured between the first two answers
        part = 0.5 if self._protocol.at_once else 1 - 1 / len(questions)
        self._last = self._sample(end - self._trip * part, numbers)
        return self._last

    def _sample(self, moment: float, numbers: Sequence[float]) -> Sample:
        position, speed, current, current_setpoint, *temperature = numbers
        if not math.isfinite(position):
            raise HardwareError(f"axis {self._axis} does not know its position: is its encoder on?")
        self._temperature = temperature[0] if temperature else self._temperature
        return Sample(
            moment,
            position * TURN,
            speed * TURN,
            current * self._direction,
            current_setpoint * self._direction,
            self._temperature,
        )

    # -- names

    def _name(self, name: str) -> str:
        return f"axis{self._axis}.{name}"

    def _number(self, name: str) -> float:
        return self._protocol.ask([f"r {self._name(name)}"], lambda replies: number(replies[0]))


def _state(replies: list[str]) -> int:
    if not replies[0].isdigit():
        raise DamagedReply(f"{replies[0]!r} is no state: answers are out of step")
    return int(replies[0])


def probe(line: Line) -> str | None:
    """Return the identity of the ODrive that answers."""
    return str(identify(line, retries=0))


def make_drive(line: Line, recipe: Recipe) -> ODrive:
    """Return the drive that a recipe names, not connected yet."""
    return ODrive(line, recipe.line.node, recipe.rig.sample_time)


DRIVER = Driver(probe, (115200,), make_drive)
