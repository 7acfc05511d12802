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


@pytest.mark.parametrize(
    ("sample_time", "samples"),
    [
        ("125e-6", (32, 8, 4, 16, 4, 16)),
        ("1e-3", (4, 1, 1, 2, 1, 2)),
        ("50e-6", (80, 20, 10, 40, 10, 40)),
    ],
)
def test_other_loops_average_for_as_long(sample_time, samples):
    recipe, _ = load_recipe(RECIPE, [f"rig.sample_time={sample_time}"])
    learn = recipe.ilc_learn
    sections = (
        recipe.calibrate_kt, recipe.stribeck, recipe.fft_ripple, learn.loads, learn.turning,
        recipe.measure_force,
    )  # fmt: skip
    assert tuple(section.record_every for section in sections) == samples
    assert recipe.measure_force.motion.record_every == 1  # live: each sample


def test_a_stated_number_of_samples_stays():
    settings = ["rig.sample_time=1e-3", "calibrate_kt.record_every=32"]
    assert load_recipe(RECIPE, settings)[0].calibrate_kt.record_every == 32


@pytest.mark.parametrize("value", ["0", "-1", "nan", "1e-320", '"fast"', "[]"])
def test_a_wrong_sample_time_is_the_only_mistake(value):
    with pytest.raises(RecipeError, match=r"1 mistake in the recipe\n.*rig\.sample_time"):
        load_recipe(RECIPE, [f"rig.sample_time={value}"])


@pytest.mark.parametrize("table", ["calibrate_kt", "ilc_learn", "ilc_learn.loads"])
def test_a_value_in_place_of_a_table_is_reported(table):
    with pytest.raises(RecipeError, match=f"{table}: must be a table"):
        load_recipe(RECIPE, ["rig.sample_time=1e-3", f"{table}=3"])
