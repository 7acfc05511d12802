"""One direction of a load model: penalised least squares, judged by held-out data.

Neighbouring splines are held together and other weights held small by one degree of smoothing
(P. H. C. Eilers, B. D. Marx, Statistical Science 11(2) 89-121, 1996). With columns A (n, k),
weights W of the rows and the penalty P, the coefficients (k,) solve

    (A'WA + n P) (c - c0) = A'W (e - A c0)

where c0 is what a prior model knows, else zero. A'WA and A'We are gathered recording by recording:
all that leaving out levels, speeds or recordings needs are sums over those.

The uncertainty has three parts: of the coefficients, from how whole recordings disagree, so that
residuals may be correlated in time as they like; scatter, that changes with speed and load; and a
factor for each load level, that makes 95 % intervals hold 95 % of its rows when the level, or one
of the speeds between others, was left out. Where strokes were learned at different places, one more
factor does so for strokes at places between them, of which no recording was learned. The first and
the last speed are between no others: each is left out, and what that changes counts at speeds
beyond, and between two where these are all.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from rigtool.errors import InsufficientDataError
from rigtool.experiments.force_filter.accuracy import COVERAGE_FACTOR
from rigtool.experiments.imported_load.basis import (
    LOAD_POWER,
    ROUNDING,
    SPLINE_COUNT,
    LoadSignals,
    Scales,
    motion_functions,
    size_of,
)
from rigtool.experiments.imported_load.model import (
    FLAT_SLOPE,
    DesignMatrix,
    Side,
    scatter_rows,
    scatter_variance,
)
from rigtool.numerics.arrays import TINY, Array, Mask

Numbers = NDArray[np.intp]

CURVED_LEVELS = 3
"""Fewest loads that show how effort bends with the load."""

FEWEST_ROWS = 200
"""Rows in motion, in each direction."""

SMOOTHING_DEGREE = 1e-2
"""Degree of smoothing; the mean square of a column is 1. Choosing one for each group of functions
by levels left out is no better at levels that were in neither."""

SPLINE_RIDGE = 1e-4
"""Degree by which splines are held small besides, so that functions that are alike where it was
learned, such as those of speed, do not work against each other between."""

ALWAYS_RIDGE = 1e-7
"""Ridge for `ALWAYS_GROUPS`, which no other function resembles: only to solve the equations."""

PRIOR_FACTOR = 100.0
"""Factor by which weights are held closer to those of a prior than others to zero."""

ALWAYS_GROUPS = ("offset", "load")

INTERVAL_COVERAGE = 0.95
"""Coverage of intervals."""

LOG_CHI2 = 1.270362845461478
"""Minus the expected logarithm of a squared standard normal number."""


@dataclass(frozen=True, eq=False)
class HeldOut:
    """Rows (n,) of levels that were left out: error and u of the torque, without unit; `within` is
    the error where the lowest and the highest level are left out in another way, if there is one.
    So is the middle one of three where that leaves less: two carry no curvature, as tables do.

    `resolved` (n,) marks rows where effort depends enough on the load for an error. `slope`
    (n,) of effort by torque is that of all rows, `slopes` (folds, n) those without each fold.
    """

    error: Array
    within: Array
    u: Array
    slope: Array
    slopes: Array
    resolved: Mask


@dataclass(frozen=True, eq=False)
class Rows:
    """Rows (n,) in motion in one direction, without unit but for the effort.

    `functions` of motion by group, (n, columns) each; `place` is along the stroke, `recording` the
    number of the recording: residuals go together there.
    """

    functions: dict[str, Array]
    effort: Array
    torque: Array
    speed: Array
    place: Array
    recording: Numbers

    @staticmethod
    def of(signals: Sequence[LoadSignals], scales: Scales, sign: int) -> Rows:
        """Gather what moves in the direction of a sign; `InsufficientDataError` where too little
        does."""
        functions: dict[str, list[Array]] = {}
        parts = []
        for number, item in enumerate(signals):
            path = item.path
            moving = sign * path.speed >= scales.standstill
            rows = np.flatnonzero(path.regular & moving)
            for name, columns in motion_functions(path, scales, sign).items():
                functions.setdefault(name, []).append(columns[rows])
            values = (item.effort, item.sensor, path.speed, path.position)
            parts.append((*(v[rows] for v in values), np.full(len(rows), number)))
        effort, torque, speed, position, recording = map(np.concatenate, zip(*parts, strict=True))
        if len(effort) < FEWEST_ROWS:
            raise InsufficientDataError(
                f"{len(effort)} rows move in the {'positive' if sign > 0 else 'negative'} "
                f"direction, {FEWEST_ROWS} are needed: record more strokes to and fro"
            )
        place = (position - scales.low) / (scales.high - scales.low)
        joined = {name: np.concatenate(columns) for name, columns in functions.items()}
        return Rows(joined, effort, torque / scales.torque, speed / scales.speed, place, recording)


@dataclass(frozen=True, eq=False)
class Fit:
    """A model of rows (n,): functions of motion `design` (n, k), `columns` those at the torque of
    each row over `size` (k,). `level` (n,) numbers the loads; `folds` are ways (n,) of leaving out,
    loads first: rows of one number are left out together, -1 never.
    """

    rows: Rows
    names: tuple[str, ...]
    design: DesignMatrix
    columns: Array
    size: Array
    level: Numbers
    folds: Sequence[Numbers]
    sums: Sums

    @staticmethod
    def of(
        rows: Rows,
        names: tuple[str, ...],
        level: Numbers,
        folds: Sequence[Numbers],
        prior: Side | None,
    ) -> Fit:
        """Fit rows; weights are those of the scatter that a first fit shows."""
        design = DesignMatrix.joined({name: rows.functions[name] for name in names})
        columns = design.at(rows.torque)
        size = np.maximum(np.sqrt(np.mean(columns**2, axis=0)), 1e-12)
        columns /= size
        penalty, centre = penalty_of(names, size), np.zeros(len(size))
        if prior is not None:
            penalty, centre = prior_of(prior, names, size, penalty)

        def summed(weight: Array) -> Sums:
            return Sums.of(columns, rows.effort, weight, rows.recording, penalty, centre)

        even = summed(np.ones(len(rows.effort)))
        plain = Fit(rows, names, design, columns, size, level, folds, even)
        scatter = _fit_scatter(plain.left_out(folds[0])[0], rows.speed, rows.torque)
        weight = 1 / scatter_variance(scatter, rows.speed, rows.torque)
        return replace(plain, sums=summed(weight / weight.mean()))

    def left_out(self, fold: Numbers) -> tuple[Array, Array, Array, Array]:
        """Leave out one fold after the other; return what the others make of its rows.

        Residual, variance of the model, and slope of effort by torque, (n,) each, NaN in rows that
        are never left out; and the slope of all rows without each fold, (folds, n).
        """
        residual, variance, slope = (np.full(len(self.rows.effort), np.nan) for _ in range(3))
        slopes = []
        for number in np.unique(fold[fold >= 0]):
            rows = fold == number
            out = np.unique(self.rows.recording[rows])
            keep = np.setdiff1d(self.sums.all, out)
            coefficients = self.sums.solve(keep)
            covariance = self.sums.covariance(keep, coefficients)
            columns = self.columns[rows]
            residual[rows] = self.rows.effort[rows] - columns @ coefficients
            variance[rows] = np.einsum("ij,ij->i", columns @ covariance, columns)
            slopes.append(self.design.slope(coefficients / self.size, self.rows.torque))
            slope[rows] = slopes[-1][rows]
        return residual, variance, slope, np.array(slopes)

    def model(self, strokes: Numbers, ends: Numbers) -> tuple[Side, HeldOut]:
        """Return the model, and how it did at folds that were left out; `strokes` (n,) is the way
        of leaving out strokes at other places, `ends` (n,) that of the first and the last speed."""
        coefficients = self.sums.solve(self.sums.all)
        covariance = self.sums.covariance(self.sums.all, coefficients)
        found = [self.left_out(fold) for fold in self.folds]
        residual, variance, slope, slopes = found[0]
        scatter = _fit_scatter(residual, self.rows.speed, self.rows.torque)
        own = scatter_variance(scatter, self.rows.speed, self.rows.torque)
        usual = float(np.median(np.abs(slope)))
        ratios = [np.abs(each[0]) / np.sqrt(each[1] + own) for each in found]
        levels, factors = self._factors(ratios)
        side = Side(
            groups=self.names,
            weights=coefficients / self.size,
            covariance=covariance / np.outer(self.size, self.size),
            scatter=scatter,
            levels=levels,
            factors=factors,
            slope=usual,
        )

        def widest(fold: Numbers) -> float:
            apart, doubt, *_ = self.left_out(fold)
            ratio = np.abs(apart) / np.sqrt(doubt + own) / side.factor(self.rows.torque)
            return max(1.0, float(np.nanquantile(ratio, INTERVAL_COVERAGE)) / COVERAGE_FACTOR)

        elsewhere, speeds = (widest(fold) if (fold >= 0).any() else 1.0 for fold in (strokes, ends))
        side = replace(side, elsewhere=elsewhere, other_speeds=speeds)
        resolved = np.abs(slope) >= FLAT_SLOPE * usual
        safe = np.where(resolved, slope, usual)
        ends = (self.level == self.level.min()) | (self.level == self.level.max())
        other = found[min(1, len(found) - 1)][0]
        if len(np.unique(self.level)) == CURVED_LEVELS:
            middle = ~ends & np.isfinite(other)
            ends |= bool(np.sum(other[middle] ** 2) < np.sum(residual[middle] ** 2))
        held = HeldOut(
            error=-residual / safe,
            within=-np.where(ends & np.isfinite(other), other, residual) / safe,
            u=side.factor(self.rows.torque) * np.sqrt(variance + own) / np.abs(safe),
            slope=self.design.slope(side.weights, self.rows.torque),
            slopes=slopes,
            resolved=resolved,
        )
        return side, held

    def _factors(self, ratios: Sequence[Array]) -> tuple[Array, Array]:
        """Return levels (l,) by their mean torque, and the factor that each asks for.

        `ratios` (n,) of residual and its standard uncertainty, one for each way of leaving out; the
        widest counts. Recordings repeat the measurement: by their number r, Student's t with r - 1
        degrees of freedom stands for the normal distribution.

        The lowest and the highest level stand twice: outermost as they were left out, for torques
        beyond them; then by the other ways, as none of the torques within is beyond the others.
        """
        from scipy.special import stdtrit

        loads_left_out = 1 if np.array_equal(self.folds[0], self.level) else 0
        repeats = len(np.unique(self.rows.recording))
        wider = float(stdtrit(repeats - 1, (1 + INTERVAL_COVERAGE) / 2)) / COVERAGE_FACTOR
        rows = []
        for level in np.unique(self.level):
            own = self.level == level
            parts = [ratio[own & np.isfinite(ratio)] for ratio in ratios]
            every, others = (
                [float(np.quantile(part, INTERVAL_COVERAGE)) for part in some if part.size]
                for some in (parts, parts[loads_left_out:])
            )
            widest = max(every), max(others or every)
            factors = np.multiply(wider / COVERAGE_FACTOR, widest)
            rows.append((float(self.rows.torque[own].mean()), *factors))
        levels, left_out, learned = np.array(sorted(rows)).T
        ends = np.maximum(left_out, learned)[[0, -1]]
        within = np.concatenate([learned[:1], left_out[1:-1], learned[-1:]])
        return np.pad(levels, 1, mode="edge"), np.concatenate([ends[:1], within, ends[1:]])


@dataclass(frozen=True, eq=False)
class Sums:
    """Weighted sums over the rows of each recording: all that leaving out recordings needs.

    `normal` (r, k, k), `right` (r, k) and `square` (r,) of the effort less what the `centre` (k,)
    of the penalty (k, k) explains, `rows` (r,) the sum of weights.
    """

    normal: Array
    right: Array
    square: Array
    rows: Array
    penalty: Array
    centre: Array

    @staticmethod
    def of(
        columns: Array,
        effort: Array,
        weight: Array,
        recording: Numbers,
        penalty: Array,
        centre: Array,
    ) -> Sums:
        """Gather them; recordings are numbered from zero."""
        normal, right, square, rows = [], [], [], []
        beside = effort - columns @ centre
        for number in range(int(recording.max()) + 1):
            mask = recording == number
            scaled = columns[mask] * weight[mask, None]
            normal.append(scaled.T @ columns[mask])
            right.append(scaled.T @ beside[mask])
            square.append(float(weight[mask] @ beside[mask] ** 2))
            rows.append(float(np.sum(weight[mask])))
        sums = np.stack(normal), np.stack(right), np.array(square), np.array(rows)
        return Sums(*sums, penalty, centre)

    @property
    def all(self) -> Numbers:
        """Numbers of all recordings."""
        return np.arange(len(self.rows))

    def solve(self, keep: Numbers) -> Array:
        """Return coefficients (k,) from some recordings."""
        from scipy.linalg import cho_factor, cho_solve

        factor = cho_factor(self._matrix(keep), check_finite=False)
        right = self.right[keep].sum(axis=0)
        return self.centre + cho_solve(factor, right, check_finite=False)

    def covariance(self, keep: Numbers, coefficients: Array) -> Array:
        """Return the covariance (k, k) of coefficients whose recordings disagree."""
        scores = self.right[keep] - self.normal[keep] @ (coefficients - self.centre)
        half = np.linalg.solve(self._matrix(keep), scores.T)
        used = int(np.count_nonzero(self.rows[keep]))
        return half @ half.T * (used / max(used - 1, 1))

    def _matrix(self, keep: Numbers) -> Array:
        return self.normal[keep].sum(axis=0) + self.rows[keep].sum() * self.penalty


def penalty_of(names: Sequence[str], size: Array) -> Array:
    """Return the matrix of the penalty for one row, (k, k); columns have been divided by `size`."""
    from scipy.linalg import block_diag

    blocks, start = [], 0
    for name in names:
        count = size_of(name)
        held, block = SMOOTHING_DEGREE, np.zeros((count, count))
        if name in SPLINE_COUNT:
            bend = np.diff(np.eye(count), 2, axis=0)
            own = size[start : start + count]
            # Neighbours are held together as functions, whatever their columns' sizes
            block = bend.T @ bend * (float(np.mean(own)) ** 2) / np.outer(own, own)
            held = ALWAYS_RIDGE if name in ALWAYS_GROUPS else SPLINE_RIDGE
        blocks.append(SMOOTHING_DEGREE * block + held * np.eye(count))
        start += count
    return np.asarray(block_diag(*blocks))


def effort_scale_of(effort: Array) -> float:
    """Return the standard deviation of efforts (n,).

    Raises `InsufficientDataError` where they are one value.
    """
    scale = float(np.std(effort))
    if scale <= ROUNDING * float(np.abs(effort).max()):
        raise InsufficientDataError(
            f"the effort is {effort[0]:.4g} throughout, in all motion: it is not that of this "
            "motor; correct its column in the mapping"
        )
    return scale


def groups_for(names: Sequence[str], levels: int) -> tuple[str, ...]:
    """Return the groups that so many load levels carry: a power of the torque needs more levels
    than it is high."""
    return tuple(name for name in names if LOAD_POWER.get(name, 0) < levels)


def _fit_scatter(residual: Array, speed: Array, torque: Array) -> Array:
    """Return how the logarithm of the residual's variance goes, (3,), see `Side`."""
    floor = 1e-6 * float(np.mean(residual**2)) + TINY
    logarithm = np.log(residual**2 + floor) + LOG_CHI2
    return np.asarray(np.linalg.lstsq(scatter_rows(speed, torque), logarithm)[0])


def prior_of(prior: Side, names: Sequence[str], size: Array, penalty: Array) -> tuple[Array, Array]:
    """Return penalty and centre where a prior model supplies what two loads do not show: the
    curvature of effort over load. All else is learned from the rows.

    The curvature w counts as far as the prior's recordings agree on it, with their covariance C:
    max(0, 1 - tr C / |w|^2) (W. James, C. Stein, Proc. 4th Berkeley Symp. 1 361-379, 1961).
    """
    held, centre, start = np.ones(len(size)), np.zeros(len(size)), 0
    for name in names:
        own = slice(start, start := start + size_of(name))
        if LOAD_POWER.get(name, 0) > 1:
            weights, square = prior.weights[own], float(np.sum(prior.weights[own] ** 2))
            doubt = float(np.trace(prior.covariance[own, own]))
            centre[own] = weights * size[own] * max(0.0, 1 - doubt / max(square, TINY))
            held[own] = PRIOR_FACTOR
    return penalty * np.sqrt(np.outer(held, held)), centre
