"""The repeatable part of cycles, order by order, and the part that may be chance.

A cycle i of m is a sum of orders, c_ki the complex amplitude of order k. With the mean C_k over
cycles and the scatter s_k^2 of single ones, the mean of noise alone has the power s_k^2/m, so that

    F_k = |C_k|^2 / (g_k s_k^2/m)   follows F(2, 2 (m - 1)),   F(1, m - 1) for order 0

g_k = (1 + r)/(1 - r), where r > 0 is the correlation of a cycle's deviation with that of the next.
Of many orders, those count as repeatable that the procedure of Benjamini & Hochberg (J. Royal
Statistical Society B 57(1) 289-300, 1995) keeps: of the orders kept, at most the part
`MAX_CHANCE_PART` is due to chance; where nothing repeats, all orders are dropped with the
probability 1 - `MAX_CHANCE_PART`.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from rigtool.numerics.arrays import Array, Mask

MAX_CHANCE_PART = 0.01
"""Largest part of the orders reported as repeatable that may be chance."""

NEGLIGIBLE_ORDER = 1e-9
"""Order relative to the strongest one below which it is rounding."""


@dataclass(frozen=True, eq=False)
class Repeatability:
    """Power of the orders 0..n/2 of cycles: `mean` (k,) that of their mean, `chance` (k,) expected.

    `chance` is the power of noise in the mean; both sum up to a mean square. `cycles` is m.
    """

    mean: Array
    chance: Array
    cycles: int

    def kept(self) -> Mask:
        """Return for each order (k,) whether it repeats, by the procedure of this module."""
        from scipy.special import fdtrc

        real = np.full(self.mean.size, 2.0)
        real[0] = 1.0
        tested = self.mean > NEGLIGIBLE_ORDER**2 * self.mean.max(initial=0.0)
        chance = np.maximum(self.chance, np.finfo(np.float64).tiny)
        p = fdtrc(real, real * (self.cycles - 1), self.mean / chance)
        p[~tested] = 1.0
        ranked = np.sort(p[tested])
        below = ranked <= MAX_CHANCE_PART * np.arange(1, ranked.size + 1) / ranked.size
        limit = ranked[below].max(initial=-1.0)
        return tested & (p <= limit)

    def ratio(self) -> float:
        """Power that repeats over the power that chance would explain; about 1 for noise alone."""
        total = float(self.chance.sum())
        return float(self.mean.sum()) / total if total > 0 else float("inf")

    def limit(self) -> float:
        """Ratio that noise alone exceeds with the probability `MAX_CHANCE_PART`.

        The sum of orders of unequal power has the degrees of freedom of Satterthwaite (Biometrics
        Bulletin 2(6) 110-114, 1946).
        """
        from scipy.special import fdtri

        squares = self.chance**2
        squares[0] *= 2  # one real number, not two
        if not squares.sum() > 0:
            return 1.0
        freedom = 2 * float(self.chance.sum()) ** 2 / float(squares.sum())
        return float(fdtri(freedom, freedom * (self.cycles - 1), 1 - MAX_CHANCE_PART))


def repeatability(cycles: Array, spread: float = 1.0) -> Repeatability:
    """Compare mean and scatter of cycles (m, n), by order.

    `spread` is the variance of the mean relative to scatter/m, where it carries other noise as
    well. Raises ValueError for fewer than two cycles.
    """
    count = len(cycles)
    if count < 2:
        raise ValueError(f"{count} cycle has no scatter: at least 2 are needed")
    orders = np.fft.rfft(cycles) / cycles.shape[1]
    weight = np.full(orders.shape[1], 2.0)  # an order k > 0 represents -k as well
    weight[0] = 1.0
    mean = orders.mean(axis=0)
    off = orders - mean
    power = np.sum(np.abs(off) ** 2, axis=0)
    next_to = np.sum(np.real(np.conj(off[:-1]) * off[1:]), axis=0)
    # The mean that was taken off lowers the correlation by about 1/m.
    r = np.clip(next_to / np.where(power > 0, power, 1.0) + 1 / count, 0.0, 0.9)
    chance = weight * power / (count - 1) / count * (1 + r) / (1 - r) * spread
    return Repeatability(weight * np.abs(mean) ** 2, chance, count)


def only_kept(cycles: Array, kept: Mask) -> Array:
    """Return cycles (..., n) of only those orders that are `kept` (n/2 + 1,)."""
    orders = np.fft.rfft(cycles)
    orders[..., ~kept] = 0.0
    return np.fft.irfft(orders, cycles.shape[-1])
