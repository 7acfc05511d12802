"""A torque that is the same both ways: torque(v) = offset + f+(v), and offset - f-(-v) for v < 0.

It and friction that differs between directions look alike, except where friction varies with the
speed [7.2.1, 7.2.2].
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from rigtool.experiments.friction.direction_fit import DirectionFit
from rigtool.numerics.arrays import TINY, Array

ASYMMETRY_U_LIMIT = 0.1
"""Largest uncertainty of an asymmetry that is separated from a constant torque."""

MIN_LEVEL_SPAN = 0.3
"""Smallest relative variation of friction for an extrapolation to no friction."""

PROPORTIONALITY_U = 0.1
"""Relative standard uncertainty of the proportionality of asymmetry to friction (assumed)."""


@dataclass(frozen=True)
class Offset:
    """Torque that is the same in both directions, and friction that is not; (value, u).

    `offset` in N m; `asymmetry` is relative: friction is (1 +- asymmetry) times its mean.
    `separated` is false where the data do not separate the two; then asymmetry is taken as zero
    and its possible value is part of the uncertainty of the offset, or else `unknown`, N m, and
    only part of that of friction by direction.
    """

    offset: tuple[float, float]
    asymmetry: tuple[float, float]
    separated: bool
    unknown: float = 0.0


def separate_offset(level: Array, middle: Array, u: Array, speed: Array) -> Offset:
    """Separate a constant torque from friction that differs between directions.

    Both shift the middle between the torques of the two directions, but asymmetry does so in
    proportion to the friction: middle = offset + asymmetry * level + slope * speed, the slope being
    half the difference in viscous friction. `level` (n,) is half the distance between the two
    directions without its viscous part, `middle` (n,) half their sum, `u` (n,) its standard
    uncertainty, N m; at the `speed` (n,), rad/s, of holds and of breakaway (0).
    """
    weight = 1 / u
    typical = float(np.average(level, weights=weight**2))
    ones = np.ones(len(level))
    slope = [speed] if len(level) >= 3 and np.ptp(speed) > 0 else []
    if len(level) >= 3 + len(slope) and np.ptp(level) > MIN_LEVEL_SPAN * typical:
        (offset, asymmetry), (offset_u, asymmetry_u) = _weighted(
            np.column_stack([ones, level, *slope]), middle, weight
        )
        if asymmetry_u < ASYMMETRY_U_LIMIT:
            doubt = PROPORTIONALITY_U * abs(asymmetry)
            return Offset(
                (offset, math.hypot(offset_u, doubt * typical)),
                (asymmetry, math.hypot(asymmetry_u, doubt)),
                True,
            )
    # With little variation of friction the middle may be offset, asymmetry, or both.
    (mean, *_), (mean_u, *_) = _weighted(np.column_stack([ones, *slope]), middle, weight)
    doubt = max(abs(mean) / typical, ASYMMETRY_U_LIMIT)
    return Offset((mean, math.hypot(mean_u, doubt * typical)), (0.0, doubt), False)


def undivided(offset: tuple[float, float], level: float) -> Offset:
    """Return the offset (value, u) of Coulomb friction, `level`, that is the same in both
    directions; half of a difference between them looks the same, and stays unknown.
    """
    doubt = max(abs(offset[0]) / level, ASYMMETRY_U_LIMIT)
    return Offset(offset, (0.0, doubt), False, doubt * level)


def half_difference(fits: Mapping[int, DirectionFit]) -> Offset:
    """Return the offset that is half of the difference between the directions' Coulomb friction."""
    (forward, u), (backward, other_u) = (fits[sign].coulomb for sign in (1, -1))
    half = (forward - backward) / 2, math.hypot(u, other_u) / 2
    return undivided(half, max((forward + backward) / 2, half[1], TINY))


def _weighted(design: Array, values: Array, weight: Array) -> tuple[list[float], list[float]]:
    """Return the first two parameters (or the one) of a weighted fit, and their uncertainties."""
    inverse = np.linalg.pinv(design * weight[:, None])
    parameters = inverse @ (values * weight)
    residual = (values - design @ parameters) * weight
    # Scatter counts where it exceeds the uncertainties of the points (Birge ratio).
    scale = max(1.0, float(residual @ residual) / max(len(values) - design.shape[1], 1))
    u = np.sqrt(np.sum(inverse**2, axis=1) * scale)
    return [float(p) for p in parameters[:2]], [float(x) for x in u[:2]]
