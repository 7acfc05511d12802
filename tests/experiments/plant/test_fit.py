"""Fits to made-up responses: the truth within its uncertainty, masses as many as there are."""

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy import stats

from rigtool.control.plant_models import PlantModel
from rigtool.errors import InsufficientDataError
from rigtool.experiments.plant.curvature import SlopeRise
from rigtool.experiments.plant.fit import PlantFit, _Data, fit_plant
from rigtool.experiments.plant.frequency_response import FrequencyResponse
from rigtool.experiments.plant.results import IdentifiedPlant
from rigtool.quantity import Quantity
from tests.thorough import first_of

SAMPLE_TIME = 125e-6
FREQUENCY = np.unique(np.geomspace(1, 62, 40).round()) * 4.0
RIGID = PlantModel(1.566e-5, 5.33e-5)
TWO = PlantModel(2.08e-5, 1e-4, 0.9, 50.0, 0.6)
NOMINAL = 1.5e-5


def measured(model, seed, *, noise=2e-3, experiments=8, lag=70e-6, coherence=1.0):
    """Return the response of a plant behind an amplifier with a lag of first order."""
    rng = np.random.default_rng(seed)
    omega = 2 * np.pi * FREQUENCY
    truth = model.held(SAMPLE_TIME).response(FREQUENCY) / (1 + 1j * omega * lag)
    shape = (experiments, len(FREQUENCY))
    scatter = noise * (rng.standard_normal(shape) + 1j * rng.standard_normal(shape))
    level = np.full(len(FREQUENCY), coherence)
    return FrequencyResponse(FREQUENCY, truth * (1 + scatter), level, np.zeros(len(FREQUENCY)))


def fitted(*args, **options):
    return fit_plant(measured(*args, **options), SAMPLE_TIME, NOMINAL)


def test_without_scatter_it_is_the_plant():
    fit = fitted(RIGID, 0, noise=1e-9, lag=0.0)
    assert fit.model.rigid
    assert fit.model.inertia == pytest.approx(RIGID.inertia, rel=1e-6, abs=0)
    assert fit.model.viscous == pytest.approx(RIGID.viscous, rel=1e-5, abs=0)
    assert abs(fit.delay) < 1e-11


@pytest.mark.parametrize("model", [RIGID, TWO])
def test_the_unit_of_torque_changes_nothing(model):
    unit, found = 64.0, measured(model, 3)
    smaller = replace(found, each=found.each / unit, quantisation=found.quantisation / unit)
    one, other = (
        fit_plant(each, SAMPLE_TIME, NOMINAL * size) for each, size in ((found, 1), (smaller, unit))
    )
    assert other.model.rigid == one.model.rigid
    for statistic, size in (
        (lambda fit: fit.model.inertia, unit),
        (lambda fit: fit.model.viscous, unit),
        (lambda fit: fit.delay, 1.0),
        (lambda fit: fit.misfit, 1.0),
        (lambda fit: fit.model.antiresonance_hz, 1.0),
    ):
        assert statistic(other) / size == pytest.approx(statistic(one), rel=1e-4)
        assert other.scatter(statistic) / size == pytest.approx(one.scatter(statistic), rel=1e-3)
        assert other.doubt(statistic) / size == pytest.approx(one.doubt(statistic), rel=1e-3)


@pytest.mark.parametrize("seed", [1, 4])
def test_an_inertia_that_friction_hides_is_refused(seed):
    """Up to 1.3 kHz friction outweighs it, and lines end at 248 Hz."""
    with pytest.raises(InsufficientDataError, match="scatter changes its logarithm by"):
        fitted(PlantModel(5e-7, 4e-3), seed, noise=0.02, lag=1e-4)


@pytest.mark.parametrize("seed", [0, 2, 3])
def test_one_that_friction_nearly_hides_is_uncertain(seed):
    fit = fitted(PlantModel(5e-7, 4e-3), seed, noise=0.02, lag=1e-4)
    u = fit.scatter(lambda fit: fit.model.inertia)
    assert 0.2 < u / fit.model.inertia < 1.5
    assert abs(fit.model.inertia - 5e-7) < 3 * u


@pytest.mark.parametrize("seed", range(3))
def test_a_fit_ends_at_the_same_wherever_its_search_begins(seed):
    found = measured(RIGID, seed)
    one, other = (fit_plant(found, SAMPLE_TIME, size * NOMINAL) for size in (1, 2))
    for statistic in (
        lambda fit: fit.model.inertia,
        lambda fit: fit.model.viscous,
        lambda fit: fit.delay,
        lambda fit: fit.roll_off,
        lambda fit: fit.misfit,
    ):
        assert statistic(other) == pytest.approx(statistic(one), rel=3e-9)


def test_a_fit_that_friction_leaves_open_stays_where_its_search_ends():
    every = np.full(len(FREQUENCY), True)
    start = PlantFit(PlantModel(NOMINAL), 0.0, 0.0, 0.0, SAMPLE_TIME, every, 1.0, 1.0)
    for seed in range(8):
        found = measured(PlantModel(2e-6, 4e-3), seed, noise=0.2, lag=1e-4)
        data = _Data(found, SAMPLE_TIME)
        searched = data.fitted(start)
        assert data.settled(searched).misfit <= searched.misfit * (1 + 1e-9)


def test_an_amplifiers_lag_is_distinguished_from_the_plant():
    """1/(1 + s tau): a delay of tau, and a gain of 1 - (w tau)^2/2."""
    fit = fitted(RIGID, 0, noise=1e-6)
    assert fit.delay == pytest.approx(70e-6, rel=0.01, abs=0)
    assert fit.roll_off == pytest.approx(70e-6**2 / 2, rel=0.02, abs=0)
    assert fit.model.inertia == pytest.approx(RIGID.inertia, rel=1e-4, abs=0)


@pytest.mark.parametrize("corner_hz", [100.0, 200.0, 300.0])
def test_lines_beyond_a_slow_current_loop_are_left_out(corner_hz):
    fit = fitted(RIGID, 1, lag=1 / (2 * math.pi * corner_hz))
    assert FREQUENCY[fit.used].max() < 0.5 * corner_hz
    assert fit.misfit < 2
    error = fit.model.inertia - RIGID.inertia
    assert abs(error) < 3 * fit.scatter(lambda one: one.model.inertia)
    assert abs(error) < 0.005 * RIGID.inertia


def test_a_current_loop_that_is_slower_than_nearly_all_lines_is_named():
    with pytest.raises(InsufficientDataError, match="current loop is slow"):
        fitted(RIGID, 1, lag=1 / (2 * math.pi * 10))


def test_friction_does_not_take_the_place_of_a_slow_amplifier():
    """Its phase at high lines, a third power of frequency, would be fitted by friction."""
    fit = fitted(RIGID, 0, noise=1e-6, lag=200e-6)
    assert fit.model.viscous == pytest.approx(RIGID.viscous, rel=5e-3, abs=0)


def test_uncertainties_are_what_repetition_shows():
    """Deviations from the truth over their u, for many realisations.

    Of two honest estimates of u the larger one counts: a little less than one is expected.
    """
    scores = []
    for seed in range(40):
        fit = fitted(RIGID, seed)
        assert fit.model.rigid
        assert fit.misfit == pytest.approx(1, abs=0.5)
        for name, scale in (("inertia", RIGID.inertia), ("viscous", RIGID.viscous)):
            u = fit.scatter(lambda f, name=name: getattr(f.model, name))
            scores.append((getattr(fit.model, name) - scale) / u)
            assert 0 < u < 0.1 * scale
    assert 0.4 < np.mean(np.square(scores)) < 1.2
    assert np.abs(scores).max() < 4


@pytest.mark.parametrize("seed", first_of(range(4)))
def test_two_masses_are_found_where_there_are_two(seed):
    fit = fitted(TWO, seed)
    assert not fit.model.rigid
    assert fit.rigid_rejected < 1e-4
    for statistic, truth in (
        (lambda f: f.model.inertia, TWO.inertia),
        (lambda f: f.model.inertia * f.model.motor_side, TWO.inertia * TWO.motor_side),
        (lambda f: f.model.antiresonance_hz, TWO.antiresonance_hz),
        (lambda f: f.model.damping, TWO.damping),
        (lambda f: f.model.resonance_hz, TWO.resonance_hz),
    ):
        u = fit.scatter(statistic)
        assert abs(statistic(fit) - truth) < 4 * u
        assert u < 0.1 * truth


@pytest.mark.parametrize("antiresonance", [2.0, 1500.0])
def test_a_resonance_outside_the_band_is_no_second_mass(antiresonance):
    fit = fitted(PlantModel(2e-5, 5e-5, 0.8, antiresonance, 0.1), 1)
    assert fit.model.rigid
    mass = 0.8 if antiresonance < 4 else 1.0
    assert fit.model.inertia == pytest.approx(mass * 2e-5, rel=0.02, abs=0)


def test_what_a_possible_second_mass_would_change_is_an_uncertainty_beside_scatter():
    fit = fitted(PlantModel(2e-5, 5e-5, 0.97, 60.0, 0.6), 0, noise=3e-2)
    assert fit.model.rigid
    assert 1e-4 < fit.rigid_rejected < 0.05
    assert not fit.possible.model.rigid
    # two values a line, less five and eight parameters: the F test of nested models
    free, more = 2 * len(FREQUENCY) - 5, 2 * len(FREQUENCY) - 8
    left, rest = fit.misfit**2 * free, fit.possible.misfit**2 * more
    test = stats.f(3, more).sf((left - rest) / 3 / (rest / more))
    assert fit.rigid_rejected == pytest.approx(test, rel=1e-6)
    constant = Quantity(0.05, "N m/A", 1e-5)
    plant = IdentifiedPlant(measured(RIGID, 0), fit, constant, 0.5, SlopeRise(0.0, 1e-5, 6))
    for name in ("inertia", "viscous"):

        def statistic(f, name=name):
            return getattr(f.model, name)

        change = abs(statistic(fit.possible) - statistic(fit))
        assert fit.doubt(statistic) == change > 0
        found = plant.quantity(statistic, "1")
        lines = {line.name: line.contribution for line in found.budget}
        assert lines["second mass"] == change
        assert found.u >= math.hypot(fit.scatter(statistic), change) * (1 - 1e-9)


@pytest.mark.parametrize("seed", [2, 6])
def test_behind_a_tendon_a_second_mass_that_does_not_show_is_possible(seed):
    hidden = replace(TWO, motor_side=0.96, damping=1.0)
    found = measured(hidden, seed, noise=4e-2, experiments=6)
    plain, known = (
        fit_plant(found, SAMPLE_TIME, NOMINAL, tendon=tendon) for tendon in (False, True)
    )
    assert plain.possible is None
    assert known.model == plain.model
    assert known.possible is not None
    assert known.doubt(lambda fit: fit.model.inertia) > 0


def test_a_second_mass_shows_also_where_experiments_scatter_by_more_than_lines_do():
    """Errors of whole experiments make their scatter large, and hardly bend the response."""
    small = PlantModel(2.08e-5, 1e-4, 0.96, 50.0, 0.6)
    found, rng = measured(small, 0), np.random.default_rng(1)
    level, tilt = 0.05 * rng.standard_normal((2, len(found.each), 1))
    each = found.each * (1 + level + tilt * np.log(FREQUENCY / 30))
    fit = fit_plant(replace(found, each=each), SAMPLE_TIME, NOMINAL)
    assert fit.rigid_rejected < 1e-4
    assert not fit.model.rigid
    assert abs(fit.model.inertia - small.inertia) < 3 * fit.scatter(lambda f: f.model.inertia)


def test_a_plant_that_no_model_explains_is_more_uncertain():
    found = measured(RIGID, 3)
    bump = 1 + 0.05 * np.sin(np.log(FREQUENCY) * 12)
    bumpy = FrequencyResponse(FREQUENCY, found.each * bump, found.coherence, found.quantisation)
    plain, odd = (fit_plant(f, SAMPLE_TIME, NOMINAL) for f in (found, bumpy))

    def inertia(fit):
        return fit.model.inertia

    assert odd.misfit > 5
    assert odd.scatter(inertia) > 3 * plain.scatter(inertia)
    assert abs(odd.model.inertia - RIGID.inertia) < 3 * odd.scatter(inertia)


def test_lines_of_little_coherence_are_left_out():
    found = measured(RIGID, 2)
    coherence = np.where(FREQUENCY < 12, 0.5, 0.99)
    wrong = found.each * np.where(FREQUENCY < 12, 2.0, 1.0)
    fit = fit_plant(
        FrequencyResponse(FREQUENCY, wrong, coherence, found.quantisation), SAMPLE_TIME, NOMINAL
    )
    np.testing.assert_array_equal(fit.used, FREQUENCY >= 12)
    assert fit.model.inertia == pytest.approx(RIGID.inertia, rel=0.005, abs=0)


def test_an_excitation_that_is_lost_is_refused():
    with pytest.raises(InsufficientDataError, match=r"only 0 of \d+ lines .* raise identify_plant"):
        fitted(RIGID, 0, coherence=0.6)


def test_fewer_than_half_of_the_lines_are_too_few():
    """Nine lines would carry a fit; a plant is not judged by a quarter of what was excited."""
    found = measured(RIGID, 2)
    coherence = np.where(np.arange(len(FREQUENCY)) < 9, 0.99, 0.5)
    with pytest.raises(InsufficientDataError, match=r"only 9 of \d+ lines .* half of them"):
        fit_plant(replace(found, coherence=coherence), SAMPLE_TIME, NOMINAL)


@pytest.mark.parametrize("coherent", [9, 5])
def test_lines_that_the_steps_of_the_encoder_hide_need_more_counts(coherent):
    """More periods would not help: coherence is that in one."""
    found = measured(RIGID, 2)
    coherence = np.where(np.arange(len(FREQUENCY)) < coherent, 0.99, 0.5)
    hidden = replace(found, coherence=coherence, quantisation=0.9 * found.u)
    with pytest.raises(InsufficientDataError, match=r"encoder; .* with more counts") as error:
        fit_plant(hidden, SAMPLE_TIME, NOMINAL)
    remedy = f"lower identify_plant.frequency_max to {FREQUENCY[8]:.4g} Hz"
    assert (remedy in str(error.value)) == (coherent == 9)
    assert "periods" not in str(error.value)
    with pytest.raises(InsufficientDataError, match="lost in disturbances; raise"):
        fit_plant(replace(hidden, quantisation=0.5 * found.u), SAMPLE_TIME, NOMINAL)


def test_a_line_on_which_ripple_falls_is_no_second_mass():
    """Its scatter is its own, many times that of its neighbours, and 3.3 of it is its error."""
    for seed in range(4):
        response = measured(RIGID, seed, noise=3e-3)
        rng = np.random.default_rng([seed, 1])
        for line, error in ((1, 0.0), (2, -0.11 + 0.03j)):
            own = rng.standard_normal((2, 8))
            own = 0.09 * (own - own.mean(axis=1, keepdims=True)) / own.std(axis=1, keepdims=True)
            response.each[:, line] *= 1 + error + own[0] + 1j * own[1]
        fit = fit_plant(response, SAMPLE_TIME, NOMINAL)
        u = fit.scatter(lambda f: f.model.inertia)
        assert fit.model.rigid
        assert abs(fit.model.inertia - RIGID.inertia) < 3 * u
