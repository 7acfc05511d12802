"""Friction of one direction as it was fitted: a line, or a curve with the Stribeck effect."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from rigtool.numerics.arrays import Array

DIRECTION_NAMES = {1: "positive", -1: "negative"}


@dataclass(frozen=True)
class DirectionFit:
    """Friction in one direction; torques in N m against the motion, speeds in rad/s.

    `covariance` belongs to `parameters`, (fc, fv) or (fc, fv, fs, vs), of the chosen model;
    `averaged` are fc and fv as stated, of a line in the mean over the models. The fit covers speeds
    from `lowest` to `highest`; `structure` is the rms of its residuals far beyond scatter, largest
    at `worst_speed`; `friction` is the mean of the points; `criterion` is Akaike's, by which the
    model was chosen, with the lead that its shape needs.
    """

    parameters: Array
    averaged: Array
    covariance: Array
    exponent: float | None
    dof: int
    lowest: float
    highest: float
    structure: float
    worst_speed: float
    friction: float
    criterion: float = math.nan

    @property
    def coulomb(self) -> tuple[float, float]:
        """The value of fc and its standard uncertainty."""
        return float(self.averaged[0]), math.sqrt(float(self.covariance[0, 0]))

    @property
    def viscous(self) -> tuple[float, float]:
        """The value of fv, N m s/rad, and its standard uncertainty."""
        return float(self.averaged[1]), math.sqrt(float(self.covariance[1, 1]))

    def level(self, speed: Array) -> Array:
        """Return f without its viscous part at speeds >= 0."""
        return self.evaluate(speed) - self.parameters[1] * speed

    @property
    def static(self) -> tuple[float, float] | None:
        """The value of fs and its standard uncertainty, None for the linear model."""
        return None if self.exponent is None else self._parameter(2)

    @property
    def stribeck_velocity(self) -> tuple[float, float] | None:
        """The value of vs and its standard uncertainty, None for the linear model."""
        return None if self.exponent is None else self._parameter(3)

    def evaluate(self, speed: Array, swing: Array | float = 0.0) -> Array:
        """Return f at speeds >= 0, or its mean where they swing, as `curve` says."""
        return curve(self.parameters, speed, self.exponent, swing)

    def _parameter(self, index: int) -> tuple[float, float]:
        return float(self.parameters[index]), math.sqrt(float(self.covariance[index, index]))


def curve(
    parameters: Array, speed: Array, exponent: float | None, swing: Array | float = 0.0
) -> Array:
    """Return f of the line, (fc, fv), or with an exponent of the curve, (fc, fv, fs, vs).

    With a `swing` of the speed, its standard deviation in rad/s, the mean of f over these speeds.
    """
    f: Array = parameters[0] + parameters[1] * speed
    if exponent is not None:
        f = f + (parameters[2] - parameters[0]) * peak(speed, parameters[3], exponent, swing)[0]
    return f


def peak(
    speed: Array, velocity: float, exponent: float, swing: Array | float
) -> tuple[Array, Array]:
    """Return the mean of exp(-(v/vs)^d) over speeds v about `speed` (n,), and its derivative by vs.

    Normal, with the standard deviation `swing`, rad/s; by three points, exact up to the fifth power
    of v (Gauss-Hermite: Abramowitz and Stegun, Handbook of Mathematical Functions, 1964, 25.4.46).
    """
    value = slope = np.zeros_like(speed)
    for away, share in ((-math.sqrt(3), 1 / 6), (0.0, 2 / 3), (math.sqrt(3), 1 / 6)):
        power = np.abs((speed + away * swing) / velocity) ** exponent
        part = share * np.exp(-power)
        value, slope = value + part, slope + part * exponent * power / velocity
    return value, slope
