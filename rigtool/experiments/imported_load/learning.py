"""A load model from recordings at known loads: both directions, judged by levels left out.

Each direction is learned by itself (`load_side`). Where there are three load levels or more, one
after the other is left out; two leave only recordings to leave out. Of the slopes g of effort by
torque, against the load and with it, friction takes

    mu = (g_against - g_with) / (g_against + g_with)
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from rigtool.errors import InsufficientDataError
from rigtool.experiments.force_filter.accuracy import COVERAGE_FACTOR
from rigtool.experiments.force_filter.motion_states import LARGEST_LEARNED_RATIO, State
from rigtool.experiments.imported_load.basis import LoadSignals, Scales, ShaftPath, find_scales
from rigtool.experiments.imported_load.loop import learn_loop
from rigtool.experiments.imported_load.model import (
    APART_SPEED,
    APART_STROKE,
    SIDE_SIGNS,
    LoadModel,
    Paces,
    Side,
    pace_of,
    stroke_of,
)
from rigtool.experiments.imported_load.noise import learned_noise
from rigtool.experiments.imported_load.odd_recording import ratios
from rigtool.experiments.imported_load.region import (
    MARGIN,
    NARROW,
    STROKE_CELLS,
    cell_means,
    learn_region,
)
from rigtool.experiments.imported_load.side import (
    INTERVAL_COVERAGE,
    Fit,
    Numbers,
    Rows,
    effort_scale_of,
    groups_for,
)
from rigtool.numerics.arrays import Array, Mask, joined
from rigtool.numerics.jackknife import standard_uncertainty
from rigtool.numerics.plateaus import group_numbers

MAX_FOLDS = 10
"""Parts into which levels are put that are left out together, at most."""

MIN_LEVEL_DISTANCE = 0.02
"""Part of the highest load by which levels differ, at least."""

ONE_LEVEL = 0.1
"""Part of the highest load within which recordings are repeats of one load, whatever gaps they
have: differences of that size do not show how effort grows with load."""

FEWEST_LEFT = 3
"""Levels without the last that show how well the model holds beyond them, at least."""

LEAST_FRICTION = 0.05
"""Friction of the wrong sign, in standard deviations of the effort, from which on current and
position have opposite signs."""

ALIKE_RATIO = 1.96 / 1.44
"""Ratio of factors on u: an interval narrower by this holds 85 instead of 95 %."""


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
class LearnedEffort:
    """A model from recordings at so many `paces`, how well it held at levels left out, friction
    that grows with load, and how `odd` each recording (r,) is, see `odd_recording`."""

    model: LoadModel
    paces: int
    validation: Validation
    friction: LoadFriction
    odd: Array


def level_numbers(values: Sequence[float], apart: float = MIN_LEVEL_DISTANCE) -> list[int]:
    """Return the number of each recording's level, by its mean torque or speed, smallest first.

    Levels are apart by more than a quarter of the widest gap, and by `apart` of the highest; within
    `ONE_LEVEL` of the highest all are one.
    """
    sizes = np.abs(np.asarray(values, dtype=np.float64))
    if np.ptp(sizes) <= ONE_LEVEL * float(sizes.max(initial=0.0)):
        return [0] * len(sizes)
    widest = float(np.diff(np.sort(sizes)).max())
    gap = max(widest / 4, apart * float(sizes.max(initial=0.0)))
    return group_numbers(sizes, gap).tolist()


def levels_of(signals: Sequence[LoadSignals]) -> list[int]:
    """Return the number of the load level of each recording, by its mean reference torque."""
    torques = [item.sensor[item.path.regular] for item in signals]
    return level_numbers([float(np.mean(own)) if own.size else 0.0 for own in torques])


def learn_load_model(
    signals: Sequence[LoadSignals], *, turn: float = 0.0, prior: LoadModel | None = None
) -> LearnedEffort:
    """Learn a model from recordings at two loads or more, each with a sensor.

    `turn` is one turn of the encoder in the unit of position, 0 where it has none. `prior` is the
    model of another mounting, of the same bandwidth: two loads are then enough.
    Raises `InsufficientDataError` where the recordings do not show how effort grows with load.
    """
    paths = [item.path for item in signals]
    scales = find_scales(paths, [item.sensor for item in signals], turn)
    if prior is not None:
        scales = _scales_as(prior, scales)
    level, pace = np.array(levels_of(signals)), _paces(signals)
    middles, stroke = _strokes(signals)
    folds, levels = _folds(level)
    rows = [Rows.of(signals, scales, sign) for sign in SIDE_SIGNS]
    effort_scale = effort_scale_of(np.concatenate([one.effort for one in rows]))
    if prior is not None:
        effort_scale = prior.effort_scale
    rows = [replace(one, effort=one.effort / effort_scale) for one in rows]
    priors = (None, None) if prior is None else prior.sides
    fits = [_fit(*both, folds, levels, pace) for both in zip(rows, priors, strict=True)]
    found = [
        fit.model(_inner(stroke[own.recording]), _ends(pace[own.recording]))
        for fit, own in zip(fits, rows, strict=True)
    ]
    sides, held = [side for side, _ in found], [out for _, out in found]
    torque, speed, place, recording = joined(rows, "torque", "speed", "place", "recording")
    error, within, u, resolved, slope = joined(held, "error", "within", "u", "resolved", "slope")
    direction = resisted_direction(rows, float(np.mean(slope)))
    spacing = float(np.ptp(torque)) / (levels - 1)
    if levels == 2:
        sides = [replace(side, bend=_bend(sides)) for side in sides]
    measured = np.where(resolved, torque + within, np.nan)
    scatter = [COVERAGE_FACTOR * float(np.median(out.u)) / spacing for out in held]
    several = bool(pace.max() > 0 or len(middles) > 1)  # speeds at one place
    torque_range = torque.min() - MARGIN * spacing, torque.max() + MARGIN * spacing
    # Else what load and speed change cannot be told from each other
    enough = len(signals) >= levels + int(pace.max())
    model = LoadModel(
        scales=scales,
        strokes=middles,
        bandwidth_hz=paths[0].bandwidth_hz,
        effort_scale=effort_scale,
        sides=(sides[0], sides[1]),
        torque_range=torque_range,
        direction=direction,
        region=learn_region(
            place, speed, torque, _margins(sides, direction, scatter) * spacing, several=several
        ),
        loop=learn_loop(place, speed > 0, measured, torque, recording),
        noise=learned_noise([item.noise.by(effort_scale) for item in signals]),
        paces=_learned_paces(
            paths,
            pace,
            recording,
            torque,
            float(np.ptp(torque_range)) if enough else MARGIN * spacing,
        ),
    )
    model = replace(model, slack=_slack(model, signals, level))
    against = direction * speed > 0
    each = [np.concatenate(pair) for pair in zip(*(out.slopes for out in held), strict=False)]
    friction = _friction(place, against, scales, slope, each)
    torque, error, u = (scales.torque * values[resolved] for values in (torque, error, u))
    validation = Validation(torque, error, u, level[recording][resolved], against[resolved])
    odd = np.max([ratios(fit.sums, len(signals)) for fit in fits], axis=0)
    return LearnedEffort(model, int(pace.max()) + 1, validation, friction, odd)


def _bend(sides: Sequence[Side]) -> float:
    """Return by how much efforts may be from a line between two loads, see `Side`.

    Friction that grows with the load, by d from one load to the other, may grow between them in
    any way in which it does not fall: by d t^2 or d t (2 - t) at most, if its growth changes
    evenly. Between the two the distribution is rectangular (GUM 4.3.7).
    """
    one, other = sides
    grown = abs(one.slope - other.slope) / 2 * abs(one.levels[-1] - one.levels[0])
    return float(grown / math.sqrt(3))


def resisted_direction(rows: Sequence[Rows], slope: float) -> int:
    """Return the sign of the speed that the load resists, from `rows` of positive and of negative
    speeds and the `slope` of effort by torque.

    There the load raises the effort as friction does, also where current and position have opposite
    signs; friction is what efforts of both directions differ by at one torque.
    """
    (rising, falling), (along, back) = (
        [float(np.mean(getattr(one, name))) for one in rows] for name in ("effort", "torque")
    )
    friction = rising - falling - slope * (along - back)
    opposite = -1 if friction < -LEAST_FRICTION else 1
    return opposite * int(np.sign(slope * (along + back))) or 1


def _fit(rows: Rows, prior: Side | None, folds: Numbers, levels: int, pace: Numbers) -> Fit:
    """Fit one direction; `folds` and `pace` are numbers of load and speed of each recording."""
    level, paces = folds[rows.recording], pace[rows.recording]
    if len(np.unique(level)) < 2:
        raise InsufficientDataError(
            "only one load moves in one of the directions: record all loads to and fro, and see to "
            "it that position and time have one unit in all recordings"
        )
    ways = [rows.recording % MAX_FOLDS]
    if levels > 2:
        turns = _turns(folds)
        ways = [level, turns[rows.recording]] if turns.any() else [level]
    if pace.max() > 1:  # speeds beyond the others are outside: those at the ends stay
        ways.append(_inner(paces))
    names = groups_for(tuple(rows.functions), levels) if prior is None else prior.groups
    return Fit.of(rows, names, level, ways, prior)


def _turns(level: Numbers) -> Numbers:
    """Return which recordings (r,) are left out together: one of each level at most, and of other
    speeds where levels were recorded at the same speeds in turn."""
    rank = np.array([np.sum(level[:n] == own) for n, own in enumerate(level)])
    return (rank + level) % min(MAX_FOLDS, int(rank.max()) + 1)


def _scales_as(prior: LoadModel, scales: Scales) -> Scales:
    """Return a prior's scales on the stroke of these; its curves end at the loads it has seen."""
    if scales.torque > LARGEST_LEARNED_RATIO * prior.scales.torque:
        raise InsufficientDataError(
            f"loads go up to {scales.torque * 1e3:.4g} mN m, those of the prior to "
            f"{prior.scales.torque * 1e3:.4g} mN m only: how effort grows beyond is unknown; learn "
            "from three loads or more without --prior"
        )
    return replace(prior.scales, low=scales.low, high=scales.high)


def _margins(sides: Sequence[Side], direction: int, scatter: Sequence[float]) -> Array:
    """Return how far beyond the levels the torque is given, (2, 2), in spacings, see `region`.

    As far as the `scatter` of either side reaches, at most `NARROW`. Where the last level, left
    out, asks for an interval like those of the others, the model holds a whole spacing beyond what
    it was learned from. Three levels do not show that: two are left, and these carry no curvature.
    Not above the heaviest load while it drives the motor: friction takes more and more of it, and
    the effort hardly depends on the load any more.
    """
    margins = np.tile(np.minimum(scatter, NARROW)[:, None], 2)
    for row, sign, side in zip(margins, SIDE_SIGNS, sides, strict=True):
        heaviest = 0 if abs(side.levels[0]) > abs(side.levels[-1]) else -1
        for end in (0, -1):
            others = np.delete(side.factors, end)
            driving = sign != direction and end == heaviest
            carried = others.size > FEWEST_LEFT + 1  # the end stands twice
            if carried and not driving and side.factors[end] <= ALIKE_RATIO * others.max():
                row[end] = MARGIN
    return margins


def _slack(model: LoadModel, signals: Sequence[LoadSignals], level: Numbers) -> float:
    """Return by how much dead bands have to be wider, without unit, to hold the torque at each of
    the levels, numbered (r,).

    Friction at rest may exceed that of any speed that was learned, of which the bands are made.
    """
    chosen = np.unique(np.linspace(0, len(signals) - 1, MAX_FOLDS).round().astype(int))
    beyond: dict[int, list[Array]] = {}
    for number in chosen.tolist():
        one = signals[number]
        found = model.read(one)
        hidden = np.isin(found.states, (State.REVERSED, State.STILL))
        apart = (np.abs(found.torque - one.sensor) - math.sqrt(3) * found.u)[hidden]
        if apart.size:
            beyond.setdefault(int(level[number]), []).append(apart / model.scales.torque)
    parts = [np.quantile(np.concatenate(own), INTERVAL_COVERAGE) for own in beyond.values()]
    return max(0.0, *map(float, parts)) if parts else 0.0


def _friction(
    place: Array, against: Mask, scales: Scales, slope: Array, each: Sequence[Array]
) -> LoadFriction:
    """Return friction by load from the slopes (n,) of both directions, in cells of the stroke.

    Its uncertainty is from `each` slope that leaving out one fold after the other gives.
    """

    def share(slope: Array) -> Array:
        resisting, driving = (cell_means(place, slope, rows) for rows in (against, ~against))
        return (resisting - driving) / (resisting + driving)

    mu = share(slope)
    without = np.stack([share(part) for part in each])
    u = np.array([standard_uncertainty(column) for column in without.T])
    known = np.isfinite(mu + u)
    centre = (np.arange(STROKE_CELLS) + 0.5) / STROKE_CELLS
    position = scales.low + centre * (scales.high - scales.low)
    return LoadFriction(position[known], mu[known], u[known], len(each) - 1)


def _paces(signals: Sequence[LoadSignals]) -> Numbers:
    """Return the number of the speed of each recording, the slowest first."""
    return np.array(level_numbers([pace_of(item.path) for item in signals], APART_SPEED))


def _learned_paces(
    paths: Sequence[ShaftPath], pace: Numbers, rows: Numbers, torque: Array, margin: float
) -> Paces:
    """Return the mean speed of paths by the number of their `pace` (r,), and the torques (n,)
    there; `rows` (n,) are the numbers of paths."""
    every = np.array([pace_of(path) for path in paths])
    speeds = np.bincount(pace, every) / np.bincount(pace)
    own = [torque[pace[rows] == number] for number in range(len(speeds))]
    lowest, highest = (np.array([f(one) for one in own]) for f in (np.min, np.max))
    return Paces(speeds, lowest - margin, highest + margin)


def _strokes(signals: Sequence[LoadSignals]) -> tuple[Array, Numbers]:
    """Return the middles of strokes (s,) at different places, rad, the lowest first, and the number
    of each recording's stroke."""
    found = np.array([stroke_of(item.path) for item in signals])
    order = np.argsort(found[:, 0], kind="stable")
    middle, length = found[order].T
    number = np.cumsum(np.diff(middle, prepend=middle[0]) > APART_STROKE * length.max())
    middles = np.bincount(number, middle) / np.bincount(number)
    return middles, number[np.argsort(order)]


def _ends(numbers: Numbers) -> Numbers:
    """Return numbers (n,) of conditions in order, -1 but for the first and the last of several."""
    most = int(numbers.max())
    return np.where((most > 0) & ((numbers == 0) | (numbers == most)), numbers, -1)


def _inner(numbers: Numbers) -> Numbers:
    """Return numbers (n,) of conditions in order, -1 for the first and the last of them: what is
    beyond the others is outside what was learned."""
    return np.where((numbers == 0) | (numbers == numbers.max()), -1, numbers)


def _folds(numbers: Numbers) -> tuple[Numbers, int]:
    """Return which load each recording is left out with, at most `MAX_FOLDS`, and how many there
    are.

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
    return numbers * min(MAX_FOLDS, levels) // levels, levels
