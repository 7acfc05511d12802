"""Scores of intervals, correlation of residuals and places within a count, written out."""

import math
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose
from scipy.stats import norm

from rigtool.experiments.force_filter.motion_states import CREEPING_KIND, KIND_COUNT, State
from rigtool.experiments.force_model import sliding_scatter
from rigtool.experiments.force_model.intervals import (
    EXPECTED,
    EXPECTED_RATIO,
    FACTORS,
    MIN_STEPS,
    SLIDING_EXPECTED,
    Errors,
    _factor,
    _score,
    _share,
    scales,
)
from rigtool.experiments.force_model.records import ROWS_HZ
from rigtool.experiments.force_model.sliding_scatter import (
    LONGEST_TIME,
    _correlation,
    _turned,
    _turning_counts,
)


@given(st.lists(st.floats(0, 5), min_size=1, max_size=20), st.floats(0.3, 4))
def test_the_score_is_that_of_gneiting_and_raftery(errors, u):
    """2 h + (2 / 0.05) max(|e| - h, 0) of 20 ms each."""
    expected = sum(2 * 1.96 * u + 40 * max(e - 1.96 * u, 0) for e in errors) * 20e-3
    assert _score(np.array(errors), np.full(len(errors), u)) == pytest.approx(expected, rel=1e-6)


def least_factor(errors, expected, count=2000):
    """Where the score of errors and of normal ones, whose mean it is, is least on a grid."""

    def score(c):
        edge = 1.96 * c / EXPECTED_RATIO
        beyond = 2 * EXPECTED_RATIO * (norm.pdf(edge) - edge * norm.sf(edge))
        return _score(errors, np.full(len(errors), c)) + expected * (3.92 * c + 40 * beyond)

    return min(np.geomspace(*FACTORS, count), key=score)


@pytest.mark.parametrize("spread", [0.3, 1.0, 3.0, 30.0])
@pytest.mark.parametrize(("count", "expected"), [(0, 2.0), (40, 50.0), (907, 2.0)])
def test_the_factor_is_that_with_the_least_score(count, expected, spread):
    errors = np.abs(np.random.default_rng(3).standard_t(3, count)) * spread
    assert _factor(errors, expected) == pytest.approx(least_factor(errors, expected), rel=2e-3)


def test_errors_of_zero_leave_the_least_factor():
    """More of them than are expected: no c, however small, has 95 % within its interval."""
    assert _factor(np.zeros(5000), 2.0) == FACTORS[0]


def mean_share(errors, loads, factor, count=1501):
    shares = np.linspace(0, 0.3, count)
    scores = [_score(errors, np.sqrt(factor**2 + (g * loads) ** 2)) for g in shares]
    weights = np.exp(min(scores) - np.array(scores))
    return np.trapezoid(weights * shares) / np.trapezoid(weights)


def test_the_share_hardly_changes_where_loads_do():
    """One of twenty strokes has a large error: no share from 0 on up to that which covers it has a
    lower score, and the least one is at either end, as a load is larger or smaller by 0.1 %."""
    errors, found = np.repeat([3.0] + 19 * [0.1], 50), []
    for ratio in (0.999, 1.0, 1.001):
        loads = np.repeat([20.0 * ratio] + 19 * [20.0], 50)
        found.append(_share(errors, loads, 0.8))
        assert found[-1] == pytest.approx(mean_share(errors, loads, 0.8), rel=5e-3)
    assert found == pytest.approx(3 * [found[1]], rel=0.02)


def test_without_loads_there_is_no_share():
    assert _share(np.ones(500), np.zeros(500), 0.8) == 0


def factors_of(errors, deviation, torque, free, expected):
    """Factor by errors without load and share by all."""
    e, load = np.abs(errors / deviation), np.abs(torque / deviation)
    c = least_factor(e[free], expected, 400)
    return c, mean_share(e, load, c, 301)


def errors_of(count, kind, seed, fitted=False, spread=1.6, loaded=True):
    rng = np.random.default_rng(seed)
    deviation = rng.uniform(0.5e-3, 1e-3, (2, count))
    torque = np.where(np.arange(count) % 2, 30e-3, 0.0) * loaded
    error = rng.standard_normal((2, count)) * np.hypot(spread * deviation, 0.03 * torque)
    kinds = np.full(count, kind, dtype=np.int32)
    return Errors(error, deviation, torque, kinds, fitted)


@pytest.mark.parametrize("shown", [True, False])
def test_each_kind_has_the_factors_of_its_own_errors(shown):
    """While the rotor slides more errors are expected, where strokes have shown how they deviate,
    and those of fitted motions do not count for c."""
    parts = [
        errors_of(600, State.WITH, 1, spread=1.2),
        errors_of(500, State.AGAINST, 2, fitted=True, spread=3.0),
        errors_of(700, State.STILL, 3, spread=2.0),
        errors_of(MIN_STEPS - 1, State.REVERSED, 4, spread=9.0),
        errors_of(400, CREEPING_KIND, 5, loaded=False),
    ]
    found = scales(parts, shown=shown)
    joined = [np.hstack([getattr(p, n) for p in parts]) for n in ("error", "deviation")]
    torque = np.concatenate([p.torque for p in parts])
    kinds = np.concatenate([p.kinds for p in parts])
    unseen = np.concatenate([np.full(len(p.kinds), not p.fitted) for p in parts])
    sliding = np.isin(kinds, (State.WITH, State.AGAINST))
    cases = [
        (State.WITH, sliding, (torque == 0) & unseen, SLIDING_EXPECTED if shown else EXPECTED),
        (State.STILL, kinds == State.STILL, torque == 0, EXPECTED),
        (State.REVERSED, kinds >= 0, torque == 0, EXPECTED),  # too few of its own
        (CREEPING_KIND, kinds >= 0, torque == 0, EXPECTED),  # none under load
    ]
    assert found.shape == (2, KIND_COUNT, 2)
    for kind, chosen, free, expected in cases:
        for form in range(2):
            own = [one[form, chosen] for one in joined]
            c, g = factors_of(*own, torque[chosen], free[chosen], expected)
            assert_allclose(found[form, kind], (c, g), rtol=0.02, atol=2e-3)
    assert_allclose(found[:, State.AGAINST], found[:, State.WITH])
    assert_allclose(found[:, State.OUTSIDE], [[1.0, 0.0]] * 2)


# -- scatter of what is learned from sliding


def recorded(used, noise):
    return SimpleNamespace(count=len(used), used=used), noise[used]


def test_the_correlation_is_that_of_all_residuals_under_parzens_window():
    rng = np.random.default_rng(5)
    parts = []
    for size, scale in ((700, 1.0), (90, 30.0)):
        noise = np.convolve(rng.standard_normal(size + 30), np.ones(31) / 31, mode="valid") * scale
        parts.append(recorded(rng.random(size) < 0.8, noise))
    found = _correlation([r for r, _ in parts], [n for _, n in parts])
    longest = round(LONGEST_TIME * ROWS_HZ)
    expected = []
    for lag in range(longest + 1):
        products, pairs = 0.0, 0
        for record, own in parts:
            signal = np.full(record.count, np.nan)
            signal[record.used] = own / math.sqrt(np.mean(own**2))
            both = [signal[k] * signal[k + lag] for k in range(record.count - lag)]
            known = [one for one in both if not math.isnan(one)]
            products, pairs = products + sum(known), pairs + len(known)
        part = lag / longest
        window = 1 - 6 * part**2 + 6 * part**3 if part < 0.5 else 2 * (1 - part) ** 3
        expected.append(window * products / max(pairs, 1))
    assert_allclose(found, np.array(expected) / expected[0], atol=1e-9)
    assert found[0] == 1
    assert found[-1] == 0


def test_only_counts_left_where_they_were_entered_are_open():
    """The angle is known at both edges of a count that the rotor passes, however slowly."""
    count = 0.1
    angle = np.array([0.55, 0.61, 0.65, 0.71, 0.79, 0.78, 0.81, 0.95, 0.88, 0.76, 0.62, 0.57, 0.52])
    found = [place.tolist() for place in _turning_counts(SimpleNamespace(angle=angle), count)]
    # counts 5 | 6 6 | 7 7 7 | 8 | 9 | 8 | 7 | 6 | 5 5, which goes on at the begin of the cycle
    assert found == [[7], [11, 12, 0]]


@pytest.mark.parametrize("start", [0, 130, 500, 999])
def test_a_stroke_is_open_at_its_two_ends_however_slow(start):
    """Five samples of the grid a count: with all of them open, a cycle had 200 such places."""
    way = 0.5 + np.concatenate([np.arange(500), np.arange(500, 0, -1)]) / 5
    angle = np.roll(way, -start)
    found = list(_turning_counts(SimpleNamespace(angle=angle), 1.0))
    assert sorted(np.floor(angle[place]).tolist()[0] for place in found) == [0, 100]
    assert all(len(set(np.floor(angle[place]))) == 1 for place in found)
    assert sum(len(place) for place in found) == np.sum(np.isin(np.floor(angle), [0, 100]))


def test_an_angle_within_a_count_is_off_by_an_even_distribution(monkeypatch):
    """The torque in the tendon after a step of the angle there, by the ratio at the motor."""
    size, count = 40, 0.1
    angle = 0.05 + np.concatenate([np.full(20, 0.0), 0.03 * np.arange(20)])
    monkeypatch.setattr(sliding_scatter, "replace", lambda one, **new: one.changed(**new))

    class Row(SimpleNamespace):
        def changed(self, **new):
            return type(self)(**{**vars(self), **new})

        def under(self, moment, load_inertia):
            assert (moment, load_inertia) == (0.06, 2e-4)
            return self.changed(carried=3.0 * self.record.angle)

    record = Row(angle=angle, interval=2e-3, moment=0.06, load_inertia=2e-4)
    own = Row(record=record, carried=3.0 * angle, known=SimpleNamespace(torque_factor=1.5))
    found = _turned(own, count)
    places = [*_turning_counts(record, count)]
    assert len(found) == len(places) > 1
    for row, place in zip(found, places, strict=True):
        expected = np.zeros(size)
        expected[place] = 3.0 * count / math.sqrt(12) / 1.5
        assert_allclose(row, expected, atol=1e-12)
