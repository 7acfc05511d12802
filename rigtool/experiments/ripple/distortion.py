"""What an amplifier whose current is no straight line over its set point does to ripple.

The set point holds the ripple. A current that is off its line by e(set point) makes the set point
off by as much the other way, so that the orders of e over the turn are those of an error. The
levels of `calibrate-kt` show e: as it bends from level to level, and, where a level is off the
straight line between its neighbours, how large it is in between. There its course is unknown. It is
taken as a sine of any phase, and of any period from `FINEST` of the levels' distance up to twice
it, which is the longest that such levels do not follow (C. E. Shannon, Proc. IRE 37, 10, 1949).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from rigtool.experiments.ripple.orders import Sampling, coefficients
from rigtool.numerics.arrays import Array

FINEST = 0.02
"""Shortest period, of the distance of levels: 4 mA for levels of 0.2 A."""

NOTED = 0.1
"""Part of a ripple, rms, that levels may be off without a note."""

PERIODS = 30
"""Periods that are tried, evenly on a logarithmic scale."""


@dataclass(frozen=True, eq=False)
class Distortion:
    """Deviations of an amplifier's current from its line, A, at rising `levels` (n,) of set point,
    A, and the amplitude `between` them, A."""

    levels: Array
    deviations: Array
    between: float


def amplifier_distortion(levels: Array, deviations: Array, scatter: float) -> Distortion:
    """Return what `levels` (n,) A, n > 2, and their `deviations` (n,) A from the line show.

    `scatter`, A, is the standard uncertainty of a deviation, which is taken off.
    """
    off = deviations[1:-1] - (deviations[2:] + deviations[:-2]) / 2
    square = float(np.mean(off**2)) / 1.5 - scatter**2  # of n alike, 1 + 1/4 + 1/4 of their own
    return Distortion(levels, deviations, float(np.sqrt(max(2 * square, 0.0))))


def distorted_orders(
    current: Array, distortion: Distortion, orders: int, sampling: Sampling
) -> Array:
    """Return the standard uncertainty of orders 1..`orders`, (orders,) A, of set points by cells
    of single turns, `current` (revolutions, cells) A.

    By the period that adds most to an order. Set points that scatter by a period from turn to turn
    average it out, as dither does (L. Schuchman, IEEE Trans. Commun. Technol. 12(4), 162, 1964).
    """
    bend = np.interp(current, distortion.levels, distortion.deviations).mean(axis=0)
    distance = float(np.diff(distortion.levels).mean())
    square = np.zeros(orders)
    for period in distance * np.geomspace(FINEST, 2.0, PERIODS if distortion.between else 0):
        phase = 2 * np.pi / period * current
        sine = np.stack([np.cos(phase).mean(axis=0), np.sin(phase).mean(axis=0)])
        found = coefficients(distortion.between * sine, orders, sampling)
        # The mean over its unknown phase.
        square = np.maximum(square, np.sum(np.abs(found) ** 2, axis=0) / 2)
    return np.sqrt(np.abs(coefficients(bend[None], orders, sampling)[0]) ** 2 + square)


def distortion_note(distortion: Distortion, ripple: Array) -> list[str]:
    """Return a note where the levels lie off by more than a part `NOTED` of a `ripple` (n,), rms A,
    of one of the recordings."""
    between, least = distortion.between, float(ripple.min())
    if between <= NOTED * least:
        return []
    return [
        f"the amplifier is not linear: levels of the calibration are {between * 1e3:.3g} mA off "
        f"those around them, and ripple is from {least * 1e3:.3g} mA rms on. Between levels its "
        "current is unknown, and u includes a sine of the period that adds most; use another "
        "amplifier"
    ]
