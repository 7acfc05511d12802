"""Identification on the virtual rig: the inertia that is there, and what is refused."""

import math

import GTC
import numpy as np
import pytest

from rigtool.errors import InsufficientDataError, RecipeError, RunFileError
from rigtool.experiments.plant import procedure as identify_plant
from rigtool.experiments.plant.curvature import excited_speed
from rigtool.experiments.plant.frequency_response import Experiment
from rigtool.experiments.plant.procedure import PROCEDURE as IDENTIFY_PLANT
from rigtool.experiments.plant.procedure_excitation import (
    excitations,
    excited_lines,
    multisine,
    period_samples,
    tasks,
)
from rigtool.experiments.torque_per_ampere import torque_per_ampere_at
from rigtool.quantity import Quantity
from rigtool.recipe import load_recipe, override_recipe
from rigtool.runfile import RunWriter, open_run
from rigtool.runfile.recording import Recording
from tests.experiments.virtual_runs import RECIPE, run, write_results
from tests.thorough import first_of
from tests.unchanged import require_unchanged

PULLEY = "rig.attachment=pulley"
SHORT = (
    PULLEY,
    "identify_plant.speeds=[14]",
    "identify_plant.realisations=2",
    "identify_plant.periods=8",
)
STROKES = ("identify_plant.realisations=2", "identify_plant.periods=8")
# What the rig's calibration finds, within its uncertainty: thesis section 7.1.1
CONSTANT = {
    "torque_constant_mean": Quantity(45.4e-3, "N m/A", 2.3e-5, 20),
    "torque_constant": Quantity(45.8e-3, "N m/A", 2.3e-5, 20),
    "torque_constant_temperature_coefficient": Quantity(-1.16e-3, "1/K", 1e-5),
    "amplifier_gain": Quantity(1.0, "1", 1e-6),
}


@pytest.fixture(scope="module")
def kt(folder):
    path = folder / "kt.h5"
    with RunWriter(path, command="calibrate-kt", recipe=None, recipe_text=None) as writer:
        writer.finish(CONSTANT, {})
    return path


@pytest.fixture(scope="module")
def pulley(folder, kt):
    path = folder / "pulley.h5"
    return path, run(IDENTIFY_PLANT, RECIPE, path, *SHORT, kt=kt)


@pytest.fixture(scope="module")
def instrument(folder, kt):
    path = folder / "instrument.h5"
    return path, run(IDENTIFY_PLANT, RECIPE, path, *STROKES, kt=kt)


def test_no_other_number_has_changed(pulley, instrument):
    require_unchanged("plant", pulley[1])
    require_unchanged("plant-instrument", instrument[1])


def motor():
    return load_recipe(RECIPE)[0].virtual.motor


def off(result, truth):
    """Return the deviation from the truth in standard uncertainties."""
    return abs(result.value - truth) / result.u


@pytest.mark.parametrize("seed", first_of([1, 2, 3, 4, 5]))
def test_the_inertia_that_is_there(folder, kt, seed):
    outcome = run(IDENTIFY_PLANT, RECIPE, folder / f"{seed}.h5", *SHORT, seed=seed, kt=kt)
    inertia, viscous = (outcome.results[name] for name in ("inertia", "viscous_friction"))
    assert off(inertia, motor().inertia) < 2
    assert inertia.u < 3e-3 * inertia.value
    assert off(viscous, motor().viscous_friction) < 4  # three degrees of freedom
    assert viscous.u < 0.05 * viscous.value
    assert "inertia_motor_side" not in outcome.results
    assert outcome.results["mass_line_crossing"].value == pytest.approx(40.2, abs=0.1)


@pytest.mark.parametrize(
    "overrides",
    [
        ("virtual.motor.inertia=3e-5", "rig.inertia.pulley=1.8e-5"),
        ("rig.sample_time=250e-6", "rig.controller.crossover_hz=40"),
        pytest.param(
            ("virtual.motor.viscous_friction=3e-4", "virtual.motor.coulomb_friction=6e-3"),
            marks=pytest.mark.thorough,
        ),
        pytest.param(
            ("rig.encoder_counts=16384", "virtual.amplifier.bandwidth_hz=700"),
            marks=pytest.mark.thorough,
        ),
    ],
)
def test_other_rigs(folder, kt, overrides):
    outcome = run(IDENTIFY_PLANT, RECIPE, folder / "other.h5", *SHORT, *overrides, kt=kt)
    recipe = load_recipe(RECIPE, overrides)[0]
    assert off(outcome.results["inertia"], recipe.virtual.motor.inertia) < 3
    # three degrees of freedom: 1 % are beyond 5.8 u
    assert off(outcome.results["viscous_friction"], recipe.virtual.motor.viscous_friction) < 5.8


def test_too_few_experiments_are_refused_before_the_rig_moves():
    alone = ("identify_plant.speeds=[10]", "identify_plant.realisations=1")
    recipe, _ = load_recipe(RECIPE, (*alone, "rig.attachment=pulley"))
    with pytest.raises(RecipeError, match=r"makes 2 experiments, 3 are needed .*realisations"):
        IDENTIFY_PLANT.measure(None, recipe, None)


def test_friction_that_differs_around_the_turn(folder):
    """A rig without other ripple; cut into one period less than recorded, friction is 4 % low."""
    overrides = (
        *SHORT,
        "identify_plant.speeds=[10, 15]",
        "identify_plant.realisations=1",
        "rig.sample_time=500e-6",
        "rig.encoder_counts=100000",
        "virtual.motor.viscous_friction=6e-4",
        "virtual.motor.viscous_modulation=[{order=1, amplitude=0.6}]",
        "virtual.motor.friction_noise=1e-5",
        "virtual.motor.cogging=[]",
        "virtual.amplifier.offset_ripple=[]",
    )
    results = run(IDENTIFY_PLANT, RECIPE, folder / "turn.h5", *overrides).results
    decay = results["viscous_friction"].value / results["inertia"].value
    assert decay == pytest.approx(6e-4 / motor().inertia, rel=5e-3)


def test_what_is_reported(pulley):
    outcome = pulley[1]
    results = outcome.results
    for name in ("bandwidth", "gain_margin", "phase_margin", "modulus_margin"):
        assert 0 < results[name].u < 0.1 * abs(results[name].value), name
    assert results["coherence_min"].value > 0.8
    assert results["bandwidth"].value == pytest.approx(100, rel=0.1)
    table = outcome.tables["frequency_response"]
    fit = outcome.tables["fit"]
    known = np.interp(
        np.log(table["frequency"]), np.log(fit["frequency"]), np.log(fit["magnitude"])
    )
    used = table["used"] == 1
    assert np.abs(np.log(table["magnitude"]) - known)[used].max() < 0.03
    assert (table["coherence"][used] >= 0.8).all()
    assert (table["u"] > 0).all()
    assert (table["radius"] > 2 * table["u"]).all()
    loop = outcome.tables["sensitivities"]
    both = [loop[f"{name}_magnitude"] * np.exp(1j * loop[f"{name}_phase"]) for name in ("t", "s")]
    np.testing.assert_allclose(both[0] + both[1], 1, rtol=0, atol=1e-9)
    assert any("encoder's steps" in note for note in outcome.notes)
    assert any("one rigid inertia" in note for note in outcome.notes)
    assert any("never stopped" in note for note in outcome.notes)


def test_the_stored_loop_is_the_controller_times_the_plant(pulley):
    """L = C P with the controller of the recipe, by its own formula, and the fitted plant."""
    loop, fit = pulley[1].tables["sensitivities"], pulley[1].tables["fit"]
    frequency = loop["frequency"]
    np.testing.assert_allclose(fit["frequency"], frequency, rtol=1e-12)
    plant = fit["magnitude"]
    np.testing.assert_allclose(loop["sp_magnitude"] / loop["s_magnitude"], plant, rtol=1e-9)
    rig = load_recipe(RECIPE)[0].rig
    own, s = rig.controller, 2j * np.pi * frequency

    def shape(s):
        zero, pole = (2 * np.pi * own.crossover_hz * own.lead_ratio**sign for sign in (-1, 1))
        low, slow = 2 * np.pi * own.lowpass_hz, 2 * np.pi * own.integrator_hz
        roll_off = (s / low) ** 2 + 2 * own.lowpass_damping * s / low + 1
        return np.abs((s + slow) / s * (s / zero + 1) / (s / pole + 1) / roll_off)

    crossover = 2j * np.pi * own.crossover_hz
    gain = rig.inertia.total("pulley") * np.abs(crossover) ** 2 / shape(crossover)
    slowly = frequency < 200  # above, samples are not continuous
    expected = gain * shape(s) * plant
    np.testing.assert_allclose(loop["open_loop_magnitude"][slowly], expected[slowly], rtol=0.05)


def test_the_response_and_its_fit_state_their_degrees_of_freedom(pulley, kt):
    """By GTC: scatter of the experiments, and the torque constant that all lines share."""
    path, outcome = pulley
    table, fit = outcome.tables["frequency_response"], outcome.tables["fit"]
    with open_run(path) as stored, open_run(kt) as calibration:
        recorded = [r for r in stored.recordings.values() if r.size]
        warm = float(np.mean([r.read("temperature").mean() for r in recorded]))
        constant = torque_per_ampere_at(calibration, warm)
    count = int(outcome.notes[0].split(" ")[0])
    for i in (0, 7):
        scatter, magnitude = table["u_phase"][i] * table["magnitude"][i], table["magnitude"][i]
        scale = GTC.ureal(0, magnitude * constant.u / constant.value, constant.dof)
        both = GTC.ureal(0, scatter, 2 * (count - 1)) + scale
        assert table["u"][i] == pytest.approx(GTC.uncertainty(both), rel=1e-4)
        assert table["dof"][i] == pytest.approx(GTC.dof(both), rel=1e-2)
    inertia = outcome.results["inertia"]
    scatter, *_ = (line for line in inertia.budget if line.dof == count - 1)
    assert inertia.u > scatter.u
    assert (fit["dof"] > count - 1).all()


@pytest.mark.parametrize("u", [1e-5, None])
def test_half_the_heat_of_the_winding_is_taken_off_and_the_rest_is_in_the_budget(pulley, folder, u):
    """A loss that staircases do not show is as uncertain as it is large."""
    path, before = pulley
    warmed = folder / f"warmed-{u}.h5"
    loss = Quantity(0.7e-3, "1/A2", u, reason=None if u else "not shown")
    with RunWriter(warmed, command="calibrate-kt", recipe=None, recipe_text=None) as writer:
        writer.finish(CONSTANT | {"winding_heat_loss": loss}, {})
    inertia = run(IDENTIFY_PLANT, path, folder / f"again-{u}.h5", kt=warmed).results["inertia"]
    with open_run(path) as stored:
        first = next(r for r in stored.recordings.values() if r.size)
        fall = 0.7e-3 * float(np.mean(first.read("current_setpoint") ** 2))
    (heat,) = (line for line in inertia.budget if line.name.endswith("heat of the winding"))
    relative = heat.contribution / inertia.value
    expected = fall / 2 * np.hypot(1 / np.sqrt(3), 0.0 if u else 1.0)
    assert relative == pytest.approx(expected, rel=1e-3, abs=0)
    assert inertia.value / before.results["inertia"].value - 1 == pytest.approx(-fall / 2, rel=0.1)


def test_the_instrument_is_not_a_rigid_body(instrument):
    """Two masses on the tendon: wheel and motor above the resonance, the grasper too below it."""
    results = instrument[1].results
    recipe = load_recipe(RECIPE)[0]
    v = recipe.virtual.instrument
    wheel = recipe.virtual.motor.inertia + v.wheel_inertia
    assert off(results["inertia_motor_side"], wheel) < 3
    carried = v.grasper_inertia / (recipe.rig.angle_ratio * recipe.rig.torque_factor)
    # Friction that grows with the load makes it seem a little heavier.
    assert results["inertia"].value == pytest.approx(wheel + carried, rel=0.015, abs=0)
    natural = math.sqrt(v.stiffness / v.grasper_inertia) / (2 * math.pi)
    assert results["antiresonance_frequency"].value == pytest.approx(natural, rel=0.1, abs=0)
    assert results["resonance_frequency"].value > results["antiresonance_frequency"].value
    assert any("a rigid inertia does not explain" in note for note in instrument[1].notes)


@pytest.mark.parametrize("attachment", ["pulley", "instrument"])
def test_the_instrument_is_known_to_have_a_second_mass(
    request, monkeypatch, folder, kt, attachment
):
    class Fitting(Exception): ...

    def fit(*_, tendon):
        raise Fitting(tendon)

    monkeypatch.setattr("rigtool.experiments.plant.procedure.fit_plant", fit)
    path = request.getfixturevalue(attachment)[0]
    with pytest.raises(Fitting, match=str(attachment == "instrument")):
        run(IDENTIFY_PLANT, path, folder / f"fitting-{attachment}.h5", kt=kt)


def test_stored_signals_give_the_same_again(pulley, folder, kt):
    path, outcome = pulley
    again = run(IDENTIFY_PLANT, path, folder / "again.h5", kt=kt)
    assert again.results == outcome.results
    assert again.notes == outcome.notes


def test_without_a_calibration_no_uncertainty_is_stated(pulley, folder):
    outcome = run(IDENTIFY_PLANT, pulley[0], folder / "plain.h5")
    inertia = outcome.results["inertia"]
    assert inertia.u is None
    assert "give --kt" in inertia.reason
    ratio = 0.045 / torque_at_27(CONSTANT)
    assert inertia.value / pulley[1].results["inertia"].value == pytest.approx(ratio, rel=1e-4)
    assert any("data sheet" in note for note in outcome.notes)


def torque_at_27(constants):
    slope = constants["torque_constant_temperature_coefficient"].value
    return constants["torque_constant"].value * (1 + 7 * slope)


def test_torque_constant_at_the_temperature_of_the_motor(kt, folder):
    with open_run(kt) as known:
        found = torque_per_ampere_at(known, 27.0)
    assert found.value == pytest.approx(torque_at_27(CONSTANT), rel=1e-12, abs=0)
    assert found.u == pytest.approx(math.hypot(5.02e-4, 7e-5) * found.value, rel=0.01, abs=0)
    mean = {"torque_constant_mean": (0.0454, "N m/A"), "amplifier_gain": (1.0, "1")}
    with open_run(write_results(folder / "mean.h5", "calibrate-kt", **mean)) as known:
        assert torque_per_ampere_at(known, 27.0).value == 0.0454


@pytest.mark.parametrize(
    ("overrides", "message"),
    [
        (("identify_plant.swing=0.003",), r"lines have a coherence .* raise identify_plant.speeds"),
        (("rig.current_limit=0.9", "identify_plant.current_share=0.99"), "reaches the limit"),
    ],
)
def test_data_that_do_not_carry_a_plant_are_refused(folder, kt, overrides, message):
    output = folder / "refused.h5"
    with pytest.raises(InsufficientDataError, match=message):
        run(IDENTIFY_PLANT, RECIPE, output, *SHORT, *overrides, kt=kt)
    assert not output.exists()


@pytest.mark.parametrize(
    ("override", "message"),
    [
        ("identify_plant.lines=11", "is not excited"),
        ("identify_plant.settle_time=5", "no whole period of 2000 samples"),
    ],
)
def test_other_settings_than_recorded_are_refused(pulley, kt, override, message):
    with open_run(pulley[0]) as stored, open_run(kt) as constant:
        recipe = override_recipe(stored.recipe, [override])
        with pytest.raises(InsufficientDataError, match=message):
            identify_plant.analyse([stored], recipe, kt=constant)


def test_a_time_that_stands_is_refused(pulley, kt, monkeypatch):
    read = Recording.read

    def standing(self, channel, *samples):
        found = read(self, channel, *samples)
        return np.minimum(found, found[len(found) // 2]) if channel == "time" else found

    monkeypatch.setattr(Recording, "read", standing)
    refused = pytest.raises(InsufficientDataError, match="time does not rise at sample")
    with open_run(pulley[0]) as stored, open_run(kt) as constant, refused:
        identify_plant.analyse([stored], stored.recipe, kt=constant)


def test_another_commands_run_is_refused(pulley, folder, kt):
    with open_run(kt) as known, open_run(pulley[0]) as stored:
        with pytest.raises(RunFileError, match="no recording 'multisine_000'"):
            identify_plant.analyse([known], stored.recipe, kt=known)
        with pytest.raises(RunFileError, match="calibrate-kt"):
            identify_plant.analyse([stored], stored.recipe, kt=stored)


@pytest.mark.parametrize(
    ("overrides", "message"),
    [
        (("identify_plant.frequency_min=2",), "less than one cycle"),
        (("identify_plant.frequency_max=3",), "must be above frequency_min"),
        (("identify_plant.turn_angle=90",), "leaves nothing"),
        (("identify_plant.stroke_speeds=[9]",), "lower the speed"),
        (("identify_plant.frequency_max=4000",), "below half the sampling rate"),
    ],
)
def test_settings_that_cannot_be_are_mistakes(folder, overrides, message):
    with pytest.raises(RecipeError, match=message):
        run(IDENTIFY_PLANT, RECIPE, folder / "mistake.h5", *overrides)


def test_lines_may_lie_up_to_half_the_sampling_rate():
    recipe = load_recipe(RECIPE, ["identify_plant.frequency_max=3900"])[0]
    assert excited_lines(recipe).max() == round(3900 * recipe.identify_plant.period)


def test_directions_have_phases_of_their_own():
    """What a function of the position leaves would otherwise be alike in both, and not scatter."""
    recipe = load_recipe(RECIPE, [PULLEY])[0]
    for plan in excitations(recipe):
        forward, backward = (task.feedforward.signal for task in tasks(recipe, plan))
        assert abs(np.corrcoef(forward, backward)[0, 1]) < 0.6


@pytest.mark.parametrize("attachment", ["pulley", "instrument"])
def test_the_excitation_keeps_to_its_limits(attachment):
    recipe = load_recipe(RECIPE, [f"rig.attachment={attachment}"])[0]
    lines = excited_lines(recipe)
    for plan in excitations(recipe):
        torque = multisine(recipe, plan)
        assert len(torque) == period_samples(recipe) == 2000
        spectrum = np.abs(np.fft.rfft(torque))
        spectrum /= spectrum.max()
        others = np.delete(spectrum, lines)
        assert others.max() < 1e-12
        assert spectrum[lines].min() > 1e-3
        for number, task in enumerate(tasks(recipe, plan)):
            periods = task.feedforward.signal.reshape(-1, 2000)
            if attachment == "instrument":
                number *= 2
            np.testing.assert_allclose(periods[0], multisine(recipe, plan, number), rtol=1e-9)
            spectra = np.abs(np.fft.rfft(periods))
            assert np.delete(spectra, lines, axis=1).max() < 1e-12 * spectra.max()


def test_the_swing_is_the_peak_of_the_excited_speed_alone():
    rng = np.random.default_rng(4)
    lines, count, step = np.array([2, 5, 9]), 200, 1e-3
    time = np.arange(count) * step
    omega = 2 * np.pi * lines / (count * step)

    def waves(amplitude, more=0):
        return np.real(np.exp(1j * np.outer(time, omega + more)) @ amplitude)

    reference = rng.standard_normal(3) + 1j * rng.standard_normal(3)
    answer = np.array([0.3j, -0.1, 0.05 + 0.02j]) * reference
    # the second period has the excitation turned over; what is beside the lines is not excited
    beside = waves(0.5 * np.ones(3), 2 * np.pi / (count * step))
    output = np.stack([waves(answer), -waves(answer)]) + beside
    output += np.array([[1.0], [1.0]]) * waves(np.full(3, 0.2))  # ripple, alike in both
    made = Experiment(np.stack([waves(reference), -waves(reference)]), output, output, output)
    expected = np.abs(waves(1j * omega * answer)).max()
    assert np.abs(excited_speed(made, lines, step)).max() == pytest.approx(expected, rel=1e-9)


def test_turns_are_cut_into_equal_parts():
    """Periods begin at equally spaced angles of the turn: ripple drops out of their mean."""
    recipe = load_recipe(RECIPE, [PULLEY])[0]
    periods, period = recipe.identify_plant.periods, recipe.identify_plant.period
    for plan in excitations(recipe):
        starts = np.sort((np.arange(periods) * plan.speed * period) % (2 * np.pi))
        steps = np.diff(starts, append=starts[0] + 2 * np.pi)
        np.testing.assert_allclose(steps, 2 * np.pi / periods, rtol=0, atol=1e-6)


def test_strokes_turn_the_excitation_over():
    recipe = load_recipe(RECIPE)[0]
    plan = excitations(recipe)[0]
    for task in tasks(recipe, plan):
        signal, motion = task.feedforward.signal, task.motion
        half = len(signal) // 2
        np.testing.assert_array_equal(signal[:half], -signal[half:])
        cycle = 2 * motion.stroke_time / recipe.rig.sample_time
        assert cycle == pytest.approx(half, abs=1e-6)
        assert motion.cycles == 2


@pytest.mark.parametrize(
    ("turning", "excited", "answer", "message"),
    [
        (7.0, 2.0, 2.0, r"turning alone takes 6.\d* A; lower identify_plant.speeds"),
        (
            1.0,
            5.0,
            5.0,
            r"torque: lower identify_plant.current_share or swing, or raise",
        ),
        (1.0, 0.1, 12.0, "so the loop shakes"),
    ],
    ids=["motion", "excitation", "unstable"],
)
def test_a_refusal_names_what_takes_the_current(turning, excited, answer, message):
    recipe, _ = load_recipe(RECIPE)
    time = np.arange(8000)
    signal = excited * np.sin(2 * np.pi * time / 50)
    swing = answer * np.sin(2 * np.pi * time / 125)
    asked = np.where(time < 4000, turning, -turning) + signal + swing
    limit = recipe.rig.current_limit
    with pytest.raises(InsufficientDataError, match=message):
        identify_plant._require_unlimited(np.clip(asked, -limit, limit), signal, recipe)


@pytest.mark.parametrize(
    ("settle", "left_out"), [(100, (114, 113)), (150, (150, 77)), (227, (227, 0))]
)
def test_whole_periods_lie_in_the_middle_of_a_stroke_as_far_as_settling_allows(settle, left_out):
    """Strokes of both directions then cover the same angles."""
    steps = np.concatenate([np.zeros(20), np.full(477, 0.5), np.zeros(30), np.full(477, -0.5)])
    for sign, begin in ((1, 20), (-1, 527)):
        (start,) = identify_plant._period_starts(steps, sign * 0.5, settle, 250)
        assert (start - begin, begin + 477 - start - 250) == left_out
