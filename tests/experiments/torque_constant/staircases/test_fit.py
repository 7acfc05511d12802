"""Least squares of all staircases beside one design written out; scatter, heat and lack of fit."""

import math
from types import SimpleNamespace

import numpy as np
import pytest
from scipy import linalg

from rigtool.experiments.torque_constant.staircases.fit import (
    _about,
    _bend,
    _lack_of_fit,
    _scatter,
    _solve,
)
from rigtool.experiments.torque_constant.staircases.least_squares import LeastSquares
from rigtool.numerics.residual_covariance import independent_samples, long_run_covariance

M, P = 4, 12
CURRENT = np.tile(np.r_[0:7, 5:0:-1] / 2.0, (M, 1)) * np.linspace(0.9, 1.1, M)[:, None]
ONES = np.ones((M, P))
QUARTERS = np.arange(4) * math.pi / 2


def shared(random):
    return [random.standard_normal((M, P)), random.standard_normal((M, P))]


def written_out(own, common):
    """Return the design of all torques in a row: each staircase's columns, then shared ones."""
    blocks = [np.column_stack([column[row] for column in own]) for row in range(M)]
    return np.column_stack([linalg.block_diag(*blocks), *(c.ravel() for c in common)])


def test_it_is_one_fit_with_the_columns_of_each_staircase_and_shared_ones():
    random = np.random.default_rng(1)
    own, common = [CURRENT, ONES], shared(random)
    torque = random.standard_normal((M, P))
    fit = LeastSquares(torque, own, common)
    inverse = np.linalg.pinv(written_out(own, common))
    expected = inverse @ torque.ravel()
    np.testing.assert_allclose(fit.own.ravel(), expected[: 2 * M], rtol=1e-9)
    left = torque.ravel() - written_out(own, common) @ expected
    np.testing.assert_allclose(fit.residual.ravel(), left, atol=1e-12)
    assert fit.parameters == 2 * M + 2
    weight = random.standard_normal(M)
    slopes = inverse[: 2 * M : 2]  # of each staircase, by torque
    np.testing.assert_allclose(fit.response(weight).ravel(), weight @ slopes, atol=1e-12)


def test_scatter_is_what_staircases_of_a_kind_do_not_have_in_common():
    random = np.random.default_rng(2)
    residual = random.standard_normal((M, P))
    fit = SimpleNamespace(residual=residual, own=np.zeros((M, 3)), parameters=14)
    weight = ONES.copy()
    weight[:, -2:] = 0.0

    def stairs(*kind):
        return SimpleNamespace(weight=weight, courses=SimpleNamespace(kind=np.array(kind)))

    square = sum(np.var(residual[those], axis=0).sum() * 2 for those in ([0, 2], [1, 3]))
    sigma, dof = _scatter(stairs(0, 1, 0, 1), fit)
    assert dof == 2 * (10 - 3)
    assert sigma == pytest.approx(math.sqrt(square / dof), rel=1e-12)
    # where each is of its own kind, nothing is in common
    sigma, dof = _scatter(stairs(0, 1, 2, 3), fit)
    assert dof == 40 - 14
    assert sigma == pytest.approx(math.sqrt(np.sum(residual**2) / dof), rel=1e-12)


def test_slopes_to_the_top_scatter_by_their_u():
    """Noise on the plateaus of many staircases of one kind."""
    random = np.random.default_rng(3)
    count = 16
    current = np.tile(CURRENT[0], (count, 1))
    friction = np.tile(np.sign(np.gradient(CURRENT[0])), (count, 1))
    own, common = [np.ones((count, P))], [friction]
    found, stated = [], []
    for _ in range(60):
        torque = 0.05 * current + 2e-3 * friction + 1e-4 * random.standard_normal((count, P))
        stairs = SimpleNamespace(
            torque=torque,
            weight=np.ones((count, P)),
            courses=SimpleNamespace(kind=np.zeros(count, dtype=int)),
        )
        bend, first, first_u, u, dof = _bend(stairs, current, own, common)
        level = torque - bend[:, None] * current**2
        slope = LeastSquares(level, [current, *own], common).own[:, 0] + 3.0 * bend
        found.append([first - 0.05, slope - 0.05])
        stated.append([first_u, u])
        assert dof == 15 * (P - 3)  # slope, bend and zero of each, but what all have in common
    scatter = np.sqrt(np.mean(np.square(found), axis=(0, 2)))
    np.testing.assert_allclose(np.sqrt(np.mean(np.square(stated), axis=(0, 2))), scatter, rtol=0.08)


def test_lack_of_fit_is_what_scatter_and_rounding_do_not_explain():
    wave = 1e-3 * np.cos(np.arange(P))
    design = np.column_stack([CURRENT[0], np.ones(P)])
    fit = SimpleNamespace(residual=wave * np.linspace(0.5, 1.5, M)[:, None], design=design)
    average, stairs = np.full(M, 1 / M), SimpleNamespace(weight=ONES)
    independent = independent_samples(wave, np.ones(P, dtype=bool), 1)
    covariance, expected = long_run_covariance(design, wave, independent)
    whole = math.sqrt(covariance[0, 0])
    own = np.full(M, 0.6 * whole * math.sqrt(M))  # in the mean 0.6 of it
    solution = SimpleNamespace(fit=fit, u=own)
    found, dof = _lack_of_fit(stairs, solution, average, 0.48 * whole)
    assert found == pytest.approx(0.64 * whole, rel=1e-9)
    assert dof == expected
    assert _lack_of_fit(stairs, solution, average, whole)[0] == 0


def test_a_kelvin_of_heat_takes_as_much_of_the_constant_at_any_temperature():
    """Torques without noise, of a constant that falls along a line down to the winding's heat."""
    rise, coefficient, loss = np.array([-40.0, 0.0, 15.0, 25.0]), -4e-3, 2e-3
    heat = np.cumsum(CURRENT**2, axis=1) / P
    stairs = SimpleNamespace(
        torque=0.05 * (1 + coefficient * rise[:, None] - loss * heat) * CURRENT + 0.01,
        current=CURRENT,
        weight=ONES,
        last_step=np.diff(CURRENT, axis=1, prepend=0.0),
        rotor_angle=QUARTERS,
        courses=SimpleNamespace(kind=np.arange(M)),
    )
    found = _solve(stairs, (heat, 20 + rise[:, None] * ONES), (), coefficient, rise)
    np.testing.assert_allclose(found.fit.residual, 0.0, atol=1e-12)
    np.testing.assert_allclose(found.slope, 0.05 * (1 + coefficient * rise), rtol=1e-9)
    np.testing.assert_allclose(found.temperature, 20 + rise)


@pytest.mark.parametrize(("rise", "coefficient"), [(1.0, 0.0), (10.0, -1.2e-3)])
def test_the_coefficient_is_that_of_lines_over_temperature(rise, coefficient):
    temperature = 20 + rise * np.array([0.0, 1.0, 1.5, 0.5])
    middle = temperature.mean()
    constant = 0.05 * (1 - 1.2e-3 * (temperature - middle))
    stairs = SimpleNamespace(
        temperature=temperature[:, None] * ONES,
        weight=ONES,
        current=CURRENT,
        torque=constant[:, None] * CURRENT + 0.01,
    )
    assert _about(stairs) == pytest.approx(coefficient, rel=1e-9)
