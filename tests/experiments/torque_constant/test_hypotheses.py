"""What a grid of hypotheses leaves open."""

from dataclasses import replace
from itertools import product
from types import SimpleNamespace

import numpy as np
import pytest

from rigtool.experiments.torque_constant import hypotheses
from rigtool.experiments.torque_constant.hypotheses import (
    LONGEST_TIME_CONSTANT,
    SHORTEST_TIME_CONSTANT,
    TAU_STEP,
    _Means,
    _ranges,
    _search,
    _untried,
)
from rigtool.experiments.torque_constant.staircase import plateaus_of_set_point
from rigtool.experiments.torque_constant.staircase_fit import fit_staircases
from rigtool.experiments.torque_constant.staircase_model import (
    HEATING_TIME,
    Common,
    arrange,
    winding,
)
from rigtool.experiments.torque_constant.swings import friction_state, straight_path
from rigtool.numerics.residual_covariance import independent_samples
from tests.experiments.torque_constant.staircases import Bench


@pytest.mark.parametrize("time_constant", [5.0, 30.0, 150.0])
def test_between_two_time_constants_a_loss_is_as_uncertain_as_their_distance(time_constant):
    """Against drawn time constants, all of which have the same loss after a staircase."""
    tau = time_constant * np.exp(TAU_STEP * np.linspace(-0.5, 0.5, 10_001))
    grown = np.expm1(-HEATING_TIME / tau) / np.expm1(-8.0 / tau)
    found = _untried(Common(None, 1.0, None, time_constant), 8.0)
    assert found == pytest.approx(np.std(np.log(grown)), rel=0.02, abs=0)
    assert _untried(Common(None, 1.0, None, time_constant), HEATING_TIME) == 0.0


def test_friction_is_tried_as_well_with_every_time_constant(monkeypatch):
    """Else a friction that fits a little less well speaks for the time constant beside it."""
    tried = []
    joined = hypotheses._joined
    monkeypatch.setattr(
        hypotheses, "_joined", lambda parts: tried.append(joined(parts)) or tried[-1]
    )
    bench = Bench()
    signals = bench.record((20, 50), angles=2)
    fit_staircases(plateaus_of_set_point(**signals, arm_length=0.54, settle_time=0.08))
    best = tried[-1].commons[int(np.argmin(tried[-1].square))]
    beside = {
        round(one.time_constant, 6)
        for one in tried[-1].commons
        if one.transition == best.transition and one.exponent == best.exponent
    }
    assert len(beside) >= 11
    assert min(beside) == pytest.approx(SHORTEST_TIME_CONSTANT)
    assert max(beside) == pytest.approx(LONGEST_TIME_CONSTANT)


class Bell:
    """Hypotheses as probable as a normal distribution over the logarithms of s, tau, exponent."""

    def __init__(self, centre, width):
        rise = np.linspace(0.0, 0.2, 11)
        self.stairs = SimpleNamespace(
            courses=SimpleNamespace(torque=rise[None], setpoint=20 * rise[None])
        )
        self.centre, self.width, self.places = centre, width, []

    def try_all(self, axes):
        place = np.array(list(product(*axes)))
        self.places.append(place)
        square = np.sum(((place - self.centre) / self.width) ** 2, axis=1)
        return list(place), square, place


@pytest.mark.parametrize("part", [0.1, 0.2])
def test_finer_grids_stand_for_their_part_of_the_coarse_one(part):
    """Mean and standard deviation of a normal distribution come back, whatever grid shows it."""
    low, high = _ranges(Bell(0, 0).stairs, None)
    bell = Bell(low + np.array([0.45, 0.5, 0.52]) * (high - low), part * (high - low))
    # plateaus rise by a tenth: their friction begins within a quarter of it
    np.testing.assert_allclose(np.exp(low), [0.02 / 4, 2.0, 0.5], rtol=1e-9)
    np.testing.assert_allclose(np.exp(high), [2.0, 300.0, 2.0], rtol=1e-9)
    tried = _search(bell, None, 3)
    weight = tried.volume * np.exp(-tried.square / 2)
    weight /= weight.sum()
    mean = weight @ tried.slope
    std = np.sqrt(weight @ (tried.slope - mean) ** 2)
    np.testing.assert_allclose(mean[0], bell.centre[0], atol=0.15 * bell.width[0])
    np.testing.assert_allclose(mean[2], bell.centre[2], atol=0.15 * bell.width[2])
    np.testing.assert_allclose(std[:2] / bell.width[:2], 1, atol=0.2)
    assert len(bell.places) == 4
    spans = np.array([np.ptp(place[:, 0]) for place in bell.places])
    assert (spans[1:] <= spans[:-1] * 0.5).all()  # each covers the best of the one before
    assert np.ptp(bell.places[-1][:, 1]) == pytest.approx(high[1] - low[1])  # all of tau again


def test_a_single_lag_is_not_searched():
    bell = Bell(np.zeros(4), 1.0)
    _search(bell, (0.01, 0.01), 1)
    assert all((place[:, 3] == np.log(0.01)).all() for place in bell.places)
    _search(bell, (0.01, 0.12), 0)
    lags = np.unique(bell.places[-1][:, 3])
    np.testing.assert_allclose(lags[[0, -1]], np.log([0.01, 0.12]))


def test_what_all_staircases_have_in_common_makes_the_loss_by_heat_uncertain():
    """A curve of the gauge is alike at all angles, so that they do not scatter by it."""
    bench = Bench(saturation=0.0)
    signals = bench.record((20, 50), angles=4)
    bent = signals | {"force": signals["force"] + 3e-4 * np.sin(40 * signals["force"])}
    straight, curved = (
        fit_staircases(plateaus_of_set_point(**each, arm_length=0.54, settle_time=0.08))
        for each in (signals, bent)
    )
    assert curved.heating_u > 3 * straight.heating_u


@pytest.fixture(scope="module")
def stairs():
    signals = Bench(saturation=0.0).record((20, 50), angles=2)
    return arrange(plateaus_of_set_point(**signals, arm_length=0.54, settle_time=0.08))


@pytest.mark.parametrize("friction", [2e-3, -2e-3, 0.06])
@pytest.mark.parametrize("loss", [1e-4, -1e-4])
def test_a_hypothesis_leaves_what_least_squares_leave_of_the_mean_staircase(stairs, friction, loss):
    """Friction opposes motion and is not most of the torque; no magnet gains by heat."""
    rng = np.random.default_rng(3)
    coefficient, s, tau, exponent = -1e-3, 0.012, 25.0, 1.5
    trend = np.array([-1.0, -1.0, 1.0, 1.0]) / 60
    heat, warmth = winding(stairs, tau)
    drift = warmth - warmth.mean(axis=1, keepdims=True)
    current = stairs.current * (1 + coefficient * drift)
    a, b = (each[0] for each in friction_state(straight_path(stairs.courses), s, exponent))
    torque = 0.05 * current * (1 - loss * heat) - friction * a + 0.01
    torque = torque * np.array([1.0, 1.0, 0.97, 0.97])[:, None]
    torque = torque + 1e-5 * rng.standard_normal(torque.shape)
    means = _Means(replace(stairs, torque=torque), coefficient, trend)
    count = torque.shape[1]
    assert means.dof == count - 7
    (common,), (square,), (slope,) = means.try_all([np.log([s]), np.log([tau]), np.log([exponent])])
    mean = current.mean(axis=0)
    columns = [mean, np.ones(count), stairs.last_step[0]]
    if loss > 0:
        columns.append((current * heat).mean(axis=0))
    if friction > 0:
        columns += [-a, -b]
    both = np.column_stack([torque.mean(axis=0), trend @ torque])

    def fitted(columns):
        design = np.column_stack(columns)
        found = np.linalg.lstsq(design, both, rcond=None)[0]
        return found, np.sum((both - design @ found)[:, 0] ** 2)

    _, left = fitted([*columns, mean * np.abs(mean)])
    without_curve, _ = fitted(columns)
    if friction > 0.25 * np.ptp(torque.mean(axis=0)):
        assert square == np.inf
        return
    assert square == pytest.approx(left, rel=1e-6)
    np.testing.assert_allclose(slope[:2], without_curve[0], rtol=1e-6)
    assert common.transition == (pytest.approx(s) if friction > 0 else None)
    assert (common.exponent, common.time_constant) == pytest.approx((exponent, tau))
    lost = -without_curve[3, 0] / without_curve[0, 0] * common.warming() if loss > 0 else 0.0
    assert slope[2] == pytest.approx(lost, rel=1e-6)
    if friction > 0 and loss > 0:
        rest = means.residual(common)
        assert rest @ rest == pytest.approx(left, rel=1e-6)
        used = np.ones(count, dtype=bool)
        assert means.independent(common) == independent_samples(rest, used, 1) - 7
