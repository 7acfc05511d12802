"""Recipes: a rig and what to do on it, in TOML. Every default is in the models here."""

from rigtool.recipe.load import (
    Recipe,
    load_recipe,
    override_recipe,
    parse_recipe,
    recipe_from_resolved,
)

__all__ = ["Recipe", "load_recipe", "override_recipe", "parse_recipe", "recipe_from_resolved"]
