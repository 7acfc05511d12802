"""The filters with a measured plant: what they rest on, what they bound, what is refused."""

from pathlib import Path

import numpy as np
import pytest

from rigtool.errors import InsufficientDataError, RecipeError, RunFileError, UsageError
from rigtool.experiments.learning.implementations.c_limited_angle import LimitedAngle
from rigtool.experiments.learning.procedure_design import design_filters
from rigtool.experiments.plant.procedure import PROCEDURE as IDENTIFY_PLANT
from rigtool.recipe import load_recipe
from rigtool.runfile import open_run
from tests.experiments.virtual_runs import RECIPE, run, write_kt

PULLEY = "rig.attachment=pulley"
FRF = "ilc_learn.learning_filter=frf"
PLANT = Path(__file__).parents[2] / "fixtures" / "plant.h5"


@pytest.fixture(scope="module")
def plant():
    with open_run(PLANT) as opened:
        yield opened


@pytest.fixture(scope="module")
def instrument(tmp_path_factory):
    """Another rig's plant: two masses, measured in a few strokes."""
    folder = tmp_path_factory.mktemp("design")
    path = folder / "instrument.h5"
    short = ("identify_plant.realisations=2", "identify_plant.periods=8")
    run(IDENTIFY_PLANT, RECIPE, path, *short, kt=write_kt(folder))
    with open_run(path) as opened:
        yield opened


def recipe(*overrides):
    return load_recipe(RECIPE, [PULLEY, *overrides])[0]


def test_without_a_plant_the_nominal_inertia_and_no_bound():
    found = design_filters(recipe())
    assert found.learning.measured is None
    assert np.isnan(found.tables()["convergence"]["bound"]).all()
    assert "convergence_bound" not in found.results()
    (note,) = found.origin
    assert "nominal inertia, 1.503e-05 kg m2. The plant was not measured" in note
    assert "without --plant" in note


@pytest.mark.parametrize("kind", ["zpetc", "frf"])
def test_with_a_plant_its_inertia_and_a_bound(plant, kind):
    found = design_filters(recipe(f"ilc_learn.learning_filter={kind}"), plant)
    inertia = plant.result("inertia").value
    model = found.learning.measured.loop.plant
    # At rest the double integrator: friction is a small part at 50 Hz.
    gain = np.abs(model.response(np.array([50.0])))[0]
    assert gain == pytest.approx(1 / (inertia * (2 * np.pi * 50) ** 2), rel=1e-3, abs=0)
    table = found.tables()["convergence"]
    assert (table["bound"] >= table["magnitude"]).all()
    assert np.isin(plant.table("frequency_response")["frequency"][1:], table["frequency"]).all()
    results = found.results()
    assert results["convergence_peak"].value <= results["convergence_bound"].value < 0.1
    assert ("zpetc_phase_advance" in results) == (kind == "zpetc")
    assert f"inertia {inertia:.5g}" in found.origin[0]
    assert any("inverse of the measured response" in note for note in found.origin) == (
        kind == "frf"
    )


def test_the_measured_inertia_is_fed_forward(plant, tmp_path):
    with open_run(write_kt(tmp_path)) as kt:
        without = LimitedAngle(recipe(), kt=kt)
        found = LimitedAngle(recipe(), kt=kt, plant=plant)
    assert without.plain.inertia == recipe().rig.nominal_inertia
    assert found.plain.inertia == plant.result("inertia").value


def test_the_model_of_two_masses_is_taken_over(instrument):
    found = design_filters(load_recipe(RECIPE)[0], instrument)
    response = found.learning.measured
    off = np.abs(response.ratio(response.frequency) - 1)
    lag = 2 * np.pi * response.frequency / (2 * np.pi * 1500)  # the amplifier's, no plant's
    assert (off - lag).max() < 0.05
    assert len(response.loop.plant.den_delta) == 5
    assert found.results()["convergence_bound"].value < 0.2


def test_filters_for_the_error_are_those_for_the_torque_times_the_controller(plant):
    """[eq. 3]: 1/Sp = C/T."""
    found = design_filters(recipe(FRF), plant)
    frequency = np.array([5.0, 20.0, 80.0])
    loop = found.learning.measured
    plant_response = loop.ratio(frequency) * loop.loop.plant.response(frequency)
    controller = found.controller.response(frequency)
    sensitivity = plant_response / (1 + controller * plant_response)
    inverse = found.learning.inverse.response(frequency) * controller
    np.testing.assert_allclose(inverse * sensitivity, 1, rtol=1e-9, atol=0)


def test_the_inverse_of_a_response_needs_one():
    with pytest.raises(UsageError, match="give --plant"):
        design_filters(recipe(FRF))


@pytest.mark.parametrize(
    ("override", "message"),
    [
        ("rig.name=another", "rig.name briaire-2006, the recipe has another"),
        ("rig.attachment=instrument", "rig.attachment pulley, the recipe has instrument"),
        ("rig.sample_time=250e-6", "rig.sample_time 0.000125"),
    ],
)
def test_the_plant_of_another_rig_is_refused(plant, override, message):
    with pytest.raises(RunFileError, match=message):
        design_filters(recipe(override), plant)


def test_a_run_of_another_command_is_no_plant():
    with (
        open_run(PLANT.with_name("kt.h5")) as other,
        pytest.raises(RunFileError, match="calibrate-kt"),
    ):
        design_filters(recipe(), other)


def test_learning_beyond_what_the_plant_carries_is_refused(plant):
    """A cut-off far above the measured lines: nobody knows what the loop does there."""
    with pytest.raises(InsufficientDataError, match="over the uncertainty of the measured plant"):
        design_filters(recipe("ilc_learn.robustness_hz=3000"), plant)
    design_filters(recipe("ilc_learn.robustness_hz=3000"))


def test_a_slow_integrator_whose_zero_is_not_cancelled_is_named():
    """Neither Q nor p help there; both remedies that are named do."""
    slow = ("rig.controller.integrator_hz=1", "rig.controller.crossover_hz=12")
    with pytest.raises(InsufficientDataError, match=r"zero at 1 Hz, radius 0\.999214.*integrator"):
        design_filters(recipe(*slow))
    for useless in ("ilc_learn.robustness_hz=5", "ilc_learn.learning_factor=0.01"):
        with pytest.raises(InsufficientDataError, match=r"does not converge.*zero at 1 Hz"):
            design_filters(recipe(*slow, useless))
    assert design_filters(recipe(*slow, "ilc_learn.cancel_radius=0.99922")).criterion.peak < 1
    assert design_filters(recipe("rig.controller.integrator_hz=1.3", slow[1])).criterion.peak < 1


def test_a_cut_off_that_no_sample_shows_is_refused():
    with pytest.raises(RecipeError, match="4000 Hz reaches half the sampling rate"):
        design_filters(recipe("ilc_learn.robustness_hz=4000"))


def test_a_controller_that_is_unstable_with_the_measured_plant_is_refused(plant):
    override = "rig.controller.integrator_hz=200"
    with pytest.raises(InsufficientDataError, match=r"unstable with the measured inertia 1\.56"):
        design_filters(recipe(override), plant)


def test_stored_functions_of_the_loop_are_those_of_its_filters():
    found = design_filters(recipe())
    tables, frequency = found.tables(), found.criterion.frequency
    transfer, criterion = tables["transfer"], tables["convergence"]
    nyquist = 0.5 / recipe().rig.sample_time
    for table in (transfer, criterion):
        np.testing.assert_array_equal(table["frequency"], frequency)
    assert (frequency[0], frequency[-1]) == (0, pytest.approx(nyquist))
    learning = found.learning
    loop = learning.loop_response(frequency)
    for name, response in (
        ("t", loop),
        ("l", learning.inverse.response(frequency, shifted=False)),
    ):
        np.testing.assert_allclose(transfer[f"{name}_magnitude"], np.abs(response))
        turned = np.exp(1j * transfer[f"{name}_phase"])
        np.testing.assert_allclose(turned, np.exp(1j * np.angle(response)), atol=1e-9)
    shifted = learning.inverse.response(frequency)
    advance = found.results()["zpetc_phase_advance"].value
    delay = np.exp(2j * np.pi * frequency * advance * recipe().rig.sample_time)
    plain = transfer["l_magnitude"] * np.exp(1j * transfer["l_phase"])
    np.testing.assert_allclose(shifted, plain * delay, atol=1e-9 * np.abs(plain).max())
    turned = np.exp(1j * (transfer["l_shifted_phase"] - transfer["l_phase"]))
    np.testing.assert_allclose(turned, delay, atol=1e-6)
    np.testing.assert_array_equal(criterion["magnitude"], found.criterion.magnitude)
    worst = int(np.argmax(found.criterion.magnitude))
    results = found.results()
    assert results["convergence_peak"].value == found.criterion.magnitude[worst]
    assert results["convergence_frequency"].value == frequency[worst]


def test_the_bound_has_its_own_peak(plant):
    found = design_filters(recipe(), plant)
    criterion, results = found.criterion, found.results()
    worst = int(np.nanargmax(criterion.bound))
    assert results["convergence_bound"].value == criterion.bound[worst]
    assert results["convergence_bound_frequency"].value == criterion.frequency[worst]
