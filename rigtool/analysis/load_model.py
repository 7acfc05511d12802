"""A drive's effort as function of motion and load, solved for the load.

    effort = f0(motion) + torque g1(motion) + torque^2 g2(motion)

The functions are those of `load_basis`, each a sum of smooth ones; `load_learning` finds their
weights. Friction that grows with load is the part of g1 that changes sign with the direction;
compliance shifts f0 along the position, which to first order is part of g1, too.

Outside the region that was learned there is no estimate (`load_region`). Near standstill friction
is undetermined: the dead band tells between which torques the load may be.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rigtool.analysis.load_basis import LOAD_POWER, Path, Scales, motion_functions, size_of
from rigtool.analysis.load_region import Region

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class Estimate:
    """Torque, N m, and its standard uncertainty at each row (n,): NaN where there is none.

    `inside` says where it was learned; `low` and `high` (n,) bound the torque near standstill, NaN
    elsewhere and where nothing bounds it. `still` marks those rows.
    """

    torque: Array
    u: Array
    inside: Mask
    still: Mask
    low: Array
    high: Array


@dataclass(frozen=True, eq=False)
class LoadModel:
    """What was learned: `degree` of each group in use, `weights` (k,) and their covariance (k, k).

    Columns are in the order of `degree`; effort is in units of `effort_scale`. `scatter` (2, 3) are
    the logarithm of the scatter's variance for each direction: constant, by the logarithm of speed,
    by torque; `factor` (2,) multiplies uncertainties. `common` (2,) is the standard deviation of a
    recording's mean error, N m: what averaging over one recording does not take off. `direction` is
    the sign of the speed against which the load acts.
    """

    scales: Scales
    bandwidth_hz: float
    effort_scale: float
    degree: Mapping[str, float]
    weights: Array
    covariance: Array
    scatter: Array
    factor: Array
    common: Array
    direction: int
    region: Region

    def sizes(self) -> list[int]:
        """Return how many weights each group has."""
        return [size_of(name) for name in self.degree]

    def estimate(self, effort: Array, path: Path) -> Estimate:
        """Return the torque at the rows (n,) of a path whose effort is given."""
        design = Design.of(path, self.scales, self.degree)
        scaled, slope, row = self._solve(design, effort / self.effort_scale)
        speed = path.speed / self.scales.speed
        variance = np.einsum("ij,jk,ik->i", row, self.covariance, row)
        variance += scatter_variance(self.scatter, speed, scaled)
        side = (speed < 0).astype(int)
        u = self.factor[side] * np.sqrt(variance) / np.abs(slope)
        place = (path.position - self.scales.low) / (self.scales.high - self.scales.low)
        still = np.abs(path.speed) < self.scales.standstill
        inside = self.region.holds(place, speed, scaled) & path.regular & ~still
        low, high = self._dead_band(effort, path, still)
        torque = np.where(inside, scaled, np.nan) * self.scales.torque
        return Estimate(
            torque, np.where(inside, u, np.nan) * self.scales.torque, inside, still, low, high
        )

    def _solve(self, design: Design, effort: Array) -> tuple[Array, Array, Array]:
        """Return torque (n,), slope of effort by torque (n,) and design rows (n, k) there."""
        parts = [
            design.columns[:, design.power == p] @ self.weights[design.power == p]
            for p in (0, 1, 2)
        ]
        rest = parts[0] - effort
        root = parts[1] ** 2 - 4 * parts[2] * rest
        with np.errstate(invalid="ignore", divide="ignore"):
            # The root that becomes the linear solution where the square vanishes
            torque = -2 * rest / (parts[1] + np.copysign(np.sqrt(root), parts[1]))
        row = design.at(torque)
        slope = parts[1] + 2 * parts[2] * torque
        return torque, slope, row

    def _dead_band(self, effort: Array, path: Path, still: Mask) -> tuple[Array, Array]:
        """Return torques between which the load is where friction may act either way."""
        edges = np.full((2, len(effort)), np.nan)
        if still.any():
            for edge, way in zip(edges, (1.0, -1.0), strict=True):
                design = Design.of(path, self.scales, self.degree, way)
                edge[still] = self._solve(design, effort / self.effort_scale)[0][still]
        low, high = np.sort(edges, axis=0) * self.scales.torque
        bad = np.isnan(edges).any(axis=0)
        return np.where(bad, np.nan, low), np.where(bad, np.nan, high)


@dataclass(frozen=True, eq=False)
class Design:
    """Functions of motion as columns (n, k); each goes with the torque to its `power` (k,)."""

    columns: Array
    power: NDArray[np.intp]

    @staticmethod
    def of(
        path: Path, scales: Scales, groups: Mapping[str, float], direction: float = 0.0
    ) -> Design:
        """Return the columns of some groups, in their order, at the rows of a path."""
        functions = motion_functions(path, scales, direction)
        return Design.joined({name: functions[name] for name in groups})

    @staticmethod
    def joined(functions: Mapping[str, Array]) -> Design:
        """Return the columns of all groups, (n, columns) each, side by side."""
        power = [np.full(f.shape[1], LOAD_POWER.get(name, 0)) for name, f in functions.items()]
        return Design(np.hstack(list(functions.values())), np.concatenate(power))

    def at(self, torque: Array) -> Array:
        """Return rows (n, k) at a torque, so that rows @ weights is the effort."""
        return self.columns * torque[:, None] ** self.power

    def slope(self, torque: Array) -> Array:
        """Return rows (n, k) so that rows @ weights is the slope of effort by torque."""
        below = np.maximum(self.power - 1, 0)
        return self.columns * (self.power * torque[:, None] ** below)


def scatter_rows(speed: Array, torque: Array) -> Array:
    """Return what the logarithm of the scatter's variance is linear in, (n, 3)."""
    return np.column_stack(
        [np.ones_like(speed), np.log(np.maximum(np.abs(speed), 1e-3)), np.abs(torque)]
    )


def scatter_variance(scatter: Array, speed: Array, torque: Array) -> Array:
    """Return the variance (n,) that scatter alone makes."""
    rows = scatter_rows(speed, np.nan_to_num(torque))
    side = (speed < 0).astype(int)
    # Beyond what was learned the logarithm of the variance must not run away.
    variance: Array = np.exp(np.minimum(np.sum(rows * scatter[side], axis=1), 50.0))
    return variance
