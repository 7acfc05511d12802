"""Angles of the arm: what orders of the ripple can be taken for."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from rigtool.experiments.torque_constant.clampings import clamping_angles
from rigtool.numerics.angle_effects import fit_angle_effects


def test_clamping_angles_mirror_about_the_middle_temperature():
    angles = clamping_angles((20, 25, 30, 35, 40, 45, 50), 8)
    assert_allclose(angles, angles[::-1], rtol=1e-12)
    # Together they divide the turn equally.
    assert_allclose(np.diff(np.unique(angles.round(9))), 2 * np.pi / 32, rtol=1e-6)
    # No order of rotation passes for a change with temperature.
    rise = np.arange(7) - 3
    for order in range(1, 40):
        assert_allclose(rise @ np.cos(order * angles).mean(axis=1), 0, atol=1e-9)


@pytest.mark.parametrize(
    ("positions", "temperatures", "part"), [(6, 4, 5e-4), (5, 4, 1e-3), (3, 7, 5e-4)]
)
def test_no_order_of_the_ripple_passes_for_the_constant(positions, temperatures, part):
    """Twelve angles show nothing of order 12, ten of order 10; `part` of a ripple of 5e-3 remains:
    twenty clampings have fewer numbers than twelve orders."""
    degc = np.linspace(20.0, 50.0, temperatures)
    angle = clamping_angles(tuple(degc), positions).ravel()
    assert angle.shape == (positions * temperatures,)
    rise = np.repeat(degc - 35.0, positions)
    design = np.column_stack([np.ones(len(angle)), rise])
    for order in range(1, 13):
        slope = 0.045 * (1 - 1.2e-3 * rise + 0.005 * np.cos(order * angle))
        u = np.full(len(angle), 4e-6)
        found = fit_angle_effects(design, slope + u * np.cos(17 * angle), u, angle)
        off = np.abs(found.parameters - [0.045, -54e-6])
        assert np.all(off < 4 * np.sqrt(np.diag(found.covariance))), order
        assert off[0] < part * 0.045
        assert off[1] < 0.05 * 54e-6


@pytest.mark.parametrize(("positions", "temperatures"), [(7, 4), (10, 3), (6, 7), (9, 3)])
def test_orders_do_not_pass_for_each_other(positions, temperatures):
    """Fourteen angles show order 10 as order 4, or take off from it."""
    degc = tuple(np.linspace(20.0, 50.0, temperatures))
    angle = clamping_angles(degc, positions).ravel()
    design = np.column_stack([np.ones(len(angle)), np.repeat(degc, positions) - 35.0])
    for seed in range(4):
        rng = np.random.default_rng(seed)
        waves = rng.choice([3, 4, 6, 8, 10, 11, 12], 5, replace=False)
        size, phase = rng.uniform(0.5, 1, 5), rng.uniform(0, 2 * np.pi, 5)
        ripple = np.cos(np.outer(angle, waves) + phase) @ size
        u = np.full(len(angle), 5e-3)
        found = fit_angle_effects(design, ripple + u * rng.standard_normal(len(angle)), u, angle)
        true = np.sqrt(size @ size / 2)
        assert abs(found.deviation - true) < 4 * found.deviation_u
        assert found.deviation_u < 0.02 * true


@pytest.mark.parametrize(("positions", "temperatures"), [(6, 4), (12, 2), (9, 3), (3, 7)])
def test_an_order_that_is_not_fitted_is_in_the_uncertainty(positions, temperatures):
    """At angles by the golden section, orders 13, 21 and 34 gave a coefficient 10 to 20 u off."""
    degc = tuple(np.linspace(20.0, 50.0, temperatures))
    angles = clamping_angles(degc, positions)
    assert np.all(np.diff(angles, axis=1) > 0)
    angle, rise = angles.ravel(), np.repeat(degc, positions) - 35.0
    u = np.full(angle.size, 9e-6)
    for order in (13, 16, 21, 34, 42):
        rng = np.random.default_rng(order)
        ripple = 0.002 * np.cos(3 * angle) + 0.004 * np.cos(order * angle + rng.uniform(0, 6))
        slope = 0.045 * (1 - 1.2e-3 * rise) * (1 + ripple) + u * rng.standard_normal(angle.size)
        found = fit_angle_effects(np.column_stack([np.ones(angle.size), rise]), slope, u, angle)
        off = np.abs(found.parameters - [0.045, -54e-6])
        assert np.all(off < 5 * np.sqrt(np.diag(found.covariance))), order
