"""Stored responses and results with their u and dof, beside the law of propagation and scipy."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import f as fisher

from rigtool.control.plant_models import PlantModel
from rigtool.experiments.plant.curvature import SlopeRise
from rigtool.experiments.plant.fit import PlantFit
from rigtool.experiments.plant.frequency_response import FrequencyResponse
from rigtool.experiments.plant.results import IdentifiedPlant, plant_outcome
from rigtool.quantity import combined, error_line
from rigtool.recipe import load_recipe
from tests.experiments.virtual_runs import RECIPE

RECIPE_HERE, _ = load_recipe(RECIPE, ("rig.attachment=pulley",))
TIME = RECIPE_HERE.rig.sample_time
FREQUENCY = np.geomspace(4, 240, 12)
USED = np.arange(12) != 3
COUNT = 5
CONSTANT = combined(0.045, "N m/A", [error_line("a", 3e-4, "N m/A", 6)])


def fit_of(inertia, viscous=5e-5, delay=2e-5):
    return PlantFit(PlantModel(inertia, viscous), delay, 1e-9, 0.0, TIME, USED, 1.1, 0.3)


def identified(constant=CONSTANT, swing=0.7, noise=0.02, rise=0.0):
    """Return five experiments, and the fit with those that lack one each."""
    rng = np.random.default_rng(1)
    whole = fit_of(1.5e-5)
    without = [fit_of(1.5e-5 * (1 + own), 5e-5 * (1 - own)) for own in 2e-3 * rng.normal(size=5)]
    fit = replace(
        whole,
        without=tuple(without),
        moved=(fit_of(1.501e-5), fit_of(1.5e-5, 5.1e-5)),
        possible=fit_of(1.52e-5),
    )
    true = whole.response(FREQUENCY)
    error = rng.normal(size=(COUNT, 12)) + 1j * rng.normal(size=(COUNT, 12))
    response = FrequencyResponse(
        FREQUENCY, true * (1 + noise * error), np.linspace(0.7, 0.99, 12), 1e-3 * np.abs(true)
    )
    return IdentifiedPlant(response, fit, constant, swing, SlopeRise(rise, 1e-6, COUNT))


def law(value, *parts):
    """Return a value with the uncertainty of (u, dof) by the law of propagation."""
    return combined(
        value,
        "1",
        [error_line(str(n), *own) for n, own in enumerate((u, "1", dof) for u, dof in parts)],
    )


def test_a_result_holds_scatter_doubt_and_the_constant():
    found = identified()
    inertia = plant_outcome(found, RECIPE_HERE).results["inertia"]
    without = np.array([own.model.inertia for own in found.fit.without])
    scatter = np.sqrt((COUNT - 1) / COUNT * np.sum((without - without.mean()) ** 2))
    scatter = max(scatter, 0.001e-5)  # what the fit's own covariance moves it by
    relative = CONSTANT.u / CONSTANT.value
    expected = law(1.5e-5, (scatter, COUNT - 1), (0.02e-5, None), (1.5e-5 * relative, 6))
    assert inertia.value == 1.5e-5
    assert inertia.u == pytest.approx(expected.u, rel=1e-6)
    assert inertia.dof == pytest.approx(expected.dof, rel=1e-4)
    # a frequency of zero gain goes with the root of a torque
    crossing = plant_outcome(found, RECIPE_HERE).results["mass_line_crossing"]
    assert crossing.value == pytest.approx(np.sqrt(1 / 1.5e-5) / (2 * np.pi))
    by_constant = next(line for line in crossing.budget if line.name == "a").contribution
    assert by_constant == pytest.approx(crossing.value * relative / 2, rel=0.02)


@pytest.mark.parametrize(("shift", "known"), [(-1.5, True), (-2.5, False)])
def test_friction_that_falls_with_the_speed_is_no_viscous_friction(shift, known):
    found = identified()
    u = plant_outcome(found, RECIPE_HERE).results["viscous_friction"].u

    def moved(fit):
        own = fit.model.viscous - 5e-5 + shift * u
        return replace(fit, model=replace(fit.model, viscous=own))

    without = tuple(moved(own) for own in found.fit.without)
    around = tuple(moved(own) for own in found.fit.moved)
    fit = replace(moved(found.fit), without=without, moved=around, possible=moved(fit_of(1.5e-5)))
    result = plant_outcome(replace(found, fit=fit), RECIPE_HERE).results["viscous_friction"]
    assert result.value == pytest.approx(shift * u)
    assert (result.u is not None) == known
    assert known or "falls with the speed" in result.reason


def test_friction_that_bends_widens_viscous_friction_alone():
    even, bent = (plant_outcome(identified(rise=rise), RECIPE_HERE) for rise in (1e-6, 9e-6))
    plain, wide = (outcome.results["viscous_friction"] for outcome in (even, bent))
    assert wide.value == plain.value
    # rectangular between none of the rise and all of it
    assert wide.u == pytest.approx(np.hypot(plain.u, 9e-6 / np.sqrt(3)), rel=1e-9)
    assert "bend of friction" in [line.name for line in wide.budget]
    assert bent.results["inertia"].u == even.results["inertia"].u
    assert "slope is the same over the swing within 2e-06 N m s/rad" in " ".join(even.notes)
    assert "slope of friction rises by 9e-06 N m s/rad over one rms" in " ".join(bent.notes)


def test_without_a_calibration_nothing_has_an_uncertainty():
    results = plant_outcome(identified(None), RECIPE_HERE).results
    assert results["inertia"].u is None
    assert "data sheet" in results["inertia"].reason
    table = plant_outcome(identified(None), RECIPE_HERE).tables["frequency_response"]
    np.testing.assert_allclose(table["dof"], 2 * (COUNT - 1))


def test_each_line_has_the_scatter_of_experiments_and_the_constant():
    found = identified()
    table = plant_outcome(found, RECIPE_HERE).tables["frequency_response"]
    relative = CONSTANT.u / CONSTANT.value
    for k in range(12):
        each = found.response.each[:, k]
        mean = each.mean()
        parts = np.concatenate([each.real - mean.real, each.imag - mean.imag])
        scatter = np.sqrt(parts @ parts / (2 * (COUNT - 1)) / COUNT)
        size = abs(mean)
        expected = law(size, (scatter, 2 * (COUNT - 1)), (relative * size, 6))
        assert table["magnitude"][k] == pytest.approx(size)
        assert table["u"][k] == pytest.approx(expected.u, rel=1e-9)
        assert table["dof"][k] == pytest.approx(expected.dof, rel=1e-9)
        assert table["u_phase"][k] == pytest.approx(scatter / size, rel=1e-9)
        circle = scatter * np.sqrt(2 * fisher.ppf(0.95, 2, 2 * (COUNT - 1)))
        assert table["radius"][k] == pytest.approx(np.hypot(circle, 2 * relative * size), rel=1e-6)
        model = found.fit.model.response(FREQUENCY[k : k + 1], TIME)[0]
        assert table["distance"][k] == pytest.approx(abs(mean / model - 1), rel=1e-9)
        assert np.exp(1j * table["phase"][k]) == pytest.approx(mean / size, rel=1e-9)
    assert table["used"].tolist() == USED.astype(int).tolist()
    np.testing.assert_array_equal(table["frequency"], FREQUENCY)
    np.testing.assert_array_equal(table["u_quantisation"], found.response.quantisation)
    np.testing.assert_array_equal(table["coherence"], found.response.coherence)


def test_the_fitted_curve_has_the_scatter_of_fits_without_an_experiment():
    found = identified()
    table = plant_outcome(found, RECIPE_HERE).tables["fit"]
    frequency, relative = table["frequency"], CONSTANT.u / CONSTANT.value
    size = np.abs(found.fit.response(frequency))
    without = np.array([np.abs(own.response(frequency)) for own in found.fit.without])
    scatter = np.sqrt((COUNT - 1) / COUNT * np.sum((without - without.mean(axis=0)) ** 2, axis=0))
    for k in (0, 60, 199):
        expected = law(size[k], (scatter[k], COUNT - 1), (relative * size[k], 6))
        assert table["u"][k] == pytest.approx(expected.u, rel=1e-9)
        assert table["dof"][k] == pytest.approx(expected.dof, rel=1e-9)
    turned = np.exp(1j * table["phase"])
    np.testing.assert_allclose(turned * table["magnitude"], found.fit.response(frequency))
    np.testing.assert_allclose(table["mass_line"] * (2 * np.pi * frequency) ** 2, 1 / 1.5e-5)
    assert frequency[0] == pytest.approx(1.0)
    assert frequency[-1] == pytest.approx(0.999 * 0.5 / TIME)


def test_the_loop_is_that_of_controller_and_fit():
    table = plant_outcome(identified(), RECIPE_HERE).tables["sensitivities"]

    def of(name):
        return table[f"{name}_magnitude"] * np.exp(1j * table[f"{name}_phase"])

    np.testing.assert_allclose(of("t") + of("s"), 1, atol=1e-9)
    np.testing.assert_allclose(of("open_loop"), of("t") / of("s"), rtol=1e-9)
    plant = identified().fit.response(table["frequency"])
    np.testing.assert_allclose(of("sp") / of("s"), plant, rtol=1e-9)


def test_notes_state_the_numbers():
    found = identified()
    notes = " ".join(plant_outcome(found, RECIPE_HERE).notes)
    assert "5 experiments; fit on 11 of 12 lines, 4 to 240 Hz" in notes
    steps = (found.response.quantisation / np.abs(found.response.response))[USED]
    assert f"uncertain by at most {100 * steps.max():.2g} %" in notes
    share = np.median((found.response.quantisation / found.response.u)[USED] ** 2)
    assert f"{share:.2g} of its variance (median)" in notes
    assert "swung by up to 70 %), so Coulomb friction is a constant" in notes
    nominal = RECIPE_HERE.rig.nominal_inertia
    assert f"{100 * (1.5e-5 - nominal) / nominal:+.2g} % from it" in notes
    gain = 100 * (np.exp(-1e-9 * (2 * np.pi * 240) ** 2) - 1)
    assert f"+20 us beyond half a sample, gain {gain:+.2g} % at 240 Hz" in notes
    assert "two masses as well (F test, p = 0.3)" in notes
    assert "are 1.1 times their expected scatter" in notes
    stopped = " ".join(plant_outcome(identified(swing=1.2), RECIPE_HERE).notes)
    assert "the shaft stopped (its speed swung by up to 120 %)" in stopped
    one = replace(found, fit=replace(found.fit, rigid_rejected=1.0))
    assert "two masses" not in " ".join(plant_outcome(one, RECIPE_HERE).notes)


def test_the_distance_and_coherence_are_those_of_lines_in_use():
    found = identified()
    results = plant_outcome(found, RECIPE_HERE).results
    off = np.abs(found.response.response / found.fit.response(FREQUENCY) - 1)[USED]
    assert results["model_distance"].value == pytest.approx(off.max())
    assert results["coherence_min"].value == pytest.approx(0.7)
    assert "inertia_motor_side" not in results
