"""The amplifier's ripple of another power-up than the learned one, in loads read from strokes.

A power-up draws the phases of the amplifier's ripple anew. What of it does not grow with the
current is the same with a load and without, and cancels. What grows with the current does not.
With the coefficients c of an order's cosine and sine as c1 + i c2, and the derivatives d of a load
by them as d1 + i d2, the order moves the load by Re(q), q = conj(d) c, the sum over the functions
that grow with the current; another power-up by Re(q exp(i p)), of any phase p. So a load that is
read with the learned ripple is off by

    -sum of Re(q) over the orders  in the mean,  with a variance of  sum of |q|^2 / 2.

Along a part of a turn low orders look like other functions: what was learned is the sum. The others
alone are less certain, D P D' with the derivatives D by these and the covariance P of what was
learned. That is more than the mean, which is therefore not corrected: its square counts.

The recordings tell which power-up they are of, by what the model leaves of the strokes without load
and with it, r. At the learned one r ~ N(0, V + D P D'), with D by all that was learned. At another
one the learned waves W c lack, and others of their amplitudes are there: r ~ N(-W c, V + D P D' +
W S W'), as in `force_sensor.power_up`. The noise V is that of the rows' scatter, or as much more as
r leaves open. Both are as probable beforehand.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import expit, logsumexp

from rigtool.experiments.force_model.drawn_ripple import sized_waves, sums
from rigtool.experiments.force_model.learning import LearnedModel
from rigtool.experiments.force_model.model import ROTOR_ORDERS, Kind
from rigtool.experiments.force_model.sliding_problem import (
    ROWS_PER_INDEPENDENT_ROW,
    SLIDING_PARAMETERS,
)
from rigtool.numerics.arrays import Array, Mask

GROWING = (Kind.GAIN_RIPPLE, Kind.SQUARE_RIPPLE)

NOISES = 12
"""Variances of the noise that are tried, equally spaced in logarithm."""


@dataclass(frozen=True, eq=False)
class Left:
    """What a model leaves of a mean cycle, at rows (r,), N m, with its derivatives `design` (p, r)
    by shape and coefficients, what the recording has of its own `own` (k, r), and the variance of
    a row by the scatter of the cycles, N2 m2."""

    rows: Array
    design: Array
    own: Array
    scattered: float

    def at(self, used: Mask) -> Left:
        """Return these at some of the rows (r,)."""
        return Left(self.rows[used], self.design[:, used], self.own[:, used], self.scattered)


def another_power_up(model: LearnedModel, records: Sequence[Left]) -> float:
    """Return the probability that recordings are of another power-up than the learned one."""
    mean, variance = sized_waves(model)
    if not mean.any():
        return 0.0
    free = [np.linalg.qr(one.own.T, mode="complete")[0][:, len(one.own) :] for one in records]
    left = np.concatenate([one.rows @ f for one, f in zip(records, free, strict=True)])
    design = np.hstack([one.design @ f for one, f in zip(records, free, strict=True)])
    terms, own = design[len(SLIDING_PARAMETERS) :], model.coefficient
    growing = [sums(model, kind) for kind in GROWING]
    waves = np.vstack([each @ terms for each in (sums(model, Kind.RIPPLE), *growing)])
    lacking = np.concatenate([mean, *(each @ own for each in growing)])
    square = np.concatenate([mean**2 + variance, *((each @ own) ** 2 for each in growing)])
    drawn = np.sqrt(square.reshape(-1, 2).sum(axis=1).repeat(2) / 2)
    sizes, axes = np.linalg.eigh(model.covariance)
    learned = (axes * np.sqrt(np.maximum(sizes, 0.0))).T @ design
    scattered = float(np.mean([one.scattered for one in records]))
    most = max(float(left @ left) / len(left), scattered)
    noise = ROWS_PER_INDEPENDENT_ROW * np.geomspace(scattered, most, NOISES)
    same = _log_density(left, learned, noise)
    other = _log_density(
        left + lacking @ waves, np.vstack([learned, drawn[:, None] * waves]), noise
    )
    return float(expit(other - same))


def _log_density(values: Array, spread: Array, noise: Array) -> float:
    """Return the logarithm of the normal density of values (r,) with the covariance S'S, S (k, r),
    and white noise beside it, summed over its variances (n,); without the constant."""
    _, sizes, axes = np.linalg.svd(spread, full_matrices=False)
    inside, rest = axes @ values, len(values) - len(sizes)
    outside = max(float(values @ values - inside @ inside), 0.0)
    variance = sizes**2 + noise[:, None]
    each = np.sum(np.log(variance) + inside**2 / variance, axis=1)
    each += rest * np.log(noise) + outside / noise
    return float(logsumexp(-each / 2))


def ripple_u(model: LearnedModel, by: Array) -> float:
    """Return the standard uncertainty, N m, that a load read at another power-up has beside that at
    the learned one; `by` (p,) are its derivatives by the model's shape and coefficients."""
    terms, own, others = by[len(SLIDING_PARAMETERS) :], model.coefficient, by.copy()
    orders = np.zeros(len(ROTOR_ORDERS), np.complex128)
    for kind in GROWING:
        waves = sums(model, kind)
        orders += (
            (waves @ own).reshape(-1, 2) @ (1, 1j) * ((waves @ terms).reshape(-1, 2) @ (1, -1j))
        )
        others[len(SLIDING_PARAMETERS) :] -= (waves.T @ waves).diagonal() * terms
    known, alone = (each @ model.covariance @ each for each in (by, others))
    moved = orders.real.sum() ** 2 + np.sum(np.abs(orders) ** 2) / 2
    return math.sqrt(max(float(alone - known), 0.0) + float(moved))
