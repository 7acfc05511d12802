"""A load model from recordings at known loads: both directions, judged by levels left out.

Each direction is learned by itself (`load_side`). Where there are three load levels or more, one
after the other is left out; two leave only recordings to leave out. Of the slopes g of effort by
torque, against the load and with it, friction takes

    mu = (g_against - g_with) / (g_against + g_with)
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from rigtool.errors import InsufficientDataError
from rigtool.experiments.imported_load.basis import Scales, ShaftPath, find_scales, motion_functions
from rigtool.experiments.imported_load.model import SIGNS, DesignMatrix, LoadModel
from rigtool.experiments.imported_load.region import learn_region, torque_range
from rigtool.experiments.imported_load.side import HeldOut, Rows
from rigtool.numerics.arrays import Array, Mask
from rigtool.numerics.jackknife import standard_uncertainty

Numbers = NDArray[np.intp]

FEWEST_ROWS = 200
"""Rows in motion, in each direction."""

FOLDS = 10
"""Parts into which levels are put that are left out together, at most."""

APART = 0.02
"""Part of the highest load by which levels differ, at least."""

CELLS = 20
"""Parts of the stroke for which friction that grows with load is reported."""


@dataclass(frozen=True, eq=False)
class Observation:
    """One recording at a known load: rows (n,) of effort and torque, both as low-passed as `path`.

    `used` marks the rows in use; `level` is a number that recordings at one load share.
    """

    path: ShaftPath
    effort: Array
    torque: Array
    used: Mask
    level: int


@dataclass(frozen=True, eq=False)
class Validation:
    """Rows (n,) of levels that were left out of the learning: torque, error and u in N m.

    `speed` has the sign of the direction, `recording` the number of the observation.
    """

    torque: Array
    error: Array
    u: Array
    speed: Array
    recording: Numbers


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


def level_numbers(torques: Sequence[float]) -> list[int]:
    """Return the number of the level of each recording by its mean torque, smallest first.

    Levels are apart by more than a quarter of the widest gap, and by `APART` of the highest load.
    """
    loads = np.abs(np.asarray(torques, dtype=np.float64))
    order = np.argsort(loads, kind="stable")
    gaps = np.diff(loads[order])
    widest = float(gaps.max()) if len(gaps) else 0.0
    levels = np.empty(len(order), dtype=int)
    gap = max(widest / 4, APART * float(loads.max(initial=0.0)))
    levels[order] = np.concatenate([[0], np.cumsum(gaps > gap)])
    return [int(level) for level in levels]


def learn_load_model(
    observations: Sequence[Observation],
    *,
    turn: float = 0.0,
    like: LoadModel | None = None,
) -> Learned:
    """Learn a model from recordings at two loads or more.

    `turn` is one turn of the encoder in the unit of position, 0 where it has none. A model to be
    `like` gives its choices of functions. Raises `InsufficientDataError` where the recordings do
    not show how effort grows with load.
    """
    paths = [item.path for item in observations]
    scales = find_scales(paths, [item.torque for item in observations], turn)
    folds, levels = _folds(observations)
    moving = _Moving.of(observations, scales, folds)
    sides, held = [], []
    for number, sign in enumerate(SIGNS):
        rows = moving.side(sign)
        if like is None:
            side, out = rows.model(rows.choose(levels), rows.choose_each(levels))
        else:
            degree = like.sides[number].degree
            side, out = rows.model(degree, [degree] * rows.sums.folds)
        sides.append(side)
        held.append(out)
    slope = moving.both([item.slope for item in held])
    direction = int(np.sign(np.mean(slope) * np.mean(moving.torque))) or 1
    model = LoadModel(
        scales=scales,
        bandwidth_hz=paths[0].bandwidth_hz,
        effort_scale=moving.effort_scale,
        sides=(sides[0], sides[1]),
        torque_range=torque_range(moving.torque, levels),
        direction=direction,
        region=learn_region(moving.place, moving.speed, moving.torque, levels),
    )
    each = [moving.both(pair) for pair in zip(*(item.slopes for item in held), strict=False)]
    friction = _friction(moving, slope, each, direction)
    return Learned(model, moving.validation(held), friction)


@dataclass(frozen=True, eq=False)
class _Moving:
    """Rows (n,) of all observations that move, without unit, and their columns (n, k)."""

    scales: Scales
    effort_scale: float
    names: list[str]
    columns: Array
    slopes: Array
    effort: Array
    torque: Array
    speed: Array
    place: Array
    fold: Numbers
    recording: Numbers

    @staticmethod
    def of(observations: Sequence[Observation], scales: Scales, folds: Sequence[int]) -> _Moving:
        parts: list[tuple[Array, ...]] = []
        names: list[str] = []
        for number, item in enumerate(observations):
            path = item.path
            used = item.used & path.regular & (np.abs(path.speed) >= scales.standstill)
            torque = item.torque[used] / scales.torque
            columns = np.empty((len(torque), 0))
            slopes = columns
            for sign in SIGNS:
                mask = sign * path.speed[used] > 0
                functions = motion_functions(path, scales, sign)
                names = list(functions)
                design = DesignMatrix.joined({n: f[used][mask] for n, f in functions.items()})
                if not columns.size:
                    columns = np.zeros((len(torque), design.columns.shape[1]))
                    slopes = columns.copy()
                columns[mask], slopes[mask] = design.at(torque[mask]), design.slope(torque[mask])
            place = (path.position[used] - scales.low) / (scales.high - scales.low)
            parts.append(
                (
                    columns,
                    slopes,
                    item.effort[used],
                    torque,
                    path.speed[used] / scales.speed,
                    place,
                    np.full(len(torque), folds[number]),
                    np.full(len(torque), number),
                )
            )
        columns, slopes, effort, *rest = (np.concatenate(part) for part in zip(*parts, strict=True))
        scale = (float(np.std(effort)) if len(effort) else 0.0) or 1.0
        return _Moving(scales, scale, names, columns, slopes, effort / scale, *rest)

    def side(self, sign: int) -> Rows:
        """Return the rows of one direction."""
        mask = sign * self.speed > 0
        if (count := int(np.count_nonzero(mask))) < FEWEST_ROWS:
            raise InsufficientDataError(
                f"{count} rows move in the {'positive' if sign > 0 else 'negative'} direction, "
                f"{FEWEST_ROWS} are needed: record more strokes to and fro"
            )
        fold = np.unique(self.fold[mask], return_inverse=True)[1]
        if fold.max() == 0:
            raise InsufficientDataError(
                "only one load, or part of the recordings, moves in one of the directions: record "
                "all loads to and fro"
            )
        return Rows.of(
            self.names,
            self.columns[mask],
            self.slopes[mask],
            self.effort[mask],
            self.torque[mask],
            self.speed[mask],
            fold,
            self.recording[mask],
        )

    def both(self, parts: Sequence[NDArray]) -> NDArray:
        """Return values of both directions in the order of all rows."""
        values = np.empty(len(self.speed), dtype=parts[0].dtype)
        for sign, part in zip(SIGNS, parts, strict=True):
            values[sign * self.speed > 0] = part
        return values

    def validation(self, held: Sequence[HeldOut]) -> Validation:
        """Return the errors in folds that were left out."""
        resolved, unit = self.both([item.resolved for item in held]), self.scales.torque
        return Validation(
            torque=self.torque[resolved] * unit,
            error=self.both([item.error for item in held])[resolved] * unit,
            u=self.both([item.u for item in held])[resolved] * unit,
            speed=self.speed[resolved] * self.scales.speed,
            recording=self.recording[resolved],
        )


def _friction(moving: _Moving, slope: Array, each: Sequence[Array], direction: int) -> LoadFriction:
    """Return friction by load from the slopes of both directions, in cells of the stroke.

    Its uncertainty is from `each` slope that leaving out one fold after the other gives.
    """
    cell = np.clip((moving.place * CELLS).astype(int), 0, CELLS - 1)
    against = direction * moving.speed > 0

    def share(slope: Array) -> Array:
        means = []
        for mask in (against, ~against):
            count = np.bincount(cell[mask], minlength=CELLS)
            total = np.bincount(cell[mask], weights=slope[mask], minlength=CELLS)
            means.append(np.where(count > 0, total / np.maximum(count, 1), np.nan))
        mu: Array = (means[0] - means[1]) / (means[0] + means[1])
        return mu

    mu = share(slope)
    without = np.stack([share(part) for part in each])
    u = np.array([standard_uncertainty(column) for column in without.T])
    scales, place = moving.scales, (np.arange(CELLS) + 0.5) / CELLS
    known = np.isfinite(mu + u)
    position = scales.low + place * (scales.high - scales.low)
    return LoadFriction(position[known], mu[known], u[known])


def _folds(observations: Sequence[Observation]) -> tuple[list[int], int]:
    """Return the fold of each observation and the number of levels.

    Levels are left out one after the other; where two leave one, recordings are.
    """
    levels = sorted({item.level for item in observations})
    if len(levels) < 2:
        raise InsufficientDataError(
            f"{len(observations)} recordings are at one load and do not show how effort "
            "grows with load; give recordings at two loads or more, at best at five"
        )
    if len(levels) > 2:
        folds = min(FOLDS, len(levels))
        number = {level: i * folds // len(levels) for i, level in enumerate(levels)}
        return [number[item.level] for item in observations], len(levels)
    if len(observations) < 4:
        raise InsufficientDataError(
            f"{len(observations)} recordings at two loads leave nothing to judge the model by: "
            "give two recordings at each load, or three loads"
        )
    folds = min(FOLDS, len(observations) // 2)
    return [i % folds for i in range(len(observations))], 2
