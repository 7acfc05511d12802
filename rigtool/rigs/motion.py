"""Motions of the motor shaft: set point of position, speed and acceleration at any sample.

A motion is a description, not an array: it is evaluated block by block, so that an hour at 8 kHz
needs no more memory than a second. Angles in rad at the motor, speeds in rad/s, times in s.

A path is described by pieces, (k, 9): from BEGIN on, with s the time since then,

    position = c0 + c1 s + c2 s2 + c3 s3 + c4 s4 + c5 s5 + AMPLITUDE sin(OMEGA s)

The simulation evaluates it sample by sample, everything else for arrays of times, both by `follow`.
"""

from __future__ import annotations

import math
from bisect import bisect_right
from dataclasses import dataclass
from functools import cached_property
from typing import Any, ClassVar, Protocol

import numpy as np

from rigtool.numerics.arrays import Array

BEGIN, AMPLITUDE, OMEGA = 0, 7, 8
"""Columns of a piece; c0 to c5 are those between."""


def follow(piece: Any, since: Any, sine: Any, cosine: Any) -> tuple[Any, Any, Any]:
    """Return position, speed and acceleration `since` s after a piece began.

    `piece` is (9,) for one time, (9, n) for n times; `sine` and `cosine` are those of OMEGA since.
    """
    c0, c1, c2, c3, c4, c5 = piece[1], piece[2], piece[3], piece[4], piece[5], piece[6]
    amplitude, omega = piece[7], piece[8]
    position = c0 + since * (c1 + since * (c2 + since * (c3 + since * (c4 + since * c5))))
    speed = c1 + since * (2 * c2 + since * (3 * c3 + since * (4 * c4 + since * 5 * c5)))
    acceleration = 2 * c2 + since * (6 * c3 + since * (12 * c4 + since * 20 * c5))
    return (
        position + amplitude * sine,
        speed + amplitude * omega * cosine,
        acceleration - amplitude * omega * omega * sine,
    )


def pieces_of(begin: Array, *coefficients: Any) -> Array:
    """Return pieces from where they begin (k,) and their coefficients, each (k,) or a number."""
    pieces = np.zeros((len(begin), 9))
    pieces[:, BEGIN] = begin
    for column, values in enumerate(coefficients, start=1):
        pieces[:, column] = values
    return pieces


class Path:
    """What is described by `pieces` (k, 9), which begin in rising order, the first at 0 or before;
    the last one goes on."""

    @cached_property
    def pieces(self) -> Array:
        """Return the pieces of the path."""
        raise NotImplementedError

    @cached_property
    def _listed(self) -> tuple[list[float], list[list[float]]]:
        """Return where the pieces begin, and the pieces, as lists."""
        return self.pieces[:, BEGIN].tolist(), self.pieces.tolist()

    def _at(self, now: float) -> tuple[float, float, float]:
        """Return position, speed and acceleration at one time."""
        begins, rows = self._listed
        row = rows[max(bisect_right(begins, now) - 1, 0)]
        since = now - row[BEGIN]
        phase = row[OMEGA] * since
        x, v, a = follow(row, since, math.sin(phase), math.cos(phase))
        return x, v, a

    def setpoint(self, time: Array) -> tuple[Array, Array, Array]:
        """See `Motion.setpoint`."""
        # As each period of a controller asks; arrays take ten times as long
        if 1 <= len(time) <= 2:
            found = np.array([self._at(now) for now in time.tolist()])
            return found[:, 0], found[:, 1], found[:, 2]
        number = np.searchsorted(self.pieces[:, BEGIN], time, side="right") - 1
        piece = self.pieces.T.take(np.maximum(number, 0), axis=1)
        since = time - piece[BEGIN]
        sine, cosine = np.zeros(len(time)), np.ones(len(time))
        arch = np.flatnonzero(piece[AMPLITUDE])
        phase = piece[OMEGA, arch] * since[arch]
        sine[arch], cosine[arch] = np.sin(phase), np.cos(phase)
        return follow(piece, since, sine, cosine)


class Motion(Protocol):
    """A closed-loop motion: the path of the controller's set-point generator."""

    @property
    def duration(self) -> float:
        """Length of the motion, s."""

    @property
    def start(self) -> float | None:
        """Position at which it starts, rad; None where it starts from wherever the rotor is."""

    def setpoint(self, time: Array) -> tuple[Array, Array, Array]:
        """Return position [rad], speed [rad/s] and acceleration [rad/s2] at these times [s].

        Positions count from `start`, or from the rotor's position where `start` is None.
        """


@dataclass(frozen=True)
class SpeedProfile(Path):
    """Speed that runs linearly from point to point; sweeps and holds are made of it."""

    times: tuple[float, ...]
    speeds: tuple[float, ...]
    start: ClassVar[None] = None

    @property
    def duration(self) -> float:
        """Length of the motion, s."""
        return self.times[-1]

    @cached_property
    def pieces(self) -> Array:
        """Parabolas: the integral of the piecewise linear speed, exactly."""
        times, speeds = np.asarray(self.times), np.asarray(self.speeds)
        steps, before, after = np.diff(times), speeds[:-1], speeds[1:]
        travelled = np.concatenate([[0.0], np.cumsum(steps * (after + before) / 2)[:-1]])
        lasts = steps > 0  # from a speed to the same one takes no time
        rate = (after - before)[lasts] / steps[lasts]
        return pieces_of(times[:-1][lasts], travelled[lasts], before[lasts], rate / 2)


@dataclass(frozen=True)
class Triangle(Path):
    """To and fro between two positions at constant speed, reversing smoothly [7.2.4.2, 8.1].

    Each reversal takes `turn_angle` on either side: the acceleration follows a sine arch, so that
    it neither starts nor ends with a jump. Starts at `low`, at rest in the middle of a reversal.
    """

    low: float
    high: float
    speed: float
    turn_angle: float
    cycles: int

    @classmethod
    def of_output(
        cls, angle_deg: float, turn_deg: float, ratio: float, speed: float, cycles: int
    ) -> Triangle:
        """Move from 0 over angles of the output, deg; `ratio` is the motor's angle to that."""
        high, turn = (math.radians(angle) * ratio for angle in (angle_deg, turn_deg))
        return cls(0.0, high, speed, turn, cycles)

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

    @cached_property
    def pieces(self) -> Array:
        """Of each stroke three: off, at constant speed, and to rest."""
        stroke, turn, v, span = self.stroke_time, self.turn_time, self.speed, self.high - self.low
        omega, half = np.pi / turn, v / 2
        off = [0.0, 0.0, half, 0, 0, 0, 0, -half / omega, omega]
        straight = [turn, self.turn_angle, v, 0, 0, 0, 0, 0, 0]
        rest = [stroke - turn, span - self.turn_angle, half, 0, 0, 0, 0, half / omega, omega]
        # A falling stroke is a rising one mirrored.
        fall = [-1.0, -1, -1, -1, -1, -1, -1, 1]
        pieces = np.tile(np.array([off, straight, rest]), (2 * self.cycles, 1, 1))
        pieces[:, :, BEGIN] += stroke * np.arange(2 * self.cycles)[:, None]
        pieces[1::2, :, 1:] *= fall
        pieces[1::2, :, 1] += span
        return pieces.reshape(-1, 9)


@dataclass(frozen=True)
class Move(Path):
    """One smooth move over an angle, at rest at both ends (minimum-jerk polynomial)."""

    angle: float
    duration: float
    start: ClassVar[None] = None

    @cached_property
    def pieces(self) -> Array:
        """The polynomial, and rest."""
        per_s = 1 / self.duration
        cube = self.angle * per_s * per_s * per_s
        moving = (0.0, 0.0, 0.0, 10 * cube, -15 * cube * per_s, 6 * cube * per_s * per_s)
        ends = ([here, end] for here, end in zip(moving, (self.angle, 0, 0, 0, 0, 0), strict=True))
        return pieces_of(np.array([0.0, self.duration]), *ends)


@dataclass(frozen=True)
class CurrentSteps(Path):
    """Open loop: a staircase of currents, each level held for `step_time`."""

    levels: tuple[float, ...]
    step_time: float

    @property
    def duration(self) -> float:
        """Length of the staircase, s."""
        return len(self.levels) * self.step_time

    @cached_property
    def pieces(self) -> Array:
        """Constant currents, A."""
        # A level begins exactly at its sample, whatever the rounding of its time.
        begin = (np.arange(len(self.levels), dtype=np.float64) - 1e-9) * self.step_time
        return pieces_of(begin, np.asarray(self.levels))

    def current(self, time: Array) -> Array:
        """Return the current set point at these times, A."""
        return self.setpoint(time)[0]


@dataclass(frozen=True)
class CurrentRamp(Path):
    """Open loop: current from zero with constant slope up to a limit, A/s and A."""

    rate: float
    limit: float

    @property
    def duration(self) -> float:
        """Time to the limit, s."""
        return abs(self.limit / self.rate)

    @cached_property
    def pieces(self) -> Array:
        """One straight line, A."""
        return pieces_of(np.zeros(1), 0.0, self.rate)

    def current(self, time: Array) -> Array:
        """Return the current set point at these times, A."""
        return self.setpoint(time)[0]


OpenLoop = CurrentSteps | CurrentRamp


@dataclass(frozen=True)
class Observe:
    """rigtool moves nothing: for `duration` s a hand or another controller may move the rig.

    Signals are recorded as far as they can be read without control of the rig: time, encoder,
    current, the current set point where the amplifier shows it, temperature; no set point of
    position.
    """

    duration: float
