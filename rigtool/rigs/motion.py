"""Motions of the motor shaft: set point of position, speed and acceleration at any sample.

A motion is a description, not an array: it is evaluated block by block, so that an hour at 8 kHz
needs no more memory than a second. Angles in rad at the motor, speeds in rad/s, times in s.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import ClassVar, Protocol

import numpy as np

from rigtool.numerics.arrays import Array


class Motion(Protocol):
    """A closed-loop motion: the path of the controller's set-point generator."""

    @property
    def duration(self) -> float:
        """Length of the motion, s."""
        ...

    @property
    def start(self) -> float | None:
        """Position at which it starts, rad; None where it starts from wherever the rotor is."""
        ...

    def setpoint(self, time: Array) -> tuple[Array, Array, Array]:
        """Return position [rad], speed [rad/s] and acceleration [rad/s2] at these times [s].

        Positions count from `start`, or from the rotor's position where `start` is None.
        """
        ...


@dataclass(frozen=True)
class SpeedProfile:
    """Speed that runs linearly from point to point; sweeps and holds are made of it."""

    times: tuple[float, ...]
    speeds: tuple[float, ...]
    start: ClassVar[None] = None

    @property
    def duration(self) -> float:
        """Length of the motion, s."""
        return self.times[-1]

    @cached_property
    def _pieces(self) -> tuple[Array, Array, Array, Array]:
        """Return times, speeds, slopes and angles travelled at the beginnings of the pieces."""
        times, speeds = np.asarray(self.times), np.asarray(self.speeds)
        steps = np.diff(times)
        travelled = np.concatenate([[0.0], np.cumsum(steps * (speeds[1:] + speeds[:-1]) / 2)])
        return times, speeds, np.diff(speeds) / steps, travelled

    def setpoint(self, time: Array) -> tuple[Array, Array, Array]:
        """Integrate the piecewise linear speed exactly; see `Motion.setpoint`."""
        times, speeds, slopes, travelled = self._pieces
        piece = np.clip(np.searchsorted(times, time, side="right") - 1, 0, len(slopes) - 1)
        elapsed = time - times[piece]
        acceleration = slopes[piece]
        speed = speeds[piece] + acceleration * elapsed
        position = travelled[piece] + (speeds[piece] + acceleration * elapsed / 2) * elapsed
        return position, speed, acceleration


@dataclass(frozen=True)
class Triangle:
    """To and fro between two positions at constant speed, reversing smoothly [7.2.4.2, 8.1].

    Each reversal takes `turn_angle` on either side: the acceleration follows a sine arch, so that
    it neither starts nor ends with a jump. Starts at `low`, at rest in the middle of a reversal.
    """

    low: float
    high: float
    speed: float
    turn_angle: float
    cycles: int

    @property
    def turn_time(self) -> float:
        """Time from standstill to full speed, s; the angle covered meanwhile is `turn_angle`."""
        # speed(t) = v sin2(pi t / 2 T) covers v T / 2
        return 2 * self.turn_angle / self.speed

    @property
    def stroke_time(self) -> float:
        """Time of one stroke from end to end, s."""
        straight = self.high - self.low - 2 * self.turn_angle
        return straight / self.speed + 2 * self.turn_time

    @property
    def duration(self) -> float:
        """Length of the motion, s."""
        return 2 * self.cycles * self.stroke_time

    @property
    def start(self) -> float:
        """Starts at the lower end."""
        return self.low

    def setpoint(self, time: Array) -> tuple[Array, Array, Array]:
        """See `Motion.setpoint`."""
        stroke, turn, v = self.stroke_time, self.turn_time, self.speed
        number = np.floor(time / stroke)
        within = time - number * stroke
        # Falling strokes are rising ones mirrored; a remainder would take a third of the time.
        sign = 1.0 - 2.0 * (number - 2.0 * np.floor(number / 2.0))
        # A stroke is symmetric about its middle: count time and travel from there.
        late = within - stroke / 2
        straight = stroke / 2 - turn
        travelled = v * late
        speed = np.full(len(time), float(v))
        acceleration = np.zeros(len(time))
        turning = np.flatnonzero(np.abs(late) > straight)
        end = np.sign(late[turning])
        phase = np.pi / turn * (stroke / 2 - np.abs(late[turning]))  # 0 where it stands still
        sine = np.sin(phase)
        rest = v * turn / (2 * np.pi) * (phase - sine)  # still to go, or gone since the reversal
        travelled[turning] = end * ((self.high - self.low) / 2 - rest)
        speed[turning] = v * (1 - np.cos(phase)) / 2
        acceleration[turning] = -end * v * np.pi / (2 * turn) * sine
        middle = (self.high - self.low) / 2
        return middle + sign * travelled, sign * speed, sign * acceleration


@dataclass(frozen=True)
class Move:
    """One smooth move over an angle, at rest at both ends (minimum-jerk polynomial)."""

    angle: float
    duration: float
    start: ClassVar[None] = None

    def setpoint(self, time: Array) -> tuple[Array, Array, Array]:
        """See `Motion.setpoint`."""
        s = np.clip(time / self.duration, 0.0, 1.0)
        # Products: how a power is rounded depends on the processor.
        position = self.angle * (s * s * s) * (10 - 15 * s + 6 * (s * s))
        speed = self.angle / self.duration * 30 * (s * s) * ((1 - s) * (1 - s))
        acceleration = self.angle / self.duration**2 * 60 * s * (1 - s) * (1 - 2 * s)
        return position, speed, acceleration


@dataclass(frozen=True)
class CurrentSteps:
    """Open loop: a staircase of currents, each level held for `step_time`."""

    levels: tuple[float, ...]
    step_time: float

    @property
    def duration(self) -> float:
        """Length of the staircase, s."""
        return len(self.levels) * self.step_time

    def current(self, time: Array) -> Array:
        """Return the current set point at these times, A."""
        # A level begins exactly at its sample, whatever the rounding of time / step_time.
        step = np.floor(time / self.step_time + 1e-9).astype(np.int64)
        return np.asarray(self.levels)[np.clip(step, 0, len(self.levels) - 1)]


@dataclass(frozen=True)
class CurrentRamp:
    """Open loop: current from zero with constant slope up to a limit, A/s and A."""

    rate: float
    limit: float

    @property
    def duration(self) -> float:
        """Time to the limit, s."""
        return abs(self.limit / self.rate)

    def current(self, time: Array) -> Array:
        """Return the current set point at these times, A."""
        return self.rate * time


OpenLoop = CurrentSteps | CurrentRamp


@dataclass(frozen=True)
class Observe:
    """rigtool moves nothing: for `duration` s a hand or another controller may move the rig.

    Signals are recorded as far as they can be read without control of the rig: time, encoder,
    current, the current set point where the amplifier shows it, temperature; no set point of
    position.
    """

    duration: float
