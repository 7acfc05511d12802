"""One direction of a load model: penalised least squares, its degrees chosen by levels left out.

Neighbouring splines are held together and other weights held small, by a degree for each group of
functions (Eilers & Marx, Statistical Science 11(2) 89-121, 1996). Rows are weighted by the scatter
that a first fit shows. Leaving out one fold of recordings after the other chooses each degree, or
that the group is of no use: what counts is how the model does where it was not learned.

The uncertainty has three parts: of the weights, from how whole recordings disagree, so that
residuals may be correlated in time as they like; scatter, that changes with speed and load; and a
factor that makes 95 % intervals hold 95 % of the rows of a level that was left out, from the choice
of degrees on.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from rigtool.experiments.imported_load.basis import LOAD_POWER, SPLINE_COUNT, size_of
from rigtool.experiments.imported_load.model import FLAT, Side, scatter_rows, scatter_variance
from rigtool.numerics.arrays import Array, Mask

Numbers = NDArray[np.intp]
Degree = Mapping[str, float]

DEGREES = (1e-6, 1e-4, 1e-2, 1.0)
"""Degrees of smoothing that are tried; the mean square of a column is 1."""

START = 1e-2
"""Degree that the choice starts from, with all groups."""

ALWAYS = ("offset", "load")
"""Groups without which there is no model; others may turn out to be of no use."""

WORTH = 0.002
"""Part by which a choice must lower the error to be taken."""

ROUNDS = 3
"""Times that the choice goes round all groups, at most."""

RIDGE = 1e-4
"""Degree by which weights are held small, at least, so that functions that are alike where it was
learned, such as those of speed, do not work against each other between."""

TINY = 1e-7
"""The same for groups that have nothing like them: just that the equations can be solved."""

COVERAGE, NORMAL = 0.95, 1.959963984540054
"""Of intervals, and the normal quantile of that."""

LOG_CHI2 = 1.270362845461478
"""Minus the expected logarithm of a squared standard normal number."""


@dataclass(frozen=True, eq=False)
class HeldOut:
    """Rows (n,) of folds that were left out: error and u of the torque, without unit.

    `resolved` (n,) marks rows where effort depends enough on the load for an error. `slope`
    (n,) of effort by torque is that of all rows, `slopes` (folds, n) those without each fold.
    """

    error: Array
    u: Array
    slope: Array
    slopes: Array
    resolved: Mask


@dataclass(frozen=True, eq=False)
class Rows:
    """Rows (n,) in motion in one direction, without unit, and columns (n, k) of all groups.

    `columns` are the effort's functions at the row's torque, `slopes` their derivative by it, both
    divided by `size` (k,); `fold` and `recording` number what is left out together, and where
    residuals go together.
    """

    groups: dict[str, Numbers]
    columns: Array
    slopes: Array
    size: Array
    effort: Array
    torque: Array
    speed: Array
    fold: Numbers
    recording: Numbers
    weight: Array
    sums: Sums

    @staticmethod
    def of(
        names: list[str],
        columns: Array,
        slopes: Array,
        effort: Array,
        torque: Array,
        speed: Array,
        fold: Numbers,
        recording: Numbers,
    ) -> Rows:
        """Gather rows; weights are those of the scatter that a first fit shows."""
        ends = np.cumsum([size_of(name) for name in names])
        groups = {
            name: np.arange(end - size_of(name), end) for name, end in zip(names, ends, strict=True)
        }
        size = np.maximum(np.sqrt(np.mean(columns**2, axis=0)), 1e-12)
        columns, ones = columns / size, np.ones(len(effort))
        plain = Rows(
            groups,
            columns,
            slopes / size,
            size,
            effort,
            torque,
            speed,
            fold,
            recording,
            ones,
            Sums.of(columns, effort, ones, fold),
        )
        scatter = _fit_scatter(
            plain.residual([dict.fromkeys(groups, START)] * plain.sums.folds), speed, torque
        )
        weight = 1 / scatter_variance(scatter, speed, torque)
        weight /= weight.mean()
        return replace(plain, weight=weight, sums=Sums.of(columns, effort, weight, fold))

    # -- one choice of degrees

    def use(self, degree: Degree) -> Numbers:
        """Return the columns in use."""
        return np.concatenate([self.groups[name] for name in degree])

    def penalty(self, degree: Degree) -> Array:
        """Return the matrix of the penalty for one row, (k, k)."""
        from scipy.linalg import block_diag

        blocks = []
        for name, value in degree.items():
            count = len(self.groups[name])
            held, block = max(value, RIDGE), np.zeros((count, count))
            if name in SPLINE_COUNT:
                bend = np.diff(np.eye(count), 2, axis=0)
                size = self.size[self.groups[name]]
                # Neighbours are held together as functions, whatever their columns' sizes
                block = bend.T @ bend * (float(np.mean(size)) ** 2) / np.outer(size, size)
                held = TINY if name in ALWAYS else RIDGE
            blocks.append(value * block + held * np.eye(count))
        return np.asarray(block_diag(*blocks))

    def weights(self, degree: Degree, without: int | None = None) -> Array:
        """Return weights (k,), one fold left out."""
        return self.sums.solve(self.use(degree), self.penalty(degree), without)

    def residual(self, degrees: Sequence[Degree]) -> Array:
        """Return the residual of effort (n,) in each fold, left out, with its own degrees."""
        residual = np.empty_like(self.effort)
        for fold, degree in enumerate(degrees):
            rows = self.fold == fold
            model = self.columns[np.ix_(rows, self.use(degree))] @ self.weights(degree, fold)
            residual[rows] = self.effort[rows] - model
        return residual

    def choose(self, levels: int, without: int | None = None) -> dict[str, float]:
        """Return the degree of each group that is of use, one group after the other.

        A fold to be `without` is not used. A power of the torque needs more levels than it is high.
        """
        sums = self.sums.without(without)
        names = [name for name in self.groups if LOAD_POWER.get(name, 0) < levels]
        degree = dict.fromkeys(names, START)
        best = self._cost(degree, sums)
        for _ in range(ROUNDS):
            before = best
            for name in names:
                tried = [{**degree, name: value} for value in DEGREES if degree.get(name) != value]
                if name in degree and name not in ALWAYS:
                    tried.append({n: v for n, v in degree.items() if n != name})
                costs = [self._cost(each, sums) for each in tried]
                if min(costs) < best - WORTH:
                    best = min(costs)
                    degree = tried[int(np.argmin(costs))]
            if best > before - WORTH:
                break
        return degree

    def choose_each(self, levels: int) -> list[dict[str, float]]:
        """Return what each fold's absence would have chosen: the choice is part of the learning."""
        if self.sums.folds < 3:
            return [self.choose(levels)] * self.sums.folds
        return [self.choose(levels, fold) for fold in range(self.sums.folds)]

    def _cost(self, degree: Degree, sums: Sums) -> float:
        """Return the mean logarithm of the residual in folds that are left out.

        Logarithms, as the levels at either end would else decide alone: they are extrapolated to.
        """
        squares = sums.held_out(self.use(degree), self.penalty(degree))
        return 0.5 * float(np.mean(np.log(np.maximum(squares, 1e-300))))

    # -- the model

    def model(self, degree: Degree, each: Sequence[Degree]) -> tuple[Side, HeldOut]:
        """Return the model of these degrees, and how folds did that were left out.

        `each` fold with the degrees that were chosen without it.
        """
        use, penalty = self.use(degree), self.penalty(degree)
        weights = self.sums.solve(use, penalty)
        residual = self.residual(each)
        scores = self._scores(residual)
        scatter = _fit_scatter(residual, self.speed, self.torque)
        variance, slope = np.empty_like(residual), np.empty_like(residual)
        slopes = np.empty((len(each), len(residual)))
        for fold, own in enumerate(each):
            rows, where = self.fold == fold, self.use(own)
            left = np.unique(self.recording[~rows])
            inverse = self.sums.inverse(where, self.penalty(own), fold)
            within = _covariance(inverse, scores[np.ix_(left, where)])
            columns = self.columns[np.ix_(rows, where)]
            variance[rows] = np.einsum("ij,ij->i", columns @ within, columns)
            slopes[fold] = self.slopes[:, where] @ self.weights(own, fold)
            slope[rows] = slopes[fold, rows]
        variance += scatter_variance(scatter, self.speed, self.torque)
        factor = self._factor(np.abs(residual) / np.sqrt(variance))
        usual = float(np.median(np.abs(slope)))
        resolved = np.abs(slope) >= FLAT * usual
        safe = np.where(resolved, slope, usual)
        held = HeldOut(
            error=-residual / safe,
            u=factor * np.sqrt(variance) / np.abs(safe),
            slope=self.slopes[:, use] @ weights,
            slopes=slopes,
            resolved=resolved,
        )
        size = self.size[use]
        covariance = _covariance(self.sums.inverse(use, penalty), scores[:, use])
        side = Side(
            degree=dict(degree),
            weights=weights / size,
            covariance=covariance / np.outer(size, size),
            scatter=scatter,
            factor=factor,
            common=_between(held.error[resolved], self.recording[resolved]),
            slope=usual,
        )
        return side, held

    def _factor(self, ratio: Array) -> float:
        """Return what makes 95 % intervals hold 95 % of the rows of folds that were left out.

        `ratio` (n,) is that of residual and its standard uncertainty there. Folds ask for different
        factors, their mean counts. Recordings repeat the measurement: by their number r, Student's
        t with r - 1 degrees of freedom stands for the normal distribution.
        """
        from scipy.stats import t

        folds = range(self.sums.folds)
        asked = [float(np.quantile(ratio[self.fold == fold], COVERAGE)) for fold in folds]
        wider = float(t.ppf((1 + COVERAGE) / 2, len(np.unique(self.recording)) - 1)) / NORMAL
        return wider * float(np.mean(asked)) / NORMAL

    def _scores(self, residual: Array) -> Array:
        """Return the sum of row times residual over each recording, (recordings, k)."""
        scores = np.zeros((int(self.recording.max()) + 1, self.columns.shape[1]))
        np.add.at(scores, self.recording, self.columns * (self.weight * residual)[:, None])
        return scores


@dataclass(frozen=True, eq=False)
class Sums:
    """Weighted sums over the rows of each fold, all that a choice of degrees needs.

    `normal` (f, k, k), `right` (f, k), `power` (f,) and `rows` (f,), for residuals
    power - 2 w.right + w.normal.w.
    """

    normal: Array
    right: Array
    power: Array
    rows: Array

    @staticmethod
    def of(columns: Array, effort: Array, weight: Array, fold: Numbers) -> Sums:
        """Gather them."""
        normal, right, power, rows = [], [], [], []
        for number in range(int(fold.max()) + 1):
            mask = fold == number
            scaled = columns[mask] * weight[mask, None]
            normal.append(scaled.T @ columns[mask])
            right.append(scaled.T @ effort[mask])
            power.append(float(np.sum(weight[mask] * effort[mask] ** 2)))
            rows.append(float(np.sum(weight[mask])))
        return Sums(np.stack(normal), np.stack(right), np.array(power), np.array(rows))

    @property
    def folds(self) -> int:
        """Number of folds."""
        return len(self.rows)

    def without(self, fold: int | None) -> Sums:
        """Return the sums of all folds but one."""
        if fold is None:
            return self
        parts = (
            np.delete(part, fold, axis=0)
            for part in (self.normal, self.right, self.power, self.rows)
        )
        return Sums(*parts)

    def solve(self, use: Numbers, penalty: Array, without: int | None = None) -> Array:
        """Return weights (k,), one fold left out."""
        from scipy.linalg import cho_factor, cho_solve

        keep = [fold for fold in range(self.folds) if fold != without]
        factor = cho_factor(self._matrix(use, penalty, keep), check_finite=False)
        weights: Array = cho_solve(factor, self.right[keep].sum(axis=0)[use], check_finite=False)
        return weights

    def inverse(self, use: Numbers, penalty: Array, without: int | None = None) -> Array:
        """Return the inverse of the equations' matrix (k, k), one fold left out."""
        keep = [fold for fold in range(self.folds) if fold != without]
        return np.asarray(np.linalg.inv(self._matrix(use, penalty, keep)))

    def held_out(self, use: Numbers, penalty: Array) -> Array:
        """Return the mean square of the residual in each fold (f,) when it is left out."""
        squares = []
        for fold in range(self.folds):
            weights = self.solve(use, penalty, fold)
            normal, right = self.normal[fold][np.ix_(use, use)], self.right[fold, use]
            square = self.power[fold] + float(weights @ (normal @ weights - 2 * right))
            squares.append(square / float(self.rows[fold]))
        return np.array(squares)

    def _matrix(self, use: Numbers, penalty: Array, keep: list[int]) -> Array:
        normal = self.normal[keep].sum(axis=0)[np.ix_(use, use)]
        matrix: Array = normal + self.rows[keep].sum() * penalty
        return matrix


def _covariance(inverse: Array, scores: Array) -> Array:
    """Return the covariance of weights whose recordings disagree by these scores (r, k)."""
    count, half = len(scores), scores @ inverse
    covariance: Array = half.T @ half * (count / max(count - 1, 1))
    return covariance


def _fit_scatter(residual: Array, speed: Array, torque: Array) -> Array:
    """Return how the logarithm of the residual's variance goes, (3,), see `Side`."""
    floor = 1e-6 * float(np.mean(residual**2)) + 1e-300
    logarithm = np.log(residual**2 + floor) + LOG_CHI2
    return np.asarray(np.linalg.lstsq(scatter_rows(speed, torque), logarithm, rcond=None)[0])


def _between(error: Array, recording: Numbers) -> float:
    """Return the standard deviation of the recordings' mean errors."""
    means = [error[recording == number].mean() for number in np.unique(recording)]
    return float(np.std(means, ddof=1)) if len(means) > 1 else math.nan
