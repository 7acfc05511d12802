"""An encoder that was zeroed elsewhere is found by friction and ripple along the angle."""

import functools
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from rigtool.experiments.force_model.deviations import Deviations
from rigtool.experiments.force_model.force_model import ForceModel
from rigtool.experiments.force_model.learning import LearnedModel
from rigtool.experiments.force_model.model import Kind, Known, Shape, Term
from rigtool.experiments.force_model.sliding_problem import SLIDING_PARAMETERS
from rigtool.experiments.force_sensor import encoder_zero as module
from rigtool.experiments.force_sensor.encoder_zero import _Search, encoder_zero
from rigtool.experiments.force_sensor.unknown_friction import ANGLE_CELLS, Passes

COUNT = 2 * math.pi / 4000
REACH, RATIO, FACTOR, STROKE = (0.0, 2.67), 0.85, 1.18, 0.36e-3
ANGLE = REACH[1] * (np.arange(ANGLE_CELLS) + 0.5) / ANGLE_CELLS
RIPPLE = {(1, 0): 0.3e-3, (1, 1): -0.2e-3, (2, 0): 0.1e-3, (2, 1): 0.8e-3}
OTHER_RIPPLE = {(1, 0): -0.1e-3, (1, 1): 0.4e-3, (2, 0): 0.7e-3, (2, 1): -0.3e-3}


def friction(angle, first=0.0, third=0.0, sixth=0.0, level=1.0):
    """Friction of the housing by angle of the motor, N m at the motor; of another housing, its
    waves have other phases."""
    output = angle / RATIO
    waves = 1.2e-3 * np.cos(output + first) - 0.3e-3 * np.sin(3 * output + third)
    return level * (2e-3 + 10e-3) + waves + 0.2e-3 * np.cos(6 * output + sixth)


def model():
    terms = [Term(Kind.BEARING, 1.0), Term(Kind.HOUSING, 1.0)]
    terms += [Term(Kind.HOUSING, 1.0, order, quarter) for order in (1, 3, 6) for quarter in (0, 1)]
    terms += [Term(Kind.RIPPLE, 1.0, *key) for key in RIPPLE]
    coefficient = np.array([2e-3, 10e-3, 1.2e-3, 0.0, 0.0, -0.3e-3, 0.2e-3, 0.0])
    coefficient = np.append(coefficient, list(RIPPLE.values()))
    size, known = len(SLIDING_PARAMETERS) + len(terms), Known(RATIO, FACTOR, 2e-5)
    shape = Shape(2e-3, 8e-3, 5e-3, 0.3, 0.03, 0.2, 8e-4, 1e-3, 2e-6, 1.8e-3)
    covariance = (0.05e-3) ** 2 * np.eye(size)
    learned = LearnedModel(tuple(terms), shape, known, coefficient, covariance, np.ones(2))
    return ForceModel(learned, Deviations(STROKE, 0.01, 0.1e-3, 0.15))


def lagged(angle, lag, waves):
    """Ripple behind a first-order lag, at a steady speed that turns by `lag` rad in its time."""
    found = [
        value * np.exp(1j * order * angle) / (1 + 1j * order * lag) * (-1j if quarter else 1)
        for (order, quarter), value in waves.items()
    ]
    return np.real(sum(found))


def passes(rng, counts, cycles=2, waves=RIPPLE, touch=None, by_friction=friction, speed=0.0):
    """Passes to and fro within the learned angles, by an encoder that shows `counts` too much."""
    true, direction = ANGLE - counts * COUNT, np.tile([1.0, -1.0], cycles)
    drawn = STROKE * rng.standard_normal((len(direction), 2))
    stroke = drawn @ np.array([np.sin(true / RATIO), np.cos(true / RATIO)])
    wrong = by_friction(true) - friction(ANGLE) + stroke
    torque = direction[:, None] * wrong
    lags = direction * speed * model().learned.shape.ripple_time
    torque += np.array([lagged(true, x, waves) - lagged(ANGLE, x, RIPPLE) for x in lags])
    torque += 0.1e-3 * rng.standard_normal(torque.shape)
    torque *= FACTOR
    if touch is not None:
        touch(torque)
    torque[:, (true < REACH[0]) | (true > REACH[1])] = np.nan
    speeds = direction[:, None] * np.full_like(torque, speed)
    return Passes(direction, torque, np.full_like(torque, 0.45e-3), speed=speeds)


def zero_of(*parts, hand=None):
    return encoder_zero(parts, model(), REACH, COUNT, hand)


@settings(max_examples=6)
@given(
    seed=st.integers(0, 2**31),
    counts=st.integers(200, 700).flatmap(lambda n: st.sampled_from([n, -n])),
    waves=st.sampled_from([RIPPLE, OTHER_RIPPLE]),
)
def test_another_zero_is_found_within_its_uncertainty(seed, counts, waves):
    own = passes(np.random.default_rng(seed), counts, cycles=4, waves=waves)
    found = zero_of(own)
    assert found is not None
    assert found.moved / COUNT == pytest.approx(counts, abs=6 * found.u / COUNT + 5)
    assert found.u < 60 * COUNT
    left = FACTOR * (friction(ANGLE - found.moved) - friction(ANGLE - counts * COUNT))
    assert np.sqrt(np.mean(left**2)) < 6 * found.spread + 0.05e-3


@settings(max_examples=4)
@given(seed=st.integers(0, 2**31), waves=st.sampled_from([RIPPLE, OTHER_RIPPLE]))
def test_the_zero_of_the_learning_is_left_alone(seed, waves):
    assert zero_of(passes(np.random.default_rng(seed), 0, waves=waves)) is None


def other_instrument(seed, other):
    """Return passes of another instrument, whose friction is found at the learned zero."""
    own = passes(
        np.random.default_rng(seed), 0, cycles=4, by_friction=functools.partial(friction, **other)
    )
    found = zero_of(own)
    assert found.moved == 0
    left = FACTOR * (friction(ANGLE, **other) - friction(ANGLE))
    assert found.spread == pytest.approx(np.sqrt(np.mean(left**2)), rel=0.15)
    return own, found


@pytest.mark.parametrize(
    "other",
    [
        {"first": 1.06, "third": 0.03, "sixth": 1.14},
        {"first": 1.09, "third": -0.7, "sixth": 0.79},
    ],
)
def test_friction_of_another_instrument_is_found_where_no_zero_explains_it(monkeypatch, other):
    own, found = other_instrument(4, other)
    with monkeypatch.context() as patch:
        patch.setattr(_Search, "shows", lambda self, untouched: False)
        assert zero_of(own) is None
    for times, expected in ((2.9, True), (3.1, False)):  # from a third of u on
        own.u[:] = times * found.spread
        assert (zero_of(own) is not None) == expected
    own.u[:] = found.spread
    monkeypatch.setattr(module, "LONG_ODDS", 1e3)
    assert zero_of(own) is None


@pytest.mark.parametrize("counts", [0, -300])
def test_ripple_lags_at_the_speed_of_a_pass(counts):
    """It differs between the directions then, as friction by angle does."""
    own = passes(np.random.default_rng(1), counts, waves=OTHER_RIPPLE, speed=20.0)
    found = [
        _Search(model(), REACH, own.direction, own.torque, speed).likelihood(counts * COUNT)[0]
        for speed in (own.speed, 0 * own.speed)
    ]
    assert found[0] > found[1] + 8


@pytest.mark.parametrize(
    "other",
    [
        {"first": -1.5, "third": -1.27, "sixth": 1.97},
        {"first": 2.87, "third": -1.84, "sixth": 2.06},
        {"first": 0.79, "third": 2.5, "sixth": 1.73, "level": 0.9},
        {"first": -2.6, "third": -1.65, "sixth": 1.89, "level": 1.06},
    ],
)
def test_friction_of_another_instrument_is_no_other_zero(monkeypatch, other):
    """Waves of other phases at the learned zero look like the learned ones at other angles, by
    which alone a zero would be found."""
    own, _ = other_instrument(7, other)
    monkeypatch.setattr(_Search, "other_friction", lambda self, untouched: (-math.inf, 0.0))
    assert zero_of(own).moved != 0


def touches(cells, torque):
    def touch(values):
        values[::4, cells] += torque

    return touch


@pytest.mark.parametrize(
    ("counts", "torque"),
    [
        *((0, t) for t in (-20e-3, 3e-3, 20e-3)),
        *((n, t) for n in (300, -300) for t in (-20e-3, 5e-3, 20e-3)),
    ],
)
def test_what_touches_is_no_other_zero(torque, counts):
    rng = np.random.default_rng(abs(counts))
    found = zero_of(passes(rng, counts, cycles=4, touch=touches(slice(None), torque)))
    assert (found is None) == (counts == 0)
    if found is not None:
        assert found.moved / COUNT == pytest.approx(counts, abs=100)


def test_a_load_that_stays_hides_the_zero():
    def pull(values):
        values[::2] += np.linspace(2e-3, 20e-3, ANGLE_CELLS)

    assert zero_of(passes(np.random.default_rng(1), 300, touch=pull)) is None


def test_few_passes_show_nothing_and_stretches_count_together():
    own = passes(np.random.default_rng(4), 400)
    parts = [Passes(own.direction[s], own.torque[s], own.u[s]) for s in (slice(2), slice(2, 4))]
    assert zero_of(parts[0]) is None
    found = zero_of(*parts)
    assert found is not None
    assert found == zero_of(own)


def test_a_hand_that_moves_the_rig_shows_no_zero():
    def push(values):
        values[::2] -= 16e-3
        values[1::2] += 16e-3

    own = passes(np.random.default_rng(2), 400, touch=push)
    assert zero_of(own, hand=8e-3) is None


@pytest.mark.parametrize(
    ("log_odds", "learned", "found"),
    [(9.0, 1.0, False), (25.0, 1.0, True), (25.0, 0.6, True), (25.0, 0.4, False)],
)
def test_another_zero_is_taken_at_long_odds_only(monkeypatch, log_odds, learned, found):
    """A good recording whose passes are likelier by 9 in the logarithm elsewhere is no surprise.
    Nor is a tissue at the end of each stroke, where all that is likelier lies beyond the learned
    angles: `learned` is what the cells within show of it."""
    place = 300 * COUNT

    class Passed:
        def __init__(self, model, reach, direction, torque, speed):
            self.part = learned if np.isnan(torque).any() else 1.0

        def odds(self, moved):
            return log_odds * math.exp(-(((moved - place) / 0.06) ** 2) / 2)

        def likelihood(self, moved):
            return 2 * self.part * self.odds(moved), np.ones(4)

        def learned_at(self, moved):
            return moved < ANGLE

        def shows(self, untouched):
            return True

        def other_friction(self, untouched):
            return -math.inf, 0.0

        def other_instrument(self, least):
            return None

        def mean(self, moved):
            return np.zeros(4)

    monkeypatch.setattr("rigtool.experiments.force_sensor.encoder_zero._Search", Passed)
    assert (zero_of(passes(np.random.default_rng(0), 0)) is not None) == found


@pytest.mark.parametrize("again", [True, False])
@pytest.mark.parametrize("anew", [True, False])
def test_what_passes_scatter_by_is_that_of_drawn_terms(again, anew):
    """By the learned covariance; of another power-up and of another instrument, the waves have
    drawn phases besides, and the latter's friction another level."""
    rng, count, moved = np.random.default_rng(5), 8000, 0.3
    own = passes(rng, 0, cycles=1, speed=20.0)
    search = _Search(model(), REACH, own.direction, own.torque, own.speed)
    hypotheses = search._other_friction if anew else search._hypotheses
    mean, root = hypotheses[0 if again else 1]
    waves = search._waves(moved)
    learned = model().learned
    drawn = learned.coefficient + 0.05e-3 * rng.standard_normal((count, 12))
    of_friction = {2: 1.2e-3, 4: 0.3e-3, 6: 0.2e-3}
    of_ripple = {8: math.hypot(0.3e-3, 0.2e-3), 10: math.hypot(0.1e-3, 0.8e-3)}
    for first, amplitude in ((of_friction if anew else {}) | ({} if again else of_ripple)).items():
        phase = 2 * math.pi * rng.random(count)
        drawn[:, first] = amplitude * np.cos(phase)
        drawn[:, first + 1] = amplitude * np.sin(phase)
    if anew:
        drawn[:, :2] *= 1 + 0.2 * rng.standard_normal((count, 2))
    angle = ANGLE - moved
    functions = [np.ones(ANGLE_CELLS), np.ones(ANGLE_CELLS)]
    functions += [way(n * angle / RATIO) for n in (1, 3, 6) for way in (np.cos, np.sin)]
    both = [
        [*(way * one for one in functions), *(lagged(angle, way * 0.6, {k: 1.0}) for k in RIPPLE)]
        for way in (1.0, -1.0)
    ]
    torques = FACTOR * drawn @ np.concatenate(both, axis=1)
    np.testing.assert_allclose(waves @ mean, torques.mean(axis=0), atol=0.1e-3 if anew else 0.05e-3)
    spread = waves @ root @ root.T @ waves.T
    size = np.max(np.var(torques, axis=0))
    np.testing.assert_allclose(spread, np.cov(torques.T), atol=0.08 * size)
