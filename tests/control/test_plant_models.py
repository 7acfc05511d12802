"""Held plants against python-control and closed forms."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from rigtool.control.plant_models import PlantModel
from rigtool.control.position_loop import double_integrator
from tests.other_tools import control

SAMPLE_TIME = 125e-6
FREQUENCY = np.geomspace(0.5, 3900, 150)


def continuous(model):
    """Write the plant's transfer function in s out by hand."""
    s = control.tf("s")
    if model.rigid:
        return 1 / (model.inertia * s**2 + model.viscous * s)
    first = model.inertia * model.motor_side
    second = model.inertia - first
    omega = 2 * np.pi * model.antiresonance_hz
    link = second * (2 * model.damping * omega * s + omega**2)
    held = second * s**2 + link
    return control.minreal(
        held / ((first * s**2 + model.viscous * s + link) * held - link**2), verbose=False
    )


@settings(max_examples=30, deadline=None)
@given(
    inertia=st.floats(1e-6, 1e-3),
    corner=st.floats(0.0, 5.0),
    part=st.none() | st.floats(0.3, 0.97),
    antiresonance=st.floats(15, 300),
    damping=st.floats(0.01, 1),
)
def test_held_plants_are_those_of_python_control(inertia, corner, part, antiresonance, damping):
    model = PlantModel(inertia, corner * inertia, part, antiresonance, damping)
    a, b, c = model._state_space()
    expected = control.ss(a, b[:, None], c[None, :], 0).sample(SAMPLE_TIME)
    held = model.held(SAMPLE_TIME)
    found = held.response(FREQUENCY)
    z = np.exp(2j * np.pi * FREQUENCY * SAMPLE_TIME)
    np.testing.assert_allclose(found, expected(z), rtol=1e-5, atol=0)
    assert held.relative_degree == 1
    below = FREQUENCY < 2000
    np.testing.assert_allclose(
        model.response(FREQUENCY[below], SAMPLE_TIME), found[below], rtol=1e-5, atol=0
    )


@pytest.mark.parametrize(
    "model",
    [
        PlantModel(1.5e-5, 5e-5),
        PlantModel(2e-5, 1e-4, 0.9, 50, 0.6),
        PlantModel(2e-5, 0, 0.5, 20, 0.01),
    ],
)
def test_the_equations_of_motion_are_those_of_the_docstring(model):
    """Far below half the rate a held plant is the continuous one, half a sample late."""
    low = FREQUENCY[FREQUENCY < 100]
    s = 2j * np.pi * low
    late = np.exp(-s * SAMPLE_TIME / 2) * np.sinc(low * SAMPLE_TIME)
    np.testing.assert_allclose(
        model.held(SAMPLE_TIME).response(low), continuous(model)(s) * late, rtol=1e-3, atol=0
    )


def test_a_rigid_plant_without_friction_is_the_double_integrator():
    found, expected = PlantModel(1.5e-5).held(SAMPLE_TIME), double_integrator(1.5e-5, SAMPLE_TIME)
    np.testing.assert_allclose(found.num_delta, expected.num_delta, rtol=1e-12, atol=0)
    np.testing.assert_allclose(found.den_delta, expected.den_delta, rtol=0, atol=1e-15)


def test_masses_below_and_above_the_resonance():
    model = PlantModel(2e-5, 0.0, 0.6, 50.0, 0.005)
    response = np.abs(model.held(SAMPLE_TIME).response(np.array([2.0, 500.0])))
    inertia = 1 / (response * (2 * np.pi * np.array([2.0, 500.0])) ** 2)
    np.testing.assert_allclose(inertia, [2e-5, 1.2e-5], rtol=0.02, atol=0)
    near = np.linspace(40, 80, 2001)
    magnitude = np.abs(model.held(SAMPLE_TIME).response(near)) * near**2
    assert near[np.argmin(magnitude)] == pytest.approx(50, abs=0.1)
    assert near[np.argmax(magnitude)] == pytest.approx(model.resonance_hz, abs=0.1)
    with pytest.raises(ValueError, match="no resonance"):
        _ = PlantModel(1e-5).resonance_hz


def test_mass_line_of_the_thesis():
    """[7.2.3]: the mass line of 1.566e-5 kg m2 crosses 0 dB at 40 Hz."""
    assert PlantModel(1.566e-5).mass_line_crossing == pytest.approx(40, abs=0.5)
