"""What a grid of hypotheses leaves open."""

from itertools import product
from types import SimpleNamespace

import numpy as np
import pytest

from rigtool.experiments.torque_constant.staircases import hypotheses
from rigtool.experiments.torque_constant.staircases.fit import fit_staircases
from rigtool.experiments.torque_constant.staircases.hypotheses import (
    Weighed,
    _likely,
    _ranges,
    _search,
    weigh_hypotheses,
    weighed,
)
from rigtool.experiments.torque_constant.staircases.mean_staircases import ASYMMETRY
from rigtool.experiments.torque_constant.staircases.model import arrange
from rigtool.experiments.torque_constant.staircases.winding_time import (
    LONGEST_TIME_CONSTANT,
    SHORTEST_TIME_CONSTANT,
    WindingTime,
)
from tests.experiments.torque_constant.bench import Bench, plateaus_in


def test_friction_is_tried_as_well_with_every_time_constant(monkeypatch):
    """Else a friction that fits a little less well speaks for the time constant beside it."""
    tried = []
    joined = hypotheses._joined
    monkeypatch.setattr(
        hypotheses, "_joined", lambda parts: tried.append(joined(parts)) or tried[-1]
    )
    bench = Bench()
    signals = bench.record((20, 50), angles=2)
    fit_staircases(plateaus_in(signals))
    place = tried[-1].place
    best = place[int(np.argmin(tried[-1].square.min(axis=1)))]
    beside = {
        round(float(np.exp(one[1])), 6) for one in place if (one[[0, 2]] == best[[0, 2]]).all()
    }
    assert len(beside) >= 11
    assert min(beside) == pytest.approx(SHORTEST_TIME_CONSTANT)
    assert max(beside) == pytest.approx(LONGEST_TIME_CONSTANT)


class Bell:
    """Hypotheses as probable as a normal distribution over the logarithms of s/e, tau, exponent."""

    asymmetry = 0.0

    alike = False
    """Whether a loss by heat leaves as much as none."""

    def __init__(self, centre, width):
        rise = np.linspace(0.0, 0.2, 11)
        self.stairs = SimpleNamespace(
            courses=SimpleNamespace(torque=rise[None], setpoint=20 * rise[None])
        )
        self.centre, self.width, self.places = centre, width, []
        span = np.log([SHORTEST_TIME_CONSTANT, LONGEST_TIME_CONSTANT])
        self.winding = WindingTime(span, np.ones(2))

    def try_all(self, axes):
        place = np.array(list(product(*axes)))
        self.places.append(place)
        square = np.sum(((place - self.centre) / self.width) ** 2, axis=1)
        both = np.stack([square, square + (0.0 if self.alike else 1.0)], axis=1)
        slope = np.repeat(place[:, None], 2, axis=1)
        unknown = np.full((len(square), 3), np.nan)
        return np.full(both.shape, False), both, slope, np.zeros(slope.shape), unknown


@pytest.mark.parametrize("part", [0.1, 0.2])
def test_finer_grids_stand_for_their_part_of_the_coarse_one(part):
    """Mean and standard deviation of a normal distribution come back, whatever grid shows it."""
    low, high = _ranges(Bell(0, 0), None)
    bell = Bell(low + np.array([0.45, 0.5, 0.52]) * (high - low), part * (high - low))
    # plateaus rise by a tenth: their friction begins within a quarter of it
    np.testing.assert_allclose(np.exp(low), [0.02 / 4, 2.0, 0.5], rtol=1e-9)
    np.testing.assert_allclose(np.exp(high), [2.0, 300.0, 2.0], rtol=1e-9)
    tried = _search(bell, None, 3)
    weight = tried.volume * np.exp(-tried.square[:, 0] / 2)
    weight /= weight.sum()
    mean = weight @ tried.slope[:, 0]
    std = np.sqrt(weight @ (tried.slope[:, 0] - mean) ** 2)
    np.testing.assert_allclose(mean[0], bell.centre[0], atol=0.15 * bell.width[0])
    np.testing.assert_allclose(mean[2], bell.centre[2], atol=0.15 * bell.width[2])
    np.testing.assert_allclose(std[:2] / bell.width[:2], 1, atol=0.2)
    assert len(bell.places) == 4
    spans = np.array([np.ptp(place[:, 0]) for place in bell.places])
    assert (spans[1:] <= spans[:-1] * 0.5).all()  # each covers the best of the one before
    assert np.ptp(bell.places[-1][:, 1]) == pytest.approx(high[1] - low[1])  # all of tau again


@pytest.mark.parametrize(("near", "grids"), [(0.0, [13, 9, 9]), (-2.0, [12, 32, 9, 9])])
def test_friction_that_was_improbable_is_not_tried_again(near, grids):
    """All of it is, where the best is at an edge of what was probable."""
    bell = Bell(np.array([-2.0, 3.0, 0.0]), 0.5)
    every = _search(bell, None, 2)
    bell.places.clear()
    some = _search(bell, None, 2, (near - 2.5, near - 1.5))
    assert [len(np.unique(place[:, 0])) for place in bell.places] == grids
    assert vars(some.best(30.0)) == vars(every.best(30.0))
    means = [
        one.volume
        @ (one.place * np.exp(-one.square[:, :1] / 2))[:, :3]
        / (one.volume @ np.exp(-one.square[:, 0] / 2))
        for one in (some, every)
    ]
    np.testing.assert_allclose(*means, atol=2e-3)


@pytest.mark.parametrize("rise", [0.1, 0.2, 0.33, 0.7, 1.3])
@pytest.mark.parametrize("end", [0, 1])
def test_friction_at_an_end_of_all_is_searched_once(rise, end):
    """Whatever rounding makes of that end."""
    bell = Bell(np.zeros(3), 1.0)
    bell.stairs.courses.torque = bell.stairs.courses.torque * rise
    bell.centre = np.array(_ranges(bell, None)[end])
    _search(bell, None, 1)
    assert [len(np.unique(place[:, 0])) for place in bell.places] == [32, 9]


def test_what_is_likely_depends_on_how_much_the_staircases_show():
    bell = Bell(np.array([-2.0, 3.0, 0.0]), 0.5)
    tried = _search(bell, None, 2)
    spans = []
    for count in (10.0, 40.0):
        bell.independent = lambda common, count=count: count
        low, high = _likely(bell, tried)
        assert low < -2 < high
        square = tried.square.min(axis=1)
        likely = tried.place[(square.min() / square) ** (count / 2) > 1e-9, 0]
        assert (low, high) == (likely.min(), likely.max())
        spans.append(high - low)
    assert spans[0] > 1.2 * spans[1] > 0


def test_a_single_lag_is_not_searched():
    bell = Bell(np.zeros(4), 1.0)
    _search(bell, (0.01, 0.01), 1)
    assert all((place[:, 3] == np.log(0.01)).all() for place in bell.places)
    _search(bell, (0.01, 0.12), 0)
    lags = np.unique(bell.places[-1][:, 3])
    np.testing.assert_allclose(lags[[0, -1]], np.log([0.01, 0.12]))


def test_the_thermometer_weighs_time_constants():
    """The mean of two normal distributions, one of the staircases and one of the thermometer."""
    bell = Bell(np.array([-2.0, 3.0, 0.0]), 0.5)
    tau = np.linspace(2.5, 4.5, 81)
    bell.winding = WindingTime(tau, np.exp(-(((tau - 3.6) / 0.2) ** 2) / 2))
    tried = _search(bell, None, 3)
    shown = tried.place[tried.volume > 0, 1]
    assert shown.min() > 2.8  # what the thermometer excludes is not tried
    assert shown.max() < 4.4
    weight = tried.volume * tried.warms * np.exp(-tried.square[:, 0] / 2)
    expected = (3.0 / 0.5**2 + 3.6 / 0.2**2) / (1 / 0.5**2 + 1 / 0.2**2)
    assert weight @ tried.place[:, 1] / weight.sum() == pytest.approx(expected, abs=0.02)
    chosen = np.log([tried.best(number).time_constant for number in (1e-6, 1e6)])
    least = tried.place[np.argmin(tried.square[:, 0]), 1]
    assert chosen == pytest.approx([3.6, least], abs=0.1)


def test_the_spread_is_that_of_constants_drawn_from_all_hypotheses(monkeypatch):
    """Each as often as it is probable, with the variance that it leaves."""
    random = np.random.default_rng(1)
    slope = np.array([4.0, 0.5, 0.3]) * random.standard_normal((40, 3)) + 50.0
    square, variance = random.uniform(1.0, 1.1, 40), random.uniform(1.0, 4.0, (40, 3))
    unknown = np.full((40, 3), np.nan)
    own = square, 30.0, slope, variance
    tau = np.tile([5.0, 20.0], 20)
    found = Weighed(None, np.log(tau), random.uniform(size=40), *own, unknown[:, 0], unknown)
    means = SimpleNamespace(dof=1, arm=None, winding=None, stairs=None)
    means.move_arm = lambda best: None
    monkeypatch.setattr(hypotheses, "friction_of_each", lambda means, best: None)
    monkeypatch.setattr(hypotheses, "MeanStaircases", lambda *given: means)
    monkeypatch.setattr(hypotheses, "ways_of", lambda stairs: [])
    monkeypatch.setattr(hypotheses, "_joined", lambda tried: SimpleNamespace(best=lambda n: None))
    monkeypatch.setattr(hypotheses, "_find_arm", lambda *given: [])
    monkeypatch.setattr(hypotheses, "weighed", lambda *given: found)
    monkeypatch.setattr(hypotheses, "with_torque", lambda *given: (None, 0.0))
    shown = weigh_hypotheses(SimpleNamespace(), 0.0, np.zeros(1))
    one = random.choice(40, 400_000, p=found.probable())
    drawn = slope[one] + np.sqrt(variance[one]) * random.standard_normal((one.size, 3))
    spread = drawn.std(axis=0)
    assert shown.constant == pytest.approx(drawn[:, 0].mean(), abs=0.02)
    stated = [shown.spread, shown.drift, shown.steady_drift]
    assert stated == pytest.approx(spread, rel=0.01)
    values, probable = shown.time_constants()
    np.testing.assert_allclose(values, [5.0, 20.0])
    np.testing.assert_allclose(probable @ values, tau @ found.probable())


@pytest.mark.parametrize("kinds", [1, 3])
def test_a_loss_by_heat_that_no_staircase_shows_is_improbable(kinds):
    """Against the integral of a likelihood of n residuals over half a normal distribution."""
    bell, independent = Bell(np.zeros(3), 10.0), 35.0
    bell.independent, bell.kinds = lambda common: kinds * independent, kinds
    bell.alike = True
    found = weighed(bell, [None])
    shown = found.probable().reshape(-1, 2).sum(axis=0)
    loss = np.linspace(0.0, 60.0, 200_001)  # in standard deviations of what one residual leaves
    prior = np.sqrt(2 / np.pi) * np.exp(-(loss**2) / 2)
    likelihood = np.exp(-independent * loss**2 / 2)
    ratio = np.trapezoid(prior * likelihood, loss) / 0.5
    # half of the likelihood is possible, which Q has
    assert shown[1] / shown[0] == pytest.approx(ratio**kinds, rel=1e-3)


class Leaning(Bell):
    """Hypotheses whose constant is the asymmetry, which has a likelihood of its own."""

    def try_all(self, axes):
        free, square, slope, variance, loss = super().try_all(axes)
        off = (self.asymmetry - self.likely) / self.width_of_asymmetry
        square = np.ones(square.shape) * np.exp(off**2 / self.count)
        return free, square, np.full(slope.shape, self.asymmetry), variance, loss

    kinds = 1

    def independent(self, common):
        return self.count


@pytest.mark.parametrize("doubt", [0.04, 0.055])
def test_the_constant_is_the_mean_over_friction_s_asymmetry(doubt):
    """Of a normal likelihood and the normal distribution beforehand."""
    bell = Leaning(np.zeros(3), 10.0)
    bell.likely, bell.width_of_asymmetry, bell.count = 0.06, 0.05, 30.0
    bell.asymmetry = 0.04
    found = weighed(bell, [None], doubt)
    assert bell.asymmetry == 0.04
    known = 1 / (1 + (0.05 / ASYMMETRY) ** 2)
    probable = found.probable()
    mean = probable @ found.slope[:, 0]
    assert mean == pytest.approx(0.06 * known, abs=0.006)
    std = np.sqrt(probable @ (found.slope[:, 0] - mean) ** 2)
    assert std == pytest.approx(0.05 * known**0.5, rel=0.15)
    alone = weighed(bell, [None])
    np.testing.assert_array_equal(alone.slope[:, 0], 0.04)


def test_friction_s_law_is_found_along_what_staircases_show_of_it():
    """They show f/s and e/s of friction, and little else: a grid in s and e misses most of what is
    likely, and what it hits stands for all of the rest."""
    bench = Bench(presliding_angle=3e-3, friction=4e-3, force_noise=1e-4, ripple=(), saturation=0.0)
    signals = bench.record((20, 50), angles=2)
    stairs = arrange(plateaus_in(signals))
    found = weigh_hypotheses(stairs, bench.coefficient, np.zeros(4))
    constant = bench.torque_constant * (1 + 15 * bench.coefficient)
    assert found.constant == pytest.approx(constant, rel=2.5e-4, abs=0)
    assert found.spread < 2e-4 * constant


def test_what_all_staircases_have_in_common_makes_the_loss_by_heat_uncertain():
    """A curve of the gauge is alike at all angles, so that they do not scatter by it."""
    bench = Bench(saturation=0.0)
    signals = bench.record((20, 50), angles=4)
    bent = signals | {"force": signals["force"] + 3e-4 * np.sin(40 * signals["force"])}
    straight, curved = (fit_staircases(plateaus_in(each)) for each in (signals, bent))
    assert curved.heating_u > 3 * straight.heating_u
