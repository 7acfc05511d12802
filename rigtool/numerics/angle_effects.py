"""Least squares where values also depend on the rotor's angle, from angles that do not resolve it.

    y = X beta + h sum over orders k = 1..K of (c_k cos(k angle) + s_k sin(k angle)) + e

The orders are random effects: c_k, s_k are normal with one variance v for all k up to K and none
beyond. Errors e are normal with standard uncertainties u, all larger by the same factor where they
scatter more. K, v and the factor are unknown; beta averages over all of them, each weighted by how
probable the values y are with it (D. J. C. MacKay, Neural Computation 4, 415-447, 1992). Orders
that the angles cannot tell from X, or from each other, so come into the uncertainty of beta, as
large as the orders that are seen let expect.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from rigtool.numerics.arrays import Array

LOWEST_ORDER, HIGHEST_ORDER = 4, 12
"""Range of K that is considered beside 0; fewer orders would be taken for all from few angles."""

EXCESS = np.geomspace(1.0, 300.0, 14)
"""Factors considered by which errors may exceed their stated uncertainty."""

EXCESS_POWER = 1.0
"""The prior of a factor falls with this power of it, beside being even in its logarithm."""

ONE_SIGMA = 0.6827
"""Probability within one standard deviation of a normal distribution."""

DRAWS = 1000
"""Draws from the posterior for the deviation over a turn."""

AMPLITUDES = 24
"""Number of standard deviations of an order that are considered."""


@dataclass(frozen=True)
class AngleEffects:
    """Parameters (p,), their covariance (p, p) and degrees of freedom; of the angle's effect.

    An interval is the standard uncertainty times the quantile of Student's t: both match the
    posterior distribution at 68 % and 95 % for the first parameter. `effect` (n,) is what the angle
    adds to each value, without h; `deviation` the standard deviation of the effect over a turn, and
    `deviation_u` its standard uncertainty.
    """

    parameters: Array
    covariance: Array
    dof: float
    effect: Array
    deviation: float
    deviation_u: float


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
    rest = value - design @ np.linalg.lstsq(x, y, rcond=None)[0]
    spread = max(float(np.sqrt(np.mean(rest**2))), float(np.min(u)))
    amplitude = spread * np.geomspace(1 / 30, 10, AMPLITUDES)
    parts = [_given(x, y, z[:, : 2 * order], amplitude) for order in highest]
    weight = np.concatenate([part[0] for part in parts])
    mean = np.concatenate([part[1] for part in parts])
    within = np.concatenate([part[2] for part in parts])
    probable = np.exp(weight - weight.max())
    probable /= probable.sum()
    parameters = probable @ mean
    off = mean - parameters
    covariance = np.einsum("h,hij->ij", probable, within + off[:, :, None] * off[:, None, :])
    covariance, dof = _as_student(covariance, probable, off, within)
    effect, deviation, deviation_u = _effect(x, y, z, probable, amplitude, highest)
    return AngleEffects(parameters, covariance, dof, waves @ effect, deviation, deviation_u)


def _given(x: Array, y: Array, z: Array, amplitude: Array) -> tuple[Array, Array, Array]:
    """Return logarithm of the probability, means and covariances of beta for each hypothesis.

    All in units of the stated errors; the hypotheses are amplitudes by excess, in sequence (h,).
    """
    power, axes = np.linalg.eigh(z @ z.T)
    xs, ys = axes.T @ x, axes.T @ y
    grown = (amplitude[:, None] ** 2 * np.maximum(power, 0.0))[:, None, :]
    variance = (grown + EXCESS[None, :, None] ** 2).reshape(-1, len(y))  # (h, n)
    precision = np.einsum("ni,hn,nj->hij", xs, 1 / variance, xs)
    within = np.linalg.inv(precision)
    mean = np.einsum("hij,hj->hi", within, np.einsum("ni,hn->hi", xs, ys / variance))
    rest = ys - mean @ xs.T
    probability = -0.5 * (
        np.sum(np.log(variance) + rest**2 / variance, axis=1) + np.linalg.slogdet(precision)[1]
    )
    prior = np.broadcast_to(-EXCESS_POWER * np.log(EXCESS), (len(amplitude), len(EXCESS)))
    return probability + prior.ravel(), mean, within


def _as_student(
    covariance: Array, probable: Array, off: Array, within: Array
) -> tuple[Array, float]:
    """Return covariance and degrees of freedom whose Student's t has the mixture's intervals."""
    from scipy.optimize import brentq
    from scipy.special import ndtr, stdtrit

    def half_width(index: int, part: float) -> float:
        std = np.sqrt(within[:, index, index])

        def beyond(width: float) -> float:
            inside = ndtr((width - off[:, index]) / std) - ndtr((-width - off[:, index]) / std)
            return float(probable @ inside) - part

        return float(brentq(beyond, 0.0, 50 * math.sqrt(covariance[index, index])))

    degrees = np.geomspace(1, 1e4, 400)
    ratios = stdtrit(degrees, 0.975) / stdtrit(degrees, 0.5 + ONE_SIGMA / 2)
    wide = [half_width(index, 0.95) for index in range(len(covariance))]
    ratio = max(w / half_width(index, ONE_SIGMA) for index, w in enumerate(wide))
    dof = float(np.interp(-ratio, -ratios, degrees))
    u = np.array(wide) / stdtrit(dof, 0.975)
    scale = u / np.sqrt(np.diag(covariance))
    return covariance * np.outer(scale, scale), dof


def _effect(
    x: Array,
    y: Array,
    z: Array,
    probable: Array,
    amplitude: Array,
    highest: tuple[int, ...],
) -> tuple[Array, float, float]:
    """Return the mean amplitudes of the orders (2 K,), and the deviation over a turn with its u."""
    count, dim = z.shape[1], x.shape[1]
    every = np.concatenate([x, z], axis=1)
    rng = np.random.default_rng(0)
    chosen, times = np.unique(rng.choice(len(probable), DRAWS, p=probable), return_counts=True)
    drawn = []
    for number, repeat in zip(chosen.tolist(), times.tolist(), strict=True):
        place, case = divmod(number, len(amplitude) * len(EXCESS))
        order = highest[place]
        size, excess = amplitude[case // len(EXCESS)], EXCESS[case % len(EXCESS)]
        used = dim + 2 * order
        precision = every[:, :used].T @ every[:, :used] / excess**2
        precision[range(dim, used), range(dim, used)] += 1 / size**2
        inverse = np.linalg.inv(precision)
        mean = inverse @ (every[:, :used].T @ y) / excess**2
        draws = np.zeros((repeat, count))
        draws[:, : used - dim] = rng.multivariate_normal(
            mean, inverse, size=repeat, method="eigh", check_valid="ignore"
        )[:, dim:]
        drawn.append(draws)
    amplitudes = np.concatenate(drawn)
    deviation = np.sqrt(np.sum(amplitudes**2, axis=1) / 2)
    low, high = np.quantile(deviation, [0.5 - ONE_SIGMA / 2, 0.5 + ONE_SIGMA / 2])
    return amplitudes.mean(axis=0), float(np.median(deviation)), float(high - low) / 2
