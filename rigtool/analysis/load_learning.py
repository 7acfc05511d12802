"""A load model from recordings at known loads: penalised least squares, judged by levels left out.

Neighbouring splines are held together and other weights held small, by a degree for each group of
functions (Eilers & Marx, Statistical Science 11(2) 89-121, 1996). Leaving out one load level after
the other chooses each degree, or that the group is of no use: what counts is how the model does at
loads that it was not learned from.

The uncertainty has three parts: of the weights, from how whole recordings disagree, so that
residuals may be correlated in time as they like; scatter, that changes with direction, speed and
load; and a factor that makes 95 % intervals hold 95 % of the levels that were left out.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from rigtool.analysis.jackknife import standard_uncertainty
from rigtool.analysis.load_basis import SPLINE_COUNT, Path, Scales, find_scales, motion_functions
from rigtool.analysis.load_model import Design, LoadModel, scatter_rows, scatter_variance
from rigtool.analysis.load_region import learn_region
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

CELLS = 20
"""Parts of the stroke in which friction that grows with load is told."""

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
class Validation:
    """Rows (n,) of levels that were left out of the learning: torque, error and u in N m.

    `speed` tells the direction, `recording` the number of the observation.
    """

    torque: Array
    error: Array
    u: Array
    speed: Array
    recording: NDArray[np.intp]


@dataclass(frozen=True, eq=False)
class LoadFriction:
    """Part mu (n,) of the load that friction takes, with u, along the position (n,).

    Effort goes as torque * (1 + mu) while the load resists the motion and torque * (1 - mu) while
    it drives it; beyond 1 the load alone would not move the drive backwards.
    """

    position: Array
    mu: Array
    u: Array


@dataclass(frozen=True, eq=False)
class Learned:
    """A model, how well it held at levels left out, and friction that grows with load."""

    model: LoadModel
    validation: Validation
    friction: LoadFriction


# -- learning


def learn(
    observations: Sequence[Observation],
    *,
    turn: float = 0.0,
    degree: Mapping[str, float] | None = None,
) -> Learned:
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
            design = Design.joined(functions)
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
        scatter = _fitscatter_variance(residual, self.speed, self.torque)
        weight = 1 / scatter_variance(scatter, self.speed, self.torque)
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

    def model(self, degree: Mapping[str, float]) -> Learned:
        """Return the model of these degrees with its uncertainty."""
        use = self.columns(degree)
        weights, inverse = self.weights(degree), self.inverse(degree)
        rows = self.rows[:, use]
        residual, slope = self.held_out(degree)
        scores = self._scores(rows, residual)
        covariance = _cluster_covariance(inverse, scores)
        scatter = _fitscatter_variance(self.effort - rows @ weights, self.speed, self.torque)
        variance = np.empty_like(residual)
        for fold in range(len(self.sums.rows)):
            inside = self.fold == fold
            left = np.unique(self.recording[~inside])
            within = _cluster_covariance(self.inverse(degree, fold), scores[left])
            variance[inside] = np.einsum("ij,jk,ik->i", rows[inside], within, rows[inside])
        variance += scatter_variance(scatter, self.speed, self.torque)
        side = (self.speed < 0).astype(int)
        ratio = np.abs(residual) / np.sqrt(variance)
        factor = np.array([np.quantile(ratio[side == s], COVERAGE) for s in (0, 1)]) / NORMAL
        error = self.error(residual, slope) * self.scales.torque
        u = factor[side] * np.sqrt(variance) / np.abs(slope) * self.scales.torque
        size = self.size[use]
        model = LoadModel(
            scales=self.scales,
            bandwidth_hz=self.bandwidth_hz,
            effort_scale=self.effort_scale,
            degree=dict(degree),
            weights=weights / size,
            covariance=covariance / np.outer(size, size),
            scatter=scatter,
            factor=factor,
            common=np.array([self._common(error, side == s) for s in (0, 1)]),
            direction=int(np.sign(np.mean(slope) * np.mean(self.torque)) or 1),
            region=learn_region(self.place, self.speed, self.torque, self.levels),
        )
        validation = Validation(
            torque=self.torque * self.scales.torque,
            error=error,
            u=u,
            speed=self.speed * self.scales.speed,
            recording=self.recording,
        )
        return Learned(model, validation, self._friction(degree, model.direction))

    def _friction(self, degree: Mapping[str, float], direction: int) -> LoadFriction:
        """Return friction by load from the slopes of both directions, in cells of the stroke.

        Its uncertainty is from leaving out one level after the other.
        """
        use = self.columns(degree)
        cell = np.clip((self.place * CELLS).astype(int), 0, CELLS - 1)
        against = direction * self.speed > 0
        found = []
        for fold in (None, *range(len(self.sums.rows))):
            slope = self.slopes[:, use] @ self.weights(degree, fold)
            means = []
            for mask in (against, ~against):
                count = np.bincount(cell[mask], minlength=CELLS)
                total = np.bincount(cell[mask], weights=slope[mask], minlength=CELLS)
                means.append(np.where(count > 0, total / np.maximum(count, 1), np.nan))
            found.append((means[0] - means[1]) / (means[0] + means[1]))
        without = np.stack(found[1:])
        u = np.array([standard_uncertainty(column) for column in without.T])
        place = (np.arange(CELLS) + 0.5) / CELLS
        position = self.scales.low + place * (self.scales.high - self.scales.low)
        known = np.isfinite(found[0] + u)
        return LoadFriction(position[known], found[0][known], u[known])

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


def _fitscatter_variance(residual: Array, speed: Array, torque: Array) -> Array:
    """Return how the logarithm of the residual's variance goes, (2, 3), see `LoadModel`."""
    floor = 1e-6 * float(np.mean(residual**2)) + 1e-300
    logarithm = np.log(residual**2 + floor) + LOG_CHI2
    found = []
    for sign in (1, -1):
        mask = sign * speed > 0
        rows = scatter_rows(speed[mask], torque[mask])
        found.append(np.linalg.lstsq(rows, logarithm[mask], rcond=None)[0])
    return np.stack(found)
