"""What a recipe may say of contacts and hands, and which mistakes are reported."""

from pathlib import Path

import pytest

from rigtool.errors import RecipeError
from rigtool.recipe import load_recipe, parse_recipe
from rigtool.recipe.load import recipe_from_resolved

RECIPE = Path(__file__).parents[2] / "recipes" / "briaire-2006.toml"
CONTACTS = """
[[virtual.contact]]
kind = "pulse"
at = [2, 5.5]
duration = 0.5
force = 1.5

[[virtual.contact]]
kind = "sine"
rate_per_min = 10
duration = [1, 3]
force = [0.1, 0.5]
frequency_hz = 10

[[virtual.contact]]
kind = "tissue"
at = [0]
angle_deg = 120
stiffness = 0.05

[virtual.hand]
speed_rev_per_s = [0.2, 1]
"""


def parse(more):
    return parse_recipe(RECIPE.read_text(encoding="utf-8") + more, "r.toml")


def test_contacts_are_read_and_kept():
    recipe = parse(CONTACTS)
    pulse, sine, tissue = recipe.virtual.contact
    assert (pulse.kind, pulse.force, pulse.duration) == ("pulse", (1.5, 1.5), (0.5, 0.5))
    assert (sine.force, sine.frequency_hz) == ((0.1, 0.5), (10, 10))
    assert (tissue.duration, tissue.damping) == (None, 0.0)
    assert recipe.virtual.hand.moves == "motor"
    assert recipe_from_resolved(recipe.resolved()) == recipe


def test_without_contacts_nothing_touches():
    recipe, _ = load_recipe(RECIPE)
    assert recipe.virtual.contact == ()


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ('kind = "poke"', "poke"),
        ('kind = "pulse"\nforce = 1\nduration = 1', "either `at`, the times, or `rate_per_min`"),
        ('kind = "pulse"\nat = [1]\nrate_per_min = 2\nforce = 1\nduration = 1', "either `at`"),
        ('kind = "pulse"\nrate_per_min = 2\nforce = 1', "needs a `duration`"),
        ('kind = "pulse"\nat = [1]\nforce = [2, 1]', "from 2 down to 1: swap the two ends"),
        ('kind = "pulse"\nat = [1]\nforce = 1\nduration = 0.05', "twice the rise_time of 0.05 s"),
        ('kind = "pulse"\nat = [1]\nforce = 1e6', "1000"),
        ('kind = "pulse"\nat = [-1]\nforce = 1', "at least 0"),
        ('kind = "mass"\nat = [1]\nforce = -1', "above 0"),
        ('kind = "sine"\nat = [1]\nforce = 1\nfrequency_hz = 900', "a tenth of the loop's"),
        ('kind = "ramp"\nat = [1]\nforce = 1', "is missing; add it (of the rise, s)"),
        ('kind = "tissue"\nat = [1]\nangle_deg = 10\nstiffness = 0', "above 0"),
        ('kind = "tissue"\nat = [1]\nangle_deg = 10\nstiffness = 1\ncolour = 1', "not a key"),
    ],
)
def test_mistakes_in_a_contact_are_named(text, message):
    with pytest.raises(RecipeError) as raised:
        parse(f"\n[[virtual.contact]]\n{text}\n")
    assert message in str(raised.value)
    assert "r.toml:" in str(raised.value)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("angle_deg = [90, 90]", "leaves 0 deg"),
        ("speed_rev_per_s = [2, 1]", "swap the two ends"),
        ('moves = "tool"', "motor"),
        ("pause_share = 1", "below 1"),
    ],
)
def test_mistakes_in_a_hand_are_named(text, message):
    with pytest.raises(RecipeError) as raised:
        parse(f"\n[virtual.hand]\n{text}\n")
    assert message in str(raised.value)
