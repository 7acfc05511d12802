"""Recipes: what is read, and how mistakes are reported."""

import json
from pathlib import Path

import pytest

from rigtool.errors import RecipeError, UsageError
from rigtool.recipe import load_recipe, override_recipe, parse_recipe, recipe_from_resolved

RECIPE = Path(__file__).parents[2] / "recipes" / "briaire-2006.toml"


def test_inertia_of_the_thesis_parts():
    recipe, _ = load_recipe(RECIPE, ["rig.attachment=pulley"])
    # [7.2.3] total of rotor, encoder and pulley
    assert recipe.rig.nominal_inertia == pytest.approx(1.503e-5, rel=1e-3)


def test_resolved_recipe_comes_back_identical():
    recipe, _ = load_recipe(RECIPE)
    assert recipe_from_resolved(recipe.resolved()) == recipe
    assert json.loads(recipe.resolved())["ilc_learn"]["moves"] == 20


def test_every_mistake_is_reported_with_its_line():
    text = RECIPE.read_text()
    wrong = {
        "encoder_counts = 4000": "encoder_counts = -4",
        "sample_time = 125e-6": 'sample_time = "fast"',
        "moves = 20": "movs = 20",
        "coulomb_friction = 2.3e-3": "# coulomb_friction = 2.3e-3",
    }
    for right, mistake in wrong.items():
        assert text.count(right) == 1
        text = text.replace(right, mistake)
    with pytest.raises(RecipeError) as caught:
        parse_recipe(text, "bad.toml")
    message = str(caught.value)
    lines = text.splitlines()
    assert "4 mistakes" in message
    for key in ("encoder_counts = -4", 'sample_time = "fast"', "movs = 20", "[virtual.motor]"):
        number = next(i for i, line in enumerate(lines, 1) if line.startswith(key))
        assert f"bad.toml:{number}: " in message
    assert "coulomb_friction: is missing" in message
    assert "movs: is not a key" in message


@pytest.mark.parametrize(
    ("text", "part"),
    [
        ("[project]\nname = 'x'\n", "not a recipe of rigtool"),
        ("recipe = 1\nrig = [", "not valid TOML"),
        ("recipe = 9\n[rig]\nname = 'x'\n", "recipe version 9"),
        ("recipe = 1\n[rig]\nname = 'x'\nsample_time = nan\n", "sample_time"),
        (
            "recipe = 1\n[rig]\nname = 'x'\n[ilc_learn]\nturn_angle = 60.0\n",
            "turn_angle 60.0 deg must be below end_angle 45.0 deg",
        ),
    ],
)
def test_other_texts_are_refused(text, part):
    with pytest.raises(RecipeError, match=part):
        parse_recipe(text)


def test_missing_and_unreadable_files(tmp_path):
    with pytest.raises(RecipeError, match="no such recipe"):
        load_recipe(tmp_path / "none.toml")
    binary = tmp_path / "binary.toml"
    binary.write_bytes(b"\x89HDF\xff\xfe")
    with pytest.raises(RecipeError, match="byte 0 is not UTF-8; give a text"):
        load_recipe(binary)


def test_overrides_change_values_and_are_checked():
    recipe, _ = load_recipe(RECIPE, ["virtual.seed=7", "rig.attachment=pulley"])
    assert recipe.virtual is not None
    assert (recipe.virtual.seed, recipe.rig.attachment) == (7, "pulley")
    assert override_recipe(recipe, ["ilc_learn.moves=5"]).ilc_learn.moves == 5
    with pytest.raises(RecipeError, match=r"--set: ilc_learn\.moves"):
        override_recipe(recipe, ["ilc_learn.moves=1"])
    with pytest.raises(RecipeError, match=r"--set: virtual\.contact\.0\.pulse\.force: is missing"):
        load_recipe(RECIPE, ['virtual.contact=[{kind="pulse"}]'])
    with pytest.raises(UsageError, match="expected key=value"):
        load_recipe(RECIPE, ["virtual.seed"])
    with pytest.raises(UsageError, match="is a value, not a table"):
        load_recipe(RECIPE, ["recipe.x=1"])
