"""What a power-up may draw, and the state in which its ripple is followed, by formulas."""

import math

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.signal import butter, lfilter

from rigtool.experiments.force_filter.plant import GRASPER, HOUSING, SPEED, STATES, TORQUE
from rigtool.experiments.force_model.drawn_ripple import FOLLOWED, learned_ripple, sized_waves
from rigtool.experiments.force_model.model import ROTOR_ORDERS, Kind, Term
from rigtool.experiments.force_model.sliding_problem import SLIDING_PARAMETERS
from rigtool.experiments.force_sensor.power_up.lasting_contact import HANGING, HANGS, LASTING, LASTS
from rigtool.experiments.force_sensor.power_up.mixed_ripple import CHANGED, PARTS, SAME, mix
from rigtool.experiments.force_sensor.power_up.power_up import PowerUp
from rigtool.experiments.force_sensor.power_up.ripple_rows import (
    CONTACT,
    SPREAD_STEPS,
    late_rows,
    row_steps,
)
from tests.experiments.deploy.sensors import LEARNED, Model
from tests.experiments.force_filter.plants import PLANT, UNCERTAINTY

FIRST = len(SLIDING_PARAMETERS)
TERMS = [*LEARNED.terms, Term(Kind.SQUARE_RIPPLE, 1e-3, 2, 0), Term(Kind.COGGING, 1e-3, 3, 0)]
COEFFICIENT = np.append(LEARNED.coefficient, [5e-3, 4e-4])


def covaried(seed=2, deviation=1e-4):
    """Return the model of the tests with a covariance between its terms, which are more."""
    rng = np.random.default_rng(seed)
    size = FIRST + len(TERMS)
    root = deviation * rng.standard_normal((size, size))
    given = {"terms": TERMS, "coefficient": COEFFICIENT, "covariance": root @ root.T}
    learned = type(LEARNED)(**{**vars(LEARNED), **given})

    class Own(Model):
        pass

    Own.learned = learned
    return Own()


def test_the_learned_ripple_is_that_of_its_orders():
    own = learned_ripple(covaried(deviation=0.0))
    expected = np.zeros((len(ROTOR_ORDERS) + 1, 2))
    for term, value in zip(TERMS, COEFFICIENT, strict=True):
        if term.kind in (Kind.RIPPLE, Kind.COGGING):
            expected[term.order, term.quarter] += value
    followed = expected[own.orders]
    assert np.count_nonzero(followed) >= FOLLOWED
    assert_allclose(own.coefficient, followed.ravel())


def test_the_strongest_orders_are_followed_and_what_is_left_is_in_the_variance():
    sizes = {1: 2e-4, 2: 9e-4, 4: 1e-4, 5: 3e-4, 7: 8e-4, 9: 5e-4, 13: 7e-4, 14: 4e-4}
    terms = [Term(Kind.RIPPLE, 1e-3, order, order % 2) for order in sizes]
    given = {"terms": terms, "coefficient": np.array([*sizes.values()])}
    given["covariance"] = np.zeros((FIRST + len(terms),) * 2)

    class Own(Model):
        learned = type(LEARNED)(**{**vars(LEARNED), **given})

    own = learned_ripple(Own())
    assert own.orders.tolist() == [2, 5, 7, 9, 13, 14]
    assert_allclose(own.drawn, np.repeat([sizes[order] ** 2 / 2 for order in own.orders], 2))
    left = [sizes[order] ** 2 if order in (1, 4) else 0.0 for order in ROTOR_ORDERS]
    assert_allclose(own.unfollowed, np.column_stack([left, np.zeros((len(left), 3))]))


def test_another_power_up_has_the_amplitude_of_each_order_and_the_doubt_of_still_ones():
    model = covaried()
    own, (mean, variance) = learned_ripple(model), sized_waves(model.learned)
    terms, values = TERMS, COEFFICIENT

    def square(kinds, order, others=None):
        total = 0.0
        for quarter in (0, 1):
            one, other = (
                np.array([t.kind in k and (t.order, t.quarter) == (order, quarter) for t in terms])
                for k in (kinds, others or kinds)
            )
            total += (one @ values) * (other @ values)
        return total

    still, gain, bent = (Kind.RIPPLE, Kind.COGGING), (Kind.GAIN_RIPPLE,), (Kind.SQUARE_RIPPLE,)
    for place, order in enumerate(own.orders):
        own_waves = slice(2 * order - 2, 2 * order)
        assert_allclose(own.coefficient[2 * place : 2 * place + 2], mean[own_waves])
        expected = (mean**2 + variance)[own_waves].sum() / 2
        assert_allclose(own.drawn[2 * place : 2 * place + 2], expected)
    for order in ROTOR_ORDERS:
        # |g + h |i||^2 = g g + 2 g h |i| + h h i^2
        growing = square(gain, order), 2 * square(gain, order, bent), square(bent, order)
        left = 0.0 if order in own.orders else square(still, order)
        assert_allclose(own.unfollowed[order - 1], [left, *growing], atol=1e-18)


def test_an_order_grows_by_what_was_learned_along_it_over_what_a_power_up_draws():
    """With phases a quarter of a turn apart, it does not; an order without amplitude does not."""
    wave = 6e-4 * np.exp(0.3j)
    grows = {1: (Kind.GAIN_RIPPLE, 4e-3 * np.exp(0.3j)), 2: (Kind.GAIN_RIPPLE, 4e-3j * wave / 6e-4)}
    grows[3] = (Kind.SQUARE_RIPPLE, -7e-3 * np.exp(0.8j))
    grows[4] = (Kind.GAIN_RIPPLE, 4e-3)
    terms, values = [], []
    for order, (kind, growing) in grows.items():
        for of, value in ((Kind.RIPPLE, wave if order < 4 else 0.0), (kind, growing)):
            terms += [Term(of, 1e-3, order, quarter) for quarter in (0, 1)]
            values += [np.real(value), np.imag(value)]
    deviation = 2e-4  # of each coefficient
    covariance = np.eye(FIRST + len(terms)) * deviation**2
    given = {"terms": terms, "coefficient": np.array(values), "covariance": covariance}

    class Own(Model):
        learned = type(LEARNED)(**{**vars(LEARNED), **given})

    model = Own()
    own, (mean, _) = learned_ripple(model), sized_waves(model.learned)
    drawn = dict(zip(own.orders.tolist(), np.sqrt(2 * own.drawn[::2]), strict=True))
    growth = dict(zip(own.orders.tolist(), own.growth, strict=True))
    assert drawn[1] > np.hypot(*mean[:2])
    assert_allclose(growth[1], [4e-3 / drawn[1], 0.0], rtol=1e-6)
    assert_allclose(growth[2], 0.0, atol=1e-12)
    assert_allclose(growth[3], [0.0, -7e-3 * math.cos(0.5) / drawn[3]], rtol=1e-6)
    assert_allclose([growth[order] for order in growth if order > 3], 0.0)


@pytest.mark.parametrize("step_time", [1e-3, 4e-3])
def test_it_is_followed_from_the_learned_power_up_on(step_time):
    model = covaried()
    learned = learned_ripple(model)
    own, drawn = learned.coefficient, learned.drawn
    found = PowerUp(model, step_time, 10.0)
    p, s = found._parameters[0], found._state[0]
    plant = model.plant(step_time)
    size = UNCERTAINTY.stroke + UNCERTAINTY.friction_noise
    factor = PLANT.torque_factor
    expected = {
        "lag": 1 - math.exp(-step_time / LEARNED.shape.ripple_time),
        "factor": factor,
        "steps": row_steps(step_time),
        "time": row_steps(step_time) * step_time,
        "size": factor * size,
        "late": late_rows(step_time),
        "step_time": step_time,
        "inertia": PLANT.inertia + PLANT.grasper_inertia / (PLANT.angle_ratio * factor),
        "friction": plant.housing_friction,
        "length": plant.housing_presliding_angle,
        "slow": 3 * PLANT.presliding_angle / step_time,
        "shown": 1 - math.exp(-step_time / 12e-3),
        "load_friction": PLANT.load_friction,
        "onset": PLANT.load_friction_onset,
        "held": round(2 / step_time),
        "lag_time": LEARNED.shape.ripple_time,
        "orders": learned.orders,
        "unfollowed": learned.unfollowed,
        "growth": learned.growth,
        "square": drawn.sum(),
        "hanging": (np.array(HANGING) * factor * size) ** 2,
    }
    assert set(expected) == set(p.dtype.names)
    for name, value in expected.items():
        assert_allclose(p[name], value, err_msg=name)
    for h, (mean, variances) in enumerate([(0 * own, CHANGED**2 * drawn), (-own, drawn)]):
        assert_allclose(s["expected"][h], mean)
        assert_allclose(s["drawn"][h], variances)
        for f, hanging in ((h, np.zeros(3)), (h + 2, expected["hanging"])):
            own = [*variances, (factor * size) ** 2, *hanging]
            assert_allclose(s["mean"][f], [*mean, 0.0, 0.0, 0.0, 0.0])
            assert_allclose(s["covariance"][f], np.diag(own))
            assert_allclose(s["means"][f], [s["mean"][f]] * 2)
            assert_allclose(s["covariances"][f], [s["covariance"][f]] * 2)
    assert_allclose(s["unfollowed"], learned.unfollowed.sum(axis=0))
    assert (s["direction"], s["length"]) == (1.0, row_steps(step_time))
    assert_allclose(s["lasts"], LASTS)
    assert_allclose(s["hangs"], HANGS)
    assert s["level_variance"] == pytest.approx((CONTACT * factor * size) ** 2)
    for name in ("lasting", "lastings"):
        assert_allclose(s[name][..., 1], (LASTING * factor * size) ** 2)
        assert not s[name][..., 0].any()
    # before a row: another power-up as likely as not, the learned ripple as likely as one near it
    assert_allclose(s["weights"], [(1 - SAME) / 2, 0.5])
    assert found.probability == 0.5


def test_before_a_row_the_doubt_holds_all_that_another_power_up_may_draw():
    own = PowerUp(Model(), 1e-3, 10.0)
    s, drawn = own._state[0], learned_ripple(Model()).drawn
    assert np.all(np.diag(s["doubt"]) >= drawn)
    assert own.counted == 1


@pytest.mark.parametrize(
    ("odds", "expected", "counted"),
    [(1, 0.5, 1), (3, 0.75, 1), (2 / 3, 0.4, 0.64), (1 / 9, 0.1, 0.1), (1e-40, 0.0, 0.0)],
)
def test_its_probability_is_that_of_its_odds(odds, expected, counted):
    own = PowerUp(Model(), 1e-3, 10.0)
    own._state["other"] = math.log(odds)
    mix(own._state[0])
    assert own.probability == pytest.approx(expected, abs=1e-12)
    assert own.counted == pytest.approx(counted, abs=1e-12)


def test_it_slides_where_the_long_bristle_is_bent_in_the_direction_of_motion(monkeypatch):
    own, seen = PowerUp(Model(), 1e-3, 10.0), []
    monkeypatch.setattr(PowerUp, "_followed", lambda self, *given: seen.append(given))
    states = np.zeros((4, STATES))
    states[:, SPEED] = 2.0, -2.0, 2.0, -2.0
    states[:, HOUSING] = 0.91, -0.91, 0.89, 0.95
    states[:, TORQUE], states[:, GRASPER] = np.arange(4), 10 + np.arange(4)
    gains, drive = np.ones((4, 6)), np.ones((2, 4)).T
    own.add(np.arange(4.0), states, gains, drive, np.full(4, 7.0))
    _, angle, torque, sliding, follows, driven = seen[0]
    assert sliding.tolist() == [True, True, False, False]
    assert torque.tolist() == [0, 1, 2, 3]
    assert_allclose(follows, np.column_stack([gains, states[:, [GRASPER, SPEED, HOUSING]]]))
    assert driven.flags.c_contiguous
    assert driven.tolist() == [[1, 1, 7]] * 4
    assert angle.tolist() == [0, 1, 2, 3]


def test_each_step_gives_mean_and_variance_of_what_is_known():
    """By scipy's low-pass; a variance holds for some steps."""
    model, rng, step = covaried(), np.random.default_rng(5), 1e-3
    own = PowerUp(model, step, 10.0)
    s, count = own._state[0], 2 * FOLLOWED
    root = 1e-3 * rng.standard_normal((count, count))
    covariance = root @ root.T
    s["doubt"], s["length"] = np.tril(covariance), 100.0  # no row is full
    s["known"], s["counts"] = 1e-3 * rng.standard_normal(count), (0.3, 0.6)
    s["waves"][:-1] = before = rng.uniform(-1, 1, count)
    size, factor = 3 * SPREAD_STEPS, PLANT.torque_factor
    taken = 1e-3 * rng.standard_normal(size)
    angle = 0.4 + 0.1 * np.cumsum(rng.uniform(0, 1, size))
    states, current = np.zeros((size, STATES)), rng.uniform(-0.5, 1, size)
    states[:, SPEED], states[:, HOUSING] = 3.0, rng.choice([0.5, 0.95], size)
    states[:, TORQUE], states[:, GRASPER] = 1e-3 * rng.standard_normal(size), angle / 0.85
    drive = np.column_stack([0.045 * current, current])
    learned = learned_ripple(model)
    orders, means, held = np.repeat(learned.orders, 2), [], 0.0
    by_order = s["unfollowed"].copy()  # at rest, until a row is full
    row, lag, lagged = np.zeros(PARTS), 1 - math.exp(-step / LEARNED.shape.ripple_time), np.zeros(2)
    assert np.abs(learned.growth).max(axis=0).min() > 0
    for k in range(size):
        ripple, variance, less, unfollowed, grown = own.add(
            angle[[k]], states[[k]], 0.01 * np.ones((1, 6)), drive[[k]], taken[[k]]
        )
        fresh = np.where(np.arange(count) % 2, np.sin(orders * angle[k]), np.cos(orders * angle[k]))
        before = before + (1 - math.exp(-step / LEARNED.shape.ripple_time)) * (fresh - before)
        assert_allclose(s["waves"], np.append(before, taken[k]))
        grows = by_order[1:] @ np.abs(current[k]) ** np.arange(3)
        expected = factor**2 * (by_order[0] + (0.045 * current[k]) ** 2 * grows)
        assert_allclose(unfollowed, [expected])
        by = (0.045 * current[k]) ** 2 * grows / learned.drawn.sum()
        assert_allclose(grown, [math.sqrt(by)])
        *seen, left = factor * s["seen"]
        lagged += lag * (drive[k, 0] * np.array([1.0, abs(current[k])]) - lagged)
        grows_by = 1 + np.repeat(learned.growth @ lagged, 2)
        torque, output = states[k, [TORQUE, GRASPER]]
        row += [*(seen * grows_by), torque + left, np.cos(output), np.sin(output), 1.0]
        if (k + 1) % SPREAD_STEPS == 0:
            held = seen @ covariance @ seen
        assert_allclose(variance, held * (1 + 2 * grown) + 0.6 * unfollowed)
        assert_allclose(less, before @ s["known"])
        means.append(seen @ s["known"] - left)
        assert_allclose(ripple[0], lfilter(*butter(2, 10.0, fs=1 / step), means)[-1])
    assert_allclose(s["row"], row / 100)
    assert s["slid"] == np.count_nonzero(states[:, HOUSING] > 0.9)
    # again, from the whole recording: as ripple is, behind no filter that shows it
    again, variance, less = own.again()(angle, np.zeros(size))
    waves, kept = np.zeros(count), math.exp(-step / LEARNED.shape.ripple_time)
    for k in range(size):
        fresh = np.where(np.arange(count) % 2, np.sin(orders * angle[k]), np.cos(orders * angle[k]))
        waves = kept * waves + (1 - kept) * fresh
        assert_allclose(again[k], factor * waves @ s["known"])
        assert_allclose(less[k], again[k] / factor)
        assert_allclose(variance[k], factor**2 * waves @ covariance @ waves)


@pytest.mark.parametrize("other", [0.0, 0.7])
def test_what_is_known_is_taken_off_once_a_row_has_shown_something(other):
    own = PowerUp(covaried(), 1e-3, 10.0)
    s, states = own._state[0], np.zeros((1, STATES))
    s["held_steps"], s["other"], s["length"] = own.steps_ahead - 1, other, 100.0  # no row is full
    assert s["known"].any()
    own.add(np.ones(1), states, np.zeros((1, 6)), np.zeros((1, 2)), np.zeros(1))
    assert_allclose(s["held"], s["known"] if other else 0.0)
    assert s["held_steps"] == 0


def test_what_is_not_followed_lags_by_the_speed_of_the_last_row():
    own = PowerUp(covaried(), 1e-3, 10.0)
    s, states = own._state[0], np.zeros((1, STATES))
    s["length"], states[:, SPEED] = 1.0, -3.0
    own.add(np.ones(1), states, np.zeros((1, 6)), np.zeros((1, 2)), np.zeros(1))
    gain = np.abs(1 / (1 + 1j * np.array(ROTOR_ORDERS) * 3.0 * LEARNED.shape.ripple_time))
    assert_allclose(s["unfollowed"], gain**2 @ learned_ripple(covaried()).unfollowed)
