"""Friction and inertia from any motion: what went in comes out, with honest uncertainties."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.signal import lfilter
from scipy.stats import t as student

from rigtool.errors import InsufficientDataError
from rigtool.experiments.friction.inverse_dynamics import identify_dynamics
from rigtool.experiments.friction.motion_terms import band_limit
from tests.thorough import thorough

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
    return identify_dynamics(
        [
            band_limit(time=time, position=position, torque=torque)
            for time, position, torque in signals
        ]
    )


def test_all_parameters_come_back():
    found = fit(moving())
    expected = [INERTIA, VISCOUS, COULOMB, OFFSET, np.nan, np.nan]
    np.testing.assert_allclose(found.parameters, expected, rtol=0.01, atol=0)
    assert found.explained > 0.999


def test_viscous_friction_by_direction_and_all_that_moves_is_used():
    """Nothing is left out where the model holds through standstill."""
    time, position, torque = moving()
    speed = np.gradient(position, time)
    torque = torque + 0.2 * VISCOUS * np.abs(speed)
    torque = torque + np.random.default_rng(2).normal(0, 2e-4, len(time))
    found = fit((time, position, torque))
    assert found.by_direction
    assert found.standstill < 0.05
    for sign, factor in (("", 1.2), ("-", 0.8)):
        value, u = found.estimate("viscous", f"{sign}viscous_difference")
        assert abs(value - factor * VISCOUS) < 3 * u
        assert u < 0.02 * VISCOUS
    value, u = found.estimate("offset")
    assert abs(value - OFFSET) < 3 * u
    assert u < 0.05 * OFFSET


def test_they_come_back_from_counts_with_noise():
    time, position, torque = moving()
    counts = np.round(position * 4000 / (2 * np.pi)) * 2 * np.pi / 4000
    noisy = torque + np.random.default_rng(1).normal(0, 1e-3, len(time))
    found = fit((time, counts, noisy))
    expected = [INERTIA, VISCOUS, COULOMB, OFFSET, np.nan, np.nan]
    np.testing.assert_allclose(found.parameters, expected, rtol=0.05, atol=0)


def multisine(random, top, seconds=20.0):
    """A motion of six frequencies with speeds up to `top`: time, position, speed, acceleration."""
    time = np.arange(0, seconds, 2 * STEP)
    omega = 2 * np.pi * np.geomspace(0.2, 2, 6) * random.uniform(0.9, 1.1, 6)
    turning = np.outer(time, omega) + random.uniform(0, 6, 6)
    amplitude = random.uniform(0.5, 1.5, 6)
    amplitude *= top / np.max(np.abs(np.cos(turning) @ amplitude))
    position, speed = np.sin(turning) @ (amplitude / omega), np.cos(turning) @ amplitude
    return time, position, speed, -np.sin(turning) @ (amplitude * omega)


def noise_with_memory(random, count, seconds):
    decay = np.exp(-2 * STEP / seconds)
    return lfilter([np.sqrt(1 - decay**2)], [1, -decay], random.normal(size=count + 2000))[2000:]


# What acts beside the model, of speed and position; the highest speed; the noise's memory in s.
BESIDE = {
    "noise with a long memory": (lambda v, x: 0 * v, 20, 0.1),
    "noise with memory": (lambda v, x: 0 * v, 20, 0.02),
    "noise": (lambda v, x: 0 * v, 20, 0.002),
    "Stribeck at low speed": (lambda v, x: 1.5e-3 * np.sign(v) * np.exp(-(v**2)), 20, 0.02),
    "Stribeck": (lambda v, x: 1.5e-3 * np.sign(v) * np.exp(-((v / 3) ** 2)), 20, 0.02),
    "Stribeck at all speeds": (
        lambda v, x: 1.5e-3 * np.sign(v) * np.exp(-((v / 8) ** 2)),
        20,
        0.02,
    ),
    "ripple": (lambda v, x: 5e-4 * np.sin(2 * x + 1), 20, 0.02),
    "ripple within a turn": (lambda v, x: 5e-4 * np.sin(2 * x + 1), 4, 0.02),
}


BETWEEN = ("noise with memory", "noise", "Stribeck at low speed", "Stribeck", "ripple")
"""Cases between two others, which `make test` leaves to `make attack`."""


@pytest.mark.parametrize(
    "beside",
    [*(b for b in BESIDE if b not in BETWEEN), *thorough(*BETWEEN)],
)
def test_uncertainties_cover_what_is_beside_the_model(beside):
    """As often as an interval of 95 % must, within what chance allows 20 of them."""
    torque_of, top, memory = BESIDE[beside]
    expected = np.array([INERTIA, VISCOUS, COULOMB])
    inside = []
    for seed in range(20):
        random = np.random.default_rng([seed, 7])
        time, position, speed, acceleration = multisine(random, top)
        torque = INERTIA * acceleration + VISCOUS * speed + COULOMB * np.sign(speed) + OFFSET
        torque += torque_of(speed, position)
        torque += 3e-4 * noise_with_memory(random, len(time), memory)
        count = 2 * np.pi / 4000
        found = fit((time, np.round(position / count) * count, torque))
        u = np.sqrt(np.diag(found.covariance))[:3]
        inside.append(np.abs(found.parameters[:3] - expected) < student.ppf(0.975, found.dof) * u)
    assert np.all(np.mean(inside, axis=0) >= 0.85), np.mean(inside, axis=0)


def test_an_effort_of_few_steps_is_in_the_uncertainty():
    """Steps of the drive's current that noise does not cross move the mean of a direction."""
    pulls, step = [], 0.3 * COULOMB
    for seed in range(6):
        time, position, torque = moving(seed=seed, amplitude=2.0)
        torque += np.random.default_rng(seed).normal(0, 0.15 * step, len(time))
        value, u = fit((time, position, step * np.round(torque / step))).estimate("coulomb")
        pulls.append((value - COULOMB) / u)
    assert np.sqrt(np.mean(np.square(pulls))) < 1.2


def test_uncertainties_are_not_larger_than_the_scatter_asks_for():
    """With nothing but noise beside the model, whatever its memory.

    Half a sample of delay is part of the inertia's, and does not scatter: up to 1.5.
    """
    values, claimed = [], []
    for seed in range(24):
        random = np.random.default_rng([seed, 8])
        time, position, torque = moving(seconds=10)
        found = fit((time, position, torque + 1e-4 * noise_with_memory(random, len(time), 0.05)))
        values.append(found.parameters[:4])
        claimed.append(np.diag(found.covariance)[:4])
    ratio = np.sqrt(np.median(claimed, axis=0)) / np.std(values, axis=0)
    assert np.all((ratio > 0.7) & (ratio < 1.5)), ratio


def test_what_is_beside_the_model_is_reported():
    random = np.random.default_rng(9)
    time, position, speed, acceleration = multisine(random, 20)
    torque = INERTIA * acceleration + VISCOUS * speed + COULOMB * np.sign(speed)
    torque += random.normal(0, 1e-4, len(time))
    curved = fit((time, position, torque + BESIDE["Stribeck"][0](speed, position)))
    rippled = fit((time, position, torque + BESIDE["ripple"][0](speed, position)))
    plain = fit((time, position, torque))
    assert curved.by_speed > 0.5 > 0.1 > curved.by_position
    assert rippled.by_position > 0.5 > 0.1 > rippled.by_speed
    assert max(plain.by_speed, plain.by_position) < 0.1


def test_samples_near_standstill_are_left_out():
    """Friction there may be anything: what is left out does not see it."""
    time, position, torque = moving()
    speed = np.gradient(position, time)
    slow = np.abs(speed) < 0.02 * np.max(np.abs(speed))
    motion = band_limit(time=time, position=position, torque=torque)
    other = band_limit(time=time, position=position, torque=torque + 50 * slow * torque)
    assert motion.left_out > np.count_nonzero(slow)
    clean, dirty = identify_dynamics([motion]).parameters, identify_dynamics([other]).parameters
    np.testing.assert_allclose(dirty, clean, rtol=0.02, atol=0)


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
    np.testing.assert_allclose(
        identify_dynamics([motion]).parameters[2], COULOMB, rtol=0.03, atol=0
    )
    assert not band_limit(time=time, position=position, torque=torque).resampled


@settings(deadline=None, max_examples=8)
@given(st.floats(0.01, 100), st.floats(0.01, 100), st.sampled_from([1, -1]))
def test_units_and_direction_scale_the_result(length, force, sign):
    """The same in other units, or with both axes turned round."""
    time, position, torque = moving(seconds=5)
    first = fit((time, position, torque)).parameters[:4]
    other = fit((time, sign * position * length, sign * torque * force)).parameters[:4]
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
    with pytest.raises(InsufficientDataError, match="cannot be separated"):
        fit((time, position, torque))


@pytest.mark.parametrize("late", [0.004, -0.003])
def test_an_effort_that_is_late_or_early(late):
    """A filter in front of the current, or of the position, biases inertia without the delay."""
    time, position, torque = moving()
    found = fit((time, position, np.interp(time - late, time, torque)))
    delay, u = found.estimate("delay")
    assert abs(delay - late) < max(3 * u, 1e-4)
    expected = [INERTIA, VISCOUS, COULOMB, OFFSET]
    np.testing.assert_allclose(found.parameters[:4], expected, rtol=0.02, atol=0)


def test_one_frequency_does_not_hide_a_delay_or_a_long_ripple():
    """Behind one sine, both look like inertia; its uncertainty allows for them."""
    time, position, plain = moving(frequencies=(0.7,))
    random = np.random.default_rng(3)
    late = np.interp(time - 0.01, time, plain + random.normal(0, 1e-3, len(time)))
    long = plain + 3e-4 * np.sin(position * np.pi / 5 + 1) + random.normal(0, 1e-4, len(time))
    for torque in (late, long):
        inertia, u = fit((time, position, torque)).estimate("inertia")
        assert abs(inertia - INERTIA) > 0.02 * INERTIA
        assert abs(inertia - INERTIA) < 2 * u < INERTIA


def test_a_filter_of_first_order_is_no_delay():
    """A speed behind such a filter makes inertia too large, which the residuals show in part."""
    decay, (time, position, torque) = np.exp(-STEP / 0.015), moving(frequencies=(0.5, 1.3, 3.1))
    torque = torque + np.random.default_rng(1).normal(0, 1e-4, len(time))
    found = fit((time, lfilter([1 - decay], [1, -decay], position), torque))
    inertia, u = found.estimate("inertia")
    assert found.is_late
    assert 0.02 * INERTIA < abs(inertia - INERTIA) < 2 * u < 0.4 * INERTIA


def test_a_drift_of_the_effort_is_part_of_the_model():
    """Without it, offset and friction by direction have ten times the uncertainty."""
    random, held, count = np.random.default_rng(8), 0, 10
    for seed in range(count):
        time, position, torque = moving(seed=seed)
        knots = random.normal(0, 0.05 * COULOMB, 6)
        drift = np.interp(time, np.linspace(0, time[-1], 6), knots)
        torque = torque + 0.2 * VISCOUS * np.abs(np.gradient(position, time))
        torque = torque + drift - drift.mean() + random.normal(0, 0.05 * COULOMB, len(time))
        found = fit((time, position, torque))
        assert found.motions[0].drift > 0
        assert found.by_direction
        for name, true, largest in (
            ("offset", OFFSET, 0.01 * COULOMB),
            ("viscous_difference", 0.2 * VISCOUS, 0.01 * VISCOUS),
        ):
            value, u = found.estimate(name)
            assert u < largest
            held += abs(value - true) < student.ppf(0.975, found.dof) * u
    assert held >= 2 * count - 2
