"""Fourier coefficients of a table: those that are there, with uncertainty, and no others."""

import numpy as np
import pytest

from rigtool.errors import InsufficientDataError
from rigtool.experiments.deploy.fourier_table import fourier_series
from rigtool.experiments.deploy.position_map import TURN, PositionMap, position_map
from tests.experiments.deploy.periodic_tables import ORDERS, cogging, turning

NOISE = 2e-4


def series(found, angle):
    """Return the sum of the orders at angles (n,)."""
    return np.cos(np.multiply.outer(angle, found.order) + found.phase) @ found.amplitude


@pytest.mark.parametrize("start", [0.0, 0.7, -2.0])
def test_the_orders_that_are_there(start):
    turn = position_map(*turning(start=start, noise=NOISE), 2.0)
    found = fourier_series(turn, None)
    truth = {order: (amplitude, phase) for order, amplitude, phase in ORDERS}
    strong = found.amplitude > 0.1e-3
    assert set(found.order[strong]) == set(truth)
    for i in np.flatnonzero(strong):
        amplitude, phase = truth[found.order[i]]
        assert abs(found.amplitude[i] - amplitude) < 4 * found.amplitude_u[i]
        assert abs(found.phase[i] - phase) < 4 * found.phase_u[i]


def test_uncertainties_are_those_of_white_noise():
    """Scatter of an amplitude over tables: noise*sqrt(2/n), here of the mean of two rows."""
    found = [
        fourier_series(position_map(*turning(1000, noise=NOISE, seed=seed), 2.0), None)
        for seed in range(40)
    ]
    amplitudes = np.array([item.amplitude[item.order == 7][0] for item in found])
    stated = np.array([item.amplitude_u[item.order == 7][0] for item in found])
    assert amplitudes.std(ddof=1) == pytest.approx(NOISE / np.sqrt(1000), rel=0.35, abs=0)
    assert stated.mean() == pytest.approx(NOISE / np.sqrt(1000), rel=0.2, abs=0)


def test_few_orders_of_noise_pass():
    """Twice the floor is exceeded by exp(-4) = 1.8 % of the orders (Rayleigh)."""
    passed = 0
    for seed in range(20):
        turn = position_map(*turning(1000, noise=NOISE, seed=seed), 2.0)
        passed += len(fourier_series(turn, None).order) - len(ORDERS)
    assert 0 < passed / (20 * 496) < 0.025


def test_the_loss_is_what_the_series_leaves():
    turn = position_map(*turning(noise=NOISE), 2.0)
    found = fourier_series(turn, 100)
    assert found.examined == 100
    left = series(found, turn.start + np.arange(4000) * TURN / 4000) - turn.values
    assert np.abs(left).max() == pytest.approx(found.lost.largest, rel=1e-9, abs=0)
    assert np.sqrt(np.mean(left**2)) == pytest.approx(found.lost.rms, rel=1e-9, abs=0)
    # All that is left is noise.
    assert found.lost.rms == pytest.approx(NOISE / np.sqrt(2), rel=0.05, abs=0)


def test_without_noise_it_is_exact():
    found = fourier_series(position_map(*turning(), 2.0), 40)
    assert found.order.tolist() == [1, 7, 28]
    angle = np.linspace(0, TURN, 777)
    np.testing.assert_allclose(series(found, angle), cogging(angle), rtol=0, atol=1e-12)


def test_noise_alone_has_no_orders():
    turn = PositionMap(0.0, np.zeros(100), np.full(100, 1e-3), 0.0, 2.0, True)
    with pytest.raises(InsufficientDataError, match=r"none of the orders 1 to 49.*revolutions"):
        fourier_series(turn, None)
