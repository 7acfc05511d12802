"""The ASCII protocol of ODrive: lines with checksums, properties by name, for each firmware.

A line is `text *C` with C the XOR of all bytes before the asterisk, in decimal. A request with a
wrong checksum is ignored in silence, and most commands have no reply at all: important values are
read back in the same exchange. Sources: `ascii_protocol.cpp`, `controller.cpp`, `axis.cpp` and
`motor.cpp` of firmware 0.5; for 0.6, whose source is not public, the maker's manual and programs of
others: see docs/bench-odrive.md.
"""

from __future__ import annotations

import functools
import operator
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import TypeVar

from rigtool.errors import HardwareError
from rigtool.rigs.serial.line import DamagedReply, Line, LineTimeout, RequestRefused

T = TypeVar("T")

MAX_REPLY_BYTES = 64
"""Bytes of a reply at most: the firmware cuts longer ones."""

OLDEST_FIRMWARE = (0, 5, 1)
"""Firmware since which positions are in turns and feed-forward in N m."""

BUFFERED_FIRMWARE = (0, 5, 3)
"""Firmware since which replies are buffered: several questions may be asked at once."""

REFUSALS = ("invalid property", "invalid motor", "not implemented", "unknown command")

AXIS_ERRORS_05 = {
    0x1: "INVALID_STATE",
    0x40: "MOTOR_FAILED",
    0x80: "SENSORLESS_ESTIMATOR_FAILED",
    0x100: "ENCODER_FAILED",
    0x200: "CONTROLLER_FAILED",
    0x800: "WATCHDOG_TIMER_EXPIRED",
    0x1000: "MIN_ENDSTOP_PRESSED",
    0x2000: "MAX_ENDSTOP_PRESSED",
    0x4000: "ESTOP_REQUESTED",
    0x20000: "HOMING_WITHOUT_ENDSTOP",
    0x40000: "OVER_TEMP",
    0x80000: "UNKNOWN_POSITION",
}

AXIS_ERRORS_06 = {
    0x1: "INITIALIZING",
    0x2: "SYSTEM_LEVEL",
    0x4: "TIMING_ERROR",
    0x8: "MISSING_ESTIMATE",
    0x10: "BAD_CONFIG",
    0x20: "DRV_FAULT",
    0x40: "MISSING_INPUT",
    0x100: "DC_BUS_OVER_VOLTAGE",
    0x200: "DC_BUS_UNDER_VOLTAGE",
    0x400: "DC_BUS_OVER_CURRENT",
    0x800: "DC_BUS_OVER_REGEN_CURRENT",
    0x1000: "CURRENT_LIMIT_VIOLATION",
    0x2000: "MOTOR_OVER_TEMP",
    0x4000: "INVERTER_OVER_TEMP",
    0x8000: "VELOCITY_LIMIT_VIOLATION",
    0x10000: "POSITION_LIMIT_VIOLATION",
    0x20000: "REQUESTED_CURRENT_TOO_HIGH",
    0x1000000: "WATCHDOG_TIMER_EXPIRED",
    0x2000000: "ESTOP_REQUESTED",
    0x4000000: "SPINOUT_DETECTED",
    0x8000000: "BRAKE_RESISTOR_DISARMED",
    0x10000000: "THERMISTOR_DISCONNECTED",
    0x40000000: "CALIBRATION_ERROR",
}


def describe_errors(code: int, names: Mapping[int, str]) -> list[str]:
    """Return the names of the bits of an error, the rest as a number."""
    found = [name for bit, name in names.items() if code & bit]
    rest = code & ~sum(names)
    return [*found, f"{rest:#x}"] if rest else found


class Missing(RequestRefused):
    """This firmware has no such property."""


@dataclass(frozen=True)
class Dialect:
    """Names of properties in a firmware, below `axisN.`; several where versions differ."""

    current_limit: str
    torque_constant: str
    motor_type: str
    direction: tuple[str, ...]
    current: str
    current_setpoint: str
    thermistor: tuple[str, ...]
    errors: tuple[str, ...]
    error_names: dict[int, str]

    @property
    def watchdog_error(self) -> int:
        """The bit of the first of `errors` that reports that the watchdog ran out."""
        return next(n for n, name in self.error_names.items() if name == "WATCHDOG_TIMER_EXPIRED")


DIALECT_05 = Dialect(
    current_limit="motor.config.current_lim",
    torque_constant="motor.config.torque_constant",
    motor_type="motor.config.motor_type",
    direction=("encoder.config.direction", "motor.config.direction"),
    current="motor.current_control.Iq_measured",
    current_setpoint="motor.current_control.Iq_setpoint",
    thermistor=("motor.motor_thermistor", "motor_thermistor"),
    errors=("error", "motor.error", "encoder.error", "controller.error"),
    error_names=AXIS_ERRORS_05,
)

DIALECT_06 = Dialect(
    current_limit="config.motor.current_soft_max",
    torque_constant="config.motor.torque_constant",
    motor_type="config.motor.motor_type",
    direction=("config.motor.direction",),
    current="motor.foc.Iq_measured",
    current_setpoint="motor.foc.Iq_setpoint",
    thermistor=("motor.motor_thermistor",),
    errors=("active_errors",),
    error_names=AXIS_ERRORS_06,
)


@dataclass(frozen=True)
class Identity:
    """The device that answers to `i`."""

    hardware: str
    firmware: tuple[int, int, int]
    serial_number: str

    def __str__(self) -> str:
        version = ".".join(map(str, self.firmware))
        return f"ODrive {self.hardware}, firmware {version}, serial number {self.serial_number}"

    @property
    def dialect(self) -> Dialect:
        """Names of properties in this firmware."""
        return DIALECT_05 if self.firmware < (0, 6, 0) else DIALECT_06


def xor_checksum(text: bytes) -> int:
    """Return the XOR of all bytes."""
    return functools.reduce(operator.xor, text, 0)


def seal(text: str) -> bytes:
    """Return a line with its checksum; it ends with LF alone, since CR would end another line."""
    body = f"{text} ".encode("ascii")
    return body + b"*%d\n" % xor_checksum(body)


def unseal(line: bytes) -> str:
    """Return the text of a reply without its checksum; `DamagedReply` where that is wrong."""
    body, star, check = line.rstrip(b"\r").rpartition(b"*")
    if not star or not check.isdigit() or int(check) != xor_checksum(body):
        raise DamagedReply(f"the reply {line[:MAX_REPLY_BYTES]!r} has a wrong checksum or none")
    return body.decode("ascii", "replace").strip()


def number(text: str) -> float:
    """Return the number in a reply, 1 for true, 0 for false; raises `DamagedReply`."""
    words = {"true": 1.0, "false": 0.0}
    try:
        return words[text.lower()] if text.lower() in words else float(text)
    except ValueError:
        raise DamagedReply(f"the reply {text!r} is no number") from None


def agrees(text: str, value: float) -> bool:
    """Return whether a reply is this value, as a 32-bit float cut after 9 characters."""
    _, point, decimals = text.partition(".")
    cut = 1.05 * 10.0 ** -len(decimals) if point else 0.0
    read = number(text)
    return read == value or abs(read - value) <= cut + 2e-7 * abs(value)


class OdriveProtocol:
    """Questions and answers on a line.

    `at_once` asks all questions of an exchange in one write; otherwise each waits for the answer
    to the one before, since firmware 0.6 drops a reply while another is being sent.
    """

    def __init__(self, line: Line) -> None:
        self._line, self.at_once = line, False

    def ask(
        self,
        questions: Sequence[str],
        understand: Callable[[list[str]], T],
        *,
        commands: Sequence[str] = (),
    ) -> T:
        """Send commands, which have no reply, then questions; return the result of `understand`.

        A reply does not name its question: an unexpected number of words, bytes left over, or a
        `DamagedReply` of `understand` repeats the whole exchange.
        Raises `RequestRefused` where the drive refuses, `Missing` for an unknown property.
        """
        first = list(questions) if self.at_once else [questions[0]]
        rest = list(questions[len(first) :])

        def receive() -> T:
            replies = self._replies(first)
            for question in rest:
                self._line.write(seal(question))
                replies += self._replies([question])
            return understand(replies)

        request = b"".join(map(seal, [*commands, *first]))
        return self._line.exchange(request, receive)

    def get(self, name: str) -> str:
        """Return a property as the drive prints it."""
        return self.ask([f"r {name}"], lambda replies: replies[0])

    def get_first(self, *names: str) -> tuple[str, str] | None:
        """Return name and value of the first of these properties that is there."""
        for name in names:
            try:
                return name, self.get(name)
            except Missing:
                continue
        return None

    def put(self, name: str, text: str, *, commands: Sequence[str] = ()) -> None:
        """Write a property, and read it back until it is there; `commands` go first.

        Raises `RequestRefused` where there is none, `LineLost` where it stays a `DamagedReply`.
        """

        def understand(replies: list[str]) -> None:
            if not agrees(replies[0], number(text)):
                raise DamagedReply(f"{name} is {replies[0]} after {text} was written")

        self.ask([f"r {name}"], understand, commands=[*commands, f"w {name} {text}"])

    def _replies(self, questions: Sequence[str]) -> list[str]:
        """Read one reply to each question."""
        lines: list[bytes] = []
        rest = b""
        while len(lines) < len(questions):
            data = self._line.read_some()
            if not data:
                raise LineTimeout(f"{len(lines)} of {len(questions)} replies came in time")
            *whole, rest = (rest + data).split(b"\n")
            lines += whole
            if len(rest) > MAX_REPLY_BYTES:
                raise DamagedReply(f"{len(rest)} bytes came without the end of a line")
        texts = [unseal(line) for line in lines]
        for number, text in enumerate(texts):
            if text.startswith(REFUSALS):  # perhaps a command before, which has no reply otherwise
                kind = Missing if text.startswith("invalid property") else RequestRefused
                asked = questions[min(number, len(questions) - 1)]
                where = "; a board with one axis has node 0" if "axis1." in asked else ""
                raise kind(f"the ODrive refuses {asked!r}, or a command with it: {text}{where}")
        if rest or len(lines) > len(questions):
            raise DamagedReply("more replies came than questions were sent")
        for question, text in zip(questions, texts, strict=True):
            if len(text.split()) != (2 if question.startswith("f ") else 1):
                raise DamagedReply(f"{text!r} is no reply to {question!r}")
        return texts


def identify(line: Line, retries: int | None = None) -> Identity:
    """Return the identity of the drive; raises `HardwareError` for firmware before 0.5.1."""

    def receive() -> Identity:
        text = ""
        while (found := _identity(text)) is None or not found.serial_number:
            try:
                text += unseal(line.read_until().removesuffix(b"\n")) + "\n"
            except LineTimeout:
                if found is None:
                    raise
                return found
        return found

    found = line.exchange(seal("i"), receive, retries=retries)
    if found.firmware < OLDEST_FIRMWARE:
        raise HardwareError(
            f"{found}: before 0.5.1 positions were counts and feed-forward A: update the firmware"
        )
    return found


def _identity(text: str) -> Identity | None:
    firmware = re.search(r"firmware version:\s*v?(\d+)\.(\d+)\.(\d+)", text, re.IGNORECASE)
    hardware = re.search(r"hardware version:\s*(\S+)", text, re.IGNORECASE)
    serial_number = re.search(r"serial number:\s*(\w+)", text, re.IGNORECASE)
    if not firmware:
        return None
    major, minor, revision = map(int, firmware.groups())
    return Identity(
        f"v{hardware[1]}" if hardware else "",
        (major, minor, revision),
        serial_number[1] if serial_number else "",
    )
