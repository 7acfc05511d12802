"""The loop against python-control and closed forms."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import signal

from rigtool.control.position_loop import (
    RunningController,
    TransferFunction,
    controller_sections,
    double_integrator,
    largest_deviation,
    position_loop,
    stable_one_sample_late,
)
from tests.other_tools import control

SAMPLE_TIME = 125e-6
THESIS = {
    "crossover_hz": 50.0,
    "lead_ratio": 3.0,
    "integrator_hz": 8.0,
    "lowpass_hz": 400.0,
    "lowpass_damping": 0.7,
    "inertia": 1.503e-5,
    "sample_time": SAMPLE_TIME,
}
FREQUENCY = np.geomspace(1, 3900, 200)


def shaped(**settings):
    """Build C(s) with gain one, as the recipe describes it, with python-control."""
    k = {**THESIS, **settings}
    s = control.tf("s")
    wc, wi, wl = (2 * np.pi * k[name] for name in ("crossover_hz", "integrator_hz", "lowpass_hz"))
    lead = (s * k["lead_ratio"] / wc + 1) / (s / (wc * k["lead_ratio"]) + 1)
    smooth = 1 / (s**2 / wl**2 + 2 * k["lowpass_damping"] * s / wl + 1)
    return (s + wi) / s * lead * smooth if wi else lead * smooth


def frequency_response(system, frequency):
    return system(np.exp(2j * np.pi * frequency * SAMPLE_TIME))


@pytest.mark.parametrize("integrator_hz", [8.0, 0.0])
def test_controller_is_tustin_of_its_definition(integrator_hz):
    sections = controller_sections(**{**THESIS, "integrator_hz": integrator_hz})
    expected = frequency_response(
        control.sample_system(shaped(integrator_hz=integrator_hz), SAMPLE_TIME, "tustin"), FREQUENCY
    )
    _, found = signal.sosfreqz(sections, FREQUENCY, fs=1 / SAMPLE_TIME)
    ratio = found / expected
    assert np.abs(ratio - ratio[0]).max() < 1e-6 * abs(ratio[0])
    assert ratio[0].real > 0
    loop = position_loop(**{**THESIS, "integrator_hz": integrator_hz})
    np.testing.assert_allclose(loop.controller.response(FREQUENCY), found, rtol=1e-6, atol=0)


def test_plant_is_the_held_double_integrator():
    inertia = 1.5e-5
    s = control.tf("s")
    exact = control.sample_system(1 / (inertia * s**2), SAMPLE_TIME, "zoh")
    np.testing.assert_allclose(
        double_integrator(inertia, SAMPLE_TIME).response(FREQUENCY),
        frequency_response(exact, FREQUENCY),
        rtol=1e-6,
        atol=0,
    )


def test_loop_agrees_with_feedback_by_python_control():
    loop = position_loop(**THESIS)
    controller, plant = (
        control.tf(part.num, part.den, SAMPLE_TIME) for part in (loop.controller, loop.plant)
    )
    c, p = (frequency_response(part, FREQUENCY) for part in (controller, plant))
    for name, expected in (
        ("complementary_sensitivity", c * p / (1 + c * p)),
        ("sensitivity", 1 / (1 + c * p)),
        ("process_sensitivity", p / (1 + c * p)),
    ):
        np.testing.assert_allclose(
            getattr(loop, name).response(FREQUENCY), expected, rtol=1e-6, atol=0
        )
    closed = control.feedback(controller * plant)
    assert np.abs(closed.poles()).max() < 1
    assert loop.stable


def test_default_loop_has_the_thesis_bandwidth_and_margin():
    """[7.2.4.2]: T reaches to about 100 Hz; the modulus margin is ours: 6 dB."""
    loop = position_loop(**THESIS)
    fine = np.linspace(1, 4000, 40000)
    magnitude = np.abs(loop.complementary_sensitivity.response(fine))
    bandwidth = fine[np.flatnonzero(magnitude > np.sqrt(0.5))[-1]]
    assert bandwidth == pytest.approx(100, abs=5)
    assert np.abs(loop.sensitivity.response(fine)).max() < 2


@settings(max_examples=40, deadline=None)
@given(
    crossover=st.floats(5, 200),
    lead=st.floats(1.5, 6),
    integrator=st.floats(0, 30),
    lowpass=st.floats(300, 3000),
    damping=st.floats(0.3, 1.5),
    inertia=st.floats(1e-7, 1e-2),
)
def test_open_loop_has_gain_one_at_crossover(
    crossover, lead, integrator, lowpass, damping, inertia
):
    loop = position_loop(
        crossover_hz=crossover,
        lead_ratio=lead,
        integrator_hz=integrator,
        lowpass_hz=lowpass,
        lowpass_damping=damping,
        inertia=inertia,
        sample_time=SAMPLE_TIME,
    )
    at = np.array([crossover])
    gain = abs(loop.controller.response(at)[0] * loop.plant.response(at)[0])
    assert gain == pytest.approx(1, rel=1e-6, abs=0)
    # Sensitivity and complementary sensitivity add up to one.
    total = loop.sensitivity.response(FREQUENCY) + loop.complementary_sensitivity.response(
        FREQUENCY
    )
    np.testing.assert_allclose(total, 1, rtol=0, atol=1e-9)


@settings(max_examples=50, deadline=None)
@given(
    num=st.lists(st.floats(-3, 3), min_size=1, max_size=5),
    den=st.lists(st.floats(-3, 3), min_size=1, max_size=5),
)
def test_polynomials_in_z_come_back(num, den):
    num, den = [1.0, *num], [2.0, *den]
    system = TransferFunction.from_z(num, den, SAMPLE_TIME)
    np.testing.assert_allclose(system.num, num, rtol=0, atol=1e-12)
    np.testing.assert_allclose(system.den, den, rtol=0, atol=1e-12)
    assert system.relative_degree == len(den) - len(num)
    _, expected = signal.freqz(
        *(np.pad(p, (max(len(num), len(den)) - len(p), 0)) for p in (num, den)),
        worN=2 * np.pi * FREQUENCY * SAMPLE_TIME,
    )
    far = np.abs(np.polyval(den, np.exp(2j * np.pi * FREQUENCY * SAMPLE_TIME))) > 1e-3
    np.testing.assert_allclose(system.response(FREQUENCY)[far], expected[far], rtol=1e-9, atol=1e-9)


def test_an_unstable_loop_is_reported():
    assert not position_loop(**{**THESIS, "lead_ratio": 1.01, "integrator_hz": 100.0}).stable


@pytest.mark.parametrize(
    ("wrong", "message"),
    [({"crossover_hz": 4000.0}, "crossover_hz 4000"), ({"lowpass_hz": 5000.0}, "lowpass_hz 5000")],
)
def test_frequencies_above_half_the_rate_are_refused(wrong, message):
    with pytest.raises(ValueError, match=message):
        controller_sections(**{**THESIS, **wrong})


def test_a_transfer_function_of_nothing_is_refused():
    with pytest.raises(ValueError, match="other than zero"):
        TransferFunction.from_z(np.zeros(3), np.ones(2), SAMPLE_TIME)
    with pytest.raises(ValueError, match="positive"):
        TransferFunction.from_z([1], [1, 0.5], 0.0)


SLOWER = THESIS | {"sample_time": 1e-3, "lowpass_hz": 200.0}


@pytest.mark.parametrize("integrator_hz", [8.0, 0.0])
def test_the_running_controller_is_scipys_filter_of_its_sections(integrator_hz):
    sections = controller_sections(**SLOWER | {"integrator_hz": integrator_hz})
    error = np.random.default_rng(1).standard_normal(50)
    running = RunningController(sections)
    found = [running.torque(each) for each in error]
    np.testing.assert_allclose(found, signal.sosfilt(sections, error), rtol=1e-9)


@pytest.mark.parametrize("crossover_hz", [10.0, 50.0])
def test_the_largest_deviation_is_the_peak_of_the_step_response(crossover_hz):
    design = SLOWER | {"crossover_hz": crossover_hz}
    loop = position_loop(**design).process_sensitivity
    num = np.pad(loop.num, (loop.relative_degree, 0))
    answer = signal.lfilter(num, loop.den, np.ones(300))
    assert 5 < np.argmax(answer) < 100
    assert largest_deviation(**design) == pytest.approx(answer.max(), rel=1e-6)


def test_a_sample_of_delay_is_a_pole_at_zero_in_the_loop():
    verdicts = []
    for crossover_hz in np.geomspace(20, 190, 12):
        design = SLOWER | {"crossover_hz": crossover_hz}
        loop = position_loop(**design)
        late = np.append(np.convolve(loop.controller.den, loop.plant.den), 0.0)
        closed = np.polyadd(late, np.convolve(loop.controller.num, loop.plant.num))
        verdicts.append(stable_one_sample_late(**design))
        assert verdicts[-1] == (np.abs(np.roots(closed)).max() < 1)
    assert verdicts == sorted(verdicts, reverse=True)
    assert verdicts.count(True) not in (0, 12)
