"""Messages of the host-target link, as host and emulator both pack and unpack them.

The link is specified in docs/target-link.md; all numbers are little-endian, floats f8.
"""

from __future__ import annotations

import enum
import struct
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any, ClassVar, Self

import numpy as np

from rigtool.control.lookup_table import LookupTable
from rigtool.numerics.arrays import Array
from rigtool.recipe.serial import Limits
from rigtool.rigs.base import Feedforward, Load
from rigtool.rigs.motion import (
    CurrentRamp,
    CurrentSteps,
    Motion,
    Move,
    Observe,
    OpenLoop,
    SpeedProfile,
    Triangle,
)
from rigtool.rigs.serial.line import DamagedReply
from rigtool.signals import CHANNELS

VERSION = 1
REPLY = 0x80
REFUSED = 0xFF
SAMPLES = 0x7E
"""Kinds of frames beside requests: reply to one (added to its kind), refusal, streamed samples."""


class FrameKind(enum.IntEnum):
    """Requests of the host."""

    HELLO = 1
    BEGIN = 2
    CHUNK = 3
    COMMIT = 4
    ARM = 5
    START = 6
    STATUS = 7
    READ = 8
    DIGEST = 9
    STOP = 10
    MOVE = 11
    CLAMP = 12
    SOAK = 13
    POWER_CYCLE = 14
    BYE = 15


class Slot(enum.IntEnum):
    """Objects that are uploaded in chunks."""

    RIG = 1
    LIMITS = 2
    CONTROLLER = 3
    FEEDFORWARD = 4
    TABLE = 5
    SIGNAL = 6
    MOTION = 7
    LOAD = 8


class TargetState(enum.IntEnum):
    """States of a target."""

    OFF = 0
    ARMED = 1
    RUNNING = 2
    DONE = 3
    TRIPPED = 4


class Refusal(enum.IntEnum):
    """Why a request is refused."""

    NO_SESSION = 1
    BAD_CRC = 2
    NOT_NOW = 3
    BAD_VALUE = 4
    FAULT = 5


class Ability(enum.IntFlag):
    """Abilities of a target beside running motions from its memory."""

    OPEN_LOOP = 1
    FEEDFORWARD = 2
    TABLE = 4
    SIGNAL = 8
    STREAM = 16
    KEEPS_LOG = 32
    LOAD = 64
    CLAMP = 128
    SOAK = 256
    POWER_CYCLE = 512


class Message:
    """A dataclass of numbers, which `_LAYOUT` packs in their order, and a text behind them."""

    _LAYOUT: ClassVar[struct.Struct]
    __dataclass_fields__: ClassVar[dict[str, Any]]

    def pack(self) -> bytes:
        """Return the payload of a frame, or an object."""
        *numbers, text = (getattr(self, name) for name in self.__dataclass_fields__)
        return self._LAYOUT.pack(*numbers) + text.encode()

    @classmethod
    def unpack(cls, payload: bytes) -> Self:
        """Read what `pack` returned; raises `DamagedReply` where it is too short."""
        text = payload[cls._LAYOUT.size :].decode("utf-8", "replace")
        kind: Any = cls  # a dataclass
        return kind(*_unpack(cls._LAYOUT, payload), text)


@dataclass(frozen=True)
class Hello(Message):
    """A target's reply to HELLO."""

    version: int
    boot: int
    abilities: Ability
    max_payload: int
    log_bytes: int
    sample_time: float
    encoder_counts: int
    channels: int
    name: str

    _LAYOUT = struct.Struct("<BIHHIdIH")

    def __post_init__(self) -> None:
        object.__setattr__(self, "abilities", Ability(self.abilities))


@dataclass(frozen=True)
class Status(Message):
    """State of a target; `samples` recorded since START, `time` of the bench clock, s."""

    boot: int
    state: TargetState
    samples: int
    time: float
    position: float
    current: float
    temperature: float
    text: str = ""

    _LAYOUT = struct.Struct("<IBIdddd")

    def __post_init__(self) -> None:
        object.__setattr__(self, "state", TargetState(self.state))


BEGIN = struct.Struct("<BI")
CHUNK = struct.Struct("<BI")
COMMIT = struct.Struct("<BII")
ARM = struct.Struct("<IdHB")
ARMED = struct.Struct("<IH")
READ = struct.Struct("<II")
DIGEST = struct.Struct("<II")
CRC32 = struct.Struct("<I")
FIRST = struct.Struct("<I")
NUMBER = struct.Struct("<d")


LINK_CHANNELS = (
    *("time", "position_setpoint", "encoder", "current_setpoint", "current"),
    *("feedforward_current", "table_current", "signal_current"),
    *("temperature", "force", "rotor_angle", "deflection"),
)
"""Channels by the number of their bit. New ones go to the end: firmware knows the numbers."""


def mask_of(channels: Iterable[str]) -> int:
    """Return channels as bits; those that the link does not know are left out."""
    wanted = set(channels)
    return sum(1 << bit for bit, name in enumerate(LINK_CHANNELS) if name in wanted)


def channels_of(mask: int) -> tuple[str, ...]:
    """Return the channels of a mask, in the order of their bits."""
    return tuple(name for bit, name in enumerate(LINK_CHANNELS) if mask >> bit & 1)


def recorded_under(load: Load) -> int:
    """Return the channels, as bits, that mean something under a load."""
    left_out = set()
    if not load.clamped:
        left_out |= {"force", "rotor_angle"}
    if not load.radial_force:
        left_out.add("deflection")
    return mask_of(set(LINK_CHANNELS) - left_out)


def sample_type(mask: int) -> np.dtype[np.void]:
    """Return how a sample lies in the log: its channels in order, without gaps."""
    return np.dtype([(name, "<" + CHANNELS[name][1]) for name in channels_of(mask)])


# -- objects


@dataclass(frozen=True)
class RigSetup(Message):
    """The rig as a target needs it, in slot RIG; `use` names the command."""

    torque_constant: float
    sample_time: float
    encoder_counts: int
    current_limit: float
    instrument: bool
    use: str

    _LAYOUT = struct.Struct("<dddd?")

    def __post_init__(self) -> None:
        object.__setattr__(self, "encoder_counts", int(self.encoder_counts))


def pack_limits(limits: Limits, watchdog: float) -> bytes:
    """Return the object of slot LIMITS."""
    return floats(
        limits.current,
        limits.speed,
        *limits.position,
        limits.temperature_degc,
        limits.duration,
        watchdog,
    )


def unpack_limits(data: bytes) -> tuple[Limits, float]:
    """Read the object of slot LIMITS."""
    current, speed, low, high, temperature, duration, watchdog = read_floats(data, 7)
    limits = Limits(
        current=current,
        speed=speed,
        position=(low, high),
        temperature_degc=temperature,
        duration=duration,
    )
    return limits, watchdog


def pack_feedforward(feedforward: Feedforward) -> bytes:
    """Return the object of slot FEEDFORWARD."""
    return floats(feedforward.inertia, feedforward.coulomb, feedforward.viscous)


def pack_load(load: Load) -> bytes:
    """Return the object of slot LOAD."""
    return floats(load.force, load.torque, load.radial_force, float(load.clamped))


def unpack_load(data: bytes) -> Load:
    """Read the object of slot LOAD."""
    force, torque, radial_force, clamped = read_floats(data, 4)
    return Load(force, torque, radial_force, bool(clamped))


_SIZES = struct.Struct("<III")


def pack_table(table: LookupTable | None) -> bytes:
    """Return the object of slot TABLE; nothing for no table."""
    if table is None:
        return b""
    sizes = (table.position.size, table.speed.size, table.low_speed.size)
    parts = (table.position, table.speed, table.low_speed, table.amplitude, table.torque.ravel())
    return _SIZES.pack(*sizes) + floats(*np.concatenate(parts))


def unpack_table(data: bytes) -> LookupTable | None:
    """Read the object of slot TABLE."""
    if not data:
        return None
    n, m, k = _unpack(_SIZES, data)
    values = read_floats(data[_SIZES.size :], n + m + 2 * k + n * m)
    position, speed, low_speed, amplitude, torque = np.split(
        values, np.cumsum([n, m, k, k]).tolist()
    )
    return LookupTable(position, speed, torque.reshape(m, n), low_speed, amplitude)


def pack_motion(motion: Motion | OpenLoop | Observe) -> bytes:
    """Return the object of slot MOTION: a byte for its kind, then its numbers.

    Raises `TypeError` for a motion that the link does not know.
    """
    match motion:
        case SpeedProfile():
            return b"\1" + floats(*motion.times, *motion.speeds)
        case Triangle():
            turn = (motion.low, motion.high, motion.speed, motion.turn_angle, motion.cycles)
            return b"\2" + floats(*turn)
        case Move():
            return b"\3" + floats(motion.angle, motion.duration)
        case CurrentSteps():
            return b"\4" + floats(motion.step_time, *motion.levels)
        case CurrentRamp():
            return b"\5" + floats(motion.rate, motion.limit)
    raise TypeError(f"{type(motion).__name__} has no place in the link")


def unpack_motion(data: bytes) -> Motion | OpenLoop:
    """Read the object of slot MOTION; `ValueError` for one that the link does not know."""
    values = read_floats(data[1:]).tolist()
    match data[:1], len(values):
        case b"\1", count if count >= 4 and count % 2 == 0:
            return SpeedProfile(tuple(values[: count // 2]), tuple(values[count // 2 :]))
        case b"\2", 5:
            low, high, speed, turn_angle, cycles = values
            return Triangle(low, high, speed, turn_angle, int(cycles))
        case b"\3", 2:
            return Move(*values)
        case b"\4", count if count >= 2:
            return CurrentSteps(tuple(values[1:]), values[0])
        case b"\5", 2:
            return CurrentRamp(*values)
    raise ValueError(f"motion {data[:1].hex()} with {len(values)} numbers is not known")


def floats(*values: float) -> bytes:
    """Return numbers as f8."""
    return np.array(values, "<f8").tobytes()


def read_floats(data: bytes, count: int | None = None) -> Array:
    """Return the numbers that `floats` packed; ValueError unless all, or `count`, are finite."""
    if len(data) % 8 or (count is not None and len(data) != 8 * count):
        wanted = "a multiple of 8" if count is None else f"{8 * count}"
        raise ValueError(f"{len(data)} bytes of numbers, not {wanted}")
    values = np.frombuffer(data, "<f8").astype(np.float64)
    if not np.isfinite(values).all():
        raise ValueError("a number is not finite")
    return values


def _unpack(layout: struct.Struct, payload: bytes) -> tuple[Any, ...]:
    if len(payload) < layout.size:
        raise DamagedReply(f"{len(payload)} bytes where at least {layout.size} belong")
    return layout.unpack_from(payload)
