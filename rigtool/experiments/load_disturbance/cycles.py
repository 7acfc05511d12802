"""Superimposed cycles of a load [8.2], with all signals that a model of its disturbance needs.

All signals are on one period of a motion that repeats, so that the low-pass is a product with its
spectrum: without phase shift, ends or delay, and the same for what is measured and what is
modelled.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from rigtool.experiments.load_disturbance.tendon import contact
from rigtool.numerics.arrays import Array
from rigtool.numerics.moves import cut_moves
from rigtool.numerics.steady_mean import steady_mean

MOTION_HZ = 60.0
"""Cut-off of angle and current where they enter as they are: the encoder's steps lie above, a
loaded instrument's resonance below."""

FEWEST_POINTS = 256
"""Points of a period, at least: reversals take a small part of it."""

POINTS = 16
"""Points for each period of the low-pass."""


@dataclass(frozen=True)
class Transmission:
    """How a motor drives the output, by the recipe.

    `angle_ratio` motor angle per output angle, `torque_factor` output torque per motor torque,
    `inertia` on the motor shaft kg m2, `arm` where the load hangs m, `bandwidth_hz` of the reading.
    """

    angle_ratio: float
    torque_factor: float
    inertia: float
    arm: float
    bandwidth_hz: float


@dataclass(frozen=True, eq=False)
class LoadedCycles:
    """Cycles of one load on one period, s; it starts where the set point rises through its middle.

    `speed` rad/s of the motor's set point while it is constant, `torque_per_ampere` N m/A at the
    output. Over the period (n,): `setpoint` and `angle` of the rotor, rad, `rotor_speed` rad/s,
    `direction` of friction, `current` A. `torque` (cycles, n) N m is all that the motor puts out,
    less what its own inertia takes, at the output.
    """

    transmission: Transmission
    speed: float
    period: float
    torque_per_ampere: float
    setpoint: Array
    angle: Array
    rotor_speed: Array
    direction: Array
    current: Array
    torque: Array

    @property
    def output_angle(self) -> Array:
        """The rotor's angle at the output (n,), rad: the grasper's, were the tendon stiff."""
        angle: Array = self.angle / self.transmission.angle_ratio
        return angle

    @property
    def turning(self) -> Array:
        """Sign of the rotor's speed (n,)."""
        sign: Array = np.sign(self.rotor_speed)
        return sign

    @property
    def mean(self) -> Array:
        """Torque of the mean cycle (n,), N m, not low-passed."""
        return steady_mean(self.torque)

    def lowpass(self, signals: Array) -> Array:
        """Low-pass signals (..., n) on the period at the bandwidth of the reading."""
        return lowpass_periodic(signals, self.period, self.transmission.bandwidth_hz)

    def crossing(self, angle: float, direction: int) -> float:
        """Return at which point of the period the rotor passes an angle, rad, as a fraction of n.

        `direction` is 1 for the rising half, -1 for the falling one.
        """
        count = len(self.angle)
        bottom, top = int(np.argmin(self.setpoint)), int(np.argmax(self.setpoint))
        first, last = (bottom, top) if direction > 0 else (top, bottom)
        half = np.arange(first, first + (last - first) % count + 1)
        way = np.maximum.accumulate(direction * self.angle[half % count])
        return float(np.interp(direction * angle, way, half.astype(np.float64)))

    def at(self, signals: Array, point: float) -> Array:
        """Read signals (..., n) at a point of the period, between samples linearly."""
        count = len(self.angle)
        whole = math.floor(point)
        part = point - whole
        here, there = signals[..., whole % count], signals[..., (whole + 1) % count]
        value: Array = here + part * (there - here)
        return value


def lowpass_periodic(signals: Array, period: float, cutoff_hz: float, slopes: int = 0) -> Array:
    """Low-pass signals (..., n) that repeat with a period, s, and differentiate them `slopes`
    times.

    The gain is that of `numerics.lowpass`, a Butterworth of second order forward and backward.
    """
    count = signals.shape[-1]
    frequency = np.arange(count // 2 + 1) / period
    gain = (2j * np.pi * frequency) ** slopes / (1 + (frequency / cutoff_hz) ** 4)
    passed: Array = np.fft.irfft(np.fft.rfft(signals) * gain, count)
    return passed


def loaded_cycles(
    time: Array,
    setpoint: Array,
    rotor: Array,
    current: Array,
    *,
    transmission: Transmission,
    speed: float,
    torque_constant: float,
    moves: int,
) -> LoadedCycles:
    """Cut the last `moves` cycles out of a recording: s, set point and rotor rad, set point A (n,).

    `speed` rad/s is that of the set point's straight part, `torque_constant` N m/A that of the
    motor at its temperature. Raises `InsufficientDataError` where there are fewer cycles, or where
    they differ in length.
    """
    cut = cut_moves(time, setpoint, current, moves)
    turned = cut_moves(time, setpoint, rotor, moves)
    period, finest = cut.period, cut.torque.shape[1]
    wanted = max(FEWEST_POINTS, POINTS * transmission.bandwidth_hz * period)
    count = min(2 ** math.ceil(math.log2(wanted)), finest)
    angle = _resampled(steady_mean(turned.torque), count)
    acceleration = lowpass_periodic(angle, period, MOTION_HZ, slopes=2)
    rotor_speed = lowpass_periodic(angle, period, MOTION_HZ, slopes=1)
    currents = _resampled(cut.torque, count)
    motor = torque_constant * currents - transmission.inertia * acceleration
    return LoadedCycles(
        transmission=transmission,
        speed=speed,
        period=period,
        torque_per_ampere=transmission.torque_factor * torque_constant,
        setpoint=cut.setpoint[:: finest // count],
        angle=lowpass_periodic(angle, period, MOTION_HZ),
        rotor_speed=rotor_speed,
        direction=contact(rotor_speed, period),
        current=lowpass_periodic(steady_mean(currents), period, MOTION_HZ),
        torque=transmission.torque_factor * motor,
    )


def _resampled(signals: Array, count: int) -> Array:
    """Return signals (..., m) on a period at `count` points of it, without aliases."""
    spectrum = np.fft.rfft(signals)[..., : count // 2 + 1]
    fewer: Array = np.fft.irfft(spectrum, count) * (count / signals.shape[-1])
    return fewer
