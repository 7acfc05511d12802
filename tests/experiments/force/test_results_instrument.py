"""Load friction and stiffness of an instrument, beside scipy's standard errors."""

import math

import numpy as np
import pytest
from scipy.stats import sem

from rigtool.experiments.force.cycles import Cycle, Peaks
from rigtool.experiments.force.results import LoadReadings, applied_torque, stroke_grid
from rigtool.experiments.force.results_instrument import (
    _friction_results,
    _stiffness_results,
    instrument_outcome,
)
from rigtool.quantity import Quantity, combined, error_line
from rigtool.recipe import load_recipe
from tests.experiments.virtual_runs import RECIPE

CONSTANT = combined(
    0.05, "N m/A", [error_line("ripple", 4e-4, "N m/A", 8), error_line("gauge", 3e-4, "N m/A")]
)


def peaks(cycles=6, shift=(0.5, 0.3)):
    rng = np.random.default_rng(1)
    angles = [math.pi / 2 + own + 0.02 * rng.standard_normal(cycles) for own in shift]
    torques = [own + 0.4e-3 * rng.standard_normal(cycles) for own in (65e-3, 55e-3)]
    return Peaks(angles[0], torques[0], angles[1], torques[1])


def test_load_friction_is_half_of_what_lifting_and_lowering_differ_by():
    found = peaks()
    results = _friction_results(found, CONSTANT)
    lifting, lowering = found.lifting_torque, found.lowering_torque
    relative = CONSTANT.u / CONSTANT.value
    for name, values in (("lifting_torque", lifting), ("lowering_torque", lowering)):
        assert results[name].value == pytest.approx(values.mean())
        expected = math.hypot(sem(values), relative * values.mean())
        assert results[name].u == pytest.approx(expected, rel=1e-9)
    friction = results["load_friction"]
    assert friction.value == pytest.approx((lifting.mean() - lowering.mean()) / 2)
    # errors of the constant at two rotor angles are independent of each other
    by_constant = [relative * own.mean() / 2 for own in (lifting, lowering)]
    expected = math.hypot(sem((lifting - lowering) / 2), *by_constant)
    assert friction.u == pytest.approx(expected, rel=1e-9)
    assert {line.name: line.dof for line in friction.budget} == {
        "scatter": 5,
        "ripple": 8,
        "gauge": None,
    }


def test_stiffness_is_the_load_over_the_mean_of_both_shifts():
    recipe, _ = load_recipe(RECIPE, ())
    found = peaks()
    results = _stiffness_results(found, 5.0, recipe)
    lifting = found.lifting_angle - math.pi / 2
    assert results["peak_angle_shift"].value == pytest.approx(lifting.mean())
    assert results["peak_angle_shift"].u == pytest.approx(sem(lifting), rel=1e-9)
    counts = results["peak_shift_counts"]
    # a turn of the motor for each 360 degrees of the output times the ratio
    turns = lifting.mean() / (2 * math.pi) * recipe.rig.angle_ratio
    assert counts.value == pytest.approx(turns * recipe.rig.encoder_counts)
    assert counts.u / counts.value == pytest.approx(sem(lifting) / lifting.mean())
    both = (lifting + found.lowering_angle - math.pi / 2) / 2
    assert results["peak_angle_shift_mean"].u == pytest.approx(sem(both), rel=1e-9)
    # 5 N at 20 mm
    assert results["stiffness"].value == pytest.approx(0.1 / both.mean(), rel=1e-6)
    assert "stiffness" not in _stiffness_results(peaks(shift=(0.1, -0.3)), 5.0, recipe)
    top = np.full(3, math.pi / 2)  # where a stiff instrument has it
    assert "stiffness" not in _stiffness_results(Peaks(top, top, top, top), 5.0, recipe)


def test_one_cycle_has_no_scatter():
    results = _friction_results(peaks(1), Quantity(0.05, "N m/A", 1e-3))
    assert results["load_friction"].u is None
    assert "one cycle" in results["load_friction"].reason


def lifted(recipe, force, name, strokes=3, shift=0.2):
    """Return readings of a load whose torque peaks behind a right angle, in both directions."""
    grid = stroke_grid(recipe)
    size, turns = len(grid), 2 * (len(grid) - 1)
    position = np.concatenate([[0.0], *[np.append(grid[1:], grid[-2::-1])] * strokes])
    rising = np.concatenate([[True], *[np.arange(turns) < size - 1] * strokes])
    angle = np.radians(recipe.measure_force.angle) * position / grid[-1]
    top = float(applied_torque(recipe, force, math.pi / 2))
    torque = np.where(rising, 1.1, 0.9) * top * np.sin(angle - shift)
    cycles = [Cycle(turns * n, turns * n + size - 1, turns * (n + 1)) for n in range(strokes)]
    return LoadReadings(
        name, force, strokes, position, torque, 0 * torque, cycles, np.zeros(strokes), 0.0
    )


def test_recordings_of_both_purposes_are_stored_with_what_a_stiff_instrument_would_show():
    recipe = load_recipe(RECIPE, ("rig.attachment=instrument",))[0]
    extra = {"hysteresis": lifted(recipe, 3.0, "h"), "shift": lifted(recipe, 5.0, "s")}
    found = instrument_outcome(extra, recipe, CONSTANT)
    grid = stroke_grid(recipe)
    angle = np.radians(recipe.measure_force.angle) * grid / grid[-1]
    for name, force in (("hysteresis", 3.0), ("shift", 5.0)):
        table, top = found.tables[name], force * recipe.rig.load_arm
        np.testing.assert_allclose(table["position"], grid)
        np.testing.assert_allclose(table["applied"], top * np.sin(angle), atol=1e-12)
        inside = slice(1, -1)
        for column, part in (("lifting", 1.1), ("lowering", 0.9)):
            expected = part * top * np.sin(angle - 0.2)
            np.testing.assert_allclose(table[column][inside], expected[inside], atol=1e-9)
    results = found.results
    top = 3.0 * recipe.rig.load_arm
    assert results["lifting_torque"].value == pytest.approx(1.1 * top, rel=1e-3)
    assert results["lowering_torque"].value == pytest.approx(0.9 * top, rel=1e-3)
    assert results["load_friction"].value == pytest.approx(0.1 * top, rel=1e-2)
    assert results["peak_angle_shift"].value == pytest.approx(0.2, rel=0.01)
    assert results["peak_angle_shift_mean"].value == pytest.approx(0.2, rel=0.01)
    assert not found.notes


def test_a_load_without_a_peak_has_its_table_and_a_note():
    recipe = load_recipe(RECIPE, ("rig.attachment=instrument",))[0]
    found = instrument_outcome({"shift": lifted(recipe, 5.0, "s", shift=1.5)}, recipe, CONSTANT)
    assert not found.results
    assert set(found.tables) == {"shift"}
    assert found.notes[0].startswith("no result: recording shift: the torque has no peak")
