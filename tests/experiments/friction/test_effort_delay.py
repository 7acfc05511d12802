"""A delay between effort and motion: found where it is, and in the uncertainty where it is not."""

import numpy as np
import pytest
from scipy.integrate import quad
from scipy.stats import norm

from rigtool.experiments.friction.effort_delay import (
    SECOND_ORDER_RATIO,
    _last,
    _likely,
    on_time,
)
from rigtool.experiments.friction.motion_terms import (
    DELAY,
    DYNAMICS_PARAMETERS,
    SmoothedMotion,
    weighted,
)

SPACING, COUNT, EVERY = 2e-3, 6000, 4
TRUE = np.array([2e-5, 1e-4, 3e-3, 0.5e-3])  # inertia, viscous, Coulomb, offset
CHOSEN = [0, 1, 2, 3]


def regressors(time):
    """Return acceleration, speed, its softened sign, one, and the sign's magnitude."""
    speed = 20 * np.cos(7 * time) + 9 * np.cos(17 * time + 1)
    acceleration = -140 * np.sin(7 * time) - 153 * np.sin(17 * time + 1)
    way = np.tanh(speed / 3)
    return np.column_stack([acceleration, speed, way, np.ones(time.size), np.abs(way)])


def motion(late=0.0, noise=2e-5, seed=1):
    """Return a recording whose effort is `late`, s."""
    time = SPACING * np.arange(COUNT)
    random = np.random.default_rng(seed)
    torque = regressors(time - late)[:, :4] @ TRUE + noise * random.standard_normal(COUNT)
    design = regressors(time)
    used = np.abs(design[:, 1]) > 2
    sliding = np.stack([used, np.abs(design[:, 1]) > 1])
    position = np.cumsum(design[:, 1]) * SPACING
    return SmoothedMotion(
        design, torque, position, used, sliding, SPACING, (0.0, 0.0), 50.0, COUNT, EVERY, False
    )


@pytest.mark.parametrize("late", [-3e-3, 2e-3, 8e-3])
def test_a_delay_is_found_and_taken_off_the_effort(late):
    found, delay, _ = on_time([motion(late), motion(late, seed=2)], CHOSEN)
    assert delay == pytest.approx(late, rel=0.02)
    for own in found:
        assert own.design.shape == (COUNT, DELAY + 1)
        inside = own.used & (np.arange(COUNT) > 10) & (np.arange(COUNT) < COUNT - 10)
        best = np.linalg.lstsq(own.design[inside][:, CHOSEN], own.torque[inside], rcond=None)[0]
        np.testing.assert_allclose(best, TRUE, rtol=0.02)
        # what is left of the delay is the slope of the model, the other way
        model = own.design[:, :4] @ TRUE
        left = own.design[inside, DELAY] + np.gradient(model, SPACING)[inside]
        assert np.sqrt(np.mean(left**2)) < 0.03 * np.std(np.gradient(model, SPACING))


def test_without_a_delay_what_one_would_change_is_in_the_uncertainty():
    """Before the data it is anywhere in a sample; the data know it better."""
    given = [motion(seed=n) for n in (3, 4)]
    found, delay, unstated = on_time(given, CHOSEN)
    assert delay == 0.0
    assert found is given
    assert unstated.shape == (DELAY,)
    assert unstated[4] == 0.0  # not asked for
    design = np.concatenate([own.design[:, CHOSEN] * own.used[:, None] for own in given])
    slope = np.concatenate(
        [np.gradient(own.design[:, :4] @ TRUE, SPACING) * own.used for own in given]
    )
    change = np.linalg.lstsq(design, -slope, rcond=None)[0]
    sample = SPACING / EVERY / np.sqrt(12)
    ratio = np.abs(unstated[:4] / change)
    np.testing.assert_allclose(ratio, ratio[0], rtol=0.05)  # one delay makes all of it
    assert 0 < ratio[0] <= sample * (1 + 1e-6)


@pytest.mark.parametrize(("value", "square"), [(0.3, 1.0), (2.0, 1.0), (-1.0, 4.0), (0.0, 0.01)])
def test_what_is_likely_is_the_root_mean_square_behind_the_data(value, square):
    before = 0.5

    def density(x):
        return norm.pdf(x, 0, np.sqrt(before)) * norm.pdf(value, x, np.sqrt(square))

    whole, second = (quad(lambda x, k=k: x**k * density(x), -20, 20, points=[0])[0] for k in (0, 2))
    assert _likely(value, square, before) == pytest.approx(np.sqrt(second / whole), rel=1e-6)


def test_a_significant_delay_is_that_of_the_measurement():
    """Beyond three standard uncertainties the prior lowers it no more."""
    for value, lowered in ((3.1, False), (2.9, True)):
        known = 1 / (1 + 1.0 / 0.5)
        expected = np.hypot(known * value if lowered else value, np.sqrt((1 - known) * 0.5))
        assert _likely(value, 1.0, 0.5) == pytest.approx(expected)
    assert _likely(0.0, np.inf, 0.5) == pytest.approx(np.sqrt(0.5))


def test_the_last_coefficient_has_the_variance_of_least_squares():
    own = motion()
    random = np.random.default_rng(7)
    columns = own.design[:, CHOSEN] * own.used[:, None]
    variances, values = [], []
    for _ in range(40):
        torque = columns @ TRUE + 1e-4 * own.used * random.standard_normal(COUNT)
        value, square = _last([own], columns[:, [3, 0, 1, 2]], torque)
        values.append(value)
        variances.append(square)
    expected = 1e-8 * np.linalg.inv(columns.T @ columns)[2, 2]
    assert np.mean(variances) == pytest.approx(expected, rel=0.2)
    assert np.var(values, ddof=1) == pytest.approx(expected, rel=0.6)
    # explained by the others, it is not known at all
    twice = np.column_stack([columns, columns[:, 0] + columns[:, 2]])
    assert _last([own], twice, torque) == (0.0, np.inf)
    assert DYNAMICS_PARAMETERS[2] == "coulomb"


def test_a_delay_that_may_be_a_filter_changes_by_its_second_order():
    """d^2/2 of the model's second derivative, with Coulomb friction or without, as a regressor."""
    here, delay, unstated = on_time([motion(8e-3), motion(8e-3, seed=2)], CHOSEN)
    design, torque, weight = weighted(here)
    columns = design[:, [*CHOSEN, DELAY]]
    solution = np.linalg.lstsq(columns, torque, rcond=None)[0][:4]
    changes = []
    for kept in ([1, 1, 1, 1], [1, 1, 0, 1]):
        models = [own.design[:, :4] @ (solution * kept) for own in here]
        bent = [np.gradient(np.gradient(model, SPACING), SPACING) for model in models]
        beyond = delay**2 / 2 * np.concatenate(bent) * weight
        part, square = _last(here, np.column_stack([columns, beyond]), torque)
        alike = np.linalg.lstsq(columns, beyond, rcond=None)[0][:4]
        changes.append(np.abs(alike) * _likely(part, square, 1 / 3) * SECOND_ORDER_RATIO)
    np.testing.assert_allclose(unstated[:4], np.max(changes, axis=0), rtol=1e-9)
    assert (changes[1] > changes[0]).any()
    assert (changes[0] > changes[1]).any()
