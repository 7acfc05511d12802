"""calibrate-kt on the virtual rig, from recipe to torque constant and back from the file."""

import json
import math

import numpy as np
import pytest
from click.testing import CliRunner
from numpy.testing import assert_allclose

from rigtool.cli.info import command as info
from rigtool.errors import InsufficientDataError, RecipeError
from rigtool.experiments.running.options import CommonOptions
from rigtool.experiments.running.session import run_command
from rigtool.experiments.torque_constant import procedure as calibrate_kt
from rigtool.experiments.torque_constant import temperature_fit
from rigtool.experiments.torque_constant.procedure import PROCEDURE as CALIBRATE_KT
from rigtool.experiments.torque_per_ampere import torque_per_ampere, torque_per_ampere_at
from rigtool.recipe import load_recipe
from rigtool.recipe.commands import CalibrateKt
from rigtool.runfile import open_run
from tests.experiments.virtual_runs import RECIPE, run
from tests.fitted_once import fit_once
from tests.thorough import first_of, thorough
from tests.unchanged import require_unchanged

SHORT = ("calibrate_kt.temperatures_degc=[20, 35, 50]", "calibrate_kt.record_every=160")


@pytest.fixture(scope="module")
def measured(tmp_path_factory):
    path = tmp_path_factory.mktemp("kt") / "kt.h5"
    return path, run(CALIBRATE_KT, RECIPE, path, *SHORT, seed=1)


def test_no_other_number_has_changed(measured):
    require_unchanged("kt", measured[1])


@pytest.mark.parametrize("seed", first_of([1, 2, 3]))
def test_thesis_values_for_several_seeds(measured, tmp_path, seed):
    """[7.1.1]"""
    path = tmp_path / "kt.h5"
    outcome = measured[1] if seed == 1 else run(CALIBRATE_KT, RECIPE, path, *SHORT, seed=seed)
    results = outcome.results
    assert_allclose(results["torque_constant"].value, 45.8e-3, atol=0.1e-3, rtol=0)
    slope = results["torque_constant_temperature_coefficient"]
    assert_allclose(slope.value, -0.116e-2, atol=0.01e-2, rtol=0)
    assert_allclose(results["torque_constant_constant_error"].value, 0.9e-2, atol=0.05e-2, rtol=0)
    assert_allclose(results["amplifier_gain"].value, 1.0, atol=1e-4)
    assert_allclose(results["amplifier_offset"].value, 1e-3, atol=5e-5, rtol=0)
    assert results["amplifier_linearity"].value < 1e-3
    for name in ("torque_constant", "torque_constant_mean"):
        assert abs(results["torque_constant"].value - 45.8e-3) < 3 * results[name].u


@pytest.mark.parametrize(
    ("setting", "constant"),
    [
        ("virtual.motor.static_friction=8e-3", 45.8e-3),
        # no ringing that shakes the friction loose
        ("virtual.arm.damping=1.0 virtual.motor.torque_constant=0.030", 0.030),
    ],
)
def test_other_rigs(tmp_path, setting, constant):
    results = run(CALIBRATE_KT, RECIPE, tmp_path / "kt.h5", *SHORT, *setting.split()).results
    assert_allclose(results["torque_constant"].value, constant, rtol=2e-3)
    assert abs(results["torque_constant"].value - constant) < 3 * results["torque_constant"].u


@pytest.mark.parametrize("corner_hz", [3.2, 300.0])
def test_friction_takes_no_part_of_a_ripple_that_follows_steps_late_or_at_once(tmp_path, corner_hz):
    """Four times the thesis's friction, which takes 4 % of a slope; nothing scatters."""
    quiet = {
        "amplifier.gain_ripple": "[{order=2, amplitude=0.005}]",
        "amplifier.saturation_ripple": "[]",
        "amplifier.offset_ripple": "[]",
        "amplifier.amplitude_spread": 0.0,
        "amplifier.ripple_corner_hz": corner_hz,
        "motor.cogging": "[]",
        "motor.coulomb_friction": 9.2e-3,
        "motor.static_friction": 16e-3,
        "motor.friction_noise": 0.0,
        "sensors.force_noise": 1e-5,
        "sensors.force_resolution": 1e-5,
    }
    settings = [f"virtual.{name}={value}" for name, value in quiet.items()]
    results = run(CALIBRATE_KT, RECIPE, tmp_path / "kt.h5", SHORT[0], *settings).results
    assert_allclose(results["torque_constant_ripple"].value, 0.005 / math.sqrt(2), rtol=0.01)
    first = results["torque_constant_ripple_small_current"].value
    assert_allclose(first, 0.005 / math.sqrt(2), rtol=0.06)


def test_analysis_of_the_file_gives_the_same(measured, tmp_path):
    path, outcome = measured
    again = run(CALIBRATE_KT, path, tmp_path / "again.h5")
    assert again.results == outcome.results
    with open_run(tmp_path / "again.h5") as stored:
        assert stored.results == outcome.results
        assert not stored.recordings
        assert_allclose(stored.table("torque_constant")["temperature"], [20, 35, 50], atol=1.5)
    assert again.notes == outcome.notes
    assert "arm length" in outcome.notes[0]


def test_hysteresis_table_is_the_friction(measured):
    _, outcome = measured
    table = outcome.tables["hysteresis"]
    middle = np.abs(table["current"] - 2.0) < 0.7
    difference = (table["falling"] - table["rising"])[middle].mean()
    assert_allclose(difference, outcome.results["hysteresis_torque"].value, rtol=0.02)
    assert difference > 1e-3


def test_runs_at_different_temperatures_are_pooled(measured, tmp_path):
    path, both = tmp_path / "60.h5", tmp_path / "both.h5"
    same = "calibrate_kt.temperatures_degc=[60, 60]"
    one = run(CALIBRATE_KT, RECIPE, path, same, SHORT[1], seed=1)
    assert "torque_constant" not in one.results
    assert any("second temperature" in note for note in one.notes)
    true = 45.8e-3 * (1 - 1.16e-3 * 40)
    assert_allclose(one.results["torque_constant_mean"].value, true, rtol=3e-3)
    sources = [str(measured[0]), str(path)]
    pooled = run_command(CALIBRATE_KT, sources, str(both), options=CommonOptions(), inputs={})
    slope = pooled.results["torque_constant_temperature_coefficient"]
    assert_allclose(slope.value, -1.16e-3, atol=1e-4, rtol=0)
    temperature = pooled.tables["torque_constant"]["temperature"]
    assert_allclose(temperature, [20, 35, 50, 60], atol=1.5, rtol=0)


@pytest.mark.compiles
def test_one_rotor_angle_says_what_it_cannot_know(tmp_path):
    same = "calibrate_kt.temperatures_degc=[20, 20]"
    outcome = run(
        CALIBRATE_KT, RECIPE, tmp_path / "kt.h5", same, "calibrate_kt.rotor_positions=1", SHORT[1]
    )
    assert any("does not average out" in note for note in outcome.notes)


def test_current_beyond_the_amplifier_is_refused(tmp_path):
    with pytest.raises(RecipeError, match=r"current_max is 12 A, rig.current_limit 10 A"):
        run(CALIBRATE_KT, RECIPE, tmp_path / "kt.h5", "calibrate_kt.current_max=12")
    assert not (tmp_path / "kt.h5").exists()


def test_staircase_goes_up_and_down():
    settings = CalibrateKt(current_max=2.0, steps=4, staircases=2)
    levels = calibrate_kt.staircase(settings)
    up = [0.0, 0.5, 1.0, 1.5, 2.0, 1.5, 1.0, 0.5]
    assert_allclose(levels, [*up, *up, 0.0], rtol=1e-9)


def test_the_motor_is_measured_without_instrument(measured):
    path, _ = measured
    recipe, _ = load_recipe(RECIPE)
    assert recipe.rig.attachment == "instrument"
    with open_run(path) as stored:
        assert stored.recipe.rig.attachment == "pulley"


def test_a_coarse_gauge_is_in_the_budget_and_a_coarser_one_refused(tmp_path):
    coarse = "virtual.sensors.force_resolution=0.008"
    found = run(CALIBRATE_KT, RECIPE, tmp_path / "kt.h5", *SHORT, coarse)
    assert "gauge resolution" in found.notes[0]
    constant = found.results["torque_constant"]
    assert abs(constant.value - 45.8e-3) < 3 * constant.u
    with pytest.raises(InsufficientDataError, match=r"gauge reads in steps of 54 mN m"):
        run(CALIBRATE_KT, RECIPE, tmp_path / "no.h5", *SHORT, coarse.replace("0.008", "0.1"))


@pytest.mark.parametrize("draw", first_of([1, 3]))
def test_instruments_that_are_off_are_in_the_budget(tmp_path, draw):
    """Errors drawn from what the recipe states: arm, gain of the current reading, thermometer."""
    stated = {"arm": 10e-3, "current": 15e-3, "thermometer": 5.0}
    off = {name: u * z for (name, u), z in zip(stated.items(), _normal(draw, 3), strict=True)}
    outcome = run(
        CALIBRATE_KT,
        RECIPE,
        tmp_path / "kt.h5",
        *SHORT,
        f"rig.arm.length_u={stated['arm'] * 0.54}",
        f"rig.current_reading_relative_u={stated['current']}",
        f"rig.thermometer_u={stated['thermometer']}",
        f"virtual.misstated.arm_length={off['arm']}",
        f"virtual.sensors.current_gain={1 + off['current']}",
        f"virtual.sensors.temperature_offset={off['thermometer']}",
    )
    constant = outcome.results["torque_constant"]
    error = constant.value - 45.8e-3
    assert abs(error) < 2.5 * constant.u
    # the lines of the budget explain the error, each with its sign
    lines = {line.name: line for line in constant.budget}
    expected = -lines["arm length"].sensitivity * 0.54 * off["arm"]  # a longer arm presses less
    expected -= lines["gain of the current reading"].sensitivity * off["current"]
    expected -= lines["thermometer"].sensitivity * off["thermometer"]
    assert_allclose(error, expected, atol=0.1e-3, rtol=0)
    assert abs(expected) > 0.3e-3
    # read again with the same instrument, current cancels
    with open_run(tmp_path / "kt.h5") as kt:
        found, warm = torque_per_ampere(kt), torque_per_ampere_at(kt, 27.5 + off["thermometer"])
    torque = 45.8e-3 * (1 - 1.16e-3 * 7.5) / (1 + off["arm"])
    assert_allclose(warm.value, torque, rtol=1e-3, atol=0)
    for used in (found, warm):
        names = {line.name for line in used.budget}
        assert abs(used.value / torque - 1) < 2.5 * used.u / used.value
        assert not names & {"gain of the current reading", "thermometer"}
        assert used.u / used.value < math.hypot(stated["arm"], 8e-3)


@pytest.mark.parametrize(
    ("line", "setting", "stated", "off"),
    [
        ("gauge calibration", "arm.gauge_relative_u", 0.01, "sensors.force_gain=1.015"),
        ("gauge linearity", "arm.gauge_linearity", 0.02, "sensors.force_linearity=0.06"),
        ("thermometer", "thermometer_u", 5.0, "sensors.temperature_offset=7.5"),
        *thorough(
            ("arm length", "arm.length_u", 5.4e-3, "misstated.arm_length=0.015"),
            (
                "gain of the current reading",
                "current_reading_relative_u",
                0.01,
                "sensors.current_gain=1.015",
            ),
        ),
    ],
)
def test_an_interval_holds_with_the_line_of_what_is_off_and_not_without(
    tmp_path, monkeypatch, line, setting, stated, off
):
    # What is stated of instruments moves no slope.
    monkeypatch.setattr(temperature_fit, "fit_staircases", fit_once)
    measured, again = tmp_path / "kt.h5", tmp_path / "again.h5"
    run(CALIBRATE_KT, RECIPE, measured, *SHORT, f"rig.{setting}={stated}", f"virtual.{off}")
    run(CALIBRATE_KT, measured, again, f"rig.{setting}=0")
    (with_line, row), (without, no_row) = (
        budget_of(path, "torque_constant", line) for path in (measured, again)
    )
    assert abs(with_line["value"] - 45.8e-3) < 2 * with_line["u"]
    assert abs(without["value"] - 45.8e-3) > 4 * without["u"]
    # as shown: value, u, sensitivity, contribution, degrees of freedom, share
    assert float(row[-2]) > 50
    assert row[-3] == "inf"
    assert no_row is None


def budget_of(path, result, line):
    """Return a result, and the words that info shows in a line of its budget, None without it."""
    shown, document = (
        CliRunner().invoke(info, [str(path), "--budget", result, *more], catch_exceptions=False)
        for more in ([], ["--json"])
    )
    rows = [row.strip() for row in shown.output.splitlines()]
    words = next((row.removeprefix(line).split() for row in rows if row.startswith(line)), None)
    return json.loads(document.output)["results"][result], words


def _normal(seed, count):
    return np.random.default_rng(seed).standard_normal(count).tolist()
