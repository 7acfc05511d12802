"""A constant torque and friction of either direction, beside weighted fits of scipy."""

from types import SimpleNamespace

import numpy as np
import pytest
from scipy.optimize import curve_fit

from rigtool.experiments.friction.offset import half_difference, separate_offset, undivided

SPEED = np.array([0.0, 1.0, 2.0, 4.0, 8.0, 16.0])
LEVEL = np.array([5.0, 3.2, 2.6, 2.3, 2.2, 2.1]) * 1e-3
U = np.array([3.0, 1.0, 1.0, 2.0, 1.0, 1.0]) * 1e-6
NOISE = np.array([0.5, -0.6, 1.2, 0.3, -0.9, 0.2])


def middle(noise):
    return 0.4e-3 + 0.05 * LEVEL + 2e-6 * SPEED + noise * U * NOISE


@pytest.mark.parametrize("noise", [1.0, 5.0])
def test_an_asymmetry_shows_where_friction_varies_with_the_speed(noise):
    """Scatter beyond the points' own u widens that of the parameters by the Birge ratio."""
    values = middle(noise)
    found = separate_offset(LEVEL, values, U, SPEED)

    def model(x, offset, asymmetry, slope):
        return offset + asymmetry * x[0] + slope * x[1]

    x = np.stack([LEVEL, SPEED])
    best, covariance = curve_fit(model, x, values, sigma=U, absolute_sigma=True)
    square = np.sum(((values - model(x, *best)) / U) ** 2) / 3
    u = np.sqrt(np.diag(covariance) * max(square, 1.0))
    assert (square > 1) == (noise > 1)
    assert found.separated
    np.testing.assert_allclose([found.offset[0], found.asymmetry[0]], best[:2], rtol=1e-6)
    # friction may differ by other than a constant factor, by a tenth of it
    typical = np.average(LEVEL, weights=U**-2)
    doubt = 0.1 * best[1]
    assert found.offset[1] == pytest.approx(np.hypot(u[0], doubt * typical), rel=1e-5)
    assert found.asymmetry[1] == pytest.approx(np.hypot(u[1], doubt), rel=1e-5)


@pytest.mark.parametrize(
    ("level", "count"), [(2e-3 + 0 * LEVEL, 6), (LEVEL, 3), (2.0e-3 + 0.1 * LEVEL, 6)]
)
@pytest.mark.parametrize("size", [0.05e-3, 0.9e-3])
def test_what_is_not_separated_is_an_offset_that_may_be_an_asymmetry(level, count, size):
    level, u, speed = level[:count], U[:count], SPEED[:count]
    values = size + 2e-6 * speed + 0.1 * U[:count] * NOISE[:count]
    found = separate_offset(level, values, u, speed)
    best, covariance = curve_fit(
        lambda x, a, b: a + b * x, speed, values, sigma=u, absolute_sigma=True
    )
    typical = np.average(level, weights=u**-2)
    assert not found.separated
    assert found.offset[0] == pytest.approx(best[0], rel=1e-6)
    # all of it, and a tenth of friction at least
    possible = max(best[0], 0.1 * typical)
    assert found.offset[1] == pytest.approx(np.hypot(np.sqrt(covariance[0, 0]), possible), rel=1e-5)
    assert found.asymmetry == (0.0, pytest.approx(possible / typical, rel=1e-6))


def test_two_points_have_no_slope():
    found = separate_offset(LEVEL[:2], np.array([1e-3, 3e-3]), np.full(2, 1e-3), SPEED[:2])
    assert found.offset[0] == pytest.approx(2e-3)
    # of two values 1.4 u off their mean each, by the Birge ratio
    assert found.offset[1] > np.sqrt(2) * 1e-3 / np.sqrt(2)


@pytest.mark.parametrize(("offset", "unknown"), [(0.1e-3, 0.2e-3), (-0.5e-3, 0.5e-3)])
def test_an_offset_that_is_undivided_leaves_as_much_unknown(offset, unknown):
    """All of it, or a tenth of Coulomb friction, may be a difference between the directions."""
    found = undivided((offset, 1e-5), 2e-3)
    assert found.offset == (offset, 1e-5)
    assert found.unknown == pytest.approx(unknown, rel=1e-12)
    assert found.asymmetry == (0.0, pytest.approx(unknown / 2e-3, rel=1e-12))
    assert not found.separated


def test_half_of_a_difference_has_half_of_its_u():
    fits = {
        1: SimpleNamespace(coulomb=(2.6e-3, 3e-5)),
        -1: SimpleNamespace(coulomb=(1.4e-3, 4e-5)),
    }
    found = half_difference(fits)
    assert found.offset == (pytest.approx(0.6e-3), pytest.approx(2.5e-5))
    assert found.asymmetry[1] == pytest.approx(0.6e-3 / 2e-3)
    assert found.unknown == pytest.approx(0.6e-3)
