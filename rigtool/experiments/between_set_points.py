"""What samples do not tell of the current, where a loop is driven by set points one by one.

The rig reads the current also between its set points (`rigs.serial.between`) and keeps the mean
difference by speed with the record of its line. It is nothing where the drive follows evenly. Where
it is not, it acts as friction does: against the motion, more with speed.
"""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rigtool.errors import InsufficientDataError
from rigtool.runfile import Recording, Run

Array = NDArray[np.float64]

SEEN = 3.0
"""A difference is worth a remark from this multiple of its standard uncertainty on."""

SAME_SPEED = 0.02
"""Part by which a speed may differ from that of readings which tell about it."""

LIMIT = 0.1
"""Part of what is to be measured that samples may lack: beyond, there is no result."""

SAMPLES = 8192
"""Samples that the step of the current is taken from."""

ROUNDING = 1e-9
"""Currents that differ by less are the same, A."""

REMEDY = "set rig.sample_time shorter, or turn more slowly"


@dataclass(frozen=True)
class Lacking:
    """By speed, all (n,): rad/s; A that samples lack along the motion, and its uncertainty.

    `known` says whether the rig looked; `stepping`, whether it had to follow steps of position.
    """

    speed: Array
    current: Array
    u: Array
    known: bool
    stepping: bool

    @classmethod
    def of(cls, runs: Sequence[Run]) -> Lacking:
        """Take it from the records of the lines; rigs without such a loop lack nothing."""
        lines = [json.loads(run.provenance.get("line") or "{}") for run in runs]
        found = [item for line in lines for item in line.get("between_set_points", ())]
        return cls(
            speed=np.array([item["speed"] for item in found]),
            current=np.array([item["lacking_current"] for item in found]),
            u=np.array([item["u"] for item in found]),
            known=bool(found),
            stepping=any(line.get("steps_in_position") for line in lines),
        )

    @property
    def whole(self) -> Array:
        """What samples lack and what is not known of it, together, with its sign (n,), A."""
        return np.copysign(np.hypot(self.current, self.u), self.current)

    def at(self, speed: float) -> float:
        """Return what samples at a speed lack with what is not known of it, A.

        Raises `InsufficientDataError` where it would matter and was not looked at.
        """
        near = np.abs(self.speed - speed) <= SAME_SPEED * speed
        if near.any():
            return float(self.whole[near][np.argmax(np.abs(self.whole[near]))])
        if self.stepping:
            raise InsufficientDataError(
                "the drive followed steps of position, each of which makes a step of current, and "
                f"what that does to samples at {speed:.3g} rad/s was not looked at often enough: "
                "hold this speed for longer"
            )
        return 0.0

    def line(self, torque_constant: float) -> tuple[float, float]:
        """Return what is missing in Coulomb [N m] and viscous friction [N m s/rad]."""
        if not self.whole.any():
            return 0.0, 0.0
        if self.speed.size < 2 or math.isclose(self.speed.min(), self.speed.max()):
            return torque_constant * float(self.whole.mean()), 0.0
        slope, start = np.polyfit(self.speed, torque_constant * self.whole, 1)
        return float(start), float(slope)


def remark(runs: Sequence[Run], torque_constant: float) -> tuple[str, ...]:
    """Say of what is found in samples that it lacks, at most so much, what flows between them."""
    lacking = Lacking.of(runs)
    seen = np.abs(lacking.current) > SEEN * lacking.u
    if not seen.any():
        return ()
    most = int(np.argmax(np.where(seen, np.abs(lacking.current), 0.0)))
    current, speed = float(lacking.current[most]), float(lacking.speed[most])
    return (
        f"current between set points differs by up to {current * 1e3:.3g} mA from that of the "
        f"samples, {abs(torque_constant * current) * 1e3:.3g} mN m, at {speed:.3g} rad/s: what is "
        f"found in the samples is off by that; {REMEDY}",
    )


def resolution(recording: Recording, averaged: int) -> float:
    """Return the steps in which a drive tells its set point of current, A.

    The smallest difference of two values, times how many were averaged into each: of a number with
    many digits that is next to nothing. Its standard uncertainty is step / sqrt(12) (GUM F.2.2.1):
    a current that stays within a step tells no more, however long it is averaged.
    """
    current = recording.read("current_setpoint", 0, min(recording.size, SAMPLES))
    apart = np.diff(np.unique(current))
    apart = apart[apart > ROUNDING]
    return averaged * float(apart.min()) if apart.size else 0.0
