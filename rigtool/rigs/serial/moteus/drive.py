"""moteus drives of mjbots, at an fdcanusb or at their own UART.

Everything that turns the motor is sent in position mode: it alone has a watchdog. A current is
feed-forward torque with the gains of the position loop scaled to zero, which the drive turns back
into that current. Position and speed are sent together: between commands the drive moves its set
point along at that speed.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

from rigtool.errors import HardwareError
from rigtool.recipe.serial import Limits
from rigtool.rigs.serial.drive import TURN, Abilities, Mode, Sample, SetPoint, persist
from rigtool.rigs.serial.moteus import frames
from rigtool.rigs.serial.moteus import registers as reg
from rigtool.rigs.serial.moteus.link import Link

STATE = (
    frames.read(reg.MODE, 5)
    + frames.read(reg.MOTOR_TEMPERATURE)
    + frames.read(reg.FAULT, 1, frames.INT8)
    + frames.read(reg.CONTROL_TORQUE)
)
EXPECTED_REGISTERS = (*range(5), reg.MOTOR_TEMPERATURE, reg.FAULT, reg.CONTROL_TORQUE)
STOP = frames.write(reg.MODE, [reg.STOPPED], frames.INT8)

TORQUE_FACTOR = 1.5 / math.sqrt(3) * 60 / TURN
"""Torque constant times Kv in the drive's own firmware, N m/A rpm/V."""
ASSUMED_CONSTANT = 0.1
"""Torque constant of the firmware where motor.Kv is 0, N m/A."""

FADING_SPEED = 2.0
"""Speeds beyond servo.max_velocity over which the firmware takes its current back, turns/s."""

LARGEST_BOUND = 32768.0
"""Revolutions beyond which the firmware takes no bound of position."""

TEXT_ROUNDING = 1e-6
"""Turns that a bound may differ by its text of six decimals."""

STARTING_TIME = 2.0
"""Longest time in which a drive has to be ready after it is switched on, s."""

ANSWER_SLACK = 0.005
"""Time of an answer beyond twice the shortest one, s: the host is busy, or it was repeated.

With less, each sample would be asked for twice on a busy computer, which adds to its load.
"""

FAULTS = {
    32: "calibration fault: encoder sees no magnet",
    33: "motor driver fault: often the supply gave way",
    34: "over voltage",
    35: "encoder fault",
    36: "motor not calibrated: run moteus_tool --calibrate",
    37: "PWM cycle overrun",
    38: "over temperature",
    39: "switched on outside servopos.position_min and position_max",
    40: "under voltage",
    41: "settings were changed while it ran",
    42: "no valid commutation encoder",
    43: "no valid position encoder",
    44: "gate driver could not be enabled",
    47: "servo.bemf_feedforward is set: set it to 0",
    48: "invalid bounds of position",
}


def read_identity(link: Link) -> str:
    """Return model, firmware and serial number of the drive in a line."""
    wanted = ((reg.IDENTITY, 2), (reg.SERIAL_NUMBER, 3))
    question = b"".join(frames.read(first, count, frames.INT32) for first, count in wanted)
    numbers = tuple(first + n for first, count in wanted for n in range(count))
    found = link.query(question, numbers)
    model, firmware, *serial = (int(found[number]) & 0xFFFFFFFF for number in numbers)
    version = ".".join(str(firmware >> shift & 0xFF) for shift in (16, 8, 0))
    number = "".join(f"{word:08x}" for word in reversed(serial))
    return f"moteus {link.node}, model 0x{model:x}, firmware {version}, serial {number}"


@dataclass(frozen=True)
class MotorSettings:
    """The drive's settings of its motor.

    `torque_constant` is that of the motor shaft in N m/A; `ratio` is output turns per turn of the
    motor: all registers are of the output; `table_scale` [A] is that of its cogging table.
    """

    torque_constant: float
    ratio: float
    has_thermometer: bool
    straight_up_to: float
    table_scale: float


class Moteus:
    """A `Drive`."""

    def __init__(self, link: Link) -> None:
        self.line, self.link = link.line, link
        self._motor: MotorSettings | None = None
        self._limits: Limits | None = None
        self._watchdog = math.nan
        self._before: dict[str, str] = {}
        self._mode: Mode = "position"
        self._fastest = self._lets_go = math.inf

    # -- who it is

    def connect(self) -> str:
        """Identify the drive; raises `HardwareError` for one that cannot be measured with."""
        self.link.find_seal(STATE)
        identity = read_identity(self.link)
        state = self.link.query(STATE, EXPECTED_REGISTERS)
        if state[reg.MODE] == reg.FAULTY:
            raise HardwareError(
                f"{identity}: reports a fault: {_fault(state)}; find its cause, then switch the "
                "drive off and on"
            )
        self.link.command("tel stop")
        self._motor = motor = self._read_motor()
        table = f"; its cogging table is on, scale {motor.table_scale:g} A"
        return f"{identity}, {self.link.wire}{table if motor.table_scale else ''}"

    def _read_motor(self) -> MotorSettings:
        number = self.link.number
        if number("motor.poles") == 0:
            raise HardwareError("the drive has no calibrated motor: run moteus_tool --calibrate")
        for name in ("servo.voltage_mode_control", "servo.fixed_voltage_mode"):
            if number(name) != 0:
                raise HardwareError(
                    f"{name} is on: the drive controls voltage, so torque does not follow from its "
                    "current; set it to 0"
                )
        ratio = number("motor_position.rotor_to_output_ratio")
        if not ratio > 0:
            raise HardwareError(
                f"motor_position.rotor_to_output_ratio is {ratio:g}: must be above 0"
            )
        kv = number("motor.Kv")
        return MotorSettings(
            torque_constant=TORQUE_FACTOR / kv if kv else ASSUMED_CONSTANT,
            ratio=ratio,
            has_thermometer=number("servo.enable_motor_temperature") != 0,
            straight_up_to=number("motor.rotation_current_cutoff_A"),
            table_scale=number("motor.cogging_dq_scale"),
        )

    @property
    def motor(self) -> MotorSettings:
        """The drive's settings of its motor, read by `connect`."""
        assert self._motor is not None, "connect first"
        return self._motor

    @property
    def abilities(self) -> Abilities:
        """Abilities of the drive."""
        channels = {"current", "current_setpoint"}
        if self.motor.has_thermometer:
            channels.add("temperature")
        modes: set[Mode] = {"position", "velocity", "current"}
        return Abilities(
            frozenset(modes), True, frozenset(channels), moves_along=True, lets_go=self._lets_go
        )

    # -- settings

    def configure(self, limits: Limits, watchdog: float) -> list[str]:
        """Set limits and watchdog; when that expires, the power stage switches off.

        Raises `HardwareError` for a limit up to which the drive's torque is not known.
        """
        if limits.current > self.motor.straight_up_to:
            raise HardwareError(
                f"serial.limits.current is {limits.current:g} A, and above motor."
                f"rotation_current_cutoff_A = {self.motor.straight_up_to:g} A the drive's torque "
                "is no multiple of current: lower the limit, or raise the cut-off"
            )
        self._limits, self._watchdog = limits, watchdog
        self._lower("servo.max_current_A", limits.current)
        highest = self._lower("servo.max_velocity", limits.speed / TURN * self.motor.ratio)
        self._lets_go = (highest + FADING_SPEED) * TURN / self.motor.ratio
        self._change("servo.default_timeout_s", f"{watchdog:g}")
        self._change("servo.timeout_mode", f"{reg.STOPPED}")
        # Limits of its own trajectories would make it lag behind the motions that it is sent.
        self._change("servo.default_velocity_limit", "nan")
        self._change("servo.default_accel_limit", "nan")
        gaps = self._set_bounds(limits)
        if self.motor.has_thermometer:
            self._lower("servo.motor_fault_temperature", limits.temperature_degc)
        else:
            gaps.append("has no thermometer on the motor")
        return gaps

    def _set_bounds(self, limits: Limits) -> list[str]:
        """Set the bounds of position; raise `HardwareError` where the drive has narrower ones.

        The drive clamps set points at its bounds, so that a motion would end there without a fault.
        """
        gaps, narrow, bounds = [], [], {}
        names = ("servopos.position_min", "servopos.position_max")
        for name, angle, inner in zip(names, limits.position, (max, min), strict=True):
            bound = angle / TURN * self.motor.ratio
            before = float(self._remember(name))
            if not math.isnan(before) and abs(inner(bound, before) - bound) > TEXT_ROUNDING:
                angle_before = before / self.motor.ratio * TURN
                narrow.append(f"{name} is {before:g} turns, {angle_before:.4g} rad")
            if abs(bound) > LARGEST_BOUND:
                gaps.append(f"takes no bound of position as far as {angle:g} rad")
            else:
                bounds[name] = bound
        if narrow:
            raise HardwareError(
                f"{' and '.join(narrow)}: the drive clamps set points there, within serial.limits."
                f"position = [{limits.position[0]:g}, {limits.position[1]:g}] rad: narrow the "
                "limits of the recipe, or widen the drive's (conf set ... nan, conf write)"
            )
        for name, bound in bounds.items():
            self._change(name, f"{bound:.9g}")
        return gaps

    def _lower(self, name: str, limit: float) -> float:
        """Set a limit, and return it; one that is lower already stays."""
        before = float(self._remember(name))
        lowest = limit if math.isnan(before) else min(limit, before)
        self._change(name, f"{lowest:.9g}")
        return lowest

    def _remember(self, name: str) -> str:
        """Return the original value of a setting."""
        if name not in self._before:
            self._before[name] = self.link.get(name)
        return self._before[name]

    def _change(self, name: str, value: str) -> None:
        self._remember(name)
        self.link.set(name, value)

    def restore(self) -> None:
        """Bring back all settings that were changed, the last one first."""
        if self._before:
            self.link.flush()  # answers to an interrupted request
        for name in reversed(list(self._before)):
            self.link.set(name, self._before[name])
            del self._before[name]

    # -- motion

    def enable(self, mode: Mode) -> None:
        """Switch on at rest where the shaft is; the position loop has no gain in mode current.

        Raises `HardwareError` where the drive does not get ready.
        """
        self.halt()
        self._mode = mode
        self._set_table(on=mode != "current")
        hold = self._command(SetPoint(position=math.nan))
        for _ in range(math.ceil(STARTING_TIME / 0.005)):
            state = self.link.query(hold + STATE, EXPECTED_REGISTERS)
            if state[reg.MODE] == reg.IN_POSITION:
                return
            if state[reg.MODE] in (reg.FAULTY, reg.TIMED_OUT):
                self._require_running(state)
            self.line.pause(0.005)
        raise HardwareError(
            f"moteus {self.link.node} was not ready in {STARTING_TIME:g} s: it is in mode "
            f"{state[reg.MODE]:g}; look at its supply"
        )

    def _set_table(self, *, on: bool) -> None:
        """Switch the drive's own cogging table: a set point of current is to be the current."""
        name = "motor.cogging_dq_scale"
        if self.motor.table_scale and not on:
            self._change(name, "0")
        elif name in self._before:
            self.link.set(name, self._before[name])

    def step(self, setpoint: SetPoint) -> Sample:
        """Send a set point and measure, in one exchange."""
        return self._measure(self._command(setpoint), running=True)

    def read(self) -> Sample:
        """Measure."""
        return self._measure(b"", running=False)

    def _command(self, setpoint: SetPoint) -> bytes:
        """Return the subframes of a set point."""
        assert self._limits is not None, "configure first"
        ratio, gain = self.motor.ratio, 0.0 if self._mode == "current" else 1.0
        torque = self.motor.torque_constant / ratio
        turns = setpoint.position / TURN * ratio if self._mode == "position" else math.nan
        speed = setpoint.speed / TURN * ratio if gain else 0.0
        values = (
            turns,
            speed,
            setpoint.current * torque,
            gain,
            gain,
            self._limits.current * torque,
        )
        return (
            frames.write(reg.MODE, [reg.IN_POSITION], frames.INT8)
            + frames.write(reg.COMMAND, values)
            + frames.write(reg.COMMAND_TIMEOUT, [self._watchdog])
            + frames.write(reg.COMMAND_INTEGRAL, [gain])
        )

    def _measure(self, command: bytes, *, running: bool) -> Sample:
        """Measure; again where a late answer leaves the time of the sample uncertain."""
        state, asked, answered = self._ask(command)
        if answered - asked > 2 * self._fastest + ANSWER_SLACK:
            state, asked, answered = self._ask(b"")
        if running:
            self._require_running(state)
            if not (math.isfinite(state[reg.POSITION]) and math.isfinite(state[reg.CURRENT])):
                raise HardwareError(
                    f"moteus {self.link.node} lost its position or its current (they read "
                    f"{state[reg.POSITION]:g} turns, {state[reg.CURRENT]:g} A): look at its encoder"
                )
        ratio = self.motor.ratio
        return Sample(
            time=(asked + answered) / 2,
            position=state[reg.POSITION] * TURN / ratio,
            speed=state[reg.VELOCITY] * TURN / ratio,
            current=state[reg.CURRENT],
            current_setpoint=state[reg.CONTROL_TORQUE] * ratio / self.motor.torque_constant,
            temperature=state[reg.MOTOR_TEMPERATURE] if self.motor.has_thermometer else math.nan,
        )

    def _ask(self, command: bytes) -> tuple[Mapping[int, float], float, float]:
        """Send a command; return the state, and the times of question and answer."""
        asked = self.line.now()
        state = self.link.query(command + STATE, EXPECTED_REGISTERS)
        answered = self.line.now()
        self._fastest = min(self._fastest, answered - asked)
        return state, asked, answered

    def _require_running(self, state: Mapping[int, float]) -> None:
        if state[reg.MODE] == reg.IN_POSITION:
            return
        if state[reg.MODE] == reg.FAULTY:
            raise HardwareError(f"moteus {self.link.node} stopped by itself: {_fault(state)}")
        if state[reg.MODE] == reg.TIMED_OUT:
            raise HardwareError(
                f"moteus {self.link.node} stopped: its watchdog received nothing for "
                f"{self._watchdog:g} s; raise serial.watchdog, or find what delays the line"
            )
        raise HardwareError(
            f"moteus {self.link.node} is switched off, mode {state[reg.MODE]:g}: it was reset, or "
            "another program stopped it"
        )

    def halt(self) -> None:
        """Switch the power stage off; raises `HardwareError` where it stays on."""
        persist(self._stop)

    def _stop(self) -> None:
        for _ in range(2):  # an answer holds the state before the stop
            state = self.link.query(STOP + frames.read(reg.MODE), (reg.MODE,))
        if state[reg.MODE] != reg.STOPPED:
            raise HardwareError(
                f"moteus {self.link.node} was sent a stop and is still in mode "
                f"{state[reg.MODE]:g}: switch its supply off"
            )


def _fault(state: Mapping[int, float]) -> str:
    code = int(state[reg.FAULT])
    return f"fault {code}, {FAULTS.get(code, 'see the list of faults of moteus')}"
