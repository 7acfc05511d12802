"""A shaft with inertia and friction behind an emulated drive, turning in real time."""

from __future__ import annotations

import math
import time
from dataclasses import dataclass, field

INTEGRATION_STEP = 2e-4
"""Longest step of integration, s."""


@dataclass
class EmulatedMotor:
    """J dw/dt = Kt i - load - fc sign(w) - fv w; SI units. Current follows, up to its limit.

    `gain_position` (rad/s)/rad and `gain_speed` A/(rad/s) close the drive's loops. `load` N m is
    that of a weight, which is held by hand while the power stage is off.
    """

    inertia: float = 1.5e-5
    torque_constant: float = 0.045
    coulomb: float = 2.3e-3
    viscous: float = 5e-5
    load: float = 0.0
    gain_position: float = 60.0
    gain_speed: float = 0.06
    current_limit: float = 10.0
    position: float = 0.0
    speed: float = 0.0
    current: float = 0.0
    current_setpoint: float = 0.0
    _then: float = field(default_factory=lambda: time.monotonic())

    def advance(
        self,
        mode: str | None,
        position: float,
        speed: float,
        current: float,
        *,
        moving: bool = False,
    ) -> None:
        """Advance to now under a set point: `mode` position, velocity, current, or None for off.

        In position and velocity mode `current` [A] is added to the demand of the loops. `moving`:
        the set point has moved to `position` at `speed`, instead of being there all the time.
        """
        now = time.monotonic()
        span, self._then = now - self._then, now
        steps = max(1, math.ceil(min(span, 1.0) / INTEGRATION_STEP))
        dt = min(span, 1.0) / steps
        for step in range(steps):
            # Shaft and set point of one and the same time: that of a step's end would ask for a
            # current that depends on how long the step is.
            behind = (steps - step) * dt * speed if moving else 0.0
            self._step(dt, mode, position - behind, speed, current)

    def _step(
        self, dt: float, mode: str | None, position: float, speed: float, current: float
    ) -> None:
        turning, limit = self.speed, self.current_limit
        asked = 0.0 if mode is None else current
        if mode is not None and mode != "current":
            wanted = speed
            if mode == "position":
                wanted += self.gain_position * (position - self.position)
            asked += self.gain_speed * (wanted - turning)
        # Comparisons: a call of min or max takes as long as all else here
        asked = limit if asked > limit else -limit if asked < -limit else asked
        self.current_setpoint = self.current = asked
        torque = self.torque_constant * asked - self.viscous * turning
        torque -= self.load if mode is not None else 0.0
        # Coulomb friction brakes, and never turns the shaft backwards
        free = turning + dt * torque / self.inertia
        left = abs(free) - dt * self.coulomb / self.inertia
        self.speed = math.copysign(left, free) if left > 0.0 else math.copysign(0.0, free)
        self.position += dt * self.speed
