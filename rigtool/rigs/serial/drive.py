"""The `Drive` protocol: a motor drive on a serial line on which the host runs motions."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal, Protocol

from rigtool.errors import HardwareError
from rigtool.recipe.serial import Limits

Mode = Literal["position", "velocity", "current"]

TURN = 2 * math.pi
RPM = TURN / 60
"""rad in a turn, and rad/s in one turn a minute."""


@dataclass(frozen=True)
class Abilities:
    """Abilities of a drive, known once it is connected.

    `channels` are those of a `Sample` that it fills: some of `current`, `current_setpoint`,
    `temperature`. Position is always there. `feedforward` states whether a current may be added in
    the modes `position` and `velocity`; `watchdog`, whether it stops by itself when the line falls
    silent. `moves_along`: in mode `position` the set point moves on at its speed until the next one
    comes; otherwise each set point is a step, which shows in the current. From the speed `lets_go`
    on, rad/s, the drive gives no more current by itself: known after `configure`.
    """

    modes: frozenset[Mode]
    feedforward: bool
    channels: frozenset[str]
    watchdog: bool = True
    moves_along: bool = False
    lets_go: float = math.inf


@dataclass(frozen=True)
class SetPoint:
    """A set point for a drive: rad and rad/s of the motor shaft, A.

    `current` is the whole in mode `current`, otherwise the added part (feed-forward). A drive that
    takes a torque multiplies it by its own torque constant, so that this current flows.
    """

    position: float = 0.0
    speed: float = 0.0
    current: float = 0.0


@dataclass(frozen=True)
class Sample:
    """Values measured by a drive, at `time` of `Line.now`; NaN for missing ones.

    rad (unwrapped, on the drive's own zero), rad/s, A, degC of the motor. Signs are such that a
    positive current pushes towards a rising position.
    """

    time: float
    position: float
    speed: float = math.nan
    current: float = math.nan
    current_setpoint: float = math.nan
    temperature: float = math.nan


def unwrapped(angle: float, speed: float, moment: float, then: Sample) -> tuple[float, float]:
    """Return an angle, rad, with the turns predicted by speed since an earlier sample, and the way.

    Speeds in rad/s, times in s; the way since then is in rad.
    """
    moved = (then.speed + speed) / 2 * (moment - then.time)
    turns = round((then.position + moved - angle) / TURN)
    return angle + TURN * turns, moved


def persist(
    act: Callable[[], None], attempts: int = 3, before_again: Callable[[], object] = lambda: None
) -> None:
    """Act; try again where that raises a `HardwareError`, which is raised at last."""
    for left in reversed(range(attempts)):
        try:
            return act()
        except HardwareError:
            if not left:
                raise
        before_again()
    return None


class Drive(Protocol):
    """A drive behind a `Line`. Each method may raise `HardwareError`; see `rigs.serial`."""

    def connect(self) -> str:
        """Identify the device and return it in a line: kind, firmware, serial number.

        Nothing moves and nothing changes. Raises `HardwareError` where something else answers, or
        a drive reports an error that its owner must examine.
        """

    @property
    def abilities(self) -> Abilities:
        """Abilities of the drive; known after `connect`."""

    def configure(self, limits: Limits, watchdog: float) -> list[str]:
        """Set limits and watchdog [s] in the drive; remember the previous values.

        Called again after a power cycle: `restore` restores the values of the first call.
        Returns the limits that the drive cannot watch, in words that continue "the drive", e.g.
        "has no limit of speed"; the host watches everything anyway.
        """

    def enable(self, mode: Mode) -> None:
        """Switch the power stage on in this mode, at rest at the shaft's position."""

    def step(self, setpoint: SetPoint) -> Sample:
        """Send a set point, reset the watchdog, and measure: once each period of the loop."""

    def read(self) -> Sample:
        """Measure, in any state of the drive; nothing moves."""

    def halt(self) -> None:
        """Stop at once and switch the power stage off, in any state of the drive.

        Called in any state, also twice, also after errors on the line: tries again by itself.
        """

    def restore(self) -> None:
        """Restore the settings that `configure` changed, if any; called after `halt`."""
