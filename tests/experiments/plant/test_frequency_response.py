"""A plant inside a loop that disturbances shake, simulated by scipy: no bias, an honest u."""

from dataclasses import replace

import numpy as np
import pytest
from scipy import signal

from rigtool.errors import InsufficientDataError
from rigtool.experiments.plant.frequency_response import (
    Experiment,
    coverage_radius,
    frequency_response,
)
from rigtool.experiments.plant.multisine import periodic, quasi_log_lines

SAMPLE_TIME = 1e-3
SAMPLES, PERIODS = 250, 8
LINES = quasi_log_lines(2, 100, 20)
FREQUENCY = LINES / (SAMPLES * SAMPLE_TIME)
# y = P u, u = r - C y, and a disturbance is added to y: P = 0.1/(z - 0.9), C = 4
POLE, GAIN, CONTROLLER = 0.9, 0.1, 4.0
PLANT = GAIN / (np.exp(2j * np.pi * FREQUENCY * SAMPLE_TIME) - POLE)


def experiments(count, noise, seed=0):
    """Simulate the loop, periods after a first one in which it settles."""
    rng = np.random.default_rng(seed)
    made = []
    for _ in range(count):
        phases = np.exp(2j * np.pi * rng.random(len(LINES)))
        r = np.tile(periodic(LINES, phases, SAMPLES), PERIODS + 1)
        v = noise * rng.standard_normal(len(r))
        closed = [1, GAIN * CONTROLLER - POLE]
        y = signal.lfilter([0, GAIN], closed, r) + signal.lfilter([1, -POLE], closed, v)
        u = r - CONTROLLER * y
        made.append(Experiment(*(x[SAMPLES:].reshape(PERIODS, -1) for x in (r, u, y, y))))
    return made


def test_without_noise_it_is_the_plant():
    found = frequency_response(experiments(3, 0.0), LINES, SAMPLE_TIME)
    np.testing.assert_allclose(found.frequency, FREQUENCY, rtol=1e-12, atol=0)
    np.testing.assert_allclose(found.response, PLANT, rtol=1e-9, atol=0)
    np.testing.assert_allclose(found.coherence, 1, rtol=1e-9, atol=0)


def test_disturbances_around_the_loop_do_not_bias_it():
    """The ratio of spectra of y and u is led towards -1/C by the noise; this one is not."""
    made = experiments(400, 1.0)
    found = frequency_response(made, LINES, SAMPLE_TIME)
    z = (found.response - PLANT) / found.u
    score = np.concatenate([z.real, z.imag])
    assert np.abs(score).max() < 4
    assert 0.6 < np.mean(score**2) < 1.6
    u, y = (
        np.stack([np.fft.rfft(getattr(e, name), axis=-1)[:, LINES] for e in made])
        for name in ("input", "output")
    )
    naive = np.sum(y * u.conj(), axis=(0, 1)) / np.sum(np.abs(u) ** 2, axis=(0, 1))
    assert np.median(np.abs(naive - PLANT) / found.u) > 10


def test_the_radius_holds_the_truth_as_often_as_it_says():
    inside = [
        np.abs(found.response - PLANT) < found.radius
        for found in (
            frequency_response(experiments(6, 0.3, seed), LINES, SAMPLE_TIME) for seed in range(60)
        )
    ]
    assert np.mean(inside) == pytest.approx(0.95, abs=0.025)


def test_the_radius_of_many_degrees_of_freedom_is_that_of_rayleigh():
    assert coverage_radius(np.ones(1), 1e7)[0] == pytest.approx(
        np.sqrt(-2 * np.log(0.05)), rel=1e-4, abs=0
    )


def test_coherence_is_the_share_of_the_excitation():
    """Of y in one period: |T/C|^2 of the line against the noise's mean power there."""
    found = frequency_response(experiments(400, 0.5), LINES, SAMPLE_TIME)
    z = np.exp(2j * np.pi * FREQUENCY * SAMPLE_TIME)
    sensitivity = (z - POLE) / (z - POLE + GAIN * CONTROLLER)
    powers = []
    for response in (sensitivity * PLANT, sensitivity):
        excited = np.abs(response) ** 2 * (SAMPLES / 2) ** 2
        gain = 1.0 if response is not sensitivity else CONTROLLER
        noise = np.abs(gain * sensitivity) ** 2 * 0.25 * SAMPLES
        powers.append((excited + noise / PERIODS) / (excited + noise))
    np.testing.assert_allclose(found.coherence, np.minimum(*powers), rtol=0.05, atol=0)


def test_what_steps_of_the_output_cause():
    """Against an output that is rounded: its error is nearly white where it moves enough."""
    rng = np.random.default_rng(5)
    step = 0.02
    made = experiments(60, 0.0, seed=3)
    rounded = []
    for e in made:
        wobble = rng.random((PERIODS, SAMPLES)) * step  # what else moves the shaft
        steps = np.floor((e.output + wobble) / step) * step - wobble + step / 2
        rounded.append(replace(e, output=steps))
    found = frequency_response(rounded, LINES, SAMPLE_TIME, step)
    assert np.mean(np.square(found.u / found.quantisation)) == pytest.approx(1, abs=0.2)


def test_too_few_experiments_and_lines_that_are_not_excited_are_refused():
    made = experiments(3, 0.1)
    with pytest.raises(InsufficientDataError, match=r"2 experiments .* 3 are needed"):
        frequency_response(made[:2], LINES, SAMPLE_TIME)
    with pytest.raises(InsufficientDataError, match="line 111 of the period is not excited"):
        frequency_response(made, np.append(LINES, 111), SAMPLE_TIME)


@pytest.mark.parametrize("unit", [1e-6, 1.0, 1e6])
@pytest.mark.parametrize(("quiet", "refused"), [(2e-5, False), (5e-6, True)])
def test_a_line_is_quiet_beside_the_others_in_any_unit(unit, quiet, refused):
    made = experiments(3, 0.1)
    spectrum = np.fft.rfft(made[0].reference, axis=-1)
    # all alike, and one this many times below
    spectrum[:, LINES] = 1.0
    spectrum[:, LINES[3]] = quiet
    reference = unit * np.fft.irfft(spectrum, made[0].reference.shape[-1], axis=-1)
    one = replace(made[0], reference=reference)
    if refused:
        with pytest.raises(InsufficientDataError, match=f"line {LINES[3]} of the period"):
            frequency_response([one, *made[1:]], LINES, SAMPLE_TIME)
    else:
        frequency_response([one, *made[1:]], LINES, SAMPLE_TIME)


def test_some_lines_of_a_response():
    found = frequency_response(experiments(4, 0.1), LINES, SAMPLE_TIME)
    keep = LINES > 20
    part = found.lines(keep)
    np.testing.assert_allclose(part.response, found.response[keep], rtol=1e-12, atol=0)
    np.testing.assert_allclose(part.u, found.u[keep], rtol=1e-12, atol=0)
    assert part.dof == found.dof == 6
