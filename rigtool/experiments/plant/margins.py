"""Margins of a loop from its frequency response L = C P.

gain margin      1/|L| where L passes -180 deg with a gain below one
phase margin     angle of L to -180 deg where |L| = 1
modulus margin   smallest distance of L to -1, or 1/max |1/(1 + L)|
bandwidth        where |T| = |L/(1 + L)| falls below 1/sqrt(2)
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy import optimize

from rigtool.numerics.arrays import Array, ComplexArray

Response = Callable[[Array], ComplexArray]

GRID_POINTS = 1000
"""Points of the grid on which crossings and extremes are located before they are refined."""

GRID_LOWEST = 1e-4
"""Lower end of that grid, relative to half the sampling rate."""


@dataclass(frozen=True)
class Margins:
    """Gain and modulus margin as ratios, phase margin in rad, frequencies in Hz.

    NaN where the response never crosses.
    """

    gain: float
    phase: float
    modulus: float
    crossover_hz: float
    bandwidth_hz: float


def margins(open_loop: Response, half_rate_hz: float) -> Margins:
    """Return the margins of a loop, given as a function of frequencies (n,), Hz.

    Of several crossings the one with the smallest margin counts; `crossover_hz` is the last.
    """
    grid = np.geomspace(GRID_LOWEST * half_rate_hz, half_rate_hz, GRID_POINTS)
    response = open_loop(grid)

    def at(frequency: float) -> complex:
        return complex(open_loop(np.array([frequency]))[0])

    gains = [
        1 / abs(at(f))
        # Only crossings of the negative real axis: the sign changes elsewhere as well.
        for f in _crossings(lambda f: at(f).imag, grid, response.imag)
        if -1 < at(f).real < 0
    ]
    level = _crossings(lambda f: abs(at(f)) - 1, grid, np.abs(response) - 1)
    phases = [math.pi - abs(float(np.angle(at(f)))) for f in level]
    closed = np.abs(response / (1 + response)) - math.sqrt(0.5)
    band = _crossings(lambda f: abs(at(f) / (1 + at(f))) - math.sqrt(0.5), grid, closed)
    return Margins(
        gain=min(gains, default=math.nan),
        phase=min(phases, default=math.nan),
        modulus=_closest(lambda f: abs(1 + at(f)), grid, np.abs(1 + response)),
        crossover_hz=max(level, default=math.nan),
        bandwidth_hz=min(band, default=math.nan),
    )


def _crossings(function: Callable[[float], float], grid: Array, values: Array) -> list[float]:
    """Return where a function passes zero, refined between the points of the grid."""
    before = np.flatnonzero(np.sign(values[:-1]) * np.sign(values[1:]) < 0)
    return [_root(function, grid[i], grid[i + 1]) for i in before]


def _root(function: Callable[[float], float], low: float, high: float) -> float:
    """Return where a function passes zero; one end where its sign there is that of rounding."""
    at_low, at_high = function(low), function(high)
    if at_low * at_high >= 0:
        return low if abs(at_low) < abs(at_high) else high
    return float(optimize.brentq(function, low, high, rtol=1e-12))


def _closest(function: Callable[[float], float], grid: Array, values: Array) -> float:
    """Return the smallest value of a function, refined around the lowest point of the grid."""
    place = int(np.argmin(values))
    low, high = grid[max(place - 1, 0)], grid[min(place + 1, len(grid) - 1)]
    found = optimize.minimize_scalar(function, bounds=(low, high), method="bounded")
    return min(float(found.fun), float(values[place]))
