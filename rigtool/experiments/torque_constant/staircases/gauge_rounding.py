"""What the steps of a coarse gauge do to the torque constant [7.1.1].

Readings are rounded alike wherever the torque is the same, so that their errors do not average out
as scatter does. Along a staircase they are a sawtooth of the torque: a slope takes a part of it,
and so does the model of friction, to which it may look like friction. Both are found by rounding
the fitted torque again, with the zero of the gauge at several places within one of its steps.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from rigtool.experiments.torque_constant.staircases.hypotheses import weigh_hypotheses
from rigtool.experiments.torque_constant.staircases.model import Stairs, arrange
from rigtool.experiments.torque_constant.staircases.plateaus import Plateaus
from rigtool.numerics.arrays import Array

GAUGE_PHASES = 12
"""Places of the gauge's zero within one of its steps that are tried."""

HARMONICS = 5
"""Of the error of rounding over the torque."""


def rounding_errors(stairs: Stairs, fitted: Array) -> Array:
    """Return the mean errors of readings of `fitted` torques (m, p), (places, m, p) N m.

    One place without error where the gauge has no steps. Noise of standard deviation sigma before
    rounding leaves a mean error of

        sum over k of (-1)^k q/(pi k) sin(2 pi k x/q) exp(-2 (pi k sigma/q)^2)

    (B. Widrow, I. Kollar, Quantization Noise, 2008, section 9.4).
    """
    q = stairs.resolution
    if q == 0:
        return np.zeros((1, *fitted.shape))
    # The scatter of rounded readings of little noise is sigma q/sqrt(pi); of much, sigma2 + q2/12.
    square = stairs.noise**2
    little = square < q**2 / 6
    sigma = math.sqrt(math.pi) * square / q if little else math.sqrt(square - q**2 / 12)
    place = (np.arange(GAUGE_PHASES) / GAUGE_PHASES)[:, None, None]
    errors = np.zeros((GAUGE_PHASES, *fitted.shape))
    for k in range(1, HARMONICS + 1):
        left = math.exp(-2 * (math.pi * k * sigma / q) ** 2)
        errors += (-1) ** k * left / k * np.sin(2 * np.pi * k * (fitted / q + place))
    return errors * stairs.weight * q / math.pi


def spread_over_zeros(
    plateaus: Plateaus, stairs: Stairs, readings: Array, coefficient: float, trend: Array
) -> float:
    """Return the standard deviation of the torque constant that all hypotheses find, N m/A.

    `readings` (n, m, p) N m are the torques of all staircases with n places of the gauge's zero;
    the swings about them are those of `plateaus`. `coefficient` and `trend` (m,) are those of
    `weigh_hypotheses`.
    """
    constants = []
    for torque in readings[:, stairs.weight > 0]:
        course = plateaus.course + (torque - plateaus.torque)[:, None]
        moved = arrange(replace(plateaus, torque=torque, course=course))
        constants.append(weigh_hypotheses(moved, coefficient, trend).constant)
    return float(np.std(constants, ddof=1))
