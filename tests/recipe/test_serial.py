"""Recipes of rigs on a line: limits are mandatory, the rest has defaults."""

import pytest

from rigtool.errors import RecipeError
from rigtool.recipe import parse_recipe, recipe_from_resolved

RIG = """recipe = 1
[rig]
name = "bench"
source = "serial"
"""

SERIAL = """[serial]
driver = "odrive"
port = "/dev/ttyACM0"
"""

LIMITS = """[serial.limits]
current = 2
speed = 40
position = [-3, 4]
temperature_degc = 60
duration = 100
"""


def test_a_whole_one():
    recipe = parse_recipe(RIG + SERIAL + LIMITS)
    assert recipe.serial.driver == "odrive"
    assert recipe.serial.limits.position == (-3, 4)
    assert recipe.serial.watchdog > 0
    assert recipe.virtual is None
    assert recipe_from_resolved(recipe.resolved()) == recipe


def test_source_without_its_table():
    with pytest.raises(RecipeError) as caught:
        parse_recipe(RIG, "bench.toml")
    text = str(caught.value)
    assert "1 mistake in the recipe" in text
    assert "add one with driver, port and [serial.limits]" in text
    assert "got" not in text


def test_every_limit_is_mandatory():
    for line in LIMITS.splitlines()[1:]:
        name = line.split()[0]
        with pytest.raises(RecipeError, match=rf"serial.limits.{name}: is missing; add it"):
            parse_recipe(RIG + SERIAL + LIMITS.replace(line, ""))
    with pytest.raises(RecipeError, match=r"serial.limits: is missing"):
        parse_recipe(RIG + SERIAL)


@pytest.mark.parametrize(
    ("line", "message"),
    [
        ("position = [4, -3]", r"position must be \[lowest, highest\]"),
        ("position = [4, 4]", r"position must be"),
        ("current = 0", "above 0"),
        ("current = inf", "finite"),
        ("torque = 1", "is not a key that this table knows"),
    ],
)
def test_limits_that_are_none(line, message):
    key = line.split()[0]
    kept = [given for given in LIMITS.splitlines() if given.split()[0] != key]
    with pytest.raises(RecipeError, match=message):
        parse_recipe(RIG + SERIAL + "\n".join([*kept, line]))


def test_a_table_for_the_line_changes_nothing_for_the_virtual_rig():
    recipe = parse_recipe(RIG.replace("serial", "virtual") + SERIAL + LIMITS)
    assert recipe.rig.source == "virtual"
