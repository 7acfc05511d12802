"""Rows of loads, their uncertainty by numeric derivatives, and the tables of the figures."""

import math

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.stats import norm, shapiro

from rigtool.experiments.force.cycles import Cycle, statistics
from rigtool.experiments.force.results import (
    ONE_ANGLE,
    LoadReadings,
    applied_torque,
    load_rows,
    loads_outcome,
    row_results,
    stroke_grid,
)
from rigtool.quantity import combined, error_line
from rigtool.recipe import load_recipe
from tests.experiments.virtual_runs import RECIPE

SETS = (
    "rig.weights_relative_u=1e-3",
    "measure_force.measure_angle=70",
)
PULLEY = (*SETS, "rig.attachment=pulley", "rig.pulley_radius_u=1e-4")
INSTRUMENT = (
    *SETS,
    "rig.attachment=instrument",
    "rig.instrument.grasper_length_u=1e-4",
    "rig.instrument.angle_ratio_relative_u=2e-3",
)
KT, KT_U, RIPPLE_U, TABLE_U = 0.045, 1e-5, 4e-4, 3e-5
METHOD_U = (2e-5, 1e-5, 0.0)
FORCES = (0.0, 0.5, 2.0)


def recipe_of(sets, zero=False):
    return load_recipe(RECIPE, (*sets, f"measure_force.zero={str(zero).lower()}"))[0]


def constant():
    lines = [
        error_line("staircase", KT_U, "N m/A", 20),
        error_line(ONE_ANGLE, RIPPLE_U, "N m/A"),
    ]
    return combined(KT, "N m/A", lines)


def loads_of(recipe, count=6, seed=1):
    """Return readings of loads whose strokes go up and down over the grid."""
    rng, grid = np.random.default_rng(seed), stroke_grid(recipe)
    size = len(grid)
    position = np.concatenate([[0.0], *[np.append(grid[1:], grid[-2::-1])] * count])
    cycles = [
        Cycle(2 * (size - 1) * n, (size - 1) * (2 * n + 1), 2 * (size - 1) * (n + 1))
        for n in range(count)
    ]
    found = []
    for number, force in enumerate(FORCES):
        level = float(applied_torque(recipe, force, math.radians(70)))
        torque = level + 1e-3 * np.arange(len(position)) / len(position)
        values = level + 2e-4 + 1e-4 * rng.standard_normal(count - number)
        fed = 2e-4 * np.cos(position / grid[-1])
        found.append(
            LoadReadings(
                f"load_{number:03d}",
                force,
                count,
                position,
                torque,
                fed,
                cycles,
                values,
                METHOD_U[number],
            )
        )
    return found


def part(current):
    """Part of the constant's ripple that acts at a current."""
    return min(1.0, current / 0.9)


@pytest.mark.parametrize("sets", [PULLEY, INSTRUMENT])
@pytest.mark.parametrize("zero", [False, True])
def test_the_uncertainty_of_a_row_is_that_of_its_equation(sets, zero):
    """mean = factor (kT i + offset) + method, with the factor by the angle ratio; every input is
    moved by its own uncertainty. Applied: force, length, and the angle by the ratio."""
    recipe = recipe_of(sets, zero)
    rig, loads = recipe.rig, loads_of(recipe)
    rows = load_rows(loads, recipe, constant(), part, TABLE_U)
    unloaded = statistics(loads[0].values)
    zero_u = math.hypot(unloaded.u, METHOD_U[0]) / rig.torque_factor
    for number, (load, row) in enumerate(zip(loads, rows, strict=True)):
        shift = unloaded.mean if zero and number else 0.0
        found = statistics(load.values - shift)
        assert row.mean.value == pytest.approx(found.mean, rel=1e-12)
        assert row.mean.value == pytest.approx(load.values.mean() - shift, rel=1e-12)
        own_u = zero_u if zero and number else TABLE_U
        current = (abs(found.mean) / rig.torque_factor + 2 * np.abs(load.feedforward).mean()) / KT
        inputs = {
            "scatter": (found.u, lambda by: (by, 0)),
            "constant": (KT_U, lambda by, m=found.mean: (m / KT * by, 0)),
            "ripple": (part(current) * RIPPLE_U, lambda by, m=found.mean: (m / KT * by, 0)),
            "offset": (own_u, lambda by: (rig.torque_factor * by, 0)),
            "method": (load.method_u, lambda by: (by, 0)),
        }
        force, arm = load.force, rig.load_arm
        motor = math.radians(70) * rig.angle_ratio

        def applied(force=force, arm=arm, ratio=rig.angle_ratio, motor=motor):
            sine = math.sin(motor / ratio) if rig.attachment == "instrument" else 1.0
            return force * arm * sine

        def by_ratio(by, m=found.mean, applied=applied):
            there = rig.angle_ratio + by
            return m * (rig.angle_ratio / there - 1), applied(ratio=there) - applied()

        inputs["weights"] = (
            1e-3 * force,
            lambda by, f=force: (0, applied(force=f + by) - applied()),
        )
        inputs["length"] = (1e-4, lambda by, a=arm: (0, applied(arm=a + by) - applied()))
        if rig.attachment == "instrument":
            inputs["ratio"] = (2e-3 * rig.angle_ratio, by_ratio)
        changes = {}
        for name, (u, change) in inputs.items():
            more, less = change(0.01 * u), change(-0.01 * u)
            changes[name] = 50 * (np.array(more) - np.array(less))
        expected = np.sqrt(np.sum(np.square([*changes.values()]), axis=0))
        assert row.mean.u == pytest.approx(expected[0], rel=1e-4)
        assert row.applied.value == pytest.approx(applied(), rel=1e-12)
        assert row.applied.u == pytest.approx(expected[1], rel=1e-4, abs=1e-15)
        error = np.sqrt(np.sum([(a - b) ** 2 for a, b in changes.values()]))
        assert row.error.value == pytest.approx(row.mean.value - applied(), abs=1e-12)
        assert row.error.u == pytest.approx(error, rel=1e-4)
        # Welch and Satterthwaite: scatter, of the zero reading too, and staircase have degrees
        spread = changes["scatter"][0] ** 4 / found.dof + changes["constant"][0] ** 4 / 20
        spread += unloaded.u**4 / unloaded.dof if zero and number else 0.0
        assert row.mean.dof == pytest.approx(row.mean.u**4 / spread, rel=1e-3)
        assert row.std_torque == pytest.approx(np.std(load.values, ddof=1))
        count = load.values.size
        assert row.std_torque_u == pytest.approx(row.std_torque / math.sqrt(2 * (count - 1)))
        assert (row.cycles, row.effective_cycles) == (count, found.effective_count)


def test_a_constant_without_a_budget_counts_whole():
    recipe = recipe_of(PULLEY)
    known = combined(KT, "N m/A", [error_line("all", 1e-3, "N m/A")])
    plain = type(known)(KT, "N m/A", 1e-3)
    ends = [load_rows(loads_of(recipe), recipe, one, part, 0.0)[2].mean.u for one in (known, plain)]
    assert ends[0] == pytest.approx(ends[1])


def test_columns_of_a_row_are_its_numbers():
    recipe = recipe_of(INSTRUMENT)
    row = load_rows(loads_of(recipe), recipe, constant(), part, TABLE_U)[2]
    expected = {
        "applied_force": 2.0,
        "applied_torque": row.applied.value,
        "applied_torque_u": row.applied.u,
        "mean_torque": row.mean.value,
        "mean_torque_u": row.mean.u,
        "mean_torque_dof": row.mean.dof,
        "error_torque": row.mean.value - row.applied.value,
        "error_torque_u": row.error.u,
        "error_percent": 100 * (row.mean.value / row.applied.value - 1),
    }
    for name, value in expected.items():
        assert row.column(name) == pytest.approx(value), name
    blank = row.blank()
    assert blank.applied == row.applied
    for name in ("mean_torque", "std_torque", "std_torque_u", "cycles", "error_torque"):
        assert math.isnan(blank.column(name))
    first = load_rows(loads_of(recipe), recipe, constant(), part, TABLE_U)[0]
    assert math.isnan(first.column("error_percent"))
    assert first.applied.u == 0


def test_a_force_acts_on_its_arm_or_on_the_radius():
    angle = np.array([0.3, 1.5])
    for sets, sine in ((PULLEY, np.ones(2)), (INSTRUMENT, np.sin(angle))):
        recipe = recipe_of(sets)
        assert_allclose(applied_torque(recipe, 2.0, angle), 2.0 * recipe.rig.load_arm * sine)


def test_curves_have_a_point_every_ten_counts_of_the_stroke():
    recipe = recipe_of(INSTRUMENT)
    rig = recipe.rig
    span = recipe.measure_force.angle / 360 * rig.encoder_counts * rig.angle_ratio
    grid = stroke_grid(recipe)
    assert (grid[0], grid[-1]) == (0, pytest.approx(span))
    assert np.diff(grid) == pytest.approx(10, rel=0.01)


def test_tables_hold_readings_and_curves_of_every_load():
    recipe = recipe_of(PULLEY)
    loads = loads_of(recipe)
    rows = load_rows(loads, recipe, constant(), part, TABLE_U)
    found = loads_outcome(loads, rows, recipe)
    values = found.tables["values"]["torque"]
    for number, load in enumerate(loads):
        assert_allclose(values[number, : load.values.size], load.values)
        assert np.isnan(values[number, load.values.size :]).all()
    assert values.shape == (3, 6)
    for name, axis in (("values", "cycle"), ("cycles_no_load", "cycle"), ("loads", "load")):
        table = found.tables[name]
        assert table[axis].tolist() == list(range(len(table[axis]))), name
    plot = found.tables["probability_plot"]
    assert_allclose(plot["value"], np.sort(loads[0].values))
    # Filliben: medians of the order statistics of a uniform distribution
    assert_allclose(norm.cdf(plot["quantile"]), plot["probability"])
    assert_allclose(plot["probability"][[0, -1]], [1 - 0.5 ** (1 / 6), 0.5 ** (1 / 6)])
    assert found.results["normality_p"].value == pytest.approx(
        shapiro(loads[0].values).pvalue, 0.02
    )
    grid = stroke_grid(recipe)
    size, cycles = 2 * len(grid) - 1, found.tables["cycles_no_load"]
    assert_allclose(cycles["position"][[0, len(grid) - 1, -1]], [0, grid[-1], 2 * grid[-1]])
    per_cycle = 2 * (len(grid) - 1)
    step = 1e-3 / len(loads[0].position)
    begins = loads[0].torque[0] + step * per_cycle * np.arange(6)
    assert_allclose(cycles["torque"], begins[:, None] + step * np.arange(size), atol=1e-12)
    means = found.tables["mean_cycles"]["torque"]
    assert_allclose(means[0], cycles["torque"].mean(axis=0))
    assert_allclose(means[2] - means[0], loads[2].torque[0] - loads[0].torque[0])
    fed = found.tables["feedforward"]
    up_down = np.append(grid, grid[-2::-1])
    assert_allclose(fed["torque"], 2e-4 * np.cos(up_down / grid[-1]), atol=1e-9)
    assert_allclose(fed["residual"], cycles["torque"][-1] / recipe.rig.torque_factor)
    scatter = found.results["std_torque_no_load"]
    assert (scatter.value, scatter.u, scatter.dof) == (rows[0].std_torque, rows[0].std_torque_u, 5)
    named = row_results(rows)
    assert named["mean_torque_no_load"] is rows[0].mean
    assert named["mean_torque_load_002"] is rows[2].mean
    assert named["error_torque_load_001"].value == rows[1].error.value
    assert "error_torque_load_000" not in named


def test_notes_state_lacking_cycles_and_readings_that_follow_each_other():
    recipe = recipe_of(PULLEY)
    loads = loads_of(recipe, count=12)
    notes = loads_outcome(loads, load_rows(loads, recipe, constant(), part, 0.0), recipe).notes
    assert [note for note in notes if "whole cycles" in note] == [
        "load_001: 11 whole cycles of 12 in the recipe",
        "load_002: 10 whole cycles of 12 in the recipe",
    ]
    assert not any("follow each other" in note for note in notes)
    slow = np.array([1.0, 2, 3, 4, 5, 6, 6, 5, 4, 3, 2, 1]) * 1e-4
    loads[0] = type(loads[0])(**{**vars(loads[0]), "values": slow})
    notes = loads_outcome(loads, load_rows(loads, recipe, constant(), part, 0.0), recipe).notes
    (text,) = [note for note in notes if "follow each other" in note]
    assert text.startswith("load_000: readings follow each other, 12 of them count as ")
    off = np.append(np.zeros(9), [1e-5, -1e-5, 1.0])
    loads[0] = type(loads[0])(**{**vars(loads[0]), "values": off})
    notes = loads_outcome(loads, load_rows(loads, recipe, constant(), part, 0.0), recipe).notes
    assert any("not normally distributed" in note for note in notes)
