"""Recipes: a rig and what to do on it, in TOML. Every default lives in the models here."""

from rigtool.recipe.commands import (
    CalibrateKt,
    FftRipple,
    IdentifyPlant,
    IlcLearn,
    MeasureForce,
    Stribeck,
    Suspension,
)
from rigtool.recipe.load import (
    Recipe,
    load_recipe,
    override_recipe,
    parse_recipe,
    recipe_from_resolved,
)
from rigtool.recipe.mapping import Mapping, load_mapping
from rigtool.recipe.rig import Rig
from rigtool.recipe.serial import Serial
from rigtool.recipe.virtual import Virtual

__all__ = [
    "CalibrateKt",
    "FftRipple",
    "IdentifyPlant",
    "IlcLearn",
    "Mapping",
    "MeasureForce",
    "Recipe",
    "Rig",
    "Serial",
    "Stribeck",
    "Suspension",
    "Virtual",
    "load_mapping",
    "load_recipe",
    "override_recipe",
    "parse_recipe",
    "recipe_from_resolved",
]
