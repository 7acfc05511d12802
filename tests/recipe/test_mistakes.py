"""Mistakes in a recipe: what is expected, in words of its own, with what was meant."""

import re
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from rigtool.errors import RecipeError, UsageError
from rigtool.recipe import load_recipe, parse_recipe

TEXT = (Path(__file__).parents[2] / "recipes" / "briaire-2006.toml").read_text("utf-8")


@pytest.mark.parametrize(
    ("override", "message"),
    [
        ("rig.arm=3", "rig.arm: must be a table of keys, got 3"),
        ("calibrate_kt.rotor_postions=3", "did you mean rotor_positions?"),
        ("current_max=3", "did you mean calibrate_kt.current_max?"),
        ("force=3", "did you mean virtual.contact.force or serial.force?"),
        ("calibrate_kt.nothing_like_it=3", "remove it or correct its spelling"),
        ('virtual.contact=[{kind="pulze",at=[0]}]', "has the 'kind' 'pulze', must be one of"),
        ("virtual.contact=[{at=[0]}]", "needs a key 'kind'"),
        ('virtual.contact=[{kind="pulse",at=[0],forse=[1,2]}]', "did you mean force?"),
        (
            'virtual.contact=[{kind="pulse",at=[0],force=1,damping=1}]',
            "damping: is a key of another kind of this table; remove it",
        ),
        ("rig.sample_time=-1", "must be above 0, got -1 (of the control loop, s)"),
        ("stribeck.hold_speeds=[1, 2, 0]", "hold_speeds.2: must be above 0, got 0 (rad/s)"),
        ("measure_force.forces=[]", "needs 1 value at least, got []"),
        ("rig.encoder_counts=4.5", "must be a whole number, got 4.5"),
        ("rig.attachment=pully", "must be 'pulley' or 'instrument', got 'pully'"),
        ("stribeck.hold_speeds=[1]", "needs 3 values at least, got [1]"),
        ("measure_force.zero=maybe", "must be true or false, got 'maybe'"),
        ("rig.name=3", "must be a text, got 3"),
        ("rig.name=", "rig.name: must not be empty, got ''"),
        ("calibrate_kt.rotor_positions=true", "rotor_positions: must be a number, got True"),
        ("stribeck.hold_speeds=[5, true, 12]", "hold_speeds.1: must be a number, got True"),
    ],
)
def test_what_is_expected_is_said_in_words_of_the_recipe(override, message):
    with pytest.raises(RecipeError) as caught:
        parse_recipe(TEXT, "r.toml", [override])
    assert message in str(caught.value)
    assert "Input should" not in str(caught.value)


@pytest.mark.parametrize(
    ("given", "places"),
    [("5000", ["force"]), ("[5000, 5000]", ["force.0", "force.1"]), ("[1, 5000]", ["force.1"])],
)
def test_a_number_that_stands_for_a_range_is_one_mistake(given, places):
    contact = f'{{kind="pulse", at=[0], force={given}}}'
    with pytest.raises(RecipeError) as caught:
        parse_recipe(TEXT, "r.toml", [f"virtual.contact=[{contact}]"])
    first, *lines = str(caught.value).splitlines()
    assert re.findall(r"pulse\.(\S+): must be at most 1000, got 5000", str(caught.value)) == places
    assert len(lines) == len(places)
    assert first == f"r.toml: {len(places)} mistake{'s'[: len(places) - 1]} in the recipe"


@pytest.mark.parametrize("key", ["", ".rig", "rig.", "rig..name", " "])
def test_a_setting_without_a_key_is_shown_as_it_was_given(key):
    with pytest.raises(UsageError, match=re.escape(f"--set '{key}=3': expected key=value")):
        parse_recipe(TEXT, "r.toml", [f"{key}=3"])


def test_a_recipe_in_another_code_is_refused_with_a_remedy(tmp_path):
    path = tmp_path / "r.toml"
    path.write_text(TEXT, encoding="utf-16")
    with pytest.raises(RecipeError, match="byte 0 is not UTF-8; give a text, saved in UTF-8"):
        load_recipe(path, ())


def test_a_long_value_is_cut():
    with pytest.raises(RecipeError) as caught:
        parse_recipe(TEXT, "r.toml", [f"rig.encoder_counts={'x' * 5000}"])
    assert len(str(caught.value)) < 300


@given(
    st.sampled_from(["rig.sample_time", "stribeck", "rig.arm.length", "virtual.motor", "rig.name"]),
    st.recursive(
        st.none() | st.booleans() | st.floats() | st.text("ab{}%", max_size=5),
        lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text("ab"), inner),
        max_leaves=5,
    ),
)
def test_any_value_gives_a_recipe_or_a_message(key, value):
    from rigtool.recipe.load import Recipe, parse_toml, validate

    data = parse_toml(TEXT, "r.toml")
    *tables, last = key.split(".")
    target = data
    for table in tables:
        target = target[table]
    target[last] = value
    found = None
    try:
        validate(Recipe, data, TEXT, "r.toml", "recipe")
    except RecipeError as error:
        found = str(error)
    assert found is None or "Input should" not in found
