"""Staircases on a clamped arm, from physics: quasi-static Dahl friction, heat, ripple, noise."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter

from rigtool.experiments.torque_constant.staircases.plateaus import Plateaus, plateaus_of_set_point
from rigtool.numerics.compiled import compiled_allocating

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Bench:
    """A motor with known constants on an arm; everything an ideal instrument would not show."""

    torque_constant: float = 45.8e-3  # at 20 degC
    coefficient: float = -1.16e-3
    friction: float = 2.0e-3
    stiffness: float = 15.0  # of the arm, N m/rad
    presliding_angle: float = 8e-4
    exponent: float = 1.0  # of Dahl's law
    asymmetry: float = 0.0  # of friction, larger where torque rises
    ripple: tuple[float, ...] = (0.004, 0.004, 0.001)  # relative, by order from the first
    saturation: float = 0.002  # relative, 1/A, third order
    amplifier_gain: float = 1.0
    amplifier_offset: float = 1e-3
    cogging: float = 0.0  # N m, of order 2
    cubic: float = 0.0  # fault of the amplifier, 1/A2
    heating: float = 0.022  # of the winding, K/(A2 s)
    time_constant: float = 29.0
    housing_drift: float = -0.01  # K/s
    housing_share: float = 0.0  # heat capacity of the winding over the housing's
    sensor_lag: float = 0.0  # of the thermometer, s
    arm_length: float = 0.54
    force_noise: float = 5e-4
    current_noise: float = 3e-4
    sample_time: float = 4e-3
    step_time: float = 0.2
    settle_time: float = 0.08

    def record(
        self,
        temperatures: tuple[float, ...] = (20, 30, 40, 50),
        angles: int = 8,
        levels: Array | None = None,
        *,
        shifted: bool = True,
        seed: int = 0,
    ) -> dict[str, Array]:
        """Return the channels of a recording with one staircase at each temperature and angle."""
        rng = np.random.default_rng(seed)
        if levels is None:
            up = np.linspace(0, 4, 11)
            levels = np.concatenate([[0.0], np.tile(np.concatenate([up[1:], up[-2::-1]]), 2)])
        parts, clock = [], 0.0
        for number, temperature in enumerate(temperatures):
            for k in range(angles):
                shift = number / len(temperatures) if shifted else 0.0
                angle = 2 * np.pi * (k + shift) / angles
                part = self._staircase(levels, temperature, angle, clock, rng)
                clock = part["time"][-1] + 600.0
                parts.append(part)
        return {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}

    def _staircase(
        self, levels: Array, degc: float, angle: float, clock: float, rng: np.random.Generator
    ) -> dict[str, Array]:
        per_step = round(self.step_time / self.sample_time)
        setpoint = np.repeat(levels, per_step)
        n = len(setpoint)
        time = np.arange(n) * self.sample_time
        current = self.amplifier_gain * setpoint * (1 + self.cubic * setpoint**2)
        current = current + self.amplifier_offset
        housing = degc + self.housing_drift * time
        excess, warmed = self._heat(current)
        winding = housing + warmed + excess
        constant = self.torque_constant * (1 + self.coefficient * (winding - 20))
        gain = 1 + sum(a * np.cos((k + 1) * angle + k) for k, a in enumerate(self.ripple))
        gain = gain + self.saturation * np.cos(3 * angle) * np.abs(current)
        position = np.zeros(n)
        for _ in range(3):  # cogging is that where the arm has given way
            drive = constant * current * gain + self.cogging * np.sin(2 * (angle + position))
            torque = self._arm_torque(drive[per_step - 1 :: per_step], per_step)
            position = torque / self.stiffness
        torque = torque + (drive - np.repeat(drive[per_step - 1 :: per_step], per_step))
        return {
            "time": clock + time,
            "rotor_angle": np.full(n, angle),
            "position": position,
            "current_setpoint": setpoint,
            "current": current + self.current_noise * rng.standard_normal(n),
            "force": torque / self.arm_length + self.force_noise * rng.standard_normal(n),
            "temperature": housing + self._sensed(warmed) + 0.03 * rng.standard_normal(n),
        }

    def _sensed(self, warmed: Array) -> Array:
        """Return the thermometer's part of what warms the housing, K."""
        if self.sensor_lag == 0:
            return warmed
        kept = np.exp(-self.sample_time / self.sensor_lag)
        return np.asarray(lfilter([1 - kept], [1, -kept], warmed))

    def _heat(self, current: Array) -> Array:
        thermal = (self.heating, self.time_constant, self.housing_drift, self.housing_share)
        return _heat(current, *thermal, self.sample_time)

    def _arm_torque(self, drive: Array, per_step: int) -> Array:
        arm = (self.friction, self.stiffness, self.presliding_angle, self.exponent)
        arm = (*arm, self.asymmetry)
        return np.repeat(_arm_torque(drive, *arm), per_step)


@compiled_allocating
def _heat(
    current: Array,
    heating: float,
    time_constant: float,
    housing_drift: float,
    housing_share: float,
    sample_time: float,
) -> Array:
    """Return by how much the winding is above the housing, and what that warms the housing."""
    found = np.zeros((2, len(current)))
    for j in range(1, len(current)):
        excess, warmed = found[:, j - 1]
        rise = housing_share * excess / time_constant
        change = heating * current[j] ** 2 - excess / time_constant
        change -= housing_drift + rise  # the winding lags behind the housing
        found[0, j] = excess + sample_time * change
        found[1, j] = warmed + sample_time * rise
    return found


@compiled_allocating
def _arm_torque(
    drive: Array,
    friction: float,
    stiffness: float,
    presliding_angle: float,
    exponent: float,
    asymmetry: float,
) -> Array:
    """Move the arm in small steps until drive = arm torque + friction at each level."""
    bristle, deflection, torque = 0.0, 0.0, np.empty(len(drive))
    step = presliding_angle / 200
    for k, target in enumerate(drive):
        held = friction * bristle * (1 + asymmetry * bristle)
        direction = 1.0 if target > stiffness * deflection + held else -1.0
        while (target - stiffness * deflection - held) * direction > 0:
            deflection += direction * step
            left = max(1 - direction * bristle, 0.0) ** exponent
            bristle += step / presliding_angle * direction * left
            held = friction * bristle * (1 + asymmetry * bristle)
        torque[k] = target - held
    return torque


def plateaus_in(signals: dict[str, Array], settle_time: float = Bench.settle_time) -> Plateaus:
    """Return the plateaus of what a bench has recorded."""
    return plateaus_of_set_point(**signals, arm_length=Bench.arm_length, settle_time=settle_time)
