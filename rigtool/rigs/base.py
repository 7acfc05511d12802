"""The Rig protocol: where signals come from, simulated or measured.

A rig performs tasks and yields blocks of signals; it knows nothing of experiments or files.
Channels and their units are fixed here, so that run files of all rigs read alike.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Generator
from dataclasses import dataclass
from typing import Any, Protocol, Self

import numpy as np

from rigtool.control.lookup_table import LookupTable
from rigtool.numerics.arrays import Array
from rigtool.rigs.motion import Motion, Observe, OpenLoop

Block = dict[str, Array]
"""Equal-length arrays by channel name, `time` among them."""

NEED_DESCRIPTIONS = {
    "closed_loop": "follow a set point of position",
    "open_loop": "follow a current with the position loop open",
    "observe": "record while a hand or another controller moves it",
    "feedforward": "add a torque that is computed from the set point",
    "table": "add a learned table",
    "signal": "add a torque signal sample by sample",
    "held_current": "hold its current from one sample to the next",
    "load": "hang a load, or pull at the shaft",
    "clamp": "clamp the arm on the force gauge",
    "soak": "bring the motor to a temperature",
    "power_cycle": "switch the amplifier off and on",
}
"""Abilities that a command may need beside channels, see `Rig.lacks`."""


def model_torque(coefficients: tuple[float, float, float], speed: Any, acceleration: Any) -> Any:
    """Return the torque of `Feedforward.coefficients`, for one sample or for n of them."""
    inertia, coulomb, viscous = coefficients
    torque = inertia * acceleration + viscous * speed
    if coulomb != 0.0:
        torque = torque + coulomb * np.tanh(speed)
    return torque


@dataclass(frozen=True)
class Feedforward:
    """Torque added to the controller's output, computed from the set point [Fig. 31, 33, 36].

    torque = inertia * a + coulomb * tanh(v / (1 rad/s)) + viscous * v + table(position, v)
    + signal(t), N m. `signal` (n,) N m holds one value a sample of the loop; it starts with the
    task and repeats: an excitation, or the torque learned along a trajectory [Fig. 37].
    """

    inertia: float = 0.0
    coulomb: float = 0.0
    viscous: float = 0.0
    table: LookupTable | None = None
    signal: Array | None = None

    @property
    def coefficients(self) -> tuple[float, float, float]:
        """Inertia, Coulomb and viscous friction."""
        return self.inertia, self.coulomb, self.viscous

    def model_torque(self, speed: Array, acceleration: Array) -> Array:
        """Return the torque (n,) of inertia and friction model, N m; rad/s and rad/s2 (n,)."""
        return model_torque(self.coefficients, speed, acceleration)


@dataclass(frozen=True)
class Load:
    """External loads on the rig.

    `force` hangs on the output (grasper or pulley), N; `torque` is constant on the motor shaft,
    N m (a weight on a cord around the pulley); `radial_force` pulls on the shaft sideways, N;
    `clamped` holds the shaft by the arm on the force gauge.
    """

    force: float = 0.0
    torque: float = 0.0
    radial_force: float = 0.0
    clamped: bool = False


@dataclass(frozen=True)
class Task:
    """One motion that is recorded.

    Each recorded sample is the mean of `record_every` samples of the loop. An open-loop task ends
    early once the shaft has turned by `stop_angle` rad, where that is given. Where it is `touched`,
    objects may touch the output meanwhile, unknown to the program, and a rig that knows the true
    torque records it as `reference_torque`: the torque on the output [N m] of all that
    hangs on it or touches it, positive where it resists positive motion, with the inertia of the
    hanging load.
    """

    motion: Motion | OpenLoop | Observe
    feedforward: Feedforward = Feedforward()
    load: Load = Load()
    record_every: int = 1
    stop_angle: float | None = None
    touched: bool = False

    @property
    def start(self) -> float | None:
        """Position at which the motion starts, rad; None where from wherever the rotor is."""
        if isinstance(self.motion, OpenLoop | Observe):
            return None
        return self.motion.start


class Rig(Protocol):
    """A motor, an encoder and a current amplifier under position control.

    A context manager: however the `with` block ends, the motor has no current afterwards. Methods
    that only a physical rig needs do nothing here; a simulated rig inherits them.
    """

    physical: bool = False
    """Whether something real moves: a plan of the motions is agreed to first, and time passes."""

    watcher: Callable[[Block], None] | None = None
    """Receives the status during a motion, where signals come later; it must not block."""

    streams: bool = False
    """Whether `watcher` receives every sample, with all channels, while the motion runs."""

    def __enter__(self) -> Self:
        """Connect; nothing moves."""
        return self

    def __exit__(self, kind: object, error: BaseException | None, trace: object) -> None:
        """Stop, switch off and release the line."""
        return None

    def lacks(self, need: str) -> str | None:
        """Return the reason why one of `NEED_DESCRIPTIONS`, or a channel, is not offered; None
        where it is offered."""
        return None

    def use_only(self, channels: Collection[str]) -> None:
        """Ignore instruments that fill none of these channels; called before `with`."""
        return None

    def permit(self, plan: str) -> None:
        """Show the planned motions; raises `UsageError` without consent."""
        return None

    def report(self) -> str | None:
        """Return facts about the line that are stored with a run, as JSON; None without a line."""
        return None

    @property
    def position(self) -> float:
        """Angle of the shaft, rad."""

    def perform(self, task: Task) -> Generator[Block, None, None]:
        """Run a task and yield its signals in blocks; moves to the motion's start first.

        Closed before its end, the motion ends: the motor has no current until the next one.
        """

    def move_by(self, angle: float) -> None:
        """Turn the shaft by an angle, rad, and come to rest; nothing is recorded."""

    def clamp(self, angle: float) -> None:
        """Clamp the arm with the shaft at this angle, rad."""

    def soak(self, temperature_degc: float) -> None:
        """Wait until the motor has this temperature throughout, degC."""

    def power_cycle(self) -> None:
        """Switch the amplifier off and on: it calibrates itself again."""
