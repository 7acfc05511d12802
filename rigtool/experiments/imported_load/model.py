"""A drive's effort as function of motion and load, solved for the load.

    effort = f0(motion) + torque g1(motion) + torque^2 g2(motion) + torque^3 g3(motion)

The functions are those of `basis`, each a sum of smooth ones; `learning` finds their weights.
Friction that grows with load is the part of g1 that changes sign with the direction; compliance
shifts f0 along the position, which to first order is part of g1, too.

Outside the region that was learned there is no estimate (`region`). Near standstill friction
is undetermined: the dead band bounds the load instead.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rigtool.experiments.imported_load.basis import LOAD_POWER, Scales, ShaftPath, motion_functions
from rigtool.experiments.imported_load.region import Region
from rigtool.numerics.arrays import Array, Mask

SIGNS = (1, -1)
"""Of the speed, in the order of a model's sides."""

FLAT = 0.25
"""Where the slope of effort by torque is below this part of the usual one in its direction, such as
after a reversal, friction hides the load as it does at standstill."""

HIGHEST_POWER = max(LOAD_POWER.values())

SLOWEST = 1e-3
"""Speed below which scatter does not change any more, as part of the highest."""

HALVINGS = 40
"""Times that the range of torques is halved to find one: far finer than any uncertainty."""


@dataclass(frozen=True, eq=False)
class TorqueEstimate:
    """Torque, N m, and its standard uncertainty at each row (n,): NaN where there is none.

    `inside` marks rows within the learned region; `low` and `high` (n,) bound the torque where
    friction hides it, NaN elsewhere and where nothing bounds it. `still` marks those rows: near
    standstill, or so soon after a reversal that effort hardly depends on the load yet.
    """

    torque: Array
    u: Array
    inside: Mask
    still: Mask
    low: Array
    high: Array


@dataclass(frozen=True, eq=False)
class Side:
    """What was learned of one direction: `degree` of each group in use, in the order of columns.

    `weights` (k,) and their `covariance` (k, k) are without unit; `scatter` (3,) is the logarithm
    of the scatter's variance: constant, by the logarithm of speed, by torque; `factor` multiplies
    uncertainties. `common` is the standard deviation of a recording's mean error, what averaging
    over one recording does not take off; `slope` is the usual one of effort by torque.
    """

    degree: Mapping[str, float]
    weights: Array
    covariance: Array
    scatter: Array
    factor: float
    common: float
    slope: float

    def solve(
        self, functions: Mapping[str, Array], effort: Array, torque_range: tuple[float, float]
    ) -> tuple[Array, Array, Array]:
        """Return torque, slope of effort by torque there, and variance of effort, (n,) each.

        All without unit. By halving the range of torques; NaN where the effort is that of none.
        """
        design = DesignMatrix.joined({name: functions[name] for name in self.degree})
        parts = design.polynomial(self.weights)
        low, high = (np.full(len(effort), edge) for edge in torque_range)
        bottom, top = polynomial_at(parts, low), polynomial_at(parts, high)
        rising = np.sign(top - bottom)
        known = (rising * (effort - bottom) >= 0) & (rising * (top - effort) >= 0)
        for _ in range(HALVINGS):
            middle = (low + high) / 2
            beyond = rising * (polynomial_at(parts, middle) - effort) > 0
            low, high = np.where(beyond, low, middle), np.where(beyond, middle, high)
        torque = np.where(known, (low + high) / 2, np.nan)
        powers = np.arange(1, len(parts))[:, None]
        slope = polynomial_at(parts[1:] * powers, torque)
        row = design.at(torque)
        return torque, slope, np.einsum("ij,ij->i", row @ self.covariance, row)


@dataclass(frozen=True, eq=False)
class LoadModel:
    """A model of both directions, positive speed first.

    Effort is in units of `effort_scale`; `torque_range` are the lowest and highest torque that are
    looked at, without unit; `direction` is the sign of the speed against which the load acts.
    """

    scales: Scales
    bandwidth_hz: float
    effort_scale: float
    sides: tuple[Side, Side]
    torque_range: tuple[float, float]
    direction: int
    region: Region

    def estimate(self, effort: Array, path: ShaftPath) -> TorqueEstimate:
        """Return the torque at the rows (n,) of a path whose effort is given."""
        speed, unit = path.speed / self.scales.speed, self.scales.torque
        torque, u, slope_share = (np.full(len(speed), np.nan) for _ in range(3))
        for sign, side in zip(SIGNS, self.sides, strict=True):
            mask = speed < 0 if sign < 0 else speed >= 0
            functions = motion_functions(path, self.scales, sign)
            found, slope, variance = side.solve(
                functions, effort / self.effort_scale, self.torque_range
            )
            variance += scatter_variance(side.scatter, speed, found)
            with np.errstate(invalid="ignore", divide="ignore"):
                spread = side.factor * np.sqrt(variance) / np.abs(slope)
            torque[mask], u[mask] = found[mask], spread[mask]
            slope_share[mask] = np.abs(slope[mask]) / side.slope
        still = (np.abs(path.speed) < self.scales.standstill) | (slope_share < FLAT)
        place = (path.position - self.scales.low) / (self.scales.high - self.scales.low)
        inside = self.region.holds(place, speed, torque) & path.regular & ~still
        low, high = self._dead_band(effort, path, still)
        return TorqueEstimate(
            torque=np.where(inside, torque, np.nan) * unit,
            u=np.where(inside, u, np.nan) * unit,
            inside=inside,
            still=still,
            low=low,
            high=high,
        )

    def _dead_band(self, effort: Array, path: ShaftPath, still: Mask) -> tuple[Array, Array]:
        """Return the torques (n,) between which the load is where friction may act either way."""
        edges = np.full((2, len(effort)), np.nan)
        if still.any():
            for edge, sign, side in zip(edges, SIGNS, self.sides, strict=True):
                functions = motion_functions(path, self.scales, sign, alone=True)
                rows = {name: functions[name][still] for name in side.degree}
                scaled = effort[still] / self.effort_scale
                edge[still] = side.solve(rows, scaled, self.torque_range)[0]
        edges[:, np.isnan(edges).any(axis=0)] = np.nan
        low, high = np.sort(edges, axis=0) * self.scales.torque
        return low, high


@dataclass(frozen=True, eq=False)
class DesignMatrix:
    """Functions of motion as columns (n, k); each goes with the torque to its `power` (k,)."""

    columns: Array
    power: NDArray[np.intp]

    @staticmethod
    def joined(functions: Mapping[str, Array]) -> DesignMatrix:
        """Return the columns of all groups, (n, columns) each, side by side."""
        power = [np.full(f.shape[1], LOAD_POWER.get(name, 0)) for name, f in functions.items()]
        return DesignMatrix(np.hstack(list(functions.values())), np.concatenate(power))

    def polynomial(self, weights: Array) -> Array:
        """Return the effort's parts by power of the torque, (powers, n)."""
        parts = [
            self.columns[:, self.power == power] @ weights[self.power == power]
            for power in range(HIGHEST_POWER + 1)
        ]
        return np.stack(parts)

    def at(self, torque: Array) -> Array:
        """Return rows (n, k) at a torque, so that rows @ weights is the effort."""
        return self.columns * torque[:, None] ** self.power

    def slope(self, torque: Array) -> Array:
        """Return rows (n, k) so that rows @ weights is the slope of effort by torque."""
        below = np.maximum(self.power - 1, 0)
        return self.columns * (self.power * torque[:, None] ** below)


def polynomial_at(parts: Array, torque: Array) -> Array:
    """Return the sum of parts (powers, n) times the torque's powers, (n,)."""
    total: Array = parts[-1]
    for part in parts[-2::-1]:
        total = total * torque + part
    return total


def scatter_rows(speed: Array, torque: Array) -> Array:
    """Return what the logarithm of the scatter's variance is linear in, (n, 3)."""
    magnitude = np.maximum(np.abs(speed), SLOWEST)
    return np.column_stack([np.ones_like(speed), np.log(magnitude), np.abs(torque)])


def scatter_variance(scatter: Array, speed: Array, torque: Array) -> Array:
    """Return the variance (n,) that scatter alone makes."""
    # Beyond what was learned the logarithm of the variance must not run away.
    variance: Array = np.exp(np.minimum(scatter_rows(speed, np.nan_to_num(torque)) @ scatter, 50.0))
    return variance
