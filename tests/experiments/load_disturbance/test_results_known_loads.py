"""Budget lines of weights, arm and angle ratio are what these change in a torque."""

import pytest

from rigtool.experiments.load_disturbance.results_known_loads import ratio_line, reference_lines
from rigtool.recipe import load_recipe
from tests.experiments.virtual_runs import RECIPE

SETTINGS = (
    "rig.attachment=instrument",
    "rig.weights_relative_u=0.002",
    "rig.instrument.grasper_length_u=1e-4",
    "rig.instrument.angle_ratio_relative_u=0.004",
)


def test_a_reference_torque_is_force_times_arm():
    recipe = load_recipe(RECIPE, SETTINGS)[0]
    arm, force = recipe.rig.load_arm, 2.5
    weights, length = reference_lines(recipe, force, force * arm)
    assert (weights.value, weights.u) == pytest.approx((force, 0.002 * force), rel=1e-12)
    assert weights.sensitivity == pytest.approx(arm, rel=1e-12)
    assert (length.value, length.u) == (arm, 1e-4)
    assert length.sensitivity == pytest.approx(force, rel=1e-12)
    assert weights.contribution == pytest.approx(0.002 * force * arm, rel=1e-12)


def test_the_ratio_changes_a_torque_by_its_relative_part():
    recipe = load_recipe(RECIPE, SETTINGS)[0]
    line = ratio_line(recipe, -0.05)
    assert line.value == recipe.rig.angle_ratio
    assert line.u == pytest.approx(0.004 * line.value, rel=1e-12)
    assert line.contribution == pytest.approx(0.05 * 0.004, rel=1e-12)
