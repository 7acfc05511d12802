"""Rounding by a coarse gauge, and what looks like friction in it."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.stats import norm

from rigtool.experiments.torque_constant.staircases import fit
from rigtool.experiments.torque_constant.staircases.gauge_rounding import (
    GAUGE_PHASES,
    rounding_errors,
    spread_over_zeros,
)
from rigtool.experiments.torque_constant.staircases.hypotheses import weigh_hypotheses
from rigtool.experiments.torque_constant.staircases.model import arrange
from tests.experiments.torque_constant.bench import Bench, plateaus_in

STEP = 0.011
"""Of the gauge, N: 30 in a staircase."""

ABOUT = -1.16e-3, np.array([-1, 1]) / 30
"""Coefficient, 1/K, and what combines two staircases to their change with temperature, 1/K."""


def test_hypotheses_spread_as_over_zeros_of_a_true_gauge():
    levels = 4 - np.abs(np.linspace(-4, 4, 21))
    signals = Bench(force_noise=1e-4, friction=1e-3).record((20, 50), 1, levels)

    def plateaus(force):
        channels = {**signals, "force": force}
        return plateaus_in(channels)

    zeros = np.arange(0, 12, 3) / 12
    rounded = [plateaus((np.round(signals["force"] / STEP + zero) - zero) * STEP) for zero in zeros]
    found = [weigh_hypotheses(arrange(each), *ABOUT).constant for each in rounded]
    exact = arrange(plateaus(signals["force"]))
    gauge = replace(arrange(rounded[0]), noise=0.0)
    errors = rounding_errors(gauge, exact.torque)
    assert len(errors) == 12
    readings = exact.torque + errors[::3]
    own = np.stack([arrange(each).torque for each in rounded])
    # Five harmonics of a sawtooth hold 0.89 of its power.
    assert np.sqrt(np.mean((readings - own) ** 2)) < 0.4 * np.sqrt(np.mean(errors**2))
    spread = spread_over_zeros(rounded[0], gauge, readings, *ABOUT)
    assert spread > 0.02 * 45e-3  # ten times what a straight line makes of the rounding
    assert 0.5 < spread / np.std(found, ddof=1) < 2  # hypotheses amplify what harmonics lack


def test_a_gauge_without_steps_rounds_nothing():
    signals = Bench().record((20,), 1)
    stairs = arrange(plateaus_in(signals))
    none = rounding_errors(replace(stairs, resolution=0.0), stairs.torque)
    assert_allclose(none, np.zeros((1, *stairs.torque.shape)))


def mean_rounded(torque, noise, step):
    """The mean of round(torque + noise), level by level: a sum over the steps of the gauge."""
    steps = step * np.arange(-30, 31)[:, None]
    edges = (steps + step / 2 - torque) / noise
    share = norm.cdf(edges) - norm.cdf(edges - step / noise)
    return (steps * share).sum(axis=0)


@pytest.mark.parametrize("ratio", [0.2, 0.3, 0.4])
def test_errors_are_those_of_the_mean_of_noisy_readings_that_are_rounded(ratio):
    """The scatter of readings about their means is that of noise and rounding together, less that
    of the means; its inverse is right within 5 %."""
    step = 2e-3
    noise, torque = ratio * step, np.linspace(-0.011, 0.017, 23)
    places = step * np.arange(GAUGE_PHASES)[:, None] / GAUGE_PHASES
    exact = np.array([mean_rounded(torque + at, noise, step) - torque - at for at in places])
    within = np.linspace(0, step, 1000, endpoint=False)
    of_means = np.mean((mean_rounded(within, noise, step) - within) ** 2)
    scatter = np.sqrt(noise**2 + step**2 / 12 - of_means)
    stairs = SimpleNamespace(resolution=step, noise=scatter, weight=1.0)
    found = rounding_errors(stairs, torque[None])[:, 0]
    assert_allclose(found, exact, rtol=0, atol=0.05 * np.abs(exact).max())
    # plateaus that a shorter staircase does not have are not read
    stairs.weight = (np.arange(23) < 20) * 1.0
    assert_allclose(rounding_errors(stairs, torque[None])[:, 0, :20], found[:, :20])
    assert_allclose(rounding_errors(stairs, torque[None])[:, 0, 20:], 0)


@pytest.mark.parametrize(("step", "coarse"), [(STEP, True), (STEP / 20, False)])
def test_hypotheses_are_spread_over_zeros_where_the_gauge_is_coarse(monkeypatch, step, coarse):
    """From a thousandth of the constant on: then their spread is the error of the resolution."""
    levels, asked = 4 - np.abs(np.linspace(-4, 4, 21)), []
    signals = Bench(force_noise=1e-4, friction=1e-3).record((20, 50), 1, levels)
    force = np.round(signals["force"] / step) * step
    channels = {**signals, "force": force}
    plateaus = plateaus_in(channels)
    monkeypatch.setattr(fit, "spread_over_zeros", lambda *given: asked.append(given) or 7e-3)
    found = fit.fit_staircases(plateaus)
    if not coarse:
        assert not asked
        assert found.resolution_u < 1e-3
        return
    ((_, stairs, readings, *_),) = asked
    assert readings.shape == (GAUGE_PHASES / 2, *stairs.torque.shape)
    # what a gauge at other places of its zero would read: off by its steps, and zero on average
    off = readings - readings.mean(axis=0)
    assert np.abs(off).max() == pytest.approx(step * 0.54 / 2, rel=0.25)
    assert np.mean(found.slope) * found.resolution_u == pytest.approx(7e-3, rel=1e-9)
