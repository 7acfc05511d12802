"""A drive's effort as function of motion and load, learned at known loads, solved for the load.

    effort = f0(motion) + torque g1(motion) + torque^2 g2(motion)

The functions are those of `load_basis`, each a sum of smooth ones with weights from penalised least
squares: neighbouring splines are held together, other weights held small, by a degree for each
group (Eilers & Marx, Statistical Science 11(2) 89-121, 1996). Leaving out one load level after the
other chooses each degree, or that the group is of no use: what counts is the error of the torque at
loads that were not learned. Friction that grows with load is the part of g1 that changes sign with
the direction; compliance shifts f0 along the position, which to first order is part of g1, too.

The uncertainty has three parts: of the weights, from how whole recordings disagree (so residuals
may be correlated in time as they like); scatter, that changes with direction, speed and load; and a
factor that makes 95 % intervals hold 95 % of the levels that were left out. Outside the region that
was learned, with a margin of `MARGIN` spacings of the levels, there is no estimate. Near standstill
friction is undetermined: the dead band tells between which torques the load may be.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from rigtool.analysis.load_basis import (
    LOAD_POWER,
    SPLINE_COUNT,
    Path,
    Scales,
    find_scales,
    motion_functions,
)
from rigtool.analysis.load_region import Region, learn_region
from rigtool.errors import InsufficientDataError

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

DEGREES = (1e-6, 1e-4, 1e-3, 1e-2, 1e-1, 1.0)
"""Degrees of smoothing that are tried; the mean square of a column is 1."""

ALWAYS = ("offset", "load")
"""Groups without which there is no model; others may turn out to be of no use."""

START = 1e-2
"""Degree from which the choice starts."""

WORTH = 0.002
"""Part by which a choice must lower the error to be taken."""

ROUNDS = 3
"""Times that the choice goes round all groups, at most."""

RIDGE = 1e-7
"""Degree by which any weight is held small, so that the equations can be solved."""

FEWEST_ROWS = 200
"""Rows in motion, in each direction."""

FLAT = 0.05
"""A slope of effort by torque below this part of the usual one is no slope."""

COVERAGE = 0.95
NORMAL = 1.959963984540054
"""Normal quantile of that coverage."""

LOG_CHI2 = 1.270362845461478
"""Minus the expected logarithm of a squared standard normal number."""

FOLDS = 10
"""Parts into which levels are put that are left out together, at most."""


@dataclass(frozen=True, eq=False)
class Observation:
    """One recording at a known load: rows (n,) of effort and torque, both as low-passed as `path`.

    `used` says which rows may serve; `level` is a number that recordings at one load share.
    """

    path: Path
    effort: Array
    torque: Array
    used: Mask
    level: int


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
    by torque; `factor` (2,) multiplies uncertainties. `validation` tells the standard deviation of
    the torque's error at levels left out, rows of `Validation`.
    """

    scales: Scales
    bandwidth_hz: float
    effort_scale: float
    degree: Mapping[str, float]
    weights: Array
    covariance: Array
    scatter: Array
    factor: Array
    region: Region
    validation: Validation

    def estimate(self, effort: Array, path: Path) -> Estimate:
        """Return the torque at the rows (n,) of a path whose effort is given."""
        design = _Design.of(path, self.scales, self.degree)
        scaled, slope, row = self._solve(design, effort / self.effort_scale)
        speed = path.speed / self.scales.speed
        variance = np.einsum("ij,jk,ik->i", row, self.covariance, row)
        variance += _scatter(self.scatter, speed, scaled)
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

    def _solve(self, design: _Design, effort: Array) -> tuple[Array, Array, Array]:
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
                design = _Design.of(path, self.scales, self.degree, way)
                edge[still] = self._solve(design, effort / self.effort_scale)[0][still]
        low, high = np.sort(edges, axis=0) * self.scales.torque
        bad = np.isnan(edges).any(axis=0)
        return np.where(bad, np.nan, low), np.where(bad, np.nan, high)


@dataclass(frozen=True, eq=False)
class Validation:
    """Errors at rows of levels that were left out of the learning: torque, error and u in N m.

    `speed` tells the direction, `level` what was left out; `common` (2,) is the standard deviation
    of the mean error of a recording, for each direction, N m.
    """

    torque: Array
    error: Array
    u: Array
    speed: Array
    recording: NDArray[np.intp]
    common: Array


@dataclass(frozen=True, eq=False)
class _Design:
    """Columns (n, k), each to be multiplied by the torque to its `power` (k,)."""

    columns: Array
    power: NDArray[np.intp]

    @staticmethod
    def of(
        path: Path, scales: Scales, groups: Mapping[str, float], direction: float = 0.0
    ) -> _Design:
        functions = motion_functions(path, scales, direction)
        power = [np.full(functions[n].shape[1], LOAD_POWER.get(n, 0)) for n in groups]
        return _Design(np.hstack([functions[n] for n in groups]), np.concatenate(power))

    def at(self, torque: Array) -> Array:
        """Return rows (n, k) at a torque, so that rows @ weights is the effort."""
        return self.columns * torque[:, None] ** self.power

    def slope(self, torque: Array) -> Array:
        """Return rows (n, k) so that rows @ weights is the slope of effort by torque."""
        below = np.maximum(self.power - 1, 0)
        return self.columns * (self.power * torque[:, None] ** below)


# -- learning


def learn(
    observations: Sequence[Observation],
    *,
    turn: float = 0.0,
    degree: Mapping[str, float] | None = None,
) -> LoadModel:
    """Learn a model from recordings at two loads or more.

    `turn` is one turn of the encoder in the unit of position, 0 where it has none. `degree`, of an
    earlier model, keeps its choices. Raises `InsufficientDataError` where the recordings do not
    tell how effort grows with load.
    """
    problem = _Problem.of(observations, turn).weighted()
    if degree is None:
        degree = problem.choose()
    return problem.model(degree)


def level_numbers(torques: Sequence[float]) -> list[int]:
    """Return the number of the level of each recording by its mean torque, lowest first.

    Levels are apart by more than a quarter of the widest gap.
    """
    order = np.argsort(torques, kind="stable")
    gaps = np.diff(np.asarray(torques)[order])
    widest = float(gaps.max()) if len(gaps) else 0.0
    number = np.concatenate([[0], np.cumsum(gaps > widest / 4)])
    levels = np.empty(len(order), dtype=int)
    levels[order] = number
    return [int(level) for level in levels]


@dataclass(frozen=True, eq=False)
class _Problem:
    """All rows of all observations, with the sums that every choice of groups shares.

    `groups` are the columns of each group; `normal` (f, k, k) and `right` (f, k) the sums over each
    fold, of columns divided by `size` (k,).
    """

    scales: Scales
    bandwidth_hz: float
    effort_scale: float
    weight: Array
    groups: dict[str, NDArray[np.intp]]
    power: NDArray[np.intp]
    rows: Array
    slopes: Array
    size: Array
    effort: Array
    torque: Array
    speed: Array
    place: Array
    fold: NDArray[np.intp]
    recording: NDArray[np.intp]
    sums: _Sums
    levels: int

    @staticmethod
    def of(observations: Sequence[Observation], turn: float) -> _Problem:
        """Gather the rows in motion."""
        paths = [item.path for item in observations]
        scales = find_scales(paths, [item.torque for item in observations], turn)
        used = [
            item.used & item.path.regular & (np.abs(item.path.speed) >= scales.standstill)
            for item in observations
        ]
        folds, levels = _folds(observations)
        designs, slopes = [], []
        for item, mask in zip(observations, used, strict=True):
            functions = motion_functions(item.path, scales)
            design = _Design.of(item.path, scales, dict.fromkeys(functions, 0.0))
            torque = item.torque / scales.torque
            designs.append(design.at(torque)[mask])
            slopes.append(design.slope(torque)[mask])
        groups, start = {}, 0
        for name, columns in functions.items():
            groups[name] = np.arange(start, start + columns.shape[1])
            start += columns.shape[1]

        def joined(values: Sequence[Array]) -> Array:
            return np.concatenate([v[m] for v, m in zip(values, used, strict=True)])

        effort = joined([item.effort for item in observations])
        speed = joined([path.speed for path in paths]) / scales.speed
        for sign, way in ((1, "positive"), (-1, "negative")):
            if (count := int(np.count_nonzero(sign * speed > 0))) < FEWEST_ROWS:
                raise InsufficientDataError(
                    f"{count} rows move in the {way} direction, {FEWEST_ROWS} are needed: record "
                    "more strokes to and fro"
                )
        rows, slope = np.vstack(designs), np.vstack(slopes)
        size = np.maximum(np.sqrt(np.mean(rows**2, axis=0)), 1e-12)
        rows, slope = rows / size, slope / size
        scale = float(np.std(effort)) or 1.0
        number = np.repeat(np.arange(len(used)), [np.count_nonzero(mask) for mask in used])
        fold = np.array(folds)[number]
        ones = np.ones(len(effort))
        part = 2 * fold + (speed < 0)
        return _Problem(
            weight=ones,
            scales=scales,
            bandwidth_hz=paths[0].bandwidth_hz,
            effort_scale=scale,
            groups=groups,
            power=design.power,
            rows=rows,
            slopes=slope,
            size=size,
            effort=effort / scale,
            torque=joined([item.torque for item in observations]) / scales.torque,
            speed=speed,
            place=(joined([path.position for path in paths]) - scales.low)
            / (scales.high - scales.low),
            fold=fold,
            recording=number,
            sums=_Sums.of(rows, effort / scale, ones, part),
            levels=levels,
        )

    def weighted(self) -> _Problem:
        """Return the problem with rows weighted by the scatter that a first fit shows."""
        degree = dict.fromkeys(("offset", "load", "viscous", "stribeck"), START)
        residual, _ = self.held_out(degree)
        scatter = _fit_scatter(residual, self.speed, self.torque)
        weight = 1 / _scatter(scatter, self.speed, self.torque)
        weight /= weight.mean()
        part = 2 * self.fold + (self.speed < 0)
        sums = _Sums.of(self.rows, self.effort, weight, part)
        return replace(self, weight=weight, sums=sums)

    # -- one choice of degrees

    def columns(self, degree: Mapping[str, float]) -> NDArray[np.intp]:
        """Return the columns in use."""
        return np.concatenate([self.groups[name] for name in degree])

    def penalty(self, degree: Mapping[str, float]) -> Array:
        """Return the matrix of the penalty for one row, (k, k)."""
        blocks = []
        for name, value in degree.items():
            count = len(self.groups[name])
            block = np.eye(count)
            if name in SPLINE_COUNT:
                each = SPLINE_COUNT[name]
                bend = np.diff(np.eye(each), 2, axis=0)
                smooth = np.kron(np.eye(count // each), bend.T @ bend)
                size = self.size[self.groups[name]]
                # Neighbours are held together as functions, whatever their columns' sizes
                block = smooth * (float(np.mean(size)) ** 2) / np.outer(size, size)
            blocks.append(value * block + RIDGE * np.eye(count))
        total = sum(len(block) for block in blocks)
        matrix, start = np.zeros((total, total)), 0
        for block in blocks:
            matrix[start : start + len(block), start : start + len(block)] = block
            start += len(block)
        return matrix

    def inverse(self, degree: Mapping[str, float], without: int | None = None) -> Array:
        """Return the inverse of the normal matrix (k, k), one fold left out."""
        from scipy.linalg import cho_factor, cho_solve

        matrix, _ = self._equations(degree, without)
        inverse: Array = cho_solve(cho_factor(matrix), np.eye(len(matrix)))
        return inverse

    def weights(self, degree: Mapping[str, float], without: int | None = None) -> Array:
        """Return weights (k,), one fold left out."""
        from scipy.linalg import cho_factor, cho_solve

        matrix, right = self._equations(degree, without)
        weights: Array = cho_solve(cho_factor(matrix, check_finite=False), right)
        return weights

    def _equations(self, degree: Mapping[str, float], without: int | None) -> tuple[Array, Array]:
        use = self.columns(degree)
        keep = [f for f in range(len(self.sums.rows)) if f != without]
        normal = self.sums.normal[keep].sum(axis=(0, 1))[np.ix_(use, use)]
        right: Array = self.sums.right[keep].sum(axis=(0, 1))[use]
        return normal + self.sums.rows[keep].sum() * self.penalty(degree), right

    def held_out(self, degree: Mapping[str, float]) -> tuple[Array, Array]:
        """Return residual of effort and slope (n,) of folds that were left out of the learning."""
        use = self.columns(degree)
        residual, slope = np.empty_like(self.effort), np.empty_like(self.effort)
        for fold in range(len(self.sums.rows)):
            weights = self.weights(degree, fold)
            rows = self.fold == fold
            residual[rows] = self.effort[rows] - self.rows[np.ix_(rows, use)] @ weights
            slope[rows] = self.slopes[np.ix_(rows, use)] @ weights
        return residual, slope

    def error(self, residual: Array, slope: Array) -> Array:
        """Return the torque's error (n,), where the slope is not flat."""
        usual = float(np.median(np.abs(slope)))
        error: Array = -residual / np.copysign(np.maximum(np.abs(slope), FLAT * usual), slope)
        return error

    def cost(self, degree: Mapping[str, float]) -> float:
        """Return the logarithm of the residual at levels left out, mean of both directions."""
        use = self.columns(degree)
        power = np.zeros(2)
        for fold in range(len(self.sums.rows)):
            weights = self.weights(degree, fold)
            for side in (0, 1):
                normal = self.sums.normal[fold, side][np.ix_(use, use)]
                right = self.sums.right[fold, side, use]
                power[side] += self.sums.power[fold, side] + weights @ (
                    normal @ weights - 2 * right
                )
        total = self.sums.rows.sum(axis=0)
        return float(np.mean(np.log(np.maximum(power / total, 1e-300)))) / 2

    def choose(self) -> dict[str, float]:
        """Return the degree of each group that is of use, one group after the other."""
        degree: dict[str, float] = {"offset": START, "load": START, "viscous": START}
        best = self.cost(degree)
        for _ in range(ROUNDS):
            before = best
            for name in self.groups:
                if name == "load_squared" and self.levels < 3:
                    continue  # two loads make a line
                tried = [{**degree, name: value} for value in DEGREES if degree.get(name) != value]
                if name in degree and name not in ALWAYS:
                    tried.append({n: v for n, v in degree.items() if n != name})
                costs = [self.cost(each) for each in tried]
                if min(costs) < best - WORTH:
                    best = min(costs)
                    degree = tried[int(np.argmin(costs))]
            if best > before - WORTH:
                break
        return degree

    # -- the model

    def model(self, degree: Mapping[str, float]) -> LoadModel:
        """Return the model of these degrees with its uncertainty."""
        use = self.columns(degree)
        weights, inverse = self.weights(degree), self.inverse(degree)
        rows = self.rows[:, use]
        residual, slope = self.held_out(degree)
        scores = self._scores(rows, residual)
        covariance = _cluster_covariance(inverse, scores)
        scatter = _fit_scatter(self.effort - rows @ weights, self.speed, self.torque)
        variance = np.empty_like(residual)
        for fold in range(len(self.sums.rows)):
            inside = self.fold == fold
            left = np.unique(self.recording[~inside])
            within = _cluster_covariance(self.inverse(degree, fold), scores[left])
            variance[inside] = np.einsum("ij,jk,ik->i", rows[inside], within, rows[inside])
        variance += _scatter(scatter, self.speed, self.torque)
        side = (self.speed < 0).astype(int)
        ratio = np.abs(residual) / np.sqrt(variance)
        factor = np.array([np.quantile(ratio[side == s], COVERAGE) for s in (0, 1)]) / NORMAL
        error = self.error(residual, slope) * self.scales.torque
        u = factor[side] * np.sqrt(variance) / np.abs(slope) * self.scales.torque
        size = self.size[use]
        return LoadModel(
            scales=self.scales,
            bandwidth_hz=self.bandwidth_hz,
            effort_scale=self.effort_scale,
            degree=dict(degree),
            weights=weights / size,
            covariance=covariance / np.outer(size, size),
            scatter=scatter,
            factor=factor,
            region=learn_region(self.place, self.speed, self.torque, self.levels),
            validation=Validation(
                torque=self.torque * self.scales.torque,
                error=error,
                u=u,
                speed=self.speed * self.scales.speed,
                recording=self.recording,
                common=np.array([self._common(error, side == s) for s in (0, 1)]),
            ),
        )

    def _scores(self, rows: Array, residual: Array) -> Array:
        """Return the sum of row times residual over each recording, (recordings, k)."""
        scores = np.zeros((int(self.recording.max()) + 1, rows.shape[1]))
        for number in range(len(scores)):
            mask = self.recording == number
            scores[number] = rows[mask].T @ (self.weight * residual)[mask]
        return scores

    def _common(self, error: Array, mask: Mask) -> float:
        """Return the standard deviation of the recordings' mean errors."""
        means = [error[mask & (self.recording == r)] for r in np.unique(self.recording[mask])]
        return (
            float(np.std([part.mean() for part in means], ddof=1)) if len(means) > 1 else math.nan
        )


@dataclass(frozen=True, eq=False)
class _Sums:
    """Weighted sums over the rows of each fold and direction, all that a choice needs.

    `normal` (f, 2, k, k), `right` (f, 2, k), `power` (f, 2) and `rows` (f, 2), for residuals
    power - 2 w.right + w.normal.w.
    """

    normal: Array
    right: Array
    power: Array
    rows: Array

    @staticmethod
    def of(rows: Array, effort: Array, weight: Array, part: NDArray[np.intp]) -> _Sums:
        """Gather them: `part` (n,) is twice the fold, plus one where the speed is negative."""
        count, size = int(part.max()) // 2 + 1, rows.shape[1]
        found = _Sums(
            np.zeros((count, 2, size, size)),
            np.zeros((count, 2, size)),
            np.zeros((count, 2)),
            np.zeros((count, 2)),
        )
        for number in range(2 * count):
            mask = part == number
            place = divmod(number, 2)
            columns, y = rows[mask], effort[mask]
            scaled = columns * weight[mask, None]
            found.normal[place] = scaled.T @ columns
            found.right[place] = scaled.T @ y
            found.power[place] = float(np.sum(weight[mask] * y**2))
            found.rows[place] = float(np.sum(weight[mask]))
        return found


def _folds(observations: Sequence[Observation]) -> tuple[list[int], int]:
    """Return the fold of each observation and the number of levels.

    Levels are left out one after the other; where two leave one, recordings are.
    """
    levels = sorted({item.level for item in observations})
    if len(levels) < 2:
        raise InsufficientDataError(
            f"{len(observations)} recordings are at one load: how effort grows with load is not "
            "told; give recordings at two loads or more, at best at five"
        )
    if len(levels) > 2:
        number = {
            level: i * min(FOLDS, len(levels)) // len(levels) for i, level in enumerate(levels)
        }
        return [number[item.level] for item in observations], len(levels)
    if len(observations) < 4:
        raise InsufficientDataError(
            f"{len(observations)} recordings at two loads leave nothing to judge the model by: "
            "give two recordings at each load, or three loads"
        )
    return [i * FOLDS // max(len(observations), FOLDS) for i in range(len(observations))], 2


def _cluster_covariance(inverse: Array, scores: Array) -> Array:
    """Return the covariance of weights whose recordings disagree by these scores (r, k)."""
    count = len(scores)
    half = scores @ inverse
    covariance: Array = half.T @ half * (count / max(count - 1, 1))
    return covariance


def _scatter_rows(speed: Array, torque: Array) -> Array:
    return np.column_stack(
        [np.ones_like(speed), np.log(np.maximum(np.abs(speed), 1e-3)), np.abs(torque)]
    )


def _fit_scatter(residual: Array, speed: Array, torque: Array) -> Array:
    """Return how the logarithm of the residual's variance goes, (2, 3), see `LoadModel`."""
    floor = 1e-6 * float(np.mean(residual**2)) + 1e-300
    logarithm = np.log(residual**2 + floor) + LOG_CHI2
    found = []
    for sign in (1, -1):
        mask = sign * speed > 0
        rows = _scatter_rows(speed[mask], torque[mask])
        found.append(np.linalg.lstsq(rows, logarithm[mask], rcond=None)[0])
    return np.stack(found)


def _scatter(scatter: Array, speed: Array, torque: Array) -> Array:
    """Return the variance (n,) that scatter alone makes."""
    rows = _scatter_rows(speed, np.nan_to_num(torque))
    side = (speed < 0).astype(int)
    # Beyond what was learned the logarithm of the variance must not run away.
    variance: Array = np.exp(np.minimum(np.sum(rows * scatter[side], axis=1), 50.0))
    return variance
