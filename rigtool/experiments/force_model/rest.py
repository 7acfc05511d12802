"""Learning from rest, reversals and fast turns, by the angles that a filter predicts.

Bristles bend within a count, where the rotor's angle is not seen: a balance of torques at known
angles cannot show their lengths. The filter of `kalman` follows the angle between the edges. A
filter that knows that nothing acts on the output predicts each angle with a standard deviation s.
That the angle lies in its count then moves it by d s and leaves the part rho of its variance, and

    e = d / sqrt(1 - rho)

has the mean 0 and the variance 1 if the model holds. The parameters are those of the least sum of
e^2 (prediction errors: K. J. Astrom, Automatica 16(5) 551-574, 1980), with the result of sliding as
their prior: lengths of the bristles and how friction is shared between them by rest and reversals,
inertia, delay, drag and friction by the turns of fast strokes. All other parameters move with them
by their covariance. Large errors count in proportion (P. J. Huber, Ann. Math. Stat. 35(1) 73-101,
1964). The least torque on the output would be biased: how much of an error a filter takes for a
torque depends on the parameters, and long bristles leave more to friction.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import product

import numpy as np

from rigtool.experiments.force_filter.estimate import Filter, Signals
from rigtool.experiments.force_filter.kalman import Uncertainty
from rigtool.experiments.force_filter.plant import Plant
from rigtool.experiments.force_model.drive import MotorMap, drive_of, plant_of
from rigtool.experiments.force_model.learning import LearnedModel
from rigtool.experiments.force_model.model import Kind
from rigtool.experiments.force_model.records import halved
from rigtool.experiments.force_model.sliding_problem import (
    SLIDING_PARAMETERS,
    logarithms,
    stepped_shape,
)
from rigtool.experiments.force_model.steps import FilterSteps, Sampler
from rigtool.numerics.arrays import Array


@dataclass(frozen=True)
class Shown:
    """Parameters of a `shape` and `kinds` of terms that a motion determines, besides lengths."""

    shape: tuple[str, ...]
    kinds: tuple[Kind, ...]


BY_REST = Shown(
    ("tip_length", "stribeck_speed"),
    (Kind.BEARING, Kind.STRIBECK, Kind.BEARING_DAMPING, Kind.HOUSING),
)
BY_TURNS = Shown(
    ("grasper_inertia",),
    (Kind.INERTIA, Kind.DELAY, Kind.VISCOUS, Kind.BEARING, Kind.HOUSING),
)
"""What rest and reversals determine, and what the turns of fast strokes determine."""

LEAST_COUNTS = 2.0
"""Mean length of the bristles by their friction, in counts, from which on rest and turns show how
friction differs by direction. With longer counts, errors of the lengths look like another ratio of
both directions, for which a constant torque makes up while the rotor slides."""

CORNER_HZ = 10.0
FILTER_SETTLING_TIME = 1.0
"""Settling time of the filter at its begin, s."""

SHORT, LONG, SHARES = (0.5, 1.0, 2.0), (0.33, 0.66, 1.33, 2.66), (0.1, 0.2)
"""Where the search begins, at the best of all: lengths of both bristles over those of the model,
and the short one's share of the friction. The least lengths are also halved, as often as the short
one stays above half a count."""

HUBER_THRESHOLD = 2.0
MAX_ITERATIONS = 8
SMALLEST_GAIN = 1.0
"""Gain of the sum of squares, in variances, below which the search ends."""

PARAMETER_STEP = 0.05
LONGEST_PARAMETER_STEP = 2.0
"""Longest step of a parameter, in standard deviations of its prior."""

UNTOUCHED_RANDOM_WALK = 1e-3
"""Random walk of the torque here, N m per square root of a second. Nothing acts, and what a filter
that expects contacts would take for one is an error of the model."""

SPEED_RATE = 2.0
"""Random walk of the speeds about rest, rad/s per square root of a second. A filter with less can
lose a count and not find back: the error then leaps where a parameter hardly changes, and the
search stops at the next leap."""

LEAST_INFORMED = 0.01
"""Least part 1 - rho of the angle's variance that is divided by: with less, a count shows
nothing."""

ANGLE_ERROR = 3.0
"""Error of an angle that counts as one standard deviation, in those of its prediction: errors of
the equations are alike in all turns. With 1, parameters are off by up to four of their
uncertainties."""


@dataclass(frozen=True, eq=False)
class Exploration:
    """A motion with nothing on the output: `encoder` counts and `current` A (n,), every
    `sample_time` s of a loop of `loop_time` s; `torque_constant` N m/A, `count` rad."""

    encoder: Array
    current: Array
    sample_time: float
    torque_constant: float
    count: float
    loop_time: float

    @property
    def grid(self) -> FilterSteps:
        """Samples and steps of the filter."""
        return FilterSteps.of(self.sample_time, self.loop_time)

    def under(self, drive: MotorMap) -> Signals:
        """Return the filter's input for a drive."""
        constant = np.full(len(self.encoder), self.torque_constant)
        known = self.encoder, self.current, constant
        return Sampler(self.grid, self.count, drive).add(known, last=True)[0]


def learn_rest(
    learned: LearnedModel, explorations: Sequence[Exploration], uncertainty: Uncertainty
) -> LearnedModel:
    """Return the model, improved by explorations of rest and reversals, of samples of one length.

    A loop alone creeps through a turn, one with a learned table is through at once. What one of
    both shows alone, lengths and shares that the other contradicts explain as well.
    """
    unsure = replace(held(uncertainty), speed_rate=SPEED_RATE)
    problem = PredictionProblem(learned, explorations, unsure, with_ratio(BY_REST))
    found = problem.solution(problem.tried())
    if shows_ratio(found, explorations[0]):
        return found
    problem = PredictionProblem(learned, explorations, unsure, BY_REST)
    return problem.solution(problem.tried())


def with_ratio(shown: Shown) -> Shown:
    """Return what is shown with the ratio of both directions' friction."""
    return replace(shown, shape=(*shown.shape, "direction_ratio"))


def shows_ratio(model: LearnedModel, motion: Exploration) -> bool:
    """Return whether the bristles have `LEAST_COUNTS` of a motion's encoder."""
    plant = plant_of(model, motion.grid.sample_time)
    bent = plant.coulomb * plant.presliding_angle
    bent += plant.housing_friction * plant.housing_presliding_angle
    return bent >= LEAST_COUNTS * motion.count * friction_of(plant)


def held(uncertainty: Uncertainty) -> Uncertainty:
    """Return the uncertainty for learning: hardly any torque on the output, and updates by the
    whole count in each step, for which prediction errors are defined."""
    return replace(
        uncertainty,
        torque_rate=UNTOUCHED_RANDOM_WALK,
        slow_torque_rate=UNTOUCHED_RANDOM_WALK,
        step_torque_rate=UNTOUCHED_RANDOM_WALK,
        repeats=1.0,
    )


def learn_turns(
    learned: LearnedModel, strokes: Sequence[Exploration], uncertainty: Uncertainty
) -> LearnedModel:
    """Return the model with the inertia, delay, drag and friction that the turns of fast strokes
    without load show.

    The strokes have several speeds, but samples of one length. The torque of inertia at a turn
    grows with the speed squared, other errors there do not. Sliding shows the inertia little, since
    turns are left out there.
    """
    shown = with_ratio(BY_TURNS) if shows_ratio(learned, strokes[0]) else BY_TURNS
    return PredictionProblem(learned, strokes, held(uncertainty), shown).solution([])


class PredictionProblem:
    """Errors e of the module by parameters: logarithms of the two lengths, then what is `shown`.

    Errors of all explorations follow one another; their samples have one length.
    """

    def __init__(
        self,
        learned: LearnedModel,
        explorations: Sequence[Exploration],
        uncertainty: Uncertainty,
        shown: Shown,
    ) -> None:
        self.learned, self.uncertainty, self.explorations = learned, uncertainty, explorations
        self.grid = explorations[0].grid
        named = [SLIDING_PARAMETERS.index(name) for name in shown.shape]
        listed = [
            len(SLIDING_PARAMETERS) + n
            for n, term in enumerate(learned.terms)
            if term.kind in shown.kinds and term.order == 0
        ]
        self.shown = [*named, *listed]
        self.known = np.concatenate([logarithms(learned.shape), learned.coefficient])
        self.start = self.parameters(learned)
        own = learned.covariance[np.ix_(self.shown, self.shown)]
        self.follows = np.linalg.solve(own, learned.covariance[self.shown]).T
        self.covariance = np.zeros((len(self.start), len(self.start)))
        self.covariance[:2, :2] = np.diag(learned.length_u**2)
        self.covariance[2:, 2:] = own
        self.friction = friction_of(plant_of(learned, self.grid.sample_time))

    def model(self, parameters: Array) -> LearnedModel:
        """Return the model with parameters (p,); all others move with them by their covariance."""
        every = self.known + self.follows @ (parameters[2:] - self.known[self.shown])
        shape = stepped_shape(
            self.learned.shape,
            every[: len(SLIDING_PARAMETERS)] - self.known[: len(SLIDING_PARAMETERS)],
        )
        lengths = np.exp(parameters[:2]).tolist()
        shape = replace(shape, bearing_length=lengths[0], housing_length=lengths[1])
        return replace(self.learned, shape=shape, coefficient=every[len(SLIDING_PARAMETERS) :])

    def parameters(self, model: LearnedModel) -> Array:
        """Return the parameters (p,) of a model."""
        shape = model.shape
        lengths = np.log([shape.bearing_length, shape.housing_length])
        every = np.concatenate([logarithms(shape), model.coefficient])
        return np.concatenate([lengths, every[self.shown]])

    def errors(self, parameters: Array) -> Array:
        """Return the errors (r,) of parameters, infinite where they are physically impossible."""
        model = self.model(parameters)
        plant = plant_of(model, self.grid.sample_time)
        if not plant_is_sound(plant):
            return np.array([np.inf])
        drive = drive_of(model)
        settling, parts = round(FILTER_SETTLING_TIME / self.grid.step_time), []
        for exploration in self.explorations:
            found = Filter(plant, self.uncertainty, self.grid.step_samples, CORNER_HZ)
            kept = found.add(exploration.under(drive), keep=True).kept
            assert kept is not None
            moved, informed, variance = kept[2:5]
            each = moved * np.sqrt(variance / np.maximum(informed, LEAST_INFORMED))
            parts.append(each[settling:])
        return np.concatenate(parts)

    def tried(self) -> Iterator[Array]:
        """Yield parameters (p,) on a grid of lengths and of the bearing's share of friction."""
        kinds = [
            self.learned.terms[n - len(SLIDING_PARAMETERS)].kind
            for n in self.shown
            if n >= len(SLIDING_PARAMETERS)
        ]
        bearing, housing, rise = (
            len(self.start) - len(kinds) + kinds.index(kind)
            for kind in (Kind.BEARING, Kind.HOUSING, Kind.STRIBECK)
        )
        rise_u = math.sqrt(self.covariance[rise, rise])
        finer = self.learned.shape.bearing_length / self.explorations[0].count
        lengths = ([*some, *halved(some[0], finer)] for some in (SHORT, LONG))
        for short, long, share in product(*lengths, SHARES):
            parameters = self.start.copy()
            parameters[:2] += np.log([short, long])
            more = share * self.friction - parameters[bearing]
            parameters[[bearing, housing]] += [more, -more]
            # sliding hardly shows the rise at low speed: friction at rest has to be above zero, and
            # with far too much a filter loses counts, from where the search does not find back
            most = max(parameters[bearing], parameters[rise] - 2 * rise_u)
            parameters[rise] = min(max(parameters[rise], -parameters[bearing] / 2), most)
            yield parameters

    def solution(self, begins: Iterable[Array]) -> LearnedModel:
        """Return the model of least error, searched from the best of its own parameters (p,) and
        others.

        Its covariance comes from both.
        """
        root: Array = np.asarray(np.linalg.cholesky(self.covariance), dtype=np.float64)
        count = len(self.start)

        def cost(x: Array) -> Array:
            return np.append(self.errors(self.start + root @ x) / ANGLE_ERROR, x)

        def slope(way: Array) -> Array:
            step = PARAMETER_STEP * way
            there = cost(here + step)
            if not np.all(np.isfinite(there)):  # beyond what is physically possible
                there, step = cost(here - step), -step
            return (there - left) / float(step @ way)

        apart = [one - self.start for one in (self.start, *begins)]
        tried = [np.asarray(np.linalg.solve(root, one), dtype=np.float64) for one in apart]
        here = min(tried, key=lambda x: float(np.sum(np.hypot(1, cost(x)))))
        left = cost(here)
        damping = 0.0
        for _ in range(MAX_ITERATIONS):
            slopes = np.stack([slope(way) for way in np.eye(count)], axis=1)
            weight = np.ones(left.size)
            weight[:-count] = 1 / np.hypot(1, left[:-count] / HUBER_THRESHOLD)
            information: Array = slopes.T @ (slopes * weight[:, None])
            before = float(weight @ left**2)
            gained = 0.0
            while damping < 100.0:
                lifted = information + damping * np.diag(np.diag(information))
                change = -np.linalg.solve(lifted, slopes.T @ (weight * left))
                longest = max(LONGEST_PARAMETER_STEP, float(np.abs(change).max()))
                change *= LONGEST_PARAMETER_STEP / longest
                there = cost(here + change)
                sound = bool(np.all(np.isfinite(there)))
                gained = before - float(weight @ there**2) if sound else -1.0
                if gained > 0:
                    here = np.add(here, change)
                    left, damping = there, damping / 4
                    break
                damping = max(4 * damping, 0.1)
            if gained < SMALLEST_GAIN:
                break
        return self._learned(np.asarray(here, dtype=np.float64), root, information)

    def _learned(self, here: Array, root: Array, information: Array) -> LearnedModel:
        model = self.model(self.start + root @ here)
        found = root @ np.linalg.inv(information) @ root.T
        own = self.covariance[2:, 2:]
        covariance = self.learned.covariance + self.follows @ (found[2:, 2:] - own) @ self.follows.T
        return replace(model, covariance=covariance, length_u=np.sqrt(np.diag(found)[:2]))


def friction_of(plant: Plant) -> float:
    """Return the friction of bearings and housing, N m."""
    return plant.coulomb + plant.housing_friction


def plant_is_sound(plant: object) -> bool:
    """Return whether frictions are physically possible."""
    values = [getattr(plant, name) for name in ("coulomb", "static", "housing_friction", "inertia")]
    return min(values) > 0
