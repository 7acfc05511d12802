"""Margins against python-control."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from rigtool.control.plant_models import PlantModel
from rigtool.control.position_loop import Loop, position_loop
from rigtool.experiments.plant.margins import margins
from tests.other_tools import control

SAMPLE_TIME = 125e-6
HALF_RATE = 0.499 / SAMPLE_TIME


def loop(inertia=1.566e-5, viscous=5e-5, **changes):
    k = {
        "crossover_hz": 50.0,
        "lead_ratio": 3.0,
        "integrator_hz": 4.0,
        "lowpass_hz": 400.0,
        "lowpass_damping": 0.7,
        **changes,
    }
    nominal = position_loop(**k, inertia=1.503e-5, sample_time=SAMPLE_TIME)
    return Loop(nominal.controller, PlantModel(inertia, viscous).held(SAMPLE_TIME))


def found(made):
    return margins(lambda f: made.controller.response(f) * made.plant.response(f), HALF_RATE)


@settings(max_examples=10, deadline=None)
@given(
    crossover_hz=st.floats(20, 90),
    lead_ratio=st.floats(2.5, 6),
    lowpass_hz=st.floats(350, 900),
    inertia=st.floats(1.2e-5, 2e-5),
)
def test_margins_are_those_of_python_control(crossover_hz, lead_ratio, lowpass_hz, inertia):
    made = loop(inertia, crossover_hz=crossover_hz, lead_ratio=lead_ratio, lowpass_hz=lowpass_hz)
    frequency = np.geomspace(5, 1000, 400)
    response = made.controller.response(frequency) * made.plant.response(frequency)
    data = control.frd(response, 2 * np.pi * frequency, smooth=True)
    gains, phases, distances, _, crossovers, _ = control.stability_margins(data, returnall=True)
    here = found(made)
    assert here.gain == pytest.approx(gains[gains > 1].min(), rel=1e-4, abs=0)
    assert here.phase == pytest.approx(np.radians(np.abs(phases).min()), rel=1e-4, abs=0)
    assert here.modulus == pytest.approx(distances.min(), rel=1e-4, abs=0)
    assert here.crossover_hz == pytest.approx(crossovers.max() / (2 * np.pi), rel=1e-4, abs=0)


def test_bandwidth_is_that_of_python_control():
    made = loop()
    c, p = (control.tf(g.num, g.den, SAMPLE_TIME) for g in (made.controller, made.plant))
    z = np.exp(2j * np.pi * found(made).bandwidth_hz * np.array([0.5, 1, 1.001]) * SAMPLE_TIME)
    below, at, above = np.abs(control.feedback(c * p, 1)(z))
    assert at == pytest.approx(np.sqrt(0.5), rel=1e-4, abs=0)
    assert above < np.sqrt(0.5) < below


def test_sensitivities_are_those_of_python_control():
    made = loop()
    z = np.exp(2j * np.pi * np.geomspace(5, 3000, 50) * SAMPLE_TIME)
    frequency = np.angle(z) / (2 * np.pi * SAMPLE_TIME)
    c, p = (control.tf(g.num, g.den, SAMPLE_TIME) for g in (made.controller, made.plant))
    for ours, theirs in (
        (made.sensitivity, control.feedback(1, c * p)),
        (made.complementary_sensitivity, control.feedback(c * p, 1)),
        (made.process_sensitivity, control.feedback(p, c)),
    ):
        np.testing.assert_allclose(ours.response(frequency), theirs(z), rtol=1e-4, atol=0)


def test_a_loop_that_never_crosses_has_no_such_margin():
    here = margins(lambda f: 0.1 / (1 + 1j * f / 10), 4000.0)
    assert np.isnan(here.gain)
    assert np.isnan(here.phase)
    assert np.isnan(here.crossover_hz)
    assert here.modulus == pytest.approx(1, rel=1e-3, abs=0)


def test_a_delay_costs_phase():
    made = loop()
    delay = 1e-4

    def late(f):
        return (
            made.controller.response(f) * made.plant.response(f) * np.exp(-2j * np.pi * f * delay)
        )

    lost = found(made).phase - margins(late, HALF_RATE).phase
    assert lost == pytest.approx(2 * np.pi * found(made).crossover_hz * delay, rel=1e-6, abs=0)


@pytest.mark.parametrize("lowest_hz", [11.7, 37.3, 211.0])
def test_the_modulus_margin_is_found_between_the_points_of_the_grid(lowest_hz):
    """1 + L = (1/2 + ln(f/f0)^2) e^i is closest to zero at f0."""
    here = margins(lambda f: (0.5 + np.log(f / lowest_hz) ** 2) * np.exp(1j) - 1, HALF_RATE)
    assert here.modulus == pytest.approx(0.5, rel=1e-9, abs=0)


def test_signs_that_are_rounding_and_a_response_of_zero_are_no_error():
    def rounded(frequency):
        noise = np.where(np.arange(frequency.size) % 2, -1e-20, 1e-20)
        return np.where(frequency > 1000, 0.0, -50 / frequency) + 1j * noise

    result = margins(rounded, HALF_RATE)
    assert result.crossover_hz == pytest.approx(50)
    assert result.gain > 1
