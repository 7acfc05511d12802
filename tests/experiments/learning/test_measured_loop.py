"""The loop around a measured plant: against the formulas, and against plants within the circles."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from rigtool.control.plant_models import PlantModel
from rigtool.control.position_loop import Loop, position_loop
from rigtool.errors import InsufficientDataError
from rigtool.experiments.learning.filters import Learning, convergence, zpetc
from rigtool.experiments.learning.measured_loop import InverseResponse, MeasuredLoop

SAMPLE_TIME = 125e-6
LINES = np.unique(np.geomspace(1, 62, 30).round()) * 4.0
AXIS = np.union1d(np.concatenate([[0.0], np.geomspace(0.1, 4000, 300)]), LINES)
NOMINAL = position_loop(
    crossover_hz=50.0,
    lead_ratio=3.0,
    integrator_hz=4.0,
    lowpass_hz=400.0,
    lowpass_damping=0.7,
    inertia=1.503e-5,
    sample_time=SAMPLE_TIME,
)
TRUE = PlantModel(2.08e-5, 1e-4, 0.9, 50.0, 0.6)


def measured(model=TRUE, radius=0.01):
    """A rigid model of a plant that is not rigid, measured without error."""
    rigid = Loop(NOMINAL.controller, PlantModel(2e-5, 5e-5).held(SAMPLE_TIME))
    response = model.held(SAMPLE_TIME).response(LINES)
    return MeasuredLoop(rigid, LINES, response, np.full(len(LINES), radius))


def complementary(plant, frequency):
    open_loop = NOMINAL.controller.response(frequency) * plant
    return open_loop / (1 + open_loop)


def learning(loop, **changes):
    system = loop.loop.complementary_sensitivity
    options = {"cutoff_hz": 100.0, "order": 4, "factor": 1.0, **changes}
    inverse = options.pop("inverse", zpetc(system, 0.999))
    return Learning(system, inverse, **options, measured=loop)


def test_at_the_lines_it_is_the_response_and_between_them_close_to_it():
    found = measured().complementary_sensitivity
    expected = complementary(TRUE.held(SAMPLE_TIME).response(LINES), LINES)
    np.testing.assert_allclose(found(LINES), expected, rtol=1e-9, atol=0)
    between = np.sqrt(LINES[1:] * LINES[:-1])
    expected = complementary(TRUE.held(SAMPLE_TIME).response(between), between)
    np.testing.assert_allclose(found(between), expected, rtol=3e-3, atol=0)


def test_at_rest_the_loop_follows():
    found = measured()
    assert found.complementary_sensitivity(np.zeros(1))[0] == pytest.approx(1, abs=1e-9)
    assert found.doubt(np.zeros(1))[0] == pytest.approx(0, abs=1e-9)


def test_beyond_the_lines_it_is_the_model_and_doubt_grows():
    found = measured()
    ratio = found.ratio(np.array([0.01, 4.0, 248.0, 496.0]))
    assert ratio[0] == pytest.approx(ratio[1], rel=1e-12)
    assert ratio[3] == pytest.approx(ratio[2], rel=1e-12)
    d = found.relative_radius(np.array([1.0, 60.0, 248.0, 496.0, 992.0]))
    np.testing.assert_allclose(d[:3], 0.01, rtol=1e-9, atol=0)
    beyond = 0.01 + abs(ratio[2] - 1)
    np.testing.assert_allclose(d[3:], [4 * beyond, 16 * beyond], rtol=1e-9, atol=0)


@settings(max_examples=60, deadline=None)
@given(
    radius=st.floats(0.001, 0.3),
    part=st.floats(0, 1),
    angle=st.floats(0, 2 * np.pi),
    factor=st.floats(0.2, 1.2),
)
def test_no_plant_within_the_circles_exceeds_the_bound(radius, part, angle, factor):
    loop = measured(radius=radius)
    plant = loop.response * (1 + part * radius * np.exp(1j * angle))
    t = complementary(plant, LINES)
    off = np.abs(t - loop.complementary_sensitivity(LINES))
    assert (off <= loop.doubt(LINES) * (1 + 1e-9)).all()
    update = learning(loop, factor=factor)
    true = update.robustness(LINES) * np.abs(1 - factor * update.inverse.response(LINES) * t)
    assert (true <= convergence(update, LINES).bound * (1 + 1e-9)).all()


def test_the_bound_is_reached():
    """By the plant that turns towards -1 at the frequency where T is largest."""
    loop = measured(radius=0.2)
    t = loop.complementary_sensitivity(LINES)
    worst = loop.response * (1 - 0.2 * np.abs(t) / t)
    off = np.abs(complementary(worst, LINES) - t)
    np.testing.assert_allclose(off, loop.doubt(LINES), rtol=1e-9, atol=0)


def test_a_plant_that_may_be_unstable_has_no_bound():
    loop = measured(radius=0.9)
    assert np.isinf(loop.doubt(LINES)).any()
    with pytest.raises(InsufficientDataError, match="over the uncertainty of the measured plant"):
        convergence(learning(loop), AXIS).require()


def test_refusal_names_frequency_and_remedy():
    criterion = convergence(learning(measured(radius=0.35), cutoff_hz=200.0), AXIS)
    assert criterion.peak < 1 < criterion.bound_peak
    assert criterion.bound[criterion.frequency == criterion.bound_frequency] == criterion.bound_peak
    with pytest.raises(InsufficientDataError) as refusal:
        criterion.require()
    assert f"{criterion.bound_frequency:.4g} Hz" in str(refusal.value)
    assert "lower ilc_learn.robustness_hz" in str(refusal.value)


def test_the_model_alone_may_converge_where_the_measured_plant_does_not():
    """A nominal inertia that is four times too small: the model's criterion does not show it."""
    wrong = Loop(NOMINAL.controller, PlantModel(2e-5).held(SAMPLE_TIME))
    response = PlantModel(0.5e-5).held(SAMPLE_TIME).response(LINES)
    loop = MeasuredLoop(wrong, LINES, response, np.full(len(LINES), 1e-3))
    update = learning(loop)
    alone = Learning(update.system, update.inverse, 100.0, 4, 1.0)
    convergence(alone, AXIS).require()
    assert np.isnan(convergence(alone, AXIS).bound).all()
    with pytest.raises(InsufficientDataError, match="does not converge"):
        convergence(update, AXIS).require()


def test_the_inverse_response_inverts_up_to_the_last_line_and_ends_smoothly():
    loop = measured()
    inverse = InverseResponse(loop)
    product = inverse.response(AXIS) * loop.complementary_sensitivity(AXIS)
    inside, outside = AXIS <= 248, AXIS >= 496
    np.testing.assert_allclose(product[inside], 1, rtol=1e-12, atol=0)
    np.testing.assert_array_equal(product[outside], 0)
    falling = product[~inside & ~outside]
    np.testing.assert_allclose(falling.imag, 0, rtol=0, atol=1e-12)
    assert (np.diff(falling.real) < 0).all()
    fine = np.linspace(248, 496, 2000)
    gain = np.abs(inverse.response(fine) * loop.complementary_sensitivity(fine))
    assert np.abs(np.diff(gain)).max() < 0.002
    np.testing.assert_array_equal(inverse.response(AXIS), inverse.response(AXIS, shifted=False))


def test_the_inverse_response_learns_what_the_rigid_model_cannot():
    loop = measured()
    zero_phase = convergence(learning(loop), AXIS)
    direct = convergence(learning(loop, inverse=InverseResponse(loop)), AXIS)
    assert direct.peak < 0.1 * zero_phase.peak
    direct.require()
    zero_phase.require()


def test_an_update_with_the_inverse_response_finds_a_disturbance():
    loop = measured()
    update = learning(loop, inverse=InverseResponse(loop))
    count = 8000
    time = np.arange(count) * SAMPLE_TIME
    disturbance = 1e-3 * np.cos(2 * np.pi * 8 * time) + 4e-4 * np.sin(2 * np.pi * 20 * time + 1)
    spectrum = np.fft.rfft(disturbance)
    frequency = np.fft.rfftfreq(count, SAMPLE_TIME)
    torque = np.fft.irfft(spectrum * loop.complementary_sensitivity(frequency), count)
    np.testing.assert_allclose(
        update.updated(torque, count * SAMPLE_TIME), update.smoothed(disturbance, 1.0), atol=1e-12
    )
