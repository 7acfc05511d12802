"""Functions of an angle, drawn and tabulated once: ripple, cogging, eccentricity, friction."""

from __future__ import annotations

import numpy as np

from rigtool.numerics.arrays import Array
from rigtool.recipe.virtual import MAX_ORDER, Amplifier, DrawnOrder, Order, Virtual

MAP_SIZE = 4096
_ANGLE = np.linspace(0.0, 2 * np.pi, MAP_SIZE + 1)


def _sum_of_orders(orders: tuple[Order, ...]) -> Array:
    total = np.zeros(MAP_SIZE + 1)
    for item in orders:
        total += item.amplitude * np.cos(item.order * _ANGLE + item.phase)
    return total


def _draw(
    orders: tuple[DrawnOrder, ...], phases: Array, spread: float, rng: np.random.Generator
) -> Array:
    """Give each order the phase of its start-up and an amplitude of its own."""
    drawn = tuple(
        Order(
            order=item.order,
            amplitude=item.amplitude * float(np.exp(spread * rng.standard_normal())),
            phase=float(phases[item.order]),
        )
        for item in orders
    )
    return _sum_of_orders(drawn)


def rotor_map(virtual: Virtual, amplifier: Amplifier, power_cycle: int) -> Array:
    """Tabulate the functions of the rotor's angle, (MAP_SIZE + 1, 5), columns as in the kernel.

    The amplifier's calibration is drawn from the seed and the number of the power cycle
    [7.1.3, App. F]; cogging and eccentricity belong to the motor and stay.
    """
    rng = np.random.default_rng([virtual.seed, power_cycle, 0x5CA1])
    spread = amplifier.amplitude_spread
    # One misalignment shows at all currents: an order keeps its phase while its amplitude grows.
    phases = rng.uniform(0, 2 * np.pi, MAX_ORDER + 1)
    eccentricity = virtual.eccentricity
    # Appendix J: T = k e^2 / 2 * sin(2 angle)
    squeeze = eccentricity.spring_constant * eccentricity.offset**2 / 2 * np.sin(2 * _ANGLE)
    columns = [
        _draw(amplifier.offset_ripple, phases, spread, rng),
        _draw(amplifier.gain_ripple, phases, spread, rng),
        _draw(amplifier.saturation_ripple, phases, spread, rng),
        _sum_of_orders(virtual.motor.cogging) - squeeze,
        _sum_of_orders(virtual.motor.viscous_modulation),
    ]
    return np.ascontiguousarray(np.stack(columns, axis=1))


def friction_map(virtual: Virtual) -> Array:
    """Tabulate the instrument's friction relative to its mean by grasper angle, (MAP_SIZE + 1,)."""
    return 1.0 + _sum_of_orders(virtual.instrument.friction_orders)
