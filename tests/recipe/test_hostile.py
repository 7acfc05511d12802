"""Recipes and mappings that would take a parser for ever, or crash it: each is refused."""

import pytest

from rigtool.errors import RecipeError
from rigtool.recipe import load_recipe
from rigtool.recipe.load import MAX_BYTES, parse_recipe, parse_toml
from rigtool.recipe.mapping import parse_mapping, require_quick

BOMBS = {
    "nested lists": ("x = " + "[" * 100_000, "nested"),
    "nested tables": ("x = " + "{a = " * 100_000, "nested"),
    "lists that end": ("x = " + "[" * 30 + "]" * 30, "nested more than 20"),
    "parts of a key": ("a." * 100_000 + "a = 1", "dots"),
    "fewer parts": ("a." * 900 + "a = 1", "nested more than 20"),
    "digits": ("x = 1" + "0" * 5000, "not valid TOML"),
    "hexadecimal digits": ("x = 0x" + "f" * 5000, "64 bits"),
}


@pytest.mark.parametrize("bomb", BOMBS)
def test_toml(bomb):
    text, message = BOMBS[bomb]
    with pytest.raises(RecipeError, match=message):
        parse_toml(text, "rig.toml")


def test_size(tmp_path):
    path = tmp_path / "rig.toml"
    path.write_text("#" * MAX_BYTES + "\n")
    with pytest.raises(RecipeError, match=f"larger than {MAX_BYTES} bytes"):
        load_recipe(path)
    with pytest.raises(RecipeError, match="no file"):
        load_recipe("/dev/zero")


@pytest.mark.parametrize("override", ["a." * 50_000 + "a=1", "rig.sample_time=" + "[" * 50_000])
def test_settings(override):
    with pytest.raises(Exception, match=r"parts|nested"):
        load_recipe("recipes/briaire-2006.toml", [override])


@pytest.mark.parametrize(
    "pattern",
    [
        "(?x)(a)#" + "[" * 200_000,
        "^((?:a+)+)$",
        "(a|a)*b",
        "(.*){9}",
        ".*.*.*.*(x)",
        "a?a?a?a?(a)",
        r"(\d+)+",
    ],
)
def test_patterns_that_backtrack(pattern):
    with pytest.raises(ValueError, match="pattern"):
        require_quick(pattern)


@pytest.mark.parametrize(
    "pattern", [r"^(\d)\d$", "(?:^|_)(nocomp|comp)(?:_|$)", r"(\d+)[*+]{1}\)+", "(?P<x>[]*+?]+)"]
)
def test_patterns_that_do_not(pattern):
    require_quick(pattern)


def test_names_of_tables_are_read_once():
    # Mistakes name their lines: finding these must not take the square of a line's length.
    text = 'recipe = 1\n[rig]\n["' + " " * 200_000 + '"]\na = 1\n'
    with pytest.raises(RecipeError, match="mistakes in the recipe"):
        parse_recipe(text)


def test_many_conditions():
    condition = '[[conditions]]\nname = "a"\npattern = "(a*)a*a*b"\n'
    text = "mapping = 1\n[signals]\ntime = { column = 1 }\n" + 101 * condition
    with pytest.raises(RecipeError, match="takes 100 values at most"):
        parse_mapping(text)
