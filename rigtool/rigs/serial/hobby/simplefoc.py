"""SimpleFOC by its Commander: lines of text, angles in rad, currents in A; docs/bench-simplefoc.md.

    M0.25 -> M0.2500        target, a current in torque mode
    MMG7  -> MMG0.25;...    target; Vq; Vd; Iq; Id; velocity; angle
    ME    -> ME1            enabled

With `@3`, machine readable, each answer begins with the letters of its question. Lines have no
checksum: the drive repeats the target, which is compared, and its own limit of current holds.
Nothing in SimpleFOC stops the motor when the line falls silent. Source: Arduino-FOC 2.4,
`Commander.cpp`, `FOCMotor.cpp`.
"""

from __future__ import annotations

import math
import re

from rigtool.errors import HardwareError
from rigtool.recipe import Recipe
from rigtool.recipe.serial import Limits
from rigtool.rigs.serial.drive import Abilities, Mode, Sample, SetPoint, persist
from rigtool.rigs.serial.drivers import Driver
from rigtool.rigs.serial.line import DamagedReply, Line, LineTimeout
from rigtool.rigs.serial.maxon.guard import UNWATCHED, Guard, make_guard

BAUD_RATE = 115200
DECIMALS = 4
LISTING = re.compile(rb"\??([^\s?@#:]):(.*)")
MEASURED_CURRENT = ("dc curr", "foc curr")
MOTIONS = ("torque", "vel", "angle", "vel open", "angle open", "angle nocascade", "custom")
"""Names of the motion controls, in the order of their numbers."""

MISSING_ABILITIES = (
    f"has no watchdog: {UNWATCHED}",
    "has no limit of speed while it follows currents",
    "has no limit of position",
)


class SimpleFoc:
    """The motor command number `node` of a sketch, in the order in which it was added."""

    abilities = Abilities(
        modes=frozenset({"current"}),
        feedforward=False,
        channels=frozenset({"current", "current_setpoint"}),
        watchdog=False,
    )

    def __init__(self, line: Line, node: int, guard: Guard | None) -> None:
        self._line, self._node, self._guard = line, node, guard
        self._letter = ""
        self._before: dict[str, str] = {}
        self._on = False

    # -- identity and settings

    def connect(self) -> str:
        """Find the motor's letter and see that its current is measured; nothing moves.

        Raises `HardwareError` where the sketch lists no motor, or controls voltage.
        """
        self._line.write(b"\n")  # ends what another program left behind
        self._line.settle()
        label = self._find_motor()
        for prefix, command in (("@machine", "@3"), (f"#{DECIMALS}", f"#{DECIMALS}")):
            self._ask(command, prefix)
        kind = self._get("T")
        if kind not in MEASURED_CURRENT:
            raise HardwareError(
                f"{self._line.port}: the motor's torque control is {kind!r}, and its current is "
                "not measured: use a current sense, TorqueControlType::foc_current or dc_current, "
                "and tuned current controllers"
            )
        return f"SimpleFOC, command {self._letter} ({label}), torque control {kind}"

    def _find_motor(self) -> str:
        motors = [
            (letter, label) for letter, label in _list(self._line) if "motor" in label.lower()
        ]
        if self._node >= len(motors):
            raise HardwareError(
                f"{self._line.port}: the sketch lists {len(motors)} motor commands, serial.node "
                f"asks for number {self._node} (from 0): add one, command.add('M', onMotor, "
                '"motor") with command.motor(&motor, cmd), or correct serial.node'
            )
        self._letter, label = motors[self._node]
        return label

    def configure(self, limits: Limits, watchdog: float) -> list[str]:
        """Lower the limit of current, silence the monitor; return what the drive cannot watch.

        Raises `HardwareError` where the drive keeps another limit.
        """
        self._before.setdefault("C", str(self._motion()))
        limit = self._get("LC")
        self._before.setdefault("LC", limit)
        lowest = min(_number(limit), limits.current)
        if abs(_number(self._get("LC", f"{lowest:.4f}")) - lowest) > 10.0**-DECIMALS:
            raise HardwareError(f"{self._line.port}: the limit of current stays at {limit} A")
        self._before.setdefault("MS", self._get("MS"))
        self._get("MC")
        return list(MISSING_ABILITIES)

    def _motion(self) -> int:
        name = self._get("C")
        if name not in MOTIONS:
            raise HardwareError(f"{self._line.port}: its motion control {name!r} is not known")
        return MOTIONS.index(name)

    def restore(self) -> None:
        """Restore motion control, limit and monitor; the motor stays switched off."""
        for name, value in reversed(list(self._before.items())):
            self._get(name, value)
            del self._before[name]
        if self._guard is not None:
            self._guard.close()

    # -- states

    def enable(self, mode: Mode) -> None:
        """Switch on, following currents, with a target of zero.

        Raises `HardwareError` where the drive stays off, or does not follow torque targets.
        """
        if self._on:
            return
        if self._guard is not None:
            self._guard.watch()
        self._off()
        if self._get("C", "0") != "torque":
            raise HardwareError(f"{self._line.port}: the drive does not follow torque targets")
        self._ask_for_nothing()
        if self._get("E", "1") != "1":
            raise HardwareError(f"{self._line.port}: the drive does not switch on")
        self._on = True

    def halt(self) -> None:
        """Switch off, in any state; `HardwareError` where the drive does not confirm it."""
        persist(self._stop, before_again=self._line.settle)
        self._on = False
        if self._guard is not None:
            self._guard.rest()

    def _stop(self) -> None:
        self._line.write(b"\n")  # ends half a line
        self._off()

    def _off(self) -> None:
        self._ask_for_nothing()
        if self._get("E", "0") != "0":
            raise DamagedReply(f"{self._line.port}: the drive reports that it is still on")

    def _ask_for_nothing(self) -> None:
        text = f"{self._letter}{0.0:.{DECIMALS}f}"
        self._ask(text, text)

    # -- samples

    def step(self, setpoint: SetPoint) -> Sample:
        """Send a current, and measure; raises `HardwareError` where the drive is off."""
        sample = self._measure(f"{setpoint.current:.{DECIMALS}f}")
        if self._guard is not None:
            self._guard.beat()
        return sample

    def read(self) -> Sample:
        """Measure; nothing moves."""
        return self._measure()

    def _measure(self, target: str | None = None) -> Sample:
        letter = self._letter
        request = f"{letter}MG7\n"
        if target is not None:
            request = f"{letter}{target}\n{request}{letter}E\n"

        def receive() -> tuple[list[float], str]:
            if target is not None and _number(self._answer(letter)) != float(target):
                raise DamagedReply(f"the drive did not take the target {target} A")
            values = [_number(word) for word in self._answer(f"{letter}MG").split(";")]
            if len(values) != 7 or (target is not None and values[0] != float(target)):
                raise DamagedReply(f"{values} is no state with the target {target} A")
            return values, self._answer(f"{letter}E") if target is not None else ""

        asked = self._line.now()
        values, on = self._line.exchange(request.encode(), receive)
        moment = (asked + self._line.now()) / 2
        if on == "0":
            raise HardwareError(f"{self._line.port}: the drive is switched off in the middle")
        wanted, _, _, current, _, speed, angle = values
        return Sample(moment, angle, speed, current, wanted if self._on else 0.0)

    # -- lines

    def _get(self, name: str, value: str = "") -> str:
        """Read a setting of the motor, or set it; return the answer."""
        return self._ask(f"{self._letter}{name}{value}", f"{self._letter}{name}")

    def _ask(self, command: str, prefix: str) -> str:
        return self._line.exchange(f"{command}\n".encode(), lambda: self._answer(prefix))

    def _answer(self, prefix: str) -> str:
        """Return the rest of the next line that begins so; lines of the monitor are left out."""
        while True:
            line = self._line.read_until().strip().decode("ascii", "replace")
            if line.startswith(prefix):
                return line.removeprefix(prefix)
            if line.endswith("err"):
                raise DamagedReply(f"the drive answers {line!r}, not {prefix!r}")
            self._line.counts.stray_bytes += len(line)


def _number(text: str) -> float:
    """Return a finite number of a reply, or raise `DamagedReply`."""
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise DamagedReply(f"the reply {text!r} is no number")
    return value


def _list(line: Line, retries: int | None = None) -> list[tuple[str, str]]:
    """Return letter and label of each command of the sketch."""

    def receive() -> list[tuple[str, str]]:
        found: list[tuple[str, str]] = []
        while True:
            try:
                match = LISTING.fullmatch(line.read_until().strip())
            except LineTimeout:
                if not found:
                    raise
                return found
            if match is not None:
                found.append(
                    (match[1].decode("ascii", "replace"), match[2].decode("utf-8", "replace"))
                )

    return line.exchange(b"?\n", receive, retries=retries)


def probe(line: Line) -> str | None:
    """Return the commands of the sketch that lists them, None for another device."""
    commands = ", ".join(f"{letter} ({label})" for letter, label in _list(line, retries=0))
    return f"SimpleFOC, commands {commands}"


def make_drive(line: Line, recipe: Recipe) -> SimpleFoc:
    """Return the drive that a recipe names, not connected yet."""
    node = recipe.line.node
    guard = make_guard(line, recipe.line, node, "SimpleFOC has", "simplefoc", BAUD_RATE)
    return SimpleFoc(line, node, guard)


def switch_off(line: Line, node: int) -> None:
    """Switch the motor off, as the process beside rigtool does."""
    drive = SimpleFoc(line, node, None)
    drive.connect()
    drive.halt()


DRIVER = Driver(
    probe, (BAUD_RATE,), make_drive, has_watchdog=False, switch_off=switch_off, host_closes=True
)
