"""How far a stored table reaches, against the motion that `measure-force` asks for."""

import math
from pathlib import Path
from types import SimpleNamespace

import pytest

from rigtool.errors import RunFileError
from rigtool.experiments.learning.stored_table import _band, require_same_rig
from rigtool.quantity import Quantity
from rigtool.recipe import override_recipe
from rigtool.runfile import open_run

TABLES = Path(__file__).parents[2] / "fixtures" / "tables.h5"
"""Learned up to 5 rev/s of the output, which is 0.85 of that at the motor; 20 to 160 deg."""


@pytest.mark.parametrize("setting", ["speed_rev_per_s=4.99", "turn_angle=20.1"])
def test_motions_within_the_learned_ones_are_accepted(setting):
    with open_run(TABLES) as tables:
        recipe = override_recipe(tables.recipe, [f"measure_force.{setting}"])
        require_same_rig(tables, recipe)


@pytest.mark.parametrize(
    ("setting", "message"),
    [
        ("speed_rev_per_s=5.01", r"up to 26.7 rad/s, .* moves at 26.76 rad/s: learn that speed"),
        ("turn_angle=19.5", r"from 17.0\d to 136 deg of the motor, .* uses 16.57 to 136.4 deg"),
    ],
)
def test_motions_beyond_the_learned_ones_are_refused(setting, message):
    with open_run(TABLES) as tables:
        recipe = override_recipe(tables.recipe, [f"measure_force.{setting}"])
        with pytest.raises(RunFileError, match=message):
            require_same_rig(tables, recipe)


def test_the_band_of_a_table_is_that_of_the_recipe_or_of_the_one_speed_it_was_learned_at():
    with open_run(TABLES) as tables:
        settings = tables.recipe.ilc_learn
        assert _band(tables) == (settings.robustness_hz, None)
        one = SimpleNamespace(
            recipe=override_recipe(
                tables.recipe,
                [
                    "ilc_learn.turning.speeds_rev_per_s=[0.5, 2]",
                    "ilc_learn.turning.low_speeds_rev_per_s=[0.1]",
                ],
            ),
            results={"learning_cutoff": None},
            result=lambda name, unit: Quantity(20.0, unit, reason="stated"),
        )
        assert _band(one) == (20.0, pytest.approx(math.pi))
        assert _band(SimpleNamespace(recipe=None)) == (None, None)
