"""The recipes for users load, and a motion can be looked at without a rig."""

from pathlib import Path

import pytest

from rigtool.recipe import load_recipe
from tests.cli.called import call

RECIPES = Path(__file__).parents[2] / "recipes"


@pytest.mark.parametrize("path", sorted(RECIPES.glob("*.toml")), ids=lambda path: path.stem)
def test_every_recipe_loads(path):
    recipe, _ = load_recipe(path)
    assert recipe.rig.name == path.stem or path.stem.startswith(("maxon", "briaire"))


def test_what_would_move_on_ones_own_target_is_reported(tmp_path, capsys):
    recipe = RECIPES / "own-target.toml"
    code, out, err = call(capsys, "calibrate-kt", recipe, "--dry-run", "-o", tmp_path / "a.h5")
    assert code == 0, err
    assert "A" in (out + err).split()
    assert not list(tmp_path.iterdir())
