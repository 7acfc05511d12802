"""What is possible for friction and for heat, of what least squares find of them.

Friction f opposes motion, and its state z0 before a staircase is within -1 to 1. Of the normal
distribution that least squares give f and h = f z0, only the part

    0 <= f <= largest,   -f <= h <= f

is possible: its probability, and its mean, are those of friction (A. Gelman et al., Bayesian Data
Analysis, 3rd ed., 2013, section 2.8). Where contacts bend further than the arm moves, noise makes f
negative in many staircases that have friction. Heat lowers the constant: its loss is positive.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from rigtool.numerics.arrays import TINY, Array

NODES, REACH = 41, 5.0
"""Values of f for which h is integrated, up to so many standard deviations from the mean."""

FAR_EDGE = 9.0
"""Standard deviations beyond which nothing of a normal distribution is left, to a double's
rounding."""


@dataclass(frozen=True)
class Possible:
    """The possible part of normal distributions (...) of f and h: the logarithm of its probability
    (...,), how far its mean is from that of the whole, N m (..., 2), and its covariance (..., 2, 2)
    in (N m)2."""

    logarithm: Array
    shift: Array
    covariance: Array


def possible(mean: Array, covariance: Array, largest: float) -> Possible:
    """Return the possible part of normal distributions of f and h, of mean (..., 2) N m and
    covariance (..., 2, 2); `largest` is that of f, N m."""
    f, h = mean[..., None, 0], mean[..., None, 1]
    sigma = np.sqrt(covariance[..., 0, 0])[..., None]
    slope = (covariance[..., 0, 1] / covariance[..., 0, 0])[..., None]
    rest = covariance[..., 1, 1] - covariance[..., 0, 1] ** 2 / covariance[..., 0, 0]
    narrow = np.sqrt(np.maximum(rest, 1e-12 * covariance[..., 1, 1]))[..., None]
    nearest = np.clip(f, 0.0, largest)
    low = np.maximum(nearest - REACH * sigma, 0.0)
    high = np.minimum(nearest + REACH * sigma, largest)
    at = low + (high - low) * (np.arange(NODES) + 0.5) / NODES
    centre = h + slope * (at - f)
    below, above = (-at - centre) / narrow, (at - centre) / narrow
    near = ~((below < -FAR_EDGE) & (above > FAR_EDGE))
    part, inner, bent = np.zeros((3, *near.shape))
    part[near], inner[near], bent[near] = _between(below[near], above[near])
    density = part - ((at - f) / sigma) ** 2 / 2
    top = density.max(axis=-1, keepdims=True)
    weight = np.exp(density - top)
    total = weight.sum(axis=-1)
    width = ((high - low) / sigma)[..., 0] / NODES / math.sqrt(2 * math.pi)
    logarithm = np.log(total * width) + top[..., 0]
    variance = np.maximum(narrow**2 * (1 + bent - inner**2), 0.0)
    weight /= total[..., None]
    off = np.stack([at - f, centre + narrow * inner - h])
    shift = np.sum(weight * off, axis=-1)
    off -= shift[..., None]
    spread = np.einsum("...k,i...k,j...k->...ij", weight, off, off)
    spread[..., 1, 1] += np.sum(weight * variance, axis=-1)
    return Possible(logarithm, np.moveaxis(shift, 0, -1), spread)


def _between(below: Array, above: Array) -> tuple[Array, Array, Array]:
    """Return the logarithm of the probability that a standard normal is between these (n,), its
    mean there, and its variance there less 1 plus the square of its mean."""
    from scipy.special import log_ndtr

    # on the side where both are small
    mirrored = below > 0
    upper = log_ndtr(np.where(mirrored, -below, above))
    lower = log_ndtr(np.where(mirrored, -above, below))
    part = upper + np.log(-np.expm1(np.minimum(lower - upper, -TINY)))
    edges = below, above
    first, last = (np.exp(-(edge**2) / 2 - part) / math.sqrt(2 * math.pi) for edge in edges)
    return part, first - last, below * first - above * last


def positive(mean: Array, sigma: Array) -> tuple[Array, Array]:
    """Return the logarithm of the probability that normal distributions (...,) are positive, and
    how far the mean of that part is from that of the whole (N. L. Johnson et al., Continuous
    Univariate Distributions, 2nd ed., 1994, section 13.10.1)."""
    from scipy.special import log_ndtr

    ratio = mean / sigma
    logarithm: Array = log_ndtr(ratio)
    return logarithm, sigma * np.exp(-(ratio**2) / 2 - logarithm) / math.sqrt(2 * math.pi)


def begins_with(found: Array, u: Array, largest: float) -> Array:
    """Return the friction with which each staircase begins, over the `largest` f, (m,).

    `found` (m,) in N m is f z0 of each by least squares, with standard uncertainties `u` (m,). Each
    is as far from the mean of all as what they scatter by beyond these makes likely (B. Efron,
    C. Morris, J. Am. Stat. Assoc. 68, 117-130, 1973).
    """
    mean, square = float(np.mean(found)), float(np.var(found))
    likely = max(1 - float(np.mean(u**2)) / max(square, TINY), 0.0)
    return np.clip((mean + likely * (found - mean)) / max(largest, TINY), -1.0, 1.0)
