"""What another power-up draws, from waves that were learned along a part of a turn."""

from dataclasses import dataclass
from itertools import product

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.stats import multivariate_normal

from rigtool.experiments.force_model.drawn_ripple import FADES, SIZES, learned_ripple
from rigtool.experiments.force_model.learning import LearnedModel
from rigtool.experiments.force_model.model import ROTOR_ORDERS, Kind, Known, Shape, Term
from rigtool.experiments.force_model.sliding_problem import SLIDING_PARAMETERS

FIRST = len(SLIDING_PARAMETERS)
NOISE, LEVEL, COUNT = 0.02e-3, 0.3e-3, 40
SHAPE = Shape(2e-3, 8e-3, 5e-3, 0.3, 0.05, 0.2, 8e-4, 1e-3, 2e-6, 1.8e-3)


@dataclass(frozen=True)
class Model:
    """What is read of a force model."""

    learned: LearnedModel


def rows(terms, arc):
    """Return the terms along an arc, rad, in both directions (n, t): a constant hides the mean of
    the waves, and cogging differs from ripple by the lag of a slow motion."""
    angle = np.linspace(0.0, arc, COUNT // 2)
    found = []
    for term in terms:
        wave = np.sin if term.quarter else np.cos
        lag = 0.1 if term.kind is Kind.RIPPLE else 0.0
        found.append([wave(term.order * (angle - way * lag)) for way in (1, -1)])
    return np.array(found).reshape(len(terms), -1).T


def known_waves(orders=(1, 2, 3), ripple=0.3e-3, cogging=0.1e-3):
    """Return terms of ripple and cogging as learning sizes them, and a constant."""
    both = (Kind.RIPPLE, ripple, 0.5), (Kind.COGGING, cogging, 1.0)
    waves = [Term(k, s * n**-f, n, q) for k, s, f in both for n in orders for q in (0, 1)]
    return (*waves, Term(Kind.OFFSET, LEVEL))


def learned_from(terms, x, torque):
    """Return the model that a torque (n,) gives: the posterior of linear terms."""
    precision = x.T @ x / NOISE**2 + np.diag([term.spread**-2 for term in terms])
    covariance = np.zeros((FIRST + len(terms),) * 2)
    covariance[FIRST:, FIRST:] = np.linalg.inv(precision)
    coefficient = covariance[FIRST:, FIRST:] @ x.T @ torque / NOISE**2
    known = Known(0.85, 1.2, 2e-5)
    return Model(LearnedModel(terms, SHAPE, known, coefficient, covariance, np.ones(2)))


@pytest.mark.parametrize("seed", [1, 2])
def test_sizes_and_fades_count_by_how_likely_they_make_the_recording(seed):
    terms = known_waves()
    rng = np.random.default_rng(seed)
    x = rows(terms, arc=1.4)
    true = rng.standard_normal(len(terms)) * [4 * term.spread for term in terms]
    torque = x @ true + NOISE * rng.standard_normal(COUNT)
    spread, order = (np.array([getattr(t, name) for t in terms]) for name in ("spread", "order"))
    ripple = np.array([term.kind is Kind.RIPPLE for term in terms])
    cogging = np.array([term.kind is Kind.COGGING for term in terms])
    largest = max(np.sqrt(np.sum(spread[own] ** 2)) for own in (ripple, cogging))
    evidence, squares, means = [], [], []
    for fade, size, still in product(FADES, SIZES, SIZES):
        other = spread.copy()
        fading = order[ripple] ** -fade
        other[ripple] = size * largest * fading / np.sqrt(np.sum(fading**2))
        other[cogging] *= still * largest / np.sqrt(np.sum(spread[cogging] ** 2))
        within = (x * other**2) @ x.T + NOISE**2 * np.eye(COUNT)
        evidence.append(multivariate_normal(np.zeros(COUNT), within).logpdf(torque))
        follows = np.linalg.solve(within, x * other**2)
        both = ripple[:, None] * np.eye(len(terms)) + cogging[:, None] * np.eye(len(terms))
        to = np.array([both[ripple][n] + both[cogging][n] for n in range(ripple.sum())])
        mean = to @ (torque @ follows)
        left = to @ (np.diag(other**2) - (x * other**2).T @ follows) @ to.T
        means.append(mean)
        squares.append(mean**2 + np.diag(left))
    weights = np.exp(np.array(evidence) - max(evidence))
    weights /= weights.sum()
    found = learned_ripple(learned_from(terms, x, torque))
    assert found.orders[:3].tolist() == [1, 2, 3]
    assert_allclose(found.coefficient[:6], weights @ means, rtol=1e-5, atol=1e-9)
    drawn = np.repeat((weights @ squares).reshape(-1, 2).sum(axis=1) / 2, 2)
    assert_allclose(found.drawn[:6], drawn, rtol=1e-5)


def test_amplitudes_hold_where_a_short_arc_shows_high_orders_alone():
    """Strong orders are the low ones: along a quarter of a turn, which hides their mean, one size
    for all orders alike is far too small."""
    orders, rng = tuple(ROTOR_ORDERS), np.random.default_rng(3)
    terms = known_waves(orders, ripple=0.12e-3, cogging=0.1e-3)
    x = rows(terms, arc=1.6)
    amplitude = np.zeros(len(terms))
    amplitude[:4] = np.repeat([0.4e-3, 0.9e-3], 2)
    found, before = [], []
    for _ in range(12):
        phases = np.repeat(rng.uniform(0, 2 * np.pi, len(terms) // 2 + 1), 2)[: len(terms)]
        true = amplitude * np.where(np.arange(len(terms)) % 2, np.sin(phases), np.cos(phases))
        true[-1] = 0.3e-3
        model = learned_from(terms, x, x @ true + NOISE * rng.standard_normal(COUNT))
        found.append(learned_ripple(model).drawn.sum())
        own = slice(0, -1)
        doubt = np.diag(model.learned.covariance)[FIRST:][own]
        before.append(np.sum(model.learned.coefficient[own] ** 2 + doubt))
    true_square = 0.4e-3**2 + 0.9e-3**2
    assert 0.8 < np.sqrt(np.mean(found) / true_square) < 1.5
    assert np.sqrt(np.mean(before) / true_square) < 0.7
