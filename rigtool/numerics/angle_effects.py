"""Least squares where values also depend on the rotor's angle, from angles that do not resolve it.

    y = X beta + h sum over orders k = 1..K of (c_k cos(k angle) + s_k sin(k angle)) + e

The orders are random effects: c_k, s_k are normal with one variance v for all k up to K and none
beyond. Errors e are normal with standard uncertainties u, all larger by the same factor where they
scatter more. K, v and the factor are unknown; beta averages over all of them, each weighted by how
probable the values y are with it (D. J. C. MacKay, Neural Computation 4, 415-447, 1992). Orders
that the angles cannot separate from X, or from each other, are thus part of the uncertainty of
beta, as large as the resolved orders suggest. What scatters beyond u may as well be orders above
K: with a probability of a half it counts for how far the values deviate over a turn.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np

from rigtool.numerics.arrays import TINY, Array

LOWEST_ORDER, HIGHEST_ORDER = 4, 12
"""Range of K that is considered beside 0; with fewer, a few angles would pass for all orders."""

ERROR_FACTORS = np.geomspace(1.0, 300.0, 14)
"""Factors considered by which errors may exceed their stated uncertainty."""

EXCESS_POWER = 1.0
"""The prior of a factor falls with this power of it, beside being even in its logarithm."""

FEWEST_DOF = 3.0
"""Fewest degrees of freedom that are stated: with fewer, a standard deviation does not exist."""

ONE_SIGMA = 0.6827
"""Probability within one standard deviation of a normal distribution."""

LARGEST_DEVIATION = 5.0
"""Largest standard deviation of an order that is considered, in units of the scatter."""

NEGLIGIBLE_PROBABILITY = 1e-4
"""Probability below which a hypothesis adds nothing to the effect."""

ROUNDING_PROBABILITY = 1e-18
"""Probability below which a hypothesis is lost in the rounding of a quantile, even of thousands."""

AMPLITUDE_COUNT = 24
"""Number of standard deviations of an order that are considered."""


@dataclass(frozen=True)
class AngleEffects:
    """Parameters (p,), their covariance (p, p) and degrees of freedom; of the angle's effect.

    An interval is the standard uncertainty times the quantile of Student's t: both match the
    posterior distribution at 68 % and 95 %. `effect` (n,) is what the angle adds to each value,
    without h; `deviation` the standard deviation of the effect over a turn, `deviation_u` its
    standard uncertainty with `deviation_dof`; `amplitudes` (2 K,) are c_k and s_k in sequence,
    `variance` (K,) the sum of both posterior variances; `beyond` is the variance of the values
    beyond their stated uncertainty that the orders do not explain, without h.
    """

    parameters: Array
    covariance: Array
    dof: Array
    effect: Array
    deviation: float
    deviation_u: float
    deviation_dof: float
    amplitudes: Array
    variance: Array
    beyond: float


def fit_angle_effects(
    design: Array, value: Array, u: Array, angle: Array, *, size: Array | None = None
) -> AngleEffects:
    """Fit values (n,) at angles (n,), rad, with standard uncertainties u (n,) and X (n, p).

    `size` (n,) is h, 1 unless it is given. Where all angles are unknown (NaN), there are no
    effects: all scatter is error.
    """
    known = not np.any(np.isnan(angle))
    size = np.ones(len(value)) if size is None else size
    orders = np.arange(1, HIGHEST_ORDER + 1 if known else 1)
    highest = (0, *range(LOWEST_ORDER, HIGHEST_ORDER + 1)) if known else (0,)
    phase = np.outer(angle, orders)
    waves = np.stack([np.cos(phase), np.sin(phase)], axis=2).reshape(len(value), -1)
    x, y = design / u[:, None], value / u
    z = waves * (size / u)[:, None]
    # Amplitudes of interest are near the scatter that X leaves.
    rest = value - design @ np.linalg.lstsq(x, y)[0]
    spread = max(float(np.sqrt(np.mean(rest**2))), float(np.min(u)))
    amplitude = spread * np.geomspace(1 / 30, LARGEST_DEVIATION, AMPLITUDE_COUNT)
    parts = [_given(x, y, z[:, : 2 * order], amplitude) for order in highest]
    weight = np.concatenate([part[0] for part in parts])
    mean = np.concatenate([part[1] for part in parts])
    within = np.concatenate([part[2] for part in parts])
    probable = np.exp(weight - weight.max())
    probable /= probable.sum()
    parameters = probable @ mean
    off = mean - parameters
    covariance = np.einsum("h,hij->ij", probable, within + off[:, :, None] * off[:, None, :])
    stated = [
        _as_student(probable, mean[:, k], np.sqrt(within[:, k, k])) for k in range(len(parameters))
    ]
    scale = np.array([u for _, u, _ in stated]) / np.sqrt(np.diag(covariance))
    own = float(np.mean((u / size) ** 2))
    amplitudes, variance, beyond, deviation = _effect(x, y, z, probable, amplitude, highest, own)
    return AngleEffects(
        parameters,
        covariance * np.outer(scale, scale),
        np.array([dof for *_, dof in stated]),
        waves @ amplitudes,
        *deviation,
        amplitudes,
        variance,
        beyond,
    )


def _given(x: Array, y: Array, z: Array, amplitude: Array) -> tuple[Array, Array, Array]:
    """Return logarithm of the probability, means and covariances of beta for each hypothesis.

    All in units of the stated errors; the hypotheses are amplitudes by excess, in sequence (h,).
    An orthogonal transformation leaves as many values as there are columns; the others become zero.
    """
    columns: Array = np.asarray(np.linalg.qr(np.column_stack([y, x, z]), mode="r"))
    zeros = len(y) - len(columns)
    y, x, z = columns[:, 0], columns[:, 1 : 1 + x.shape[1]], columns[:, 1 + x.shape[1] :]
    power, axes = np.linalg.eigh(z @ z.T)
    xs, ys = axes.T @ x, axes.T @ y
    grown = (amplitude[:, None] ** 2 * np.maximum(power, 0.0))[:, None, :]
    variance = (grown + ERROR_FACTORS[None, :, None] ** 2).reshape(-1, len(y))  # (h, n)
    precision = np.einsum("ni,hn,nj->hij", xs, 1 / variance, xs)
    within = np.linalg.inv(precision)
    mean = np.einsum("hij,hj->hi", within, np.einsum("ni,hn->hi", xs, ys / variance))
    rest = ys - mean @ xs.T
    probability = -0.5 * (
        np.sum(np.log(variance) + rest**2 / variance, axis=1) + np.linalg.slogdet(precision)[1]
    )
    prior = np.broadcast_to(
        -(EXCESS_POWER + zeros) * np.log(ERROR_FACTORS), (len(amplitude), len(ERROR_FACTORS))
    )
    return probability + prior.ravel(), mean, within


def _quantiles(probable: Array, mean: Array, std: Array, parts: tuple[float, ...]) -> Array:
    """Return quantiles of a mixture of normal distributions, each (h,).

    By Newton's method within bounds, whose middle is next where it leaves them.
    """
    from scipy.special import ndtr, ndtri

    seen = probable > ROUNDING_PROBABILITY
    probable, mean, std = probable[seen], mean[seen], std[seen]
    low: Array = np.full(len(parts), np.min(mean - 9 * std))
    high: Array = np.full(len(parts), np.max(mean + 9 * std))
    centre = probable @ mean
    found: Array = centre + np.sqrt(probable @ (std**2 + (mean - centre) ** 2)) * ndtri(parts)
    for _ in range(60):
        z = (found - mean[:, None]) / std[:, None]
        over = probable @ ndtr(z) - parts
        low, high = np.where(over < 0, found, low), np.where(over < 0, high, found)
        density = (probable / std) @ np.exp(-0.5 * z**2) / np.sqrt(2 * np.pi)
        with np.errstate(all="ignore"):  # no density, far from all
            before, found = found, found - over / density
        found = np.where((found >= low) & (found <= high), found, (low + high) / 2)
        if np.all(np.abs(found - before) < 1e-8 * std.min()):  # the next step is its square
            break
    return found


@cache
def _ratios() -> tuple[Array, Array]:
    """Return the ratio of intervals of 95 and 68 %, negative so that it rises, and its dof."""
    from scipy.special import stdtrit

    degrees = np.geomspace(FEWEST_DOF, 1e4, 400)
    ratios = stdtrit(degrees, 0.975) / stdtrit(degrees, 0.5 + ONE_SIGMA / 2)
    return -np.asarray(ratios, dtype=np.float64), degrees


def _as_student(probable: Array, mean: Array, std: Array) -> tuple[float, float, float]:
    """Return median, u and dof of Student's t with the mixture's intervals of 68 and 95 %."""
    from scipy.special import stdtrit

    half = ONE_SIGMA / 2
    parts = (0.025, 0.5 - half, 0.5, 0.5 + half, 0.975)
    q = _quantiles(probable, mean, std, parts)
    dof = float(np.interp(-(q[4] - q[0]) / (q[3] - q[1]), *_ratios()))
    return float(q[2]), float((q[4] - q[0]) / 2 / stdtrit(dof, 0.975)), dof


def _effect(
    x: Array,
    y: Array,
    z: Array,
    probable: Array,
    amplitude: Array,
    highest: tuple[int, ...],
    variance: float,
) -> tuple[Array, Array, float, tuple[float, float, float]]:
    """Return `amplitudes`, `variance` and `beyond`; the deviation over a turn, its u and dof.

    The square of the deviation is half the sum of squared amplitudes, whose mean and variance are
    known for normal amplitudes. Either that is all, or orders above K add what the values scatter
    by beyond their stated `variance`.
    """
    count, dim = z.shape[1], x.shape[1]
    every = np.concatenate([x, z], axis=1)
    products, moments = every.T @ every, every.T @ y
    effect, power = np.zeros((2, count))
    shown = np.flatnonzero(probable > NEGLIGIBLE_PROBABILITY)
    weight = probable[shown] / probable[shown].sum()
    square, spread = np.zeros(len(shown)), np.zeros(len(shown))
    place, case = np.divmod(shown, len(amplitude) * len(ERROR_FACTORS))
    size = amplitude[case // len(ERROR_FACTORS)]
    excess = ERROR_FACTORS[case % len(ERROR_FACTORS)]
    for one in np.unique(place).tolist():
        own, used = np.flatnonzero(place == one), dim + 2 * highest[one]
        precision = products[:used, :used] / excess[own, None, None] ** 2
        precision[:, range(dim, used), range(dim, used)] += size[own, None] ** -2.0
        covariance = np.linalg.inv(precision)
        mean = (covariance @ moments[:used] / excess[own, None] ** 2)[:, dim:]
        covariance = covariance[:, dim:, dim:]
        effect[: used - dim] += weight[own] @ mean
        within = np.diagonal(covariance, axis1=1, axis2=2)
        power[: used - dim] += weight[own] @ (mean**2 + within)
        square[own] = np.sum(mean**2 + within, axis=1) / 2
        spread[own] = np.sum(covariance**2, axis=(1, 2)) / 2
        spread[own] += np.einsum("hi,hij,hj->h", mean, covariance, mean)
    more = variance * (excess**2 - 1)
    square = np.concatenate([square, square + more])
    deviation = np.sqrt(square)
    std = np.sqrt(np.tile(spread, 2) / np.maximum(square, TINY)) / 2
    std = np.maximum(std, 1e-9 * deviation.max() + TINY)
    unknown = np.sum((power - effect**2).reshape(-1, 2), axis=1)
    stated = _as_student(np.tile(weight / 2, 2), deviation, std)
    return effect, unknown, float(weight @ more), stated
