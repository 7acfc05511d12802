"""An encoder that was zeroed elsewhere, found in the recording itself.

With an encoder that shows b + o instead of the rotor's angle b, friction by angle and ripple are
subtracted at the wrong place. In the cells of the learned angle, the torque of a pass in direction
d that nothing touches is then

    M = n [d (F(b - o) - F(b)) + R(b - o) - R(b)] + stroke + e

with the torque factor n, friction F and torque by rotor angle R of the learned terms, whose
coefficients have the learned covariance, friction's deviation of the stroke, and white noise e. The
amplifier's part of R lags, as at the steady speed of a pass in a cell.
Either ripple is that of the learned power-up, or its waves have other phases:
beta ~ N(0, A^2 / 2), as in `power_up`. What touches makes cells as far off as `TOUCHED`; which
ones, is found for each o by expectation and maximisation (A. P. Dempster, N. M. Laird, D. B. Rubin,
J. R. Stat. Soc. B 39(1) 1977; its bound in R. M. Neal, G. E. Hinton, Learning in Graphical Models,
1998, is the likelihood of o). All of this is linear for one o, so that o alone is searched.

Friction of another instrument or mounting looks like friction at other angles, too. So o also has
to be likelier than the learned zero with other friction by angle: its waves have other phases, as
those of the ripple, and its level is off by `LEVEL`. What touches is then searched for from what o
leaves untouched, as this friction alone may be as large as what touches. Where it is likelier, the
tables do not hold F, whichever it is. Nor do they where no o is found, and this friction is
likelier than the learned one by the odds that another zero needs, and differs by `DOUBTED` u.

Beyond the learned angles the learned coefficients leave F and R open, so that a zero by which a
tissue at the end of the stroke lies there explains it. The cells that o leaves within the learned
angles have to show o by themselves.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from rigtool.experiments.force_model.force_model import ForceModel
from rigtool.experiments.force_model.model import Kind, Term, wave
from rigtool.experiments.force_model.sliding_problem import SLIDING_PARAMETERS
from rigtool.experiments.force_sensor.unknown_friction import (
    ANGLE_CELLS,
    DOUBTED,
    FEWEST_CELLS,
    Passes,
)
from rigtool.numerics.arrays import Array, Mask, joined

FARTHEST, PLACES, PARTS = 0.5, 43, 4
"""Largest o, in the learned range of angles, and part of the cells that were then not learned: with
more, anything explains what passes show. Odd number of places that are tried, and parts of the
distance between two of them near the best."""

FEWEST_PASSES, MOST_PASSES = 2, 8
"""Passes in each direction below which nothing is looked for, and how many are looked at."""

NOISE, KNOWN, TOUCHED = 0.5, 0.03, 0.35
"""In deviations of a stroke: white noise of a cell, and the deviation of a sum of coefficients
below which it is taken as known. In parts of the friction: torque that touches."""

LEVEL, OTHER = 0.2, 0.1
"""Deviation of the friction of another instrument, in parts of the learned one; and how often
tables are of another instrument, in parts of how often the zero is another one: an encoder without
an index has one at each start, tables are checked for the name of the rig."""

UNCERTAIN_SHARE = 0.3
"""Part of the variance of waves with other phases that counts besides the learned amplitude."""

TOUCHED_PROBABILITY, ROUNDS = 0.3, 4
"""Probability that something touches, before anything is seen; rounds of the search for what is
touched."""

ROW_EVIDENCE, UNMOVED, BEYOND = 0.5, 0.999, 30.0
"""Part of the likelihood's logarithm that counts, as errors of cells that follow one another are
alike; the probability that the zero is that of the learning, before anything is seen: a good
recording is ruined by a zero that is not off; and the rate at which the other's falls with the part
of the cells that were then not learned: rigs move where they were learned, and friction elsewhere
may be anything."""

CERTAIN, LARGEST_U, UNTOUCHED_PART, SEEN_CELLS = 0.999, 0.05, 0.45, 0.8
"""Probability of another zero from which on it is taken, and its largest u, in the learned range;
parts of the passes of each direction that nothing touches, and of the cells that are so in both:
with less, a load that stays looks like it."""

LONG_ODDS = math.log(CERTAIN / (1 - CERTAIN)) + math.log(UNMOVED / (1 - UNMOVED))
"""Logarithm of the likelihood's gain by what is `CERTAIN` although another zero is so unlikely."""


@dataclass(frozen=True)
class EncoderZero:
    """The angle `moved` rad that the encoder shows too much, its standard uncertainty `u`, and the
    `spread` N m of the torque on the output that follows from it; 0 where other friction by angle
    is likelier, and the spread that of its difference from the learned one."""

    moved: float
    u: float
    spread: float


def encoder_zero(
    parts: Sequence[Passes],
    model: ForceModel,
    reach: tuple[float, float],
    count: float,
    hand: float | None = None,
) -> EncoderZero | None:
    """Return the zero that the passes of stretches show, in whole counts of `count` rad; None where
    zero and friction by angle are those of the learning, or too few passes are left alone by what
    touches.

    Torques of the passes are those before another power-up's ripple was taken off; `reach` rad is
    the learned range of angles. Torque that drives a pass with more than `hand` N m is a hand's.
    """
    direction, torque, doubt = joined(parts, "direction", "torque", "u")
    speed = np.vstack([np.broadcast_to(part.speed, part.torque.shape) for part in parts])
    if hand is not None:
        torque = np.where(direction[:, None] * torque >= -hand, torque, np.nan)
    seen = np.isfinite(torque).sum(axis=1) >= FEWEST_CELLS
    sides = [np.flatnonzero(seen & (direction == sign)) for sign in (1.0, -1.0)]
    if min(map(len, sides)) < FEWEST_PASSES or model.deviations.stroke <= 0:
        return None
    spread = [np.linspace(0, len(one) - 1, min(len(one), MOST_PASSES)) for one in sides]
    every = zip(sides, spread, strict=True)
    chosen = np.sort(np.concatenate([one[at.round().astype(int)] for one, at in every]))
    direction, torque, speed = direction[chosen], torque[chosen], speed[chosen]
    search = _Search(model, reach, direction, torque, speed)
    doubted = DOUBTED * float(np.nanmedian(doubt))
    places, odds, unmoved = _tried(search, reach[1] - reach[0])
    mean = float(odds @ places)
    moved, u = count * round(mean / count), math.sqrt(odds @ (places - mean) ** 2)
    if moved == 0 or unmoved > 1 - CERTAIN or u > LARGEST_U * (reach[1] - reach[0]):
        return search.other_instrument(doubted)
    likelihood, untouched = search.likelihood(moved)
    if not search.shows(untouched):
        return search.other_instrument(doubted)
    there = np.where(search.learned_at(moved), torque, math.nan)
    within = _Search(model, reach, direction, there, speed)
    gained = ROW_EVIDENCE * (within.likelihood(moved)[0] - within.likelihood(0.0)[0])
    if gained < LONG_ODDS:
        return search.other_instrument(doubted)
    other, differs = search.other_friction(untouched)
    if ROW_EVIDENCE * (other - likelihood) + math.log(OTHER) > 0:
        return EncoderZero(0.0, u, differs)
    torques = np.array([search.mean(place) for place in places])
    off = float(np.sqrt(np.mean(odds @ (torques - search.mean(moved)) ** 2)))
    return EncoderZero(moved, u, off)


def _tried(search: _Search, span: float) -> tuple[Array, Array, float]:
    """Return the zeros that are tried in a learned range of `span` rad, closer about the best, (k,)
    rad; their probabilities (k,) if the zero is another one; and the probability that it is not."""
    step = 2 * FARTHEST * span / (PLACES - 1)
    places = step * (np.arange(PLACES, dtype=np.float64) - PLACES // 2)
    logs = np.array([search.odds(place) for place in places])
    unmoved = logs[PLACES // 2] + math.log(UNMOVED)
    best = places[np.argmax(logs)]
    far = np.abs(places - best) > 2.001 * step
    near = best + step * ((np.arange(5 * PARTS) + 0.5) / PARTS - 2.5)
    fine = [search.odds(place) - math.log(PARTS) for place in near]
    places, logs = np.concatenate([places[far], near]), np.concatenate([logs[far], fine])
    logs += math.log((1 - UNMOVED) / PLACES)
    odds = np.exp(logs - logs.max())
    unmoved = 1 / (1 + odds.sum() * math.exp(np.clip(logs.max() - unmoved, -100, 100)))
    return places, odds / odds.sum(), unmoved


class _Search:
    """Passes in cells, and the linear model that they have for one o; see the module."""

    def __init__(
        self,
        model: ForceModel,
        reach: tuple[float, float],
        direction: Array,
        torque: Array,
        speed: Array,
    ) -> None:
        learned, (low, high) = model.learned, reach
        self._known = learned.known
        self._angle = low + (0.5 + np.arange(ANGLE_CELLS)) * (high - low) / ANGLE_CELLS
        at_once = Kind.OFFSET, Kind.COGGING, Kind.DISTINCT_COGGING
        kinds = ((Kind.BEARING, Kind.HOUSING), at_once, (Kind.RIPPLE,))
        own = [[n for n, t in enumerate(learned.terms) if t.kind in kind] for kind in kinds]
        self._terms = [[learned.terms[n] for n in numbers] for numbers in own]
        every = [*own[0], *own[1], *own[2]]
        size, terms = len(SLIDING_PARAMETERS), [learned.terms[n] for n in every]
        coefficient = learned.coefficient[every]
        covariance = learned.covariance[size:, size:][np.ix_(every, every)]
        plain = [n < len(own[0]) and not term.order for n, term in enumerate(terms)]
        level = covariance + np.diag((LEVEL * coefficient * plain) ** 2)
        frictions = [n for n in range(len(own[0])) if not plain[n]]
        ripples = list(range(len(own[0]) + len(own[1]), len(every)))
        stroke = model.deviations.stroke

        def either(mean: Array, covariance: Array) -> list[tuple[Array, Array]]:
            both = (mean, covariance), _other_phases(mean, covariance, terms, ripples)
            return [(mean, _root(one, KNOWN * stroke)) for mean, one in both]

        self._hypotheses = either(coefficient, covariance)
        self._other_friction = either(*_other_phases(coefficient, level, terms, frictions))
        self._pass, self._cell = np.nonzero(np.isfinite(torque))
        self._direction = direction[self._pass]
        self._torque = torque[self._pass, self._cell]
        self._lag = speed[self._pass, self._cell] * learned.shape.ripple_time
        self._learned, self._subtracted = coefficient, self._waves(0.0) @ coefficient
        deviation = self._known.torque_factor * stroke
        friction = sum(c for t, c in zip(self._terms[0], coefficient, strict=False) if not t.order)
        self._noise = NOISE * deviation
        self._touched = TOUCHED * self._known.torque_factor * float(friction)
        output = self._angle[self._cell] / self._known.angle_ratio
        self._strokes = np.zeros((len(self._torque), 2 * len(torque)))
        rows = np.arange(len(self._torque))
        self._strokes[rows, 2 * self._pass] = deviation * np.cos(output)
        self._strokes[rows, 2 * self._pass + 1] = deviation * np.sin(output)

    def _friction(self, moved: float) -> Array:
        """Return the terms of friction in positive motion, (cells, t), N m on the output."""
        output = (self._angle - moved) / self._known.angle_ratio
        found = np.array([wave(term, output) for term in self._terms[0]]).reshape(-1, ANGLE_CELLS)
        return self._known.torque_factor * found.T

    def _waves(self, moved: float) -> Array:
        """Return the terms in the passes (n, t), N m on the output."""
        friction = self._direction[:, None] * self._friction(moved)[self._cell]
        rotor = self._angle[self._cell] - moved
        width = float(self._angle[1] - self._angle[0]) / (2 * np.pi)
        means = [float(np.sinc(term.order * width)) for term in self._terms[1]]  # over a cell
        by_angle = [mean * wave(t, rotor) for mean, t in zip(means, self._terms[1], strict=True)]
        by_angle += [_lagged_wave(term, rotor, self._lag) for term in self._terms[2]]
        others = np.array(by_angle).reshape(-1, len(rotor)).T
        return np.hstack([friction, self._known.torque_factor * others])

    def odds(self, moved: float) -> float:
        """Return the logarithm of the probability of o, but for what is the same for all."""
        beyond = float(np.mean(~self.learned_at(moved)[np.unique(self._cell)]))
        if beyond > FARTHEST:
            return -math.inf
        return ROW_EVIDENCE * self.likelihood(moved)[0] - BEYOND * beyond

    def learned_at(self, moved: float) -> Mask:
        """Return which cells (cells,) are learned ones with another zero, too."""
        angle = self._angle - moved
        return (angle >= self._angle[0]) & (angle <= self._angle[-1])

    def mean(self, moved: float) -> Array:
        """Return the torque that another zero makes of the learned friction, (cells,), N m."""
        return self._friction(moved) @ self._learned[: len(self._terms[0])]

    def likelihood(self, moved: float) -> tuple[float, Array]:
        """Return the likelihood's logarithm, and the probability that nothing touches (n,), of the
        hypothesis that is likelier."""
        waves = self._waves(moved)
        found = [
            self._by_hypothesis(waves @ mean - self._subtracted, waves @ root)[:2]
            for mean, root in self._hypotheses
        ]
        return max(found, key=lambda one: one[0])

    def other_friction(self, untouched: Array) -> tuple[float, float]:
        """Return the likelihood's logarithm of the learned zero with other friction by angle, and
        root mean square N m of that friction's difference from the learned one. The search for what
        touches begins with the probabilities (n,) that nothing does, `untouched`."""
        waves, friction, found = self._waves(0.0), self._friction(0.0), []
        for mean, root in self._other_friction:
            off = waves @ mean - self._subtracted
            value, _, drawn = self._by_hypothesis(off, waves @ root, untouched)
            differs = (mean + root @ drawn - self._learned)[: friction.shape[1]]
            found.append((value, float(np.sqrt(np.mean((friction @ differs) ** 2)))))
        return max(found)

    def other_instrument(self, least: float) -> EncoderZero | None:
        """Return the difference of other friction by angle where this is far likelier than the
        learned one, at the learned zero, and differs by the `least` N m that counts."""
        learned, untouched = self.likelihood(0.0)
        other, differs = self.other_friction(untouched)
        gained = ROW_EVIDENCE * (other - learned) + math.log(OTHER)
        found = gained > LONG_ODDS and differs > least and self.shows(untouched)
        return EncoderZero(0.0, 0.0, differs) if found else None

    def _by_hypothesis(
        self, mean: Array, columns: Array, found: Array | None = None
    ) -> tuple[float, Array, Array]:
        left, s, w = self._torque - mean, self._noise, self._touched
        design = np.hstack([columns, self._strokes])
        prior = math.log(TOUCHED_PROBABILITY / (1 - TOUCHED_PROBABILITY))

        def probability(error: Array, variance: Array | float) -> Array:
            exponent = error**2 / 2 * (1 / variance - 1 / w**2) + np.log(variance / w**2) / 2
            return 1 / (1 + np.exp(np.clip(prior + exponent, -30, 30)))

        if found is None:
            found = probability(left, np.sum(design**2, axis=1) + s**2)
        for number in range(ROUNDS):
            weight = found / s**2 + (1 - found) / w**2
            weighted = design * weight[:, None]
            normal, right = design.T @ weighted + np.eye(design.shape[1]), weighted.T @ left
            solution = np.linalg.solve(normal, right)
            if number < ROUNDS - 1:
                found = probability(left - design @ solution, s**2)
        value = -(weight @ left**2 - right @ solution + np.linalg.slogdet(normal)[1]) / 2
        value += found @ np.log((1 - TOUCHED_PROBABILITY) / (s * found))
        value += (1 - found) @ np.log(TOUCHED_PROBABILITY / (w * (1 - found)))
        return float(value), found, solution[: columns.shape[1]].astype(np.float64)

    def shows(self, untouched: Array) -> bool:
        """Return whether cells (n,) that nothing touches, by probability, are enough."""
        parts, seen = [], []
        for sign in (1.0, -1.0):
            side = self._direction == sign
            parts.append(float(untouched[side].mean()))
            free = np.bincount(self._cell[side], untouched[side], minlength=ANGLE_CELLS)
            seen.append(free > 1 / 2)
        both = float((seen[0] & seen[1]).sum()) / np.unique(self._cell).size
        return min(parts) >= UNTOUCHED_PART and both >= SEEN_CELLS


def _lagged_wave(term: Term, angle: Array, lag: Array) -> Array:
    """Return a wave at angles (n,) behind a first-order lag, at steady speeds: `lag` (n,) rad is
    the angle that passes in its time constant."""
    later, quarter = term.order * lag, replace(term, quarter=1 - term.quarter)
    turned = wave(quarter, angle) * (-1.0 if term.quarter else 1.0)
    return (wave(term, angle) + later * turned) / (1 + later**2)


def _other_phases(
    mean: Array, covariance: Array, terms: Sequence[Term], waves: list[int]
) -> tuple[Array, Array]:
    """Return mean and covariance of the terms where these `waves` of theirs have other phases."""
    square = mean**2 + UNCERTAIN_SHARE * np.diag(covariance)
    mean, covariance = mean.copy(), covariance.copy()
    orders = np.array([terms[n].order for n in waves])
    mean[waves] = covariance[waves, :] = covariance[:, waves] = 0.0
    covariance[waves, waves] = [square[waves][orders == order].sum() / 2 for order in orders]
    return mean, covariance


def _root(covariance: Array, least: float) -> Array:
    """Return a matrix S of which S S' is a covariance, but for deviations below the least one."""
    values, vectors = np.linalg.eigh(covariance)
    large = values > least**2
    return vectors[:, large] * np.sqrt(values[large])
