"""Friction of one direction as it was fitted: a line, or a curve with the Stribeck effect.

What no friction does is refused.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from rigtool.errors import InsufficientDataError
from rigtool.numerics.arrays import Array

DIRECTION_NAMES = {1: "positive", -1: "negative"}

STRUCTURE_LIMIT = 0.08
"""Largest rms structure in the residuals, relative to the mean friction."""

FALLING = 4.0
"""Multiple of its uncertainty by which a line may fall with the speed."""


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


def require_no_fall(line: DirectionFit) -> None:
    """Raise `InsufficientDataError` where friction clearly falls with the speed, which viscous
    friction does not.

    Torque along the motion, which rises, has a reason of its own.
    """
    slope, u = float(line.parameters[1]), math.sqrt(float(line.covariance[1, 1]))
    if line.parameters[0] > 0 and slope < -FALLING * u:
        raise InsufficientDataError(
            f"friction falls from {line.lowest:.3g} to {line.highest:.3g} rad/s, by "
            f"{-slope * 1e3:.3g}({u * 1e3:.1g}) mN m a rad/s, limit {FALLING:g} times its "
            "uncertainty: that is the Stribeck effect, which hides Coulomb and viscous friction; "
            "hold higher speeds, too"
        )


def require_explained(fits: Sequence[DirectionFit]) -> None:
    """Raise where the curve has structure that no friction model explains (Appendix C).

    `fits` are of both directions, so that a constant torque drops out of their mean, or of one.
    The error is an `InsufficientDataError`.
    """
    coulomb = float(np.mean([fit.coulomb[0] for fit in fits]))
    coulomb_u = math.hypot(*(fit.coulomb[1] for fit in fits)) / len(fits)
    if coulomb < -3 * coulomb_u:
        raise InsufficientDataError(
            f"torque against the motion extrapolates to {coulomb * 1e3:.3g}({coulomb_u * 1e3:.1g}) "
            "mN m at standstill: friction cannot be below 0; check the signs of current and encoder"
        )
    friction = float(np.mean([fit.friction for fit in fits]))
    if friction <= 0:
        raise InsufficientDataError(
            f"the mean torque against the motion is {friction * 1e3:.3g} mN m: friction is above "
            "0; check current and encoder, whose signs may be wrong or which may not change"
        )
    limit = STRUCTURE_LIMIT * friction
    worst = max(fits, key=lambda fit: fit.structure)
    if worst.dof > 0 and worst.structure > limit:
        raise InsufficientDataError(
            f"torque against speed has structure of {worst.structure * 1e3:.3g} mN m rms about "
            f"the best friction model, far beyond the scatter of its points; limit "
            f"{limit * 1e3:.3g} mN m ({100 * STRUCTURE_LIMIT:.0f} % of the friction); worst at "
            f"{worst.worst_speed:.3g} rad/s. No friction model explains that: suspect noise "
            "that is slower than a hold (raise stribeck.hold_time), a Stribeck effect that too few "
            "speeds show (hold 8 or more, some of them above it), the current amplifier at low "
            "current, or a resonance of the speed loop"
        )
