"""The standard uncertainty is that whose intervals have the least score under known loads."""

from dataclasses import replace

import numpy as np
import pytest

from rigtool.experiments.force_filter.motion_states import CREEPING_KIND, KIND_COUNT, State
from rigtool.experiments.force_model.intervals import Errors, scales, uncertainty_of_kinds

MINUTES = 15_000
"""Compared steps of five minutes."""

NO_RIPPLE, QUIET = np.zeros(1), np.zeros(1, dtype=bool)


def drawn(factor, share, kind, count=MINUTES, seed=3, tails=False):
    """Return errors, half of them without load; with heavy `tails` 95 % hold, too."""
    rng = np.random.default_rng(seed)
    deviation = rng.uniform(0.3e-3, 1e-3, (2, count))
    torque = rng.uniform(-60e-3, 60e-3, count) * (np.arange(count) % 2)
    unit = (
        rng.standard_t(3, (2, count)) * 1.96 / 3.182 if tails else rng.standard_normal((2, count))
    )
    error = unit * np.hypot(factor * deviation, share * torque)
    return Errors(error, deviation, torque, np.full(count, kind, dtype=np.int32))


@pytest.mark.parametrize(
    ("factor", "share", "kind"),
    [
        (2.5, 0.0, State.REVERSED),
        (1.3, 0.0, State.STILL),
        (0.9, 0.0, CREEPING_KIND),
        (1.0, 0.05, CREEPING_KIND),
    ],
)
def test_factor_and_share_are_those_of_the_errors(factor, share, kind):
    own = drawn(factor, share, kind)
    every = scales([own])
    found = every[:, kind]
    np.testing.assert_allclose(found[:, 0], factor, rtol=0.05)
    np.testing.assert_allclose(found[:, 1], share, atol=8e-3)
    u = uncertainty_of_kinds(every[1], own.deviation[1], own.torque, own.kinds, NO_RIPPLE, QUIET)
    assert 0.945 < np.mean(np.abs(own.error[1]) < 1.96 * u) < 0.955


@pytest.mark.parametrize("kind", [State.REVERSED, State.STILL])
@pytest.mark.parametrize("share", [0.0, 0.05])
@pytest.mark.parametrize(("factor", "found"), [(0.5, 0.5), (0.1, 0.4)])
def test_errors_without_a_load_give_a_factor_of_their_own(factor, found, share, kind):
    own = scales([drawn(factor, share, kind)])[:, kind]
    np.testing.assert_allclose(own[:, 0], found, rtol=0.03)
    np.testing.assert_allclose(own[:, 1], share, atol=8e-3)


@pytest.mark.parametrize("factor", [0.5, 0.9])
def test_known_loads_that_hardly_change_do_not_narrow_a_torque_that_shows(factor):
    """Which intervals hold zero does not depend on that."""
    factors, torque = np.ones((KIND_COUNT, 2)) * (factor, 0.0), np.linspace(-4e-3, 4e-3, 7778)
    kinds, deviation = np.full(7778, State.STILL), np.full(7778, 1e-3)
    u = uncertainty_of_kinds(factors, deviation, torque, kinds, NO_RIPPLE, QUIET)
    least = max(factor, 0.8) * 1e-3
    shows = np.abs(torque) > 1.96 * least
    np.testing.assert_allclose(u[shows], least, rtol=1e-12)
    np.testing.assert_allclose(u[np.abs(torque) < 1.96e-3 * factor], factor * 1e-3, rtol=1e-12)
    np.testing.assert_array_equal(np.abs(torque) > 1.96 * u * (1 + 1e-9), shows)
    assert np.abs(np.diff(u)).max() < 1e-6  # no step, N m, from one torque to the next


def test_kinds_have_their_own_errors_and_sliding_has_one_for_both_directions():
    parts = [
        drawn(0.8, 0.0, State.AGAINST),
        drawn(0.8, 0.0, State.WITH),
        drawn(2.0, 0, CREEPING_KIND),
    ]
    found = scales(parts)
    np.testing.assert_array_equal(found[:, State.AGAINST], found[:, State.WITH])
    np.testing.assert_allclose(found[:, State.WITH, 0], 0.8, rtol=0.04)
    np.testing.assert_allclose(found[:, CREEPING_KIND, 0], 2.0, rtol=0.04)


def test_heavy_tails_do_not_widen_the_intervals():
    own = drawn(1.5, 0.0, State.REVERSED, tails=True)
    np.testing.assert_allclose(scales([own])[:, State.REVERSED, 0], 1.5, rtol=0.05)
    u = uncertainty_of_kinds(
        scales([own])[0], own.deviation[0], own.torque, own.kinds, NO_RIPPLE, QUIET
    )
    assert 0.945 < np.mean(np.abs(own.error[0]) < 1.96 * u) < 0.955


def test_ripple_of_another_power_up_widens_u_as_it_is():
    """Known loads have no error from it, so that their factor, here of rest, does not scale it."""
    factors = np.ones((KIND_COUNT, 2)) * (1.0, 0.0)
    factors[State.STILL] = 0.9, 0.1
    kinds = np.array([State.STILL, State.AGAINST])
    u = uncertainty_of_kinds(
        factors, np.array([1e-3, 1e-3]), np.full(2, 5e-3), kinds, np.full(2, 0.36e-6), QUIET
    )
    np.testing.assert_allclose(u, np.sqrt([0.81e-6 + 0.25e-6 + 0.36e-6, 1.36e-6]), rtol=1e-12)


def test_what_friction_leaves_open_is_not_in_the_deviation_twice():
    factors = np.ones((KIND_COUNT, 2)) * (0.9, 0.1)
    kinds, least = np.array([State.REVERSED, State.REVERSED]), np.array([0.01e-6, 9e-6])
    u = uncertainty_of_kinds(
        factors, np.array([1e-3, 1e-3]), np.full(2, 5e-3), kinds, np.full(2, 0.36e-6), QUIET, least
    )
    np.testing.assert_allclose(u, np.sqrt([1.42e-6, 9.61e-6]), rtol=1e-12)


@pytest.mark.parametrize(("factor", "held"), [(0.8, 1.0), (1.3, 1.3)])
def test_where_a_load_has_raised_the_noise_the_deviation_counts_whole(factor, held):
    factors, kinds = np.ones((KIND_COUNT, 2)) * (factor, 0.0), np.full(2, State.REVERSED)
    known = np.full(2, 1e-3), np.zeros(2), kinds, NO_RIPPLE
    u = uncertainty_of_kinds(factors, *known, np.array([False, True]))
    np.testing.assert_allclose(u, [factor * 1e-3, held * 1e-3], rtol=1e-12)


def test_few_strokes_hardly_change_what_slides():
    few = drawn(2.0, 0.0, State.AGAINST, count=150)
    assert np.all(scales([few])[:, State.AGAINST, 0] < 1.2)


def test_errors_that_true_equations_make_are_smaller_than_the_deviation():
    few = drawn(0.87, 0.0, State.AGAINST, count=150)
    np.testing.assert_allclose(scales([few])[:, State.AGAINST, 0], 0.87, rtol=0.03)


def test_strokes_that_friction_was_fitted_to_do_not_show_how_far_it_is_off():
    """Their errors count after reversals, which are not fitted to them, and under load."""
    fitted = replace(drawn(0.8, 0.0, State.WITH), fitted=True)
    found = scales([drawn(1.2, 0.0, State.WITH, count=3 * MINUTES), fitted])
    np.testing.assert_allclose(found[:, State.WITH, 0], 1.2, rtol=0.04)
    few = scales([drawn(1.2, 0.0, State.WITH, count=150), fitted])
    np.testing.assert_allclose(few[:, State.WITH, 0], 0.8, rtol=0.08)
    # nor do those under load, or of another kind, where few errors without load are of others
    fitted = replace(drawn(0.9, 0.2, State.WITH), fitted=True)
    rest = drawn(2.0, 0.0, State.STILL)
    few = scales([drawn(1.2, 0.0, State.WITH, count=150), fitted, rest])
    np.testing.assert_allclose(few[:, State.WITH, 0], 0.9, rtol=0.08)
    turns = [drawn(1.2, 0.0, State.REVERSED), replace(drawn(1.2, 0, State.REVERSED), fitted=True)]
    np.testing.assert_array_equal(
        scales(turns)[:, State.REVERSED],
        scales([turns[0], turns[0]])[:, State.REVERSED],
    )


def test_a_kind_that_nothing_shows_has_the_factor_of_all():
    found = scales([drawn(2.0, 0.0, State.REVERSED)])
    assert found.shape == (2, KIND_COUNT, 2)
    np.testing.assert_array_equal(found[:, State.STILL], found[:, State.REVERSED])
