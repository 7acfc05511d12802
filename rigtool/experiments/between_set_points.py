"""Current that the samples miss, where the host sends the loop's set points one by one.

    unsampled current(speed) = mean current between set points - mean current of the samples

The rig also reads the current between its set points (`rigs.serial.hosted.between`) and stores the
mean difference by speed with the record of its line. The difference is zero where the drive follows
evenly. Elsewhere it acts as friction does: against the motion, and more at higher speed.
"""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from rigtool.errors import InsufficientDataError
from rigtool.numerics.arrays import Array
from rigtool.runfile import Run

REPORTED_FROM = 3.0
"""Multiple of its standard uncertainty from which on a difference is reported."""

READING_SPEED_TOLERANCE = 0.02
"""Readings between set points hold for speeds that differ from theirs by up to this part."""

UNSAMPLED_LIMIT = 0.1
"""Largest part of the measured quantity that the samples may miss; above it, no result."""

RESOLUTION_SAMPLES = 8192
"""Number of samples from which the step of the current is taken."""

CURRENT_ROUNDING = 1e-9
"""Currents that differ by less than this are equal, A."""

SET_POINT_REMEDY = "set rig.sample_time shorter, or turn more slowly"


@dataclass(frozen=True)
class UnsampledCurrent:
    """Current that the samples miss along the motion, by speed.

    `speed` (n,) in rad/s; `current` (n,) and its standard uncertainty `u` (n,) in A. `stepping`
    is true where the drive followed steps of position.
    """

    speed: Array
    current: Array
    u: Array
    stepping: bool

    @classmethod
    def of(cls, runs: Sequence[Run]) -> UnsampledCurrent:
        """Read it from the records of the serial lines; empty for rigs without such a loop."""
        lines = [json.loads(run.provenance.get("line") or "{}") for run in runs]
        found = [item for line in lines for item in line.get("between_set_points", ())]
        return cls(
            speed=np.array([item["speed"] for item in found]),
            current=np.array([item["lacking_current"] for item in found]),
            u=np.array([item["u"] for item in found]),
            stepping=any(line.get("steps_in_position") for line in lines),
        )

    @property
    def whole(self) -> Array:
        """Unsampled current with its uncertainty added in quadrature, signed, (n,) A."""
        return np.copysign(np.hypot(self.current, self.u), self.current)

    def at(self, speed: float) -> float:
        """Return the largest `whole` of the readings at a speed in rad/s, A; 0 without readings.

        Raises `InsufficientDataError` where the drive stepped and no reading is at this speed.
        """
        near = np.abs(self.speed - speed) <= READING_SPEED_TOLERANCE * speed
        if near.any():
            return float(self.whole[near][np.argmax(np.abs(self.whole[near]))])
        if self.stepping:
            raise InsufficientDataError(
                "the drive followed steps of position, each of which makes a step of current; the "
                f"current between the samples at {speed:.3g} rad/s was read too rarely to show how "
                "far the samples are off: hold this speed for longer"
            )
        return 0.0

    def line(self, torque_constant: float) -> tuple[float, float]:
        """Return the error in Coulomb friction, N m, and in viscous friction, N m s/rad."""
        if not self.whole.any():
            return 0.0, 0.0
        if self.speed.size < 2 or math.isclose(self.speed.min(), self.speed.max()):
            return torque_constant * float(self.whole.mean()), 0.0
        slope, start = np.polyfit(self.speed, torque_constant * self.whole, 1)
        return float(start), float(slope)


def unsampled_note(runs: Sequence[Run], torque_constant: float) -> tuple[str, ...]:
    """Return a note with the largest significant difference, none without one."""
    lacking = UnsampledCurrent.of(runs)
    seen = np.abs(lacking.current) > REPORTED_FROM * lacking.u
    if not seen.any():
        return ()
    most = int(np.argmax(np.where(seen, np.abs(lacking.current), 0.0)))
    current, speed = float(lacking.current[most]), float(lacking.speed[most])
    return (
        f"current between set points differs by up to {current * 1e3:.3g} mA from that of the "
        f"samples, {abs(torque_constant * current) * 1e3:.3g} mN m, at {speed:.3g} rad/s: results "
        f"from the samples are off by that; {SET_POINT_REMEDY}",
    )


def setpoint_resolution(current: Array, averaged: int) -> float:
    """Return the step in which a drive reports its current set point, A.

    The smallest difference of two recorded values (n,), A, times the number of samples `averaged`
    into each; next to zero for a drive that reports many digits. The standard uncertainty is
    step / sqrt(12) (GUM F.2.2.1), and averaging does not lower it while the current stays within
    one step.
    """
    apart = np.diff(np.unique(current[:RESOLUTION_SAMPLES]))
    apart = apart[apart > CURRENT_ROUNDING]
    return averaged * float(apart.min()) if apart.size else 0.0
