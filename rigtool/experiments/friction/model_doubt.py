"""Uncertainty of least-squares parameters from structure in the residuals.

A function of some quantity that the model lacks (ripple over position) shows in the residuals, but
only the part of it that resembles none of the regressors. The strength of the part that resembles
regressor j is unknown; it is taken to be as strong as each of the patterns that show:

    u_j^2 = P / m * alike_j / own_j^2

with P the residuals' power that a function of the quantity explains, m the number of patterns
(cosines over the quantity) of which it consists, own_j the power of regressor j that the others do
not explain, and alike_j the part of that power that a function of the quantity explains. Functions
are means over ranges of the quantity. A function of the quantity is what residuals in one range
have in common at different times; a mean over a range that is due to chance does not agree with the
mean at other times, however the residuals are correlated in time.

The deviation of friction from a straight line over speed has a known shape (Stribeck), and so has a
ripple about as long as the stroke, which is too long for a pattern. A model with such a term shows
by how much the parameters would change (`curvature`, `long_ripple`).
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from rigtool.numerics.arrays import TINY, Array
from rigtool.numerics.residual_covariance import cosine_transform, long_run_covariance

RESIDUAL_RANGES = 24
"""Ranges of the quantity over which residuals are averaged, with as many samples each."""

TIME_PARTS = 10
"""Parts of a recording that count as different times."""

STRIBECK_VELOCITIES = np.geomspace(0.05, 0.5, 12)
"""Stribeck velocities to try, relative to the highest speed."""

RIPPLES_A_STROKE = np.geomspace(0.5, 8, 12)
"""Periods of ripple within the range of positions to try."""

CHANCE_LEVEL = 2.0
"""Standard uncertainties by which the best of these terms differs from zero by chance."""


def own_part(design: Array, column: int) -> float:
    """Return the part of a regressor's power that the others do not explain, 1 - R^2.

    `design` (n, p).
    """
    others = np.delete(design, column, axis=1)
    rest = design[:, column] - others @ np.linalg.lstsq(others, design[:, column])[0]
    return float(np.sum(rest**2)) / max(float(np.sum(design[:, column] ** 2)), TINY)


def structure(
    over: Array, residual: Array, design: Array, times: NDArray[np.intp]
) -> tuple[float, Array]:
    """Return the part of the residual's power that a function of `over` explains.

    Also return the uncertainty of each parameter (p,) that follows. `over` (n,), `residual` (n,),
    `design` (n, p); `times` (n,) numbers the parts of the recordings.
    """
    total = max(float(np.sum(residual**2)), TINY)
    ranges = np.empty(len(over), dtype=np.intp)
    ranges[np.argsort(over, kind="stable")] = np.arange(len(over)) * RESIDUAL_RANGES // len(over)
    power = min(max(_common(ranges, times, residual), 0.0), total)
    patterns = _patterns(_sums(ranges, residual) / np.maximum(_sums(ranges), 1))
    # The rows are the parts of regressors that the others do not explain, over their squares.
    own = np.linalg.pinv(design)
    # Regressors are known exactly: their means over ranges hold no chance.
    means = np.array([_sums(ranges, row) for row in own]) / np.sqrt(np.maximum(_sums(ranges), 1))
    return power / total, math.sqrt(power / patterns) * np.linalg.norm(means, axis=1)


def _patterns(means: Array) -> float:
    """Return the effective number of cosines over the ranges in the means; 1 for a single one."""
    power = cosine_transform(means) ** 2
    power[0] /= 2  # of equal length as the others
    return float(np.sum(power) ** 2 / max(np.sum(power**2), TINY))


def _common(ranges: NDArray[np.intp], times: NDArray[np.intp], values: Array) -> float:
    """Return the power of the means over ranges that different times have in common.

    The mean product of all pairs of samples of one range but of different times; where a range was
    visited at one time only, the square of its mean, as nothing shows that it is chance.
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
    speed: Array, coulomb: Array, residual: Array, design: Array, independent: float
) -> Array:
    """Return the uncertainty (p,) from friction that is no straight line over speed.

    That of the best-fitting Stribeck term sign(v) exp(-(v/vs)^2). `speed` (n,), `coulomb` (n,) the
    regressor of sign(v) in the weighted rows of `design` (n, p) and of `residual` (n,), which
    amount to `independent` samples.
    """
    velocities = STRIBECK_VELOCITIES * float(np.max(np.abs(speed[coulomb != 0])))
    terms = [(coulomb * np.exp(-((speed / v) ** 2)))[:, None] for v in velocities]
    return _unmodelled(terms, residual, design, independent)


def long_ripple(
    position: Array, weight: Array, residual: Array, design: Array, independent: float
) -> Array:
    """Return the uncertainty (p,) from ripple about as long as the stroke.

    Most of such a ripple looks like an offset and, in a motion at one frequency, like inertia; what
    is left shows how strong it is. `position` (n,), `weight` (n,) of the rows of `design` (n, p)
    and of `residual` (n,), which amount to `independent` samples.
    """
    turns = 2 * np.pi * position / np.ptp(position[weight > 0])
    terms = [
        np.column_stack([np.cos(n * turns), np.sin(n * turns)]) * weight[:, None]
        for n in RIPPLES_A_STROKE
    ]
    return _unmodelled(terms, residual, design, independent)


def _unmodelled(
    terms: Sequence[Array], residual: Array, design: Array, independent: float
) -> Array:
    """Return the change of each parameter (p,) if the model had the term that fits best, as far as
    the term exceeds chance.

    A term (n, k) has k columns.
    """
    best, found = 0.0, None
    basis = np.linalg.qr(design)[0]
    for term in terms:
        rest = term - basis @ (basis.T @ term)
        height = np.linalg.lstsq(rest, residual)[0]
        explained = float(np.sum((rest @ height) ** 2))
        if explained > best and np.all(np.sum(rest**2, 0) > 1e-6 * np.sum(term**2, 0)):
            best, found = explained, (term, rest, height)
    if found is None:
        return np.zeros(design.shape[1])
    term, rest, height = found
    change = np.asarray(np.linalg.lstsq(design, term @ height)[0], np.float64)
    left = residual - rest @ height
    scatter, _ = long_run_covariance(np.column_stack([design, term]), left, independent)
    k = len(height)
    square = float(height @ np.linalg.solve(scatter[-k:, -k:], height))
    chance = CHANCE_LEVEL**2 * k / max(square, TINY)
    return np.abs(change) * math.sqrt(max(0.0, 1 - chance))
