"""A load model from recordings at known loads: both directions, judged by levels left out.

Each direction is learned by itself (`load_side`). Where there are three load levels or more, one
after the other is left out; two leave only recordings to leave out. Of the slopes g of effort by
torque, against the load and with it, friction takes

    mu = (g_against - g_with) / (g_against + g_with)
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from rigtool.errors import InsufficientDataError
from rigtool.experiments.imported_load.basis import (
    GROUPS,
    LOAD_POWER,
    LoadSignals,
    Scales,
    find_scales,
    motion_functions,
    size_of,
)
from rigtool.experiments.imported_load.loop import learn_loop
from rigtool.experiments.imported_load.model import SIGNS, DesignMatrix, LoadModel, Side
from rigtool.experiments.imported_load.region import (
    BEYOND,
    MARGIN,
    NARROW,
    learn_region,
    spacing_of,
)
from rigtool.experiments.imported_load.side import Rows, groups_for
from rigtool.numerics.arrays import Array, Mask
from rigtool.numerics.jackknife import standard_uncertainty

Numbers = NDArray[np.intp]

FEWEST_ROWS = 200
"""Rows in motion, in each direction."""

FOLDS = 10
"""Parts into which levels are put that are left out together, at most."""

APART = 0.02
"""Part of the highest load by which levels differ, at least."""

APART_SPEED = 0.1
"""Part of the highest speed by which speeds differ, at least."""

ALIKE = 1.96 / 1.44
"""Of factors on u: an interval narrower by this holds 85 instead of 95 %, normal distribution."""

CELLS = 20
"""Parts of the stroke for which friction that grows with load is reported."""


@dataclass(frozen=True, eq=False)
class Validation:
    """Rows (n,) of levels that were left out of the learning: torque, error and u in N m.

    `level` is the number of the load, `against` marks rows that move against it.
    """

    torque: Array
    error: Array
    u: Array
    level: Numbers
    against: Mask


@dataclass(frozen=True, eq=False)
class LoadFriction:
    """Part mu (n,) of the load that friction takes, with u and its dof, along the position (n,).

    Effort goes as torque * (1 + mu) while the load resists the motion and torque * (1 - mu) while
    it drives it; beyond 1 the load alone would not move the drive backwards.
    """

    position: Array
    mu: Array
    u: Array
    dof: int


@dataclass(frozen=True, eq=False)
class Learned:
    """A model from recordings at so many `paces`, how well it held at levels left out, and
    friction that grows with load."""

    model: LoadModel
    paces: int
    validation: Validation
    friction: LoadFriction


def level_numbers(values: Sequence[float], apart: float = APART) -> list[int]:
    """Return the number of each recording's level, by its mean torque or speed, smallest first.

    Levels are apart by more than a quarter of the widest gap, and by `apart` of the highest.
    """
    sizes = np.abs(np.asarray(values, dtype=np.float64))
    order = np.argsort(sizes, kind="stable")
    gaps = np.diff(sizes[order])
    widest = float(gaps.max()) if len(gaps) else 0.0
    levels = np.empty(len(order), dtype=int)
    gap = max(widest / 4, apart * float(sizes.max(initial=0.0)))
    levels[order] = np.concatenate([[0], np.cumsum(gaps > gap)])
    return [int(level) for level in levels]


def levels_of(signals: Sequence[LoadSignals]) -> list[int]:
    """Return the number of the load level of each recording, by its mean reference torque."""
    means = []
    for item in signals:
        moving = item.counts & item.path.regular
        means.append(float(np.mean(item.sensor[moving])) if moving.any() else 0.0)
    return level_numbers(means)


def learn_load_model(
    signals: Sequence[LoadSignals],
    *,
    turn: float = 0.0,
    prior: LoadModel | None = None,
) -> Learned:
    """Learn a model from recordings at two loads or more, each with a sensor.

    `turn` is one turn of the encoder in the unit of position, 0 where it has none. `prior` is the
    model of another mounting, of the same bandwidth: two loads are then enough.
    Raises `InsufficientDataError` where the recordings do not show how effort grows with load.
    """
    paths = [item.path for item in signals]
    scales = find_scales(paths, [item.sensor for item in signals], turn)
    if prior is not None:
        scales = _scales_as(prior, scales)
    numbers = np.array(levels_of(signals))
    folds, levels = _folds(numbers)
    moving = _Moving.of(signals, scales, folds, None if prior is None else prior.effort_scale)
    sides, held = [], []
    for number, sign in enumerate(SIGNS):
        rows = moving.side(sign, levels, None if prior is None else prior.sides[number])
        side, out = rows.model()
        sides.append(side)
        held.append(out)
    slope = moving.both([item.slope for item in held])
    direction = int(np.sign(np.mean(slope) * np.mean(moving.torque))) or 1
    error, u, resolved = (
        moving.both([getattr(item, name) for item in held]) for name in ("error", "u", "resolved")
    )
    measured = np.where(resolved, moving.torque + error, np.nan)
    spacing = spacing_of(moving.torque, levels)
    margins = _margins(sides, direction) * spacing
    model = LoadModel(
        scales=scales,
        bandwidth_hz=paths[0].bandwidth_hz,
        effort_scale=moving.effort_scale,
        sides=(sides[0], sides[1]),
        torque_range=(
            float(moving.torque.min()) - MARGIN * spacing,
            float(moving.torque.max()) + MARGIN * spacing,
        ),
        direction=direction,
        region=learn_region(moving.place, moving.speed, moving.torque, margins),
        loop=learn_loop(moving.place, moving.speed > 0, measured, moving.recording),
    )
    each = [moving.both(pair) for pair in zip(*(item.slopes for item in held), strict=False)]
    torque, error, u = (scales.torque * v[resolved] for v in (moving.torque, error, u))
    level, against = numbers[moving.recording], direction * moving.speed > 0
    validation = Validation(torque, error, u, level[resolved], against[resolved])
    friction = _friction(moving, slope, each, direction)
    return Learned(model, int(moving.pace.max()) + 1, validation, friction)


def _scales_as(prior: LoadModel, scales: Scales) -> Scales:
    """Return a prior's scales on the stroke of these; its curves end at the loads it has seen."""
    if scales.torque > BEYOND * prior.scales.torque:
        raise InsufficientDataError(
            f"loads go up to {scales.torque * 1e3:.4g} mN m, those of the prior to "
            f"{prior.scales.torque * 1e3:.4g} mN m only: how effort grows beyond is unknown; learn "
            "from three loads or more without --prior"
        )
    return replace(prior.scales, low=scales.low, high=scales.high)


def _margins(sides: Sequence[Side], direction: int) -> Array:
    """Return how far beyond the levels the torque is given, (2, 2), in spacings, see `region`.

    Where the last level, left out, asks for an interval like those of the others, the model holds a
    whole spacing beyond what it was learned from. Not above the heaviest load while it drives the
    motor: friction takes more and more of it, and the effort hardly depends on the load any more.
    """
    margins = np.full((2, 2), NARROW)
    for row, sign, side in zip(margins, SIGNS, sides, strict=True):
        heaviest = 0 if abs(side.levels[0]) > abs(side.levels[-1]) else -1
        for end in (0, -1):
            others = np.delete(side.factors, end)
            driving = sign != direction and end == heaviest
            if others.size > 1 and not driving and side.factors[end] <= ALIKE * others.max():
                row[end] = MARGIN
    return margins


@dataclass(frozen=True, eq=False)
class _Moving:
    """Rows (n,) of all recordings that move, without unit, and their functions (n, k).

    `level` and `pace` number loads, as they are left out, and speeds.
    """

    scales: Scales
    effort_scale: float
    names: tuple[str, ...]
    functions: Array
    effort: Array
    torque: Array
    speed: Array
    place: Array
    recording: Numbers
    level: Numbers
    pace: Numbers

    @staticmethod
    def of(
        signals: Sequence[LoadSignals],
        scales: Scales,
        folds: Numbers,
        effort_scale: float | None,
    ) -> _Moving:
        paces = _paces(signals)
        parts: list[tuple[Array | Numbers, ...]] = []
        for number, item in enumerate(signals):
            path = item.path
            used = item.counts & path.regular & (np.abs(path.speed) >= scales.standstill)
            rows = np.flatnonzero(used)
            functions = np.empty((len(rows), sum(map(size_of, GROUPS))))
            for sign in SIGNS:
                mask = sign * path.speed[rows] > 0
                by_group = motion_functions(path, scales, sign)
                names = tuple(by_group)
                columns = np.hstack([by_group[name][rows[mask]] for name in names])
                functions = functions[:, : columns.shape[1]]
                functions[mask] = columns
            parts.append(
                (
                    functions,
                    item.effort[rows],
                    item.sensor[rows] / scales.torque,
                    path.speed[rows] / scales.speed,
                    (path.position[rows] - scales.low) / (scales.high - scales.low),
                    *(np.full(len(rows), n) for n in (number, folds[number], paces[number])),
                )
            )
        functions, effort, *rest = (np.concatenate(part) for part in zip(*parts, strict=True))
        scale = effort_scale or (float(np.std(effort)) if len(effort) else 0.0) or 1.0
        return _Moving(scales, scale, names, functions, effort / scale, *rest)

    def side(self, sign: int, levels: int, prior: Side | None) -> Rows:
        """Return the rows of one direction."""
        mask = sign * self.speed > 0
        if (count := int(np.count_nonzero(mask))) < FEWEST_ROWS:
            raise InsufficientDataError(
                f"{count} rows move in the {'positive' if sign > 0 else 'negative'} direction, "
                f"{FEWEST_ROWS} are needed: record more strokes to and fro"
            )
        level = np.unique(self.level[mask], return_inverse=True)[1]
        if level.max() == 0:
            raise InsufficientDataError(
                "only one load moves in one of the directions: record all loads to and fro"
            )
        recording = np.unique(self.recording[mask], return_inverse=True)[1]
        folds = [level if levels > 2 else recording % FOLDS]
        if self.pace.max() > 1:  # speeds beyond the others are outside: those at the ends stay
            pace = self.pace[mask]
            folds.append(np.where((pace == 0) | (pace == self.pace.max()), -1, pace))
        names = groups_for(self.names, levels) if prior is None else prior.groups
        ends_of = dict(zip(self.names, np.cumsum([size_of(n) for n in self.names]), strict=True))
        columns = np.concatenate([np.arange(ends_of[n] - size_of(n), ends_of[n]) for n in names])
        design = DesignMatrix(
            self.functions[np.ix_(mask, columns)],
            np.concatenate([np.full(size_of(n), LOAD_POWER.get(n, 0)) for n in names]),
        )
        return Rows.of(
            names,
            design,
            self.effort[mask],
            self.torque[mask],
            self.speed[mask],
            recording,
            level,
            folds,
            prior,
        )

    def both(self, parts: Sequence[NDArray]) -> NDArray:
        """Return values of both directions in the order of all rows."""
        values = np.empty(len(self.speed), dtype=parts[0].dtype)
        for sign, part in zip(SIGNS, parts, strict=True):
            values[sign * self.speed > 0] = part
        return values


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
    return LoadFriction(position[known], mu[known], u[known], len(each) - 1)


def _paces(signals: Sequence[LoadSignals]) -> list[int]:
    """Return the number of the speed of each recording, the slowest first."""
    speeds = [item.path.speed[item.counts & item.path.regular] for item in signals]
    sizes = [float(np.sqrt(np.mean(own**2))) if own.size else 0.0 for own in speeds]
    return level_numbers(sizes, APART_SPEED)


def _folds(numbers: Numbers) -> tuple[Numbers, int]:
    """Return which load each recording is left out with, at most `FOLDS`, and how many there are.

    `numbers` are those of the loads, each recording's (r,).
    """
    levels = int(numbers.max()) + 1
    if levels < 2:
        raise InsufficientDataError(
            f"{len(numbers)} recordings are at one load and do not show how effort "
            "grows with load; give recordings at two loads or more, at best at five"
        )
    if levels == 2 and len(numbers) < 4:
        raise InsufficientDataError(
            f"{len(numbers)} recordings at two loads leave nothing to judge the model by: "
            "give two recordings at each load, or three loads"
        )
    return numbers * min(FOLDS, levels) // levels, levels
