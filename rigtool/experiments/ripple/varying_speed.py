"""Ripple of the motor where the position loop lets it vary the speed.

The torque that a loop asks for holds the motor's ripple and accelerates its inertia J. Over the
angle, acceleration is the slope of the kinetic energy,

    controller torque(angle) = ripple(angle) + J d(w^2/2)/d(angle),

at any speed w around the turn: an order k of the energy is i k of it in the torque. How long the
rotor takes for each cell of the turn shows w.
"""

from __future__ import annotations

import numpy as np

from rigtool.experiments.ripple.orders import LoopRipple, coefficients
from rigtool.numerics.arrays import TINY, Array, ComplexArray

SPEED_ORDERS = 30
"""Orders by which ripple varies the speed: the inertia holds higher ones."""

NEARLY_EVEN = 0.99
"""Part of the mean speed from which on the slowest place is as fast as the mean."""

LEAP = 10.0
"""Largest speed over its mean that counts: a rotor that is faster leaps."""


def speed_variation(durations: Array, orders: int = SPEED_ORDERS) -> float:
    """Return the relative standard deviation of the speed around the turn, by its orders up to
    `orders`.

    `durations` (revolutions, cells) as in `orders.LoopRipple`.
    """
    mean = durations.mean(axis=0)
    found = np.fft.rfft(mean / mean.mean())[1 : orders + 1] * (2 / mean.size)
    return float(np.linalg.norm(found)) / np.sqrt(2)


def fastest(durations: Array) -> float:
    """Return the highest speed around the turn over its mean, at most `LEAP`, by its orders up to
    `SPEED_ORDERS`.

    `durations` (revolutions, cells) as in `orders.LoopRipple`.
    """
    return 1 / max(float(_smooth(durations).min()), 1 / LEAP)


def slowest(durations: Array) -> float:
    """Return the lowest speed around the turn over its mean, as `fastest`.

    `durations` (revolutions, cells) as in `orders.LoopRipple`.
    """
    return 1 / float(_smooth(durations).max())


def _smooth(durations: Array) -> Array:
    """Return the mean time for each cell over its mean (cells,), by its orders up to
    `SPEED_ORDERS`."""
    mean = durations.mean(axis=0)
    slow = np.fft.rfft(mean / mean.mean())
    slow[SPEED_ORDERS + 1 :] = 0.0
    return np.fft.irfft(slow, mean.size)


def friction_changes(speed: Array, friction: Array, lowest: float) -> Array:
    """Return the standard change of friction, N m, with the relative change of each speed (n,).

    Between two others of these rising speeds its slope is taken as up to the steeper of those to
    them, which holds for a friction (n,), N m, that bends one way. At the ends nothing shows it:
    from all of the friction more, as viscous friction rises, to as much less, as that of a mixed
    lubrication falls, a rectangular distribution. At the slowest of three speeds or more, what
    friction is off the line through the others is how much there is of a mixed lubrication's.
    That is f exp(-(v/v_s)^2) at most, f all friction: a part q of f at this speed is q^(w^2) at the
    part w of it, and the mean slope down to the `lowest` part of the speed is the change.
    """
    changes: Array = np.abs(friction) / np.sqrt(3)
    if speed.size < 3:
        return changes
    slopes = np.abs(np.diff(friction) / np.diff(speed))
    changes[1:-1] = np.maximum(slopes[1:], slopes[:-1]) * speed[1:-1]
    line, least = np.polyfit(speed[1:], friction[1:], 1), min(lowest, NEARLY_EVEN)
    off = float(friction[0] - np.polyval(line, speed[0])) / max(abs(float(friction[0])), TINY)
    part = min(max(abs(off), TINY), 1.0)
    mixed = abs(float(friction[0])) * (part**least**2 - part) / (1 - least)
    changes[0] = min(abs(float(line[0])) * speed[0] + mixed, changes[0])
    return changes


def uneven_orders(ripple: LoopRipple, orders: int) -> Array:
    """Return what the motor's torque changes by with a speed that varies around the turn: the
    standard uncertainty of orders 1..`orders`, (orders,), N m, as those of an even speed.

    Friction changes with the speed, and ripple that lags behind its angle by up to as much as the
    speed, more or less: a rectangular distribution.
    """
    mean = ripple.durations.mean(axis=0)
    uneven = mean.mean() / mean - 1
    parts = np.stack([ripple.friction_change * uneven, ripple.mean / np.sqrt(3) * uneven])
    return np.linalg.norm(coefficients(parts, orders, ripple.sampling), axis=0)


def motor_orders(
    ripple: LoopRipple, inertia: float, late: ComplexArray, width: int = 1
) -> tuple[ComplexArray, ComplexArray]:
    """Return orders 1..m of the torque that the loop asks for, and of the motor's ripple, N m, in
    each revolution, both (revolutions, m).

    `late` (m,) turns an order of what is recorded to when it acts. With a `width`, torque and speed
    are means over that many cells: where that changes the orders, cells do not resolve the motion.
    The energy of a single revolution is linear about that of the mean durations, which is then
    their mean: squares of what noise does to single ones would lean high.
    """
    durations = ripple.durations
    cells, orders = durations.shape[1], late.size
    taken = _stretches(durations, width)
    asked = coefficients(
        _stretches(ripple.waveforms * durations, width) / taken, orders, ripple.sampling, width
    )
    mean = taken.mean(axis=0)
    speed = 2 * np.pi * width / cells / mean
    energy = coefficients(inertia * speed**2 * (1.5 - taken / mean), orders, ripple.sampling, width)
    return asked * late, asked * late - 1j * np.arange(1, orders + 1) * energy


def _stretches(cells: Array, width: int) -> Array:
    """Return sums over so many cells of (revolutions, cells) from each one on, around the turn."""
    return sum((np.roll(cells, -n, axis=1) for n in range(1, width)), start=cells)
