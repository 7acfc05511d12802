"""Friction and inertia from any motion: what went in comes out, with honest uncertainties."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.signal import lfilter

from rigtool.analysis.inverse_dynamics import band_limit, identify
from rigtool.errors import InsufficientDataError

INERTIA, VISCOUS, COULOMB, OFFSET = 1.5e-5, 5e-5, 2.3e-3, 0.4e-3
STEP = 1e-3


def moving(seconds=20.0, seed=0, frequencies=(0.5, 1.3), amplitude=4.0):
    """Time, position and torque of a motor that is moved to and fro."""
    time = np.arange(0, seconds, STEP)
    phases = np.random.default_rng(seed).uniform(0, 6, len(frequencies))
    omega = 2 * np.pi * np.array(frequencies)
    turning = np.outer(time, omega) + phases
    position = (amplitude * np.sin(turning)).sum(axis=1)
    speed = (amplitude * omega * np.cos(turning)).sum(axis=1)
    acceleration = -(amplitude * omega**2 * np.sin(turning)).sum(axis=1)
    torque = INERTIA * acceleration + VISCOUS * speed + COULOMB * np.sign(speed) + OFFSET
    return time, position, torque


def fit(*signals):
    return identify(
        [
            band_limit(time=time, position=position, torque=torque)
            for time, position, torque in signals
        ]
    )


def test_all_parameters_come_back():
    found = fit(moving())
    expected = [INERTIA, VISCOUS, COULOMB, OFFSET]
    np.testing.assert_allclose(found.parameters, expected, rtol=0.01, atol=0)
    assert found.explained > 0.999


def test_they_come_back_from_counts_with_noise():
    time, position, torque = moving()
    counts = np.round(position * 4000 / (2 * np.pi)) * 2 * np.pi / 4000
    noisy = torque + np.random.default_rng(1).normal(0, 1e-3, len(time))
    found = fit((time, counts, noisy))
    expected = [INERTIA, VISCOUS, COULOMB, OFFSET]
    np.testing.assert_allclose(found.parameters, expected, rtol=0.05, atol=0)


def test_uncertainties_cover_the_scatter_of_correlated_residuals():
    """Noise with a memory of 50 samples: ordinary least squares would claim a tenth."""
    random = np.random.default_rng(2)
    values, claimed = [], []
    for _ in range(60):
        time, position, torque = moving(seed=0)
        noise = lfilter([1], [1, -0.98], random.normal(0, 2e-5, len(time)))
        found = fit((time, position, torque + noise))
        values.append(found.parameters)
        claimed.append(np.sqrt(np.diag(found.covariance)))
    ratio = np.mean(claimed, axis=0) / np.std(values, axis=0)
    assert np.all((ratio > 0.6) & (ratio < 1.6)), ratio


def test_several_recordings_are_fitted_together():
    parts = [moving(seconds=8, seed=seed) for seed in range(4)]
    together, alone = fit(*parts), fit(parts[0])
    np.testing.assert_allclose(together.parameters[2], COULOMB, rtol=0.01, atol=0)
    assert len(together.parameters) == len(alone.parameters)


def test_an_irregular_time_axis_is_resampled():
    time, position, torque = moving()
    random = np.random.default_rng(4)
    uneven = np.sort(random.uniform(0, time[-1], len(time)))
    motion = band_limit(
        time=uneven,
        position=np.interp(uneven, time, position),
        torque=np.interp(uneven, time, torque),
    )
    assert motion.resampled
    np.testing.assert_allclose(identify([motion]).parameters[2], COULOMB, rtol=0.03, atol=0)
    assert not band_limit(time=time, position=position, torque=torque).resampled


@settings(deadline=None, max_examples=15)
@given(st.floats(0.01, 100), st.floats(0.01, 100), st.sampled_from([1, -1]))
def test_units_and_direction_scale_the_result(length, force, sign):
    """The same in other units, or with both axes turned round."""
    time, position, torque = moving(seconds=10)
    first = fit((time, position, torque)).parameters
    other = fit((time, sign * position * length, sign * torque * force)).parameters
    expected = first * force * np.array([1 / length, 1 / length, 1, sign])
    np.testing.assert_allclose(other, expected, rtol=1e-6, atol=0)


def steady(time, position, torque):
    return time, 3 * time, torque


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (steady, "in the positive direction: Coulomb friction and a constant torque"),
        (lambda t, p, y: (t, np.zeros(len(t)), y), "nothing moves"),
        (lambda t, p, y: (t[:40], p[:40], y[:40]), "40 samples are too few"),
        (lambda t, p, y: (t[::-1], p, y), "time does not rise"),
        (lambda t, p, y: (t, p, -0.0 * y + np.cos(77 * t)), "something else acts"),
        (lambda t, p, y: (t, np.where(t > 5, np.nan, p), y), "position is nan"),
    ],
)
def test_motions_that_do_not_carry_it(change, message):
    with pytest.raises(InsufficientDataError, match=message):
        fit(change(*moving()))


def test_one_direction_does_not_tell_friction_from_offset():
    time, _, torque = moving()
    position = 20 * time + np.sin(2 * np.pi * 0.5 * time)
    with pytest.raises(InsufficientDataError, match="apart"):
        fit((time, position, torque))
