"""VESC by its serial frames: currents out, telemetry back; docs/bench-vesc.md.

    02 length u8 | 03 length u16, payload, CRC-16 u16, 03        all big-endian, CRC-16/XMODEM

A set point has no reply: it goes out together with a question for the state. A damaged one is
dropped by the drive; the next one comes a period later. The drive releases its motor where set
points stay out for its timeout, which questions do not feed; `configure` measures that timeout.
Source: bldc, firmware 6, `comm/packet.c`, `comm/commands.c`, `timeout.c`, `mcpwm_foc.c`.
"""

from __future__ import annotations

import binascii
import math
import struct
from typing import NamedTuple

from rigtool.errors import HardwareError, RecipeError
from rigtool.recipe import Recipe
from rigtool.recipe.serial import Limits
from rigtool.rigs.serial.drive import RPM, Abilities, Mode, Sample, SetPoint, persist, unwrapped
from rigtool.rigs.serial.drivers import Driver
from rigtool.rigs.serial.line import DamagedReply, Line, LineLost

FIRMWARE, SET_CURRENT, SET_LIMITS, VALUES, LIMITS = 0, 6, 48, 50, 91
VALUE_MASK = sum(1 << bit for bit in (1, 5, 7, 15, 16, 21))
"""Values that are asked for: motor temperature, Iq, ERPM, fault, position, status."""
STATE = struct.Struct(">BIhiiBiB")
LIMIT_VALUES = struct.Struct(">10fBff")
"""Scales of current, ERPM, duty, power and battery current, lowest and highest each; then the
number of poles, gear ratio and wheel diameter."""
LOWEST_ERPM, HIGHEST_ERPM = 2, 3

TIMED_OUT, KILL_SWITCH = 1, 2
LARGEST_CURRENT = 2**31 / 1e3
FADING_RATIO = 0.8
"""Part of the highest ERPM at which a drive begins to reduce current, as it is delivered."""

TIMEOUT_SLACK = 0.03
"""Time by which the drive may be late with its timeout, which it looks at every 10 ms, s."""

POLL_INTERVAL = 0.005

DRIFT_ANGLE, DRIFT_SHARE = 1.0, 0.2
"""Difference between the angle and the integral of speed from which on the two do not belong to one
shaft: rad, and part of the way."""

PLAUSIBLE_DEGC = (-20.0, 180.0)
"""Range of a motor's thermistor; without one the drive reports a value outside."""

FAULTS = (
    "none",
    "over voltage",
    "under voltage",
    "gate driver",
    "absolute over current",
    "temperature of the transistors",
    "temperature of the motor",
)


class VescState(NamedTuple):
    """Values of a drive, in its units: 0.1 degC, 10 mA, ERPM, 1e-6 deg."""

    command: int
    mask: int
    temperature: int
    current: int
    erpm: int
    fault: int
    angle: int
    status: int


def frame(payload: bytes) -> bytes:
    """Return a frame with this payload."""
    size = len(payload)
    head = struct.pack(">BB", 2, size) if size < 256 else struct.pack(">BH", 3, size)
    return head + payload + struct.pack(">HB", binascii.crc_hqx(payload, 0), 3)


def read_frame(line: Line) -> bytes:
    """Return the payload of the next frame; raises `DamagedReply` for anything else."""
    start = line.read_exactly(1)
    if start not in (b"\2", b"\3"):
        raise DamagedReply(f"a frame begins with {start!r}")
    size = int.from_bytes(line.read_exactly(start[0] - 1), "big")
    data = line.read_exactly(size + 3)
    payload, check, end = data[:size], int.from_bytes(data[size:-1], "big"), data[-1]
    if binascii.crc_hqx(payload, 0) != check or end != 3:
        raise DamagedReply(f"a frame of {size} bytes has a wrong CRC or end")
    return payload


class Vesc:
    """A VESC with an encoder; turns are counted here."""

    def __init__(self, line: Line) -> None:
        self._line = line
        self._pole_pairs = 1.0
        self._before: bytes | None = None
        self._watchdog, self._lets_go = 0.0, math.inf
        self._temperature = self._on = False
        self._setpoint = 0.0
        self._last: Sample | None = None
        self._drift = self._way = 0.0

    # -- identity and settings

    def connect(self) -> str:
        """Identify the drive, and read its poles; nothing changes.

        Raises `HardwareError` where it reports a fault, or its firmware is too old.
        """
        identity = identify(self._line)
        try:
            self._pole_pairs = self._limits()[10] / 2
            state = self._ask_state()
        except LineLost as error:
            raise HardwareError(
                f"{self._line.port}: {identity} does not report its limits and its timeout "
                f"({error}): update its firmware, to 6.00 or later"
            ) from None
        if self._pole_pairs <= 0:
            raise HardwareError(f"{self._line.port}: set the number of poles in VESC Tool")
        low, high = PLAUSIBLE_DEGC
        self._temperature = low < state.temperature / 10 < high
        self._last, self._drift, self._way = None, 0.0, 0.0
        return f"{identity}, {2 * self._pole_pairs:g} poles"

    @property
    def abilities(self) -> Abilities:
        """Currents; temperature where there is a thermistor."""
        more = {"temperature"} if self._temperature else set()
        channels = frozenset({"current", "current_setpoint"} | more)
        return Abilities(frozenset({"current"}), False, channels, lets_go=self._lets_go)

    def configure(self, limits: Limits, watchdog: float) -> list[str]:
        """Measure the timeout without current, and lower the limit of ERPM.

        Raises `RecipeError` for a timeout that is longer than the watchdog.
        """
        self._watchdog = watchdog
        self._require_timeout()
        values = list(self._limits())
        if self._before is None:
            self._before = struct.pack(">10f", *values[:10])
        fastest = limits.speed / RPM * self._pole_pairs / FADING_RATIO
        values[LOWEST_ERPM] = max(values[LOWEST_ERPM], -fastest)
        values[HIGHEST_ERPM] = min(values[HIGHEST_ERPM], fastest)
        self._lets_go = max(-values[LOWEST_ERPM], values[HIGHEST_ERPM]) / self._pole_pairs * RPM
        self._set_limits(struct.pack(">10f", *values[:10]))
        return [
            "has no limit of position",
            f"reduces current only from {limits.speed:g} rad/s on, to none at "
            f"{limits.speed / FADING_RATIO:g} rad/s",
        ]

    def _limits(self) -> tuple[float, ...]:
        """Return limits, poles, gear ratio and wheel diameter."""
        reply = self._ask(bytes([LIMITS]), LIMIT_VALUES.size + 1)
        return LIMIT_VALUES.unpack(reply[1:])

    def _set_limits(self, values: bytes) -> None:
        """Set limits until the drive is switched off."""
        nothing_else = bytes([SET_LIMITS, 0, 0, 1, 0])  # not stored, not forwarded, acknowledged
        self._ask(nothing_else + values, 1)
        found = struct.pack(">10f", *self._limits()[:10])
        if found != values:
            raise HardwareError(f"{self._line.port}: the drive does not take a limit of its speed")

    def _require_timeout(self) -> None:
        """See that the drive reports its timeout soon enough after the last set point, of zero."""
        self._feed()
        begin = self._line.now()
        if not self._wait_for(timed_out=True):
            raise RecipeError(
                f"{self._line.port}: the drive did not stop by itself in "
                f"{self._line.now() - begin:.2f} s of silence: its timeout is longer than "
                f"serial.watchdog = {self._watchdog:g} s, or off. Set it in VESC Tool (App "
                "Settings, General, Timeout; 1000 ms as delivered), or serial.watchdog to it"
            )

    def _wait_for(self, *, timed_out: bool, feed: bool = False) -> bool:
        """Ask until the drive has timed out, or no longer has; return whether that state was
        reached."""
        until = self._line.now() + self._watchdog + TIMEOUT_SLACK
        while True:
            state = self._ask_state(0.0 if feed else None)
            if bool(state.status & TIMED_OUT) == timed_out:
                return True
            if self._line.now() > until:
                return False
            self._line.pause(POLL_INTERVAL)

    def restore(self) -> None:
        """Restore the limits."""
        if self._before is not None:
            self._set_limits(self._before)
            self._before = None

    # -- states

    def enable(self, mode: Mode) -> None:
        """Begin to feed the timeout, with a current of zero."""
        self._setpoint, self._on = 0.0, True
        self._feed()

    def _feed(self) -> None:
        """Send currents of zero until the drive no longer reports its timeout."""
        if not self._wait_for(timed_out=False, feed=True):
            raise HardwareError(
                f"{self._line.port}: the drive reports its timeout although set points come: see "
                "in VESC Tool whether its kill switch or another input holds it"
            )

    def halt(self) -> None:
        """Set the current to zero, and see the timeout come: then the motor is released.

        Raises `HardwareError` where it does not come.
        """
        self._setpoint = 0.0
        persist(self._stop)

    def _stop(self) -> None:
        self._line.write(self._current(0.0))
        self._ask_state(0.0)
        if self._on and not self._wait_for(timed_out=True):
            raise HardwareError(
                f"{self._line.port}: the drive's timeout does not come: switch it off"
            )
        self._on = False

    # -- samples

    def step(self, setpoint: SetPoint) -> Sample:
        """Send a current, and measure; raises `HardwareError` where the drive has stopped."""
        self._setpoint = setpoint.current
        return self._measure(setpoint.current)

    def read(self) -> Sample:
        """Measure; nothing moves."""
        return self._measure()

    def _measure(self, current: float | None = None) -> Sample:
        asked = self._line.now()
        state = self._ask_state(current)
        moment = (asked + self._line.now()) / 2
        if current is not None:
            self._require_running(state)
        speed = state.erpm / self._pole_pairs * RPM
        self._last = Sample(
            moment,
            self._unwrap(math.radians(state.angle / 1e6), speed, moment),
            speed,
            state.current / 100,
            self._setpoint,
            state.temperature / 10 if self._temperature else math.nan,
        )
        return self._last

    def _require_running(self, state: VescState) -> None:
        if state.fault:
            name = FAULTS[state.fault] if state.fault < len(FAULTS) else "see VESC Tool"
            raise HardwareError(
                f"{self._line.port}: the drive reports fault {state.fault} ({name})"
            )
        if state.status & KILL_SWITCH:
            raise HardwareError(f"{self._line.port}: the drive's kill switch is active")
        if state.status & TIMED_OUT:
            raise HardwareError(
                f"{self._line.port}: the drive timed out: no set points arrived, or it was reset"
            )

    def _unwrap(self, angle: float, speed: float, moment: float) -> float:
        """Return the position nearest to the one that the speed since the last sample predicts."""
        if self._last is None:
            return angle
        then = self._last
        angle, moved = unwrapped(angle, speed, moment, then)
        if not self._on:  # a shaft that is turned by hand meanwhile is no fault
            self._drift = self._way = 0.0
            return angle
        self._way += abs(moved)
        self._drift += angle - then.position - moved
        if abs(self._drift) > DRIFT_ANGLE + DRIFT_SHARE * self._way:
            raise HardwareError(
                f"{self._line.port}: position and speed disagree by {self._drift:.3g} rad over "
                f"{self._way:.3g} rad: the number of poles ({2 * self._pole_pairs:g}) or the "
                "direction of the encoder is wrong in VESC Tool, or the angle is not that of an "
                "encoder on the shaft"
            )
        return angle

    # -- frames

    def _current(self, current: float) -> bytes:
        if abs(current) >= LARGEST_CURRENT:
            raise HardwareError(
                f"{self._line.port}: a current of {current:g} A is beyond its range"
            )
        return frame(struct.pack(">Bi", SET_CURRENT, round(current * 1e3)))

    def _ask_state(self, current: float | None = None) -> VescState:
        """Ask for the state, after a set point of current [A] if there is one."""
        first = b"" if current is None else self._current(current)
        reply = self._ask(struct.pack(">BI", VALUES, VALUE_MASK), STATE.size, first)
        return VescState(*STATE.unpack(reply))

    def _ask(self, payload: bytes, size: int, first: bytes = b"") -> bytes:
        """Send a question and return the reply of this kind; others, sent unasked, are left out."""

        def receive() -> bytes:
            while (reply := read_frame(self._line))[:1] != payload[:1]:
                self._line.counts.stray_bytes += len(reply)
            if len(reply) != size:
                raise DamagedReply(f"the reply to {payload[0]} has {len(reply)} bytes, not {size}")
            return reply

        return self._line.exchange(first + frame(payload), receive)


def identify(line: Line, retries: int | None = None) -> str:
    """Return hardware and firmware of the VESC that answers; `HardwareError` for another device."""
    reply = line.exchange(frame(bytes([FIRMWARE])), lambda: read_frame(line), retries=retries)
    hardware, end, rest = reply[3:].partition(b"\0")
    if reply[:1] != bytes([FIRMWARE]) or not end:
        raise HardwareError(f"{line.port}: {reply[:16]!r} is no answer of a VESC")
    number = rest[:12].hex()
    name = hardware.decode("ascii", "replace")
    return f"VESC {name}, firmware {reply[1]}.{reply[2]:02d}, UUID {number}"


def probe(line: Line) -> str | None:
    """Return the identity of the VESC that answers."""
    return identify(line, retries=0)


def make_drive(line: Line, recipe: Recipe) -> Vesc:
    """Return the drive on a line, not connected yet; `RecipeError` for a node behind it."""
    if recipe.line.node:
        raise RecipeError(
            f"serial.node is {recipe.line.node}: rigtool drives the VESC at the line itself, "
            "none behind it on CAN: set it to 0"
        )
    return Vesc(line)


DRIVER = Driver(probe, (115200,), make_drive, host_closes=True)
