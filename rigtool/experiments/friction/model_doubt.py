"""What residuals of a least-squares fit show beside the model, and the doubt that it leaves.

A function g of some quantity that the model lacks (ripple over position) leaves its trace in the
residuals, but only that part of it that looks like none of the regressors. How strongly it acted
where it does look like regressor j is not known; it is taken to be as strong there as in each of
the patterns in which it shows:

    u_j^2 = P / m * alike_j / own_j^2

with P the residuals' power that a function of the quantity explains, m the number of patterns
(cosines over the quantity) of which it consists, own_j the power of regressor j that the others do
not explain, and alike_j the part of that power that a function of the quantity explains. Functions
are means over ranges of the quantity. What residuals have in common at one value of it but at
different times is a function of it; what a mean over a range shows by chance, however residuals are
correlated in time, has nothing in common with what it shows at other times.

Friction's departure from a straight line over speed has a known shape (Stribeck), so the model that
has it tells by how much the parameters would change (`curvature`).
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from rigtool.numerics.residual_covariance import long_run_covariance

Array = NDArray[np.float64]

RANGES = 24
"""Ranges of the quantity in which the mean residual is looked at, with as many samples each."""

TIMES = 10
"""Parts of a recording that count as different times."""


VELOCITIES = np.geomspace(0.05, 0.5, 12)
"""Stribeck velocities that are tried, as part of the highest speed."""

BY_CHANCE = 2.0
"""Standard uncertainties by which the best of these terms differs from zero where there is none."""


def own(design: Array, column: int) -> Array:
    """Return what the other regressors of a design (n, p) do not explain of one, (n,)."""
    others = np.delete(design, column, axis=1)
    fit = np.linalg.lstsq(others, design[:, column], rcond=None)[0]
    rest: Array = design[:, column] - others @ fit
    return rest


def own_part(design: Array, column: int) -> float:
    """Return the part of a regressor's power that the others do not explain, 1 - R^2.

    `design` (n, p).
    """
    power = max(float(np.sum(design[:, column] ** 2)), 1e-300)
    return float(np.sum(own(design, column) ** 2)) / power


def structure(
    over: Array, residual: Array, design: Array, times: NDArray[np.intp]
) -> tuple[float, Array]:
    """Return the part of the residual's power that a function of `over` explains.

    And the doubt about each parameter (p,) that follows. `over` (n,), `residual` (n,), `design`
    (n, p); `times` (n,) numbers the parts of the recordings.
    """
    total = max(float(np.sum(residual**2)), 1e-300)
    ranges = np.empty(len(over), dtype=np.intp)
    ranges[np.argsort(over, kind="stable")] = np.arange(len(over)) * RANGES // len(over)
    power = min(max(_common(ranges, times, residual), 0.0), total)
    patterns = _patterns(_sums(ranges, residual) / np.maximum(_sums(ranges), 1))
    doubt = np.zeros(design.shape[1])
    for column in range(design.shape[1]):
        rest = own(design, column)
        # What a regressor is of `over`, it is for certain: chance makes it none the less alike.
        alike = float(np.sum(_sums(ranges, rest) ** 2 / np.maximum(_sums(ranges), 1)))
        doubt[column] = math.sqrt(power / patterns * alike) / max(float(np.sum(rest**2)), 1e-300)
    return power / total, doubt


def _patterns(means: Array) -> float:
    """Return how many cosines over the ranges have equal parts in the means: 1 where it is one."""
    from scipy.fft import dct

    power = dct(means, norm="ortho") ** 2
    return float(np.sum(power) ** 2 / max(np.sum(power**2), 1e-300))


def _common(ranges: NDArray[np.intp], times: NDArray[np.intp], values: Array) -> float:
    """Return the power of the means over ranges that different times have in common.

    The mean product of all pairs of samples of one range but of different times; where a range was
    visited at one time only, the square of its mean: nothing tells that this is chance.
    """
    parts = int(times.max()) + 1
    cells, shape = ranges * parts + times, (int(ranges.max()) + 1, parts)
    sums = np.bincount(cells, values, math.prod(shape)).reshape(shape)
    counts = np.bincount(cells, minlength=math.prod(shape)).reshape(shape).astype(np.float64)
    total, count = sums.sum(axis=1), counts.sum(axis=1)
    pairs = count**2 - np.sum(counts**2, axis=1)
    products = np.where(pairs > 0, total**2 - np.sum(sums**2, axis=1), total**2)
    return float(np.sum(count * products / np.where(pairs > 0, pairs, np.maximum(count, 1) ** 2)))


def _sums(labels: NDArray[np.intp], values: Array | None = None) -> Array:
    return np.bincount(labels, values).astype(np.float64)


def curvature(
    speed: Array, weight: Array, residual: Array, design: Array, independent: float
) -> Array:
    """Return the doubt (p,) for friction that is no straight line over speed.

    How far each parameter would move if the model had the Stribeck term sign(v) exp(-(v/vs)^2) that
    fits best, as far as the term is no chance. `speed` (n,), `weight` (n,) of the rows of `design`
    (n, p) and of `residual` (n,), that are worth `independent` samples.
    """
    best, change, u = 0.0, np.zeros(design.shape[1]), 1.0
    for velocity in VELOCITIES * float(np.max(np.abs(speed[weight > 0]))):
        bump = weight * np.sign(speed) * np.exp(-((speed / velocity) ** 2))
        alike = np.linalg.lstsq(design, bump, rcond=None)[0]
        rest = bump - design @ alike
        power = float(np.sum(rest**2))
        explained = float(rest @ residual) ** 2 / max(power, 1e-300)
        if explained > best and power > 1e-6 * float(np.sum(bump**2)):
            best, height = explained, float(rest @ residual) / power
            left = residual - height * rest
            scatter, _ = long_run_covariance(np.column_stack([design, bump]), left, independent)
            change, u = height * alike, math.sqrt(scatter[-1, -1]) / abs(height)
    doubt: Array = np.abs(change) * math.sqrt(max(0.0, 1 - (BY_CHANCE * u) ** 2))
    return doubt
