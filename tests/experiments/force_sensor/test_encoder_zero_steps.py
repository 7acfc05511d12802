"""Steps of the search for another zero, against whole matrices and the posterior written out."""

import math

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy import stats

from rigtool.experiments.force_sensor import encoder_zero as module
from rigtool.experiments.force_sensor.encoder_zero import (
    BEYOND,
    NOISE,
    ROUNDS,
    ROW_EVIDENCE,
    TOUCHED,
    TOUCHED_PROBABILITY,
    _root,
    _Search,
    encoder_zero,
)
from rigtool.experiments.force_sensor.unknown_friction import ANGLE_CELLS, FEWEST_CELLS, Passes
from tests.experiments.force_sensor.test_encoder_zero import (
    ANGLE,
    COUNT,
    FACTOR,
    RATIO,
    REACH,
    STROKE,
    model,
    passes,
)


@pytest.fixture(scope="module")
def search():
    own = passes(np.random.default_rng(3), 200)
    torque = own.torque.copy()
    torque[1, 4:9] += 8e-3
    torque[0, :2] = np.nan
    return _Search(model(), REACH, own.direction, torque, 0 * torque)


def test_noise_and_touch_are_parts_of_the_stroke_and_of_the_friction(search):
    """Friction without its waves by angle, on the output."""
    assert search._noise == pytest.approx(NOISE * FACTOR * STROKE)
    assert search._touched == pytest.approx(TOUCHED * FACTOR * 12e-3)
    cells, output = search._cell, ANGLE[search._cell] / RATIO
    for number in range(4):
        own = search._pass == number
        expected = FACTOR * STROKE * np.stack([np.cos(output[own]), np.sin(output[own])])
        columns = search._strokes[own]
        assert_allclose(columns[:, 2 * number : 2 * number + 2].T, expected)
        columns = np.delete(columns, [2 * number, 2 * number + 1], axis=1)
        assert not columns.any()
    assert len(cells) == np.isfinite(search._torque).sum()


@pytest.mark.parametrize("moved", [0.0, 0.2, -0.4])
def test_what_touches_is_found_by_expectation_and_maximisation(search, moved):
    """The value is the bound: the density of normal errors, and what is unlike the posterior."""
    mean, root = search._hypotheses[1]
    waves = search._waves(moved)
    off, columns = waves @ mean - search._subtracted, waves @ root
    value, untouched, terms = search._by_hypothesis(off, columns)
    s, w = search._noise, search._touched
    left = search._torque - off
    design = np.hstack([columns, search._strokes])

    def posterior(error, deviation):
        free = (1 - TOUCHED_PROBABILITY) * stats.norm.pdf(error, scale=deviation)
        other = TOUCHED_PROBABILITY * stats.norm.pdf(error, scale=w)
        return np.clip(free / (free + other), 1 / (1 + math.exp(30)), 1 / (1 + math.exp(-30)))

    found = posterior(left, np.sqrt(np.sum(design**2, axis=1) + s**2))
    for number in range(ROUNDS):
        weight = found / s**2 + (1 - found) / w**2
        whole = np.diag(1 / weight) + design @ design.T
        drawn = design.T @ np.linalg.solve(whole, left)  # the mean of what strokes and terms drew
        if number < ROUNDS - 1:
            found = posterior(left - design @ drawn, s)
    assert_allclose(untouched, found, atol=1e-9)
    assert 0.02 < np.mean(found < 0.5) < 0.5
    square = left @ np.linalg.solve(whole, left)
    size = np.linalg.slogdet(whole)[1] + np.sum(np.log(weight))
    expected = -(square + size) / 2
    expected += np.sum(found * np.log((1 - TOUCHED_PROBABILITY) / (s * found)))
    expected += np.sum((1 - found) * np.log(TOUCHED_PROBABILITY / (w * (1 - found))))
    assert value == pytest.approx(expected, rel=1e-8)
    assert_allclose(terms, drawn[: columns.shape[1]], atol=1e-9)


def test_the_likelier_hypothesis_counts(search):
    found = []
    for mean, root in search._hypotheses:
        waves = search._waves(0.1)
        off = waves @ mean - search._subtracted
        found.append(search._by_hypothesis(off, waves @ root)[0])
    assert found[0] != pytest.approx(found[1])
    assert search.likelihood(0.1)[0] == max(found)


def test_cells_that_were_not_learned_count_against_a_zero(search):
    seen = ANGLE[np.unique(search._cell)]
    for moved in (0.0, 0.3, -0.3, 0.9):
        there = seen - moved
        beyond = np.mean((there < ANGLE[0]) | (there > ANGLE[-1]))
        likelihood = search.likelihood(moved)[0]
        expected = ROW_EVIDENCE * likelihood - BEYOND * beyond
        assert search.odds(moved) == pytest.approx(expected, rel=1e-9)
    assert search.odds(0.6 * REACH[1]) == -math.inf
    assert search.odds(-0.6 * REACH[1]) == -math.inf


def test_the_torque_of_another_zero_is_that_of_the_friction_in_one_direction(search):
    output = (ANGLE - 0.3) / RATIO
    friction = 12e-3 + 1.2e-3 * np.cos(output) - 0.3e-3 * np.sin(3 * output)
    friction += 0.2e-3 * np.cos(6 * output)
    assert_allclose(search.mean(0.3), FACTOR * friction, rtol=1e-9)


@pytest.mark.parametrize(
    ("free", "other", "shown"),
    [(1.0, 1.0, True), (1.0, 0.46, True), (0.46, 1.0, True), (1.0, 0.44, False), (0.44, 1, False)],
)
def test_both_directions_need_passes_that_nothing_touches(free, other, shown):
    """45 % of them; cells are seen where one pass is likely free."""
    direction = np.repeat([1.0, -1.0], 10)
    own = _Search(model(), REACH, direction, *np.zeros((2, 20, ANGLE_CELLS)))
    side = own._direction > 0
    untouched = np.where(side, free, other)
    assert own.shows(untouched) == shown


@pytest.mark.parametrize(("share", "shown"), [(0.7, False), (0.9, True)])
@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_four_cells_in_five_are_seen_in_both_directions(share, shown, sign):
    direction = np.repeat([1.0, -1.0], 3)
    own = _Search(model(), REACH, direction, *np.zeros((2, 6, ANGLE_CELLS)))
    hidden = (own._cell >= share * ANGLE_CELLS) & (own._direction == sign)
    assert own.shows(np.where(hidden, 0.1, 1.0)) == shown


def test_a_root_leaves_out_what_is_known():
    rng = np.random.default_rng(2)
    basis = np.linalg.qr(rng.standard_normal((5, 5)))[0]
    deviations = np.array([3.0, 2.0, 1.01, 0.99, 0.0])
    covariance = basis @ np.diag(deviations**2) @ basis.T
    found = _root(covariance, 1.0)
    assert found.shape == (5, 3)
    kept = basis[:, :3] @ np.diag(deviations[:3] ** 2) @ basis[:, :3].T
    assert_allclose(found @ found.T, kept, atol=1e-12)


class Given:
    """A search whose odds are normal about a place, far above the learned zero's."""

    place, spread, height, taken = 0.401, 0.02, 60.0, None

    def __init__(self, own, reach, direction, torque, speed):
        type(self).taken = direction, torque

    def odds(self, moved):
        return self.height - ((moved - self.place) / self.spread) ** 2 / 2

    def likelihood(self, moved):
        return 100.0 * (moved != 0), np.ones(4)

    def learned_at(self, moved):
        return np.ones(ANGLE_CELLS, dtype=bool)

    def shows(self, untouched):
        return True

    def other_friction(self, untouched):
        return -math.inf, 0.0

    def other_instrument(self, least):
        return None

    def mean(self, moved):
        return np.full(4, 5e-3 * moved)


@pytest.fixture
def given(monkeypatch):
    class Own(Given):
        pass

    monkeypatch.setattr(module, "_Search", Own)
    return Own


def parts(cycles=4):
    return passes(np.random.default_rng(0), 0, cycles=cycles)


@pytest.mark.parametrize("place", [0.401, -0.7, 1.1])
@pytest.mark.parametrize("spread", [0.02, 0.05, 0.0636])
def test_zero_and_its_uncertainty_are_moments_of_the_posterior(given, place, spread):
    """In whole counts; the torque's spread is that of the friction's slope."""
    given.place, given.spread = place, spread
    found = encoder_zero([parts()], model(), REACH, COUNT)
    assert found.moved == pytest.approx(place, abs=0.51 * COUNT + 0.01 * spread)
    assert found.moved / COUNT == pytest.approx(round(found.moved / COUNT), abs=1e-9)
    assert found.u == pytest.approx(spread, rel=0.01)
    assert found.spread == pytest.approx(5e-3 * spread, rel=0.02)


@pytest.mark.parametrize(("part", "found"), [(0.045, True), (0.055, False)])
def test_a_zero_is_known_within_a_twentieth_of_the_range(given, part, found):
    given.place, given.spread = 1.1, part * (REACH[1] - REACH[0])
    assert (encoder_zero([parts()], model(), REACH, COUNT) is not None) == found


@pytest.mark.parametrize(("more", "found"), [(-0.7, False), (0.7, True)])
def test_another_zero_is_a_thousand_times_likelier(given, more, found):
    """Priors: 0.999 for the learned zero, the rest over 43 places; places near are four times as
    many, each a fourth as likely. A normal has sqrt(2 pi) spreads of them."""
    given.spread = 0.03
    step = (REACH[1] - REACH[0]) / 42
    places = math.sqrt(2 * math.pi) * given.spread / step
    level = math.log(0.999 / 0.001) + math.log(0.999 * 43 / (0.001 * places))

    given.odds = lambda self, moved: (
        0.0 if moved == 0 else level + more - ((moved - self.place) / self.spread) ** 2 / 2
    )
    assert (encoder_zero([parts()], model(), REACH, COUNT) is not None) == found


@pytest.mark.parametrize(("more", "zero"), [(-0.2, True), (0.2, False)])
def test_other_friction_is_a_tenth_as_likely_beforehand(given, more, zero):
    """Where it is likelier, what it differs by is not in the tables."""
    level = 100 + math.log(10) / ROW_EVIDENCE
    given.other_friction = lambda self, untouched: (level + more, 3e-3)
    found = encoder_zero([parts()], model(), REACH, COUNT)
    assert (found.moved != 0) == zero
    assert found.spread == pytest.approx(5e-3 * given.spread if zero else 3e-3, rel=0.02)


def test_what_touches_is_searched_for_from_what_is_given(search):
    """The likelier ripple counts; the bound rises from wherever it begins."""
    touched = np.full(len(search._torque), 1e-6)
    waves, found = search._waves(0.0), []
    for mean, root in search._other_friction:
        off = waves @ mean - search._subtracted
        found.append(search._by_hypothesis(off, waves @ root, touched)[0])
        assert found[-1] != search._by_hypothesis(off, waves @ root)[0]
    assert search.other_friction(touched)[0] == max(found)


@pytest.mark.parametrize("cycles", [2, 6, 20])
def test_passes_that_are_looked_at_are_spread_over_all(given, cycles):
    """Eight of each direction at most, the first and the last among them."""
    own = parts(cycles)
    own.torque[:] = np.arange(2 * cycles)[:, None]
    encoder_zero([own], model(), REACH, COUNT)
    direction, torque = given.taken
    for sign, first in ((1.0, 0), (-1.0, 1)):
        numbers = torque[direction == sign, 0]
        assert len(numbers) == min(cycles, 8)
        assert (numbers[0], numbers[-1]) == (first, 2 * (cycles - 1) + first)
        assert np.ptp(np.diff(numbers)) <= 2
    assert np.all(np.diff(torque[:, 0]) > 0)


def test_passes_of_few_cells_and_torques_of_a_hand_do_not_count(given):
    own = parts(2)
    torque = np.tile(own.direction[:, None] * 1e-3, (1, ANGLE_CELLS))
    torque[:, :5] = -9e-3 * own.direction[:, None]
    encoder_zero([Passes(own.direction, torque, own.u)], model(), REACH, COUNT, 8e-3)
    assert np.isnan(given.taken[1][:, :5]).all()
    assert np.isfinite(given.taken[1][:, 5:]).all()
    few = torque.copy()
    few[0, FEWEST_CELLS - 1 :] = np.nan
    assert encoder_zero([Passes(own.direction, few, own.u)], model(), REACH, COUNT) is None
    few[0, FEWEST_CELLS - 1] = 1e-3
    assert encoder_zero([Passes(own.direction, few, own.u)], model(), REACH, COUNT) is not None
