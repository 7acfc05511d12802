"""Stiffness of the motor's leaf springs, and the torque of eccentric pulleys.

Two parallel leaf springs, clamped at both ends, of length a, width b and thickness t [App. E]:

    k = 2 E b t^3 / a^3

Pulleys of the total eccentricity e push the motor against the springs and swing its mass to and fro
as they turn by the angle theta at the speed omega [App. J]:

    T_spring(theta)  = k e^2 sin(2 theta) / 2
    T_inertia(theta) = -m omega^2 e^2 sin(2 theta) / 2

The thesis prints the last formula without the square of e; its numbers hold with the square. The
eigenfrequency of motor and springs is sqrt(k/m) / (2 pi).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from rigtool.errors import InsufficientDataError
from rigtool.numerics.arrays import Array
from rigtool.numerics.checks import require_signals

MIN_READINGS = 4
"""Smallest number of readings: two for the line, and two for its uncertainty."""


@dataclass(frozen=True, eq=False)
class SpringCurve:
    """A straight line through measured readings: deflection = force / stiffness + offset.

    `stiffness` in N/m with its standard uncertainty; `deflection` (n,) m is that of the line, `dof`
    are its degrees of freedom.
    """

    stiffness: float
    stiffness_u: float
    deflection: Array
    dof: int


def spring_curve(force: ArrayLike, deflection: ArrayLike) -> SpringCurve:
    """Fit a spring constant to deflections (n,), m, that known forces (n,), N, make [Fig. 70].

    Least squares of the deflection, which has the errors, on the force; the uncertainty comes from
    the scatter about the line. Raises `InsufficientDataError` where the readings are too few, all
    at one force, or show no spring.
    """
    x, y = require_signals(MIN_READINGS, force=force, deflection=deflection)
    centred = x - x.mean()
    spread = float(centred @ centred)
    if spread <= (1e-9 * float(np.abs(x).max())) ** 2 * x.size:
        raise InsufficientDataError(
            f"all {x.size} forces are {x[0]:.4g} N: pull with different forces"
        )
    compliance = float(centred @ y) / spread
    offset = float(y.mean()) - compliance * float(x.mean())
    residual = y - offset - compliance * x
    dof = x.size - 2
    u = math.sqrt(float(residual @ residual) / dof / spread)
    if compliance <= 3 * u:
        raise InsufficientDataError(
            f"the motor yields by {compliance:.3g} m/N with u = {u:.2g}, at least 3 u are "
            "needed: pull harder, read more finely, or check the sign"
        )
    stiffness = 1 / compliance
    return SpringCurve(stiffness, stiffness**2 * u, y - residual, dof)


def eccentric_torque(
    angle: ArrayLike, *, eccentricity: float, stiffness: float, mass: float, speed: float
) -> tuple[Array, Array]:
    """Return the torque of the springs and that of the mass at angles (n,) rad, each (n,) N m.

    `eccentricity` of both pulleys in m, `stiffness` in N/m, `mass` in kg, `speed` in rad/s.
    """
    wave = np.sin(2 * np.asarray(angle, dtype=np.float64)) / 2 * eccentricity**2
    return stiffness * wave, -mass * speed**2 * wave


def eigenfrequency(stiffness: float, mass: float) -> float:
    """Return the frequency, Hz, of a mass, kg, on a spring, N/m; `ValueError` below zero."""
    if not (stiffness >= 0 and mass > 0):
        raise ValueError(f"a stiffness of {stiffness} N/m and a mass of {mass} kg do not oscillate")
    return math.sqrt(stiffness / mass) / (2 * math.pi)
