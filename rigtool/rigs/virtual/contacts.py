"""Contacts at the output of the virtual rig during a motion: pulses, masses, sines, ramps, tissue.

Each contact of the recipe is drawn from a stream of its own, so that adding one changes no other.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from rigtool.numerics.arrays import Array
from rigtool.recipe.virtual import AnyContact, Eased, Mass, Ramp, Sine, Tissue
from rigtool.rigs.motion import Motion
from rigtool.rigs.virtual.layout import FORCE_TORQUE, HAND_ANGLE, HAND_SPEED, WEIGHT_MOMENT


@dataclass(frozen=True)
class Touch:
    """One contact from `begin` to `end` [s]; `size` is its force [N] or stiffness [N m/rad]."""

    contact: AnyContact
    begin: float
    end: float
    size: float
    frequency_hz: float = 0.0

    def force(self, time: Array) -> Array:
        """Return the force that it makes at these times [s], (n,) N; nothing for tissue."""
        within = (time >= self.begin) & (time < self.end)
        since, left = time - self.begin, self.end - time
        match self.contact:
            case Eased(rise_time=rise):
                shape = np.clip(np.minimum(since, left) / rise, 0.0, 1.0) if rise > 0 else 1.0
            case Sine():
                shape = np.sin(2 * np.pi * self.frequency_hz * since)
            case Ramp():
                shape = since / (self.end - self.begin)
            case _:
                return np.zeros(len(time))
        return np.where(within, self.size * shape, 0.0)


def draw(contacts: Sequence[AnyContact], duration: float, seed: Sequence[int]) -> tuple[Touch, ...]:
    """Return all contacts of a motion that lasts `duration` s; those drawn depend on `seed`.

    Contacts of one entry never overlap where they are drawn: the times between them are
    exponential, as events without memory have them; all other values are uniform in their ranges.
    """
    return tuple(
        touch
        for number, contact in enumerate(contacts)
        for touch in _touches(contact, duration, np.random.default_rng([*seed, number]))
    )


def _touches(contact: AnyContact, duration: float, rng: np.random.Generator) -> Iterator[Touch]:
    size = contact.stiffness if isinstance(contact, Tissue) else contact.force
    frequency = contact.frequency_hz if isinstance(contact, Sine) else (0.0, 0.0)
    begin, number = 0.0, 0
    while True:
        if contact.rate_per_min is not None:
            begin += rng.exponential(60.0 / contact.rate_per_min)
        elif number < len(contact.at):
            begin = contact.at[number]
        else:
            return
        if begin >= duration and contact.rate_per_min is not None:
            return
        lasts = math.inf if contact.duration is None else rng.uniform(*contact.duration)
        yield Touch(contact, begin, begin + lasts, rng.uniform(*size), rng.uniform(*frequency))
        begin, number = begin + lasts, number + 1


@dataclass(frozen=True)
class Grip:
    """A hand that holds the output; its motion is on the motor's scale and begins at `origin`."""

    motion: Motion
    origin: float
    angle_ratio: float

    def at(self, time: Array) -> tuple[Array, Array]:
        """Return the hand's angle [rad] and speed [rad/s] on the output's scale, each (n,)."""
        position, speed, _ = self.motion.setpoint(time)
        return (self.origin + position) / self.angle_ratio, speed / self.angle_ratio


@dataclass(frozen=True)
class Outside:
    """All that acts on the output during a motion; forces act at `arm` [m] from its axis."""

    touches: tuple[Touch, ...]
    arm: float
    grip: Grip | None

    def at(self, time: Array) -> Array:
        """Return the contacts at these times, (n, 4) in the kernel's columns."""
        found = np.zeros((len(time), 4))
        for touch in self.touches:
            if touch.begin <= time[-1] and touch.end > time[0]:
                column = WEIGHT_MOMENT if isinstance(touch.contact, Mass) else FORCE_TORQUE
                found[:, column] += self.arm * touch.force(time)
        if self.grip is not None:
            found[:, HAND_ANGLE], found[:, HAND_SPEED] = self.grip.at(time)
        return found

    def tissues(self) -> Array:
        """Return begin, end, angle [rad], stiffness and damping of each tissue, (k, 5)."""
        rows = [
            (touch.begin, touch.end, math.radians(tissue.angle_deg), touch.size, tissue.damping)
            for touch in self.touches
            if isinstance(tissue := touch.contact, Tissue)
        ]
        return np.array(rows, dtype=np.float64).reshape(len(rows), 5)
