"""ZPETC, Q and the update: the thesis's polynomials, scipy, and properties of any system."""

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from scipy import signal

from rigtool.control.position_loop import TransferFunction, position_loop
from rigtool.errors import InsufficientDataError
from rigtool.experiments.learning.filters import (
    Learning,
    convergence,
    robustness_gain,
    zpetc,
)

SAMPLE_TIME = 125e-6
FREQUENCY = np.concatenate([[0.0], np.geomspace(0.1, 4000, 300)])
# T as the thesis prints it, section 7.2.4.2.
PUBLISHED = TransferFunction.from_z(
    [1, 1.408, -5, 1.898, 0.6939], [565.4, -2488, 4356, -3788, 1634, -278.9], SAMPLE_TIME
)
LOOP = position_loop(
    crossover_hz=50.0,
    lead_ratio=3.0,
    integrator_hz=8.0,
    lowpass_hz=400.0,
    lowpass_damping=0.7,
    inertia=1.503e-5,
    sample_time=SAMPLE_TIME,
)


def learning(system=LOOP.complementary_sensitivity, radius=0.999, cutoff_hz=100.0, factor=1.0):
    return Learning(system, zpetc(system, radius), cutoff_hz, order=4, factor=factor)


def test_published_inverse():
    """Numerator, denominator and phd of thesis section 7.2.4.2, to the digits printed there.

    The zero near 1.0008 is a rounding of one: a radius a little above one takes it along.
    """
    inverse = zpetc(PUBLISHED, cancel_radius=1.01)
    numerator = [103.3, -421.7, 651.7, -440, 79.4, 43.5, -16.12]
    last_digit = np.array([0.1, 0.1, 0.1, 1, 0.1, 0.1, 0.01])
    assert (np.abs(inverse.filter.num - numerator) < last_digit / 2).all()
    denominator = [1, -1.751, 0.5312, 0.2196, 0, 0, 0]
    np.testing.assert_allclose(inverse.filter.den, denominator, rtol=5e-4, atol=1e-9)
    assert inverse.advance == 2
    mirrored = np.roots(inverse.filter.num)  # the zero that is not cancelled, from z to 1/z
    assert np.abs(mirrored + 1 / 3.159).min() < 1e-4


def test_radius_decides_what_is_cancelled():
    modulus = np.sort(np.abs(PUBLISHED.zeros()))
    for radius, kept in ((0.999, 2), (1.01, 1), (4.0, 0), (0.1, 4)):
        inverse = zpetc(PUBLISHED, radius)
        mirrored = np.abs(np.roots(inverse.filter.num))
        for outside in modulus[4 - kept :]:
            assert np.abs(mirrored - 1 / outside).min() < 1e-9
        assert inverse.advance == 1 + kept


roots = st.lists(
    st.tuples(st.floats(0.02, 0.95), st.floats(0, np.pi), st.booleans()), min_size=1, max_size=3
)


def polynomial(found, scale=1.0):
    """Build a real polynomial from moduli, angles and whether a root is real."""
    result = np.ones(1)
    for modulus, angle, real in found:
        radius = modulus * scale
        if real:
            result = np.convolve(result, [1, -radius * np.sign(np.cos(angle))])
        else:
            result = np.convolve(result, [1, -2 * radius * np.cos(angle), radius**2])
    return result


def apart(zeros):
    """Say whether zeros are distinct: those of high multiplicity are found to a few digits only."""
    distance = np.abs(zeros[:, None] - zeros[None, :]) + np.eye(len(zeros))
    return distance.min(initial=1.0) > 0.02


@settings(max_examples=100, deadline=None)
@given(
    poles=roots,
    inside=roots,
    outside=roots,
    sampling=st.integers(0, 2),
    delay=st.integers(0, 3),
    radius=st.floats(0.9, 0.99),  # lower ones are ill-conditioned for so many zeros
    gain=st.floats(1e-3, 1e3),
)
def test_inverse_has_no_phase_and_gain_one_at_dc(
    poles, inside, outside, sampling, delay, radius, gain
):
    """Any proper system: zeros inside and outside, complex, negative, at -1 and at infinity."""
    num = gain * np.convolve(polynomial(inside), polynomial(outside, scale=3.0))
    for _ in range(sampling):
        num = np.convolve(num, [1.0, 1.0])
    den = polynomial(poles)
    den = np.concatenate([den, np.zeros(max(0, len(num) + delay - len(den)))])
    system = TransferFunction.from_z(num, den, SAMPLE_TIME)
    zeros = np.abs(system.zeros())
    assume((np.abs(zeros - radius) > 0.01).all())
    assume(apart(system.zeros()[np.abs(system.zeros() + 1) > 0.1]))
    at_one = np.prod(1 - system.zeros()[zeros >= radius])
    assume(abs(at_one) > 1e-3)
    inverse = zpetc(system, radius)
    assert inverse.advance == system.relative_degree + (zeros >= radius).sum()
    product = inverse.response(FREQUENCY) * system.response(FREQUENCY)
    scale = np.abs(product).max()
    assert np.abs(product.imag).max() < 1e-6 * scale
    assert product.real.min() > -1e-6 * scale
    assert product[0].real == pytest.approx(1, rel=1e-5, abs=0)
    assert np.abs(inverse.filter.poles()).max(initial=0) < radius < 1
    assert inverse.filter.relative_degree == 0
    unshifted = inverse.response(FREQUENCY, shifted=False)
    turn = np.exp(2j * np.pi * FREQUENCY * inverse.advance * SAMPLE_TIME)
    np.testing.assert_allclose(unshifted * turn, inverse.response(FREQUENCY), rtol=1e-12, atol=0)


@pytest.mark.parametrize(
    ("num", "radius", "message"),
    [
        ([1, 0, 0, 0], 0.9, "proper|poles as zeros"),
        ([1, -1], 0.999, "no gain at DC"),
        ([1, 1], 1.01, "unit circle"),
    ],
)
def test_systems_without_an_inverse_are_refused(num, radius, message):
    with pytest.raises(InsufficientDataError, match=message):
        zpetc(TransferFunction.from_z(num, [1, -1.2, 0.5], SAMPLE_TIME), radius)


@pytest.mark.parametrize(("order", "cutoff"), [(4, 100.0), (1, 20.0), (10, 1500.0)])
def test_robustness_is_butterworth_forth_and_back(order, cutoff):
    sections = signal.butter(order, cutoff, fs=1 / SAMPLE_TIME, output="sos")
    _, once = signal.sosfreqz(sections, FREQUENCY[:-1], fs=1 / SAMPLE_TIME)
    found = robustness_gain(FREQUENCY, cutoff_hz=cutoff, order=order, sample_time=SAMPLE_TIME)
    np.testing.assert_allclose(found[:-1], np.abs(once) ** 2, rtol=1e-6, atol=1e-15)
    assert found[-1] == pytest.approx(0, abs=1e-15)


def test_robustness_filters_as_filtfilt_does():
    time = np.arange(8000) * SAMPLE_TIME
    noise = np.random.default_rng(3).normal(size=8000)
    sections = signal.butter(4, 100.0, fs=1 / SAMPLE_TIME, output="sos")
    expected = signal.sosfiltfilt(sections, noise)
    found = learning().smoothed(noise, len(time) * SAMPLE_TIME)
    inner = slice(800, -800)  # filtfilt guesses what lies beyond its ends
    np.testing.assert_allclose(found[inner], expected[inner], rtol=0, atol=1e-6)


def test_robustness_cutoff_must_lie_below_half_the_rate():
    with pytest.raises(ValueError, match="4000"):
        robustness_gain(FREQUENCY, cutoff_hz=4000.0, order=4, sample_time=SAMPLE_TIME)


def test_a_time_that_stands_still_is_refused():
    with pytest.raises(InsufficientDataError, match="a cycle lasts 0 s"):
        learning().smoothed(np.zeros(100), 0.0)


def answer_of_loop(torque):
    """Return what the loop makes of a periodic torque, simulated sample by sample by scipy."""
    t = LOOP.complementary_sensitivity
    num = np.pad(t.num, (t.relative_degree, 0))
    return signal.lfilter(num, t.den, np.tile(torque, 4))[-len(torque) :]


def test_one_update_finds_the_disturbance_that_made_the_torque():
    """q = T d, simulated sample by sample by scipy, gives back d within the band of Q."""
    count = 8000
    time = np.arange(count) * SAMPLE_TIME
    disturbance = 1e-3 * np.cos(2 * np.pi * 3 * time) + 4e-4 * np.sin(2 * np.pi * 20 * time + 1)
    torque = answer_of_loop(disturbance)
    found = learning().updated(torque, count * SAMPLE_TIME)
    # Zeros of T at -1 are not cancelled: at 20 Hz L T is 1.8e-4 below one.
    np.testing.assert_allclose(found, disturbance, rtol=0, atol=1e-7)
    # A second update, of what is left, hardly changes it; the first is kept in full.
    again = learning().updated(np.zeros(count), count * SAMPLE_TIME, before=found)
    np.testing.assert_allclose(again, found, rtol=0, atol=2e-9)


def test_a_cancelled_zero_outside_the_circle_does_not_blow_up():
    inverse = zpetc(PUBLISHED, cancel_radius=1.01)
    assert np.abs(inverse.filter.poles()).max() > 1
    update = Learning(PUBLISHED, inverse, 100.0, 4, 1.0)
    tone = np.cos(2 * np.pi * 10 * np.arange(80000) * SAMPLE_TIME)
    found = update.updated(tone, 80000 * SAMPLE_TIME)
    gain = np.abs(inverse.response(np.array([10.0])))[0]
    assert np.abs(found).max() == pytest.approx(gain, rel=1e-3, abs=0)


@settings(max_examples=25, deadline=None)
@given(seed=st.integers(0, 2**31), rows=st.integers(1, 4), count=st.integers(50, 400))
def test_learning_is_linear(seed, rows, count):
    cycles = np.random.default_rng(seed).normal(size=(rows, count))
    update = learning()
    period = count * SAMPLE_TIME
    np.testing.assert_allclose(
        update.updated(cycles, period).mean(axis=0),
        update.updated(cycles.mean(axis=0), period),
        rtol=0,
        atol=1e-9,
    )


def test_criterion_is_what_an_update_leaves():
    """Simulate eq. 9-12 on a tone: the part that is left is |Q (1 - p L T)|."""
    update = learning(factor=0.7)
    frequency, count = 40.0, 8000
    tone = np.cos(2 * np.pi * frequency * np.arange(count) * SAMPLE_TIME)
    feedforward = update.updated(tone, count * SAMPLE_TIME)
    # Thesis eq. 10 and 11, for the part of q within Q
    left = update.smoothed(tone, count * SAMPLE_TIME) - answer_of_loop(feedforward)
    found = convergence(update, np.array([frequency]))
    assert np.abs(left).max() == pytest.approx(found.magnitude[0], rel=1e-4, abs=0)


def test_criterion_holds_for_the_loop_and_names_its_peak():
    found = convergence(learning(), FREQUENCY)
    found.require()
    assert found.peak == found.magnitude.max() < 0.01
    assert found.frequency[found.magnitude == found.peak] == found.peak_frequency


@pytest.mark.parametrize("changes", [{"radius": 0.5}, {"factor": 2.1}])
def test_learning_that_does_not_converge_is_refused(changes):
    with pytest.raises(InsufficientDataError, match="must be below 1"):
        convergence(learning(**changes), FREQUENCY).require()
