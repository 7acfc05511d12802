"""A motor held at constant speeds, from physics: friction, ripple, correlated noise, inertia."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

COUNT = 2 * np.pi / 4000


@dataclass(frozen=True)
class Motor:
    """Friction as in the module under test, and what disturbs its measurement."""

    coulomb: float = 2.3e-3
    viscous: float = 5.33e-5
    static: float = 4.0e-3
    stribeck_velocity: float = 0.3
    exponent: float = 2.0
    asymmetry: float = 0.0
    offset: float = 0.0
    ripple: float = 0.9e-3  # second order
    noise: float = 0.12e-3
    noise_time: float = 0.15
    inertia: float = 1.5e-5
    sample_time: float = 2e-3

    def friction(self, speed: Array) -> Array:
        """Return the torque that a constant speed takes."""
        size = np.abs(speed)
        level = self.coulomb + (self.static - self.coulomb) * np.exp(
            -((size / self.stribeck_velocity) ** self.exponent)
        )
        sign = np.sign(speed)
        return self.offset + sign * level * (1 + self.asymmetry * sign) + self.viscous * speed

    def follow(self, speed: Array, seed: int = 0) -> dict[str, Array]:
        """Return the signals of a shaft that follows a set point of speed (n,)."""
        rng = np.random.default_rng(seed)
        n = len(speed)
        angle = np.cumsum(speed) * self.sample_time
        # The speed loop answers a change of speed with a decaying oscillation.
        error = np.convolve(np.diff(speed, prepend=0.0), self._transient(), "full")[:n]
        torque = self.friction(speed) + self.ripple * np.cos(2 * angle + 0.7)
        torque = torque + self.inertia * np.gradient(speed, self.sample_time) + 0.02 * error
        keep = np.exp(-self.sample_time / self.noise_time)
        shocks = rng.standard_normal(n) * self.noise * np.sqrt(1 - keep**2)
        wander = np.zeros(n)
        for k in range(1, n):
            wander[k] = keep * wander[k - 1] + shocks[k]
        measured = np.floor((angle - error) / COUNT) * COUNT
        return {
            "time": np.arange(n) * self.sample_time,
            "angle": measured,
            "setpoint": angle,
            "torque": torque + wander,
        }

    def _transient(self) -> Array:
        t = np.arange(0, 0.4, self.sample_time)
        return 0.05 * np.exp(-t / 0.06) * np.sin(60 * t)

    def hold(self, speeds: list[float], turns: int = 3, seconds: float = 4.0, seed: int = 0):
        """Return the signals of holds, each for whole turns and at least some seconds."""
        parts, before = [np.zeros(100)], 0.0
        for speed in speeds:
            turn = 2 * np.pi / abs(speed)
            length = 0.6 + max(turns, np.ceil(seconds / turn)) * turn
            parts.append(np.linspace(before, speed, 60)[1:-1])
            parts.append(np.full(round(length / self.sample_time), speed))
            before = speed
        parts.append(np.linspace(before, 0.0, 60)[1:])
        return self.follow(np.concatenate(parts), seed)

    def sweep(self, top: float = 30.0, seconds: float = 60.0, seed: int = 0):
        """Return the signals of a run-up backwards and a sweep to full speed."""
        run_up = np.linspace(0, -top, round(1.0 / self.sample_time))
        rise = np.linspace(-top, top, round(seconds / self.sample_time))
        return self.follow(np.concatenate([run_up, rise]), seed)
