"""Mappings: mistakes are reported together, names mean what they mean elsewhere."""

import re
from pathlib import Path

import pytest

from rigtool.errors import RecipeError
from rigtool.recipe.mapping import (
    SIGNALS,
    Condition,
    FileLayout,
    ImportedRig,
    Map,
    Mapping,
    Signal,
    load_mapping,
    parse_mapping,
)
from rigtool.signals import CHANNELS
from tests.runfile.importers.mappings import TEXT

RECIPES = Path(__file__).parents[2] / "recipes" / "import"


@pytest.mark.parametrize("path", sorted(RECIPES.glob("*.toml")), ids=lambda path: path.stem)
def test_the_mappings_that_come_with_rigtool(path):
    assert load_mapping(path)[0].rig.name


def test_names_mean_the_same_as_on_our_own_rigs():
    for name in CHANNELS.keys() & SIGNALS.keys():
        assert SIGNALS[name][0] == CHANNELS[name][0], name


def test_a_linear_axis_has_metres():
    text = TEXT.replace("[rig]", '[rig]\naxis = "linear"').replace("torque_constant = 0.045", "")
    text = text.replace("encoder = ", "position = ").replace('unit = "count"', 'unit = "mm"')
    mapping = parse_mapping(text)
    assert (mapping.unit("position"), mapping.factor("position")) == ("m", 1e-3)
    with pytest.raises(RecipeError, match="position on a rotary axis is in rad, this is in m"):
        parse_mapping(text.replace('axis = "linear"', ""))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (("mapping = 1", "mapping = 2"), "needs `mapping = 1`"),
        (("column = 1", "column = 0"), r"map:9: .*counted from 1"),
        (('"mA"', '"horse"'), "unit: is no known unit: known are 1, %, s"),
        (('comment = "%"', 'delimiter = ".."'), "one character"),
        (('comment = "%"', 'delimiter = ","\ndecimal = ","'), "both delimiter and decimal"),
        (("scale = 10", "scale = 0"), "nothing of the signal"),
        (("[file]", "[file]\nsampling_rate_hz = 8"), "either a signal `time` or sampling_rate"),
        (('unit = "mA"', 'unit = "mA", counts_per_turn = 8'), "goes with unit"),
        (('name = "bench"', ""), "rig.name: is missing"),
        (("[signals]", '[map]\nsignal = "a"\nunit = "A"\n[signals]'), r"a \[map\] or has"),
        (("current = ", '"a-b" = '), "use letters, digits"),
        (('"mA"', '"% of rated torque"'), "needs rated_torque"),
    ],
)
def test_mistakes(change, message):
    with pytest.raises(RecipeError, match=message):
        parse_mapping(TEXT.replace(*change), "map")


def test_all_mistakes_at_once():
    text = TEXT.replace('"mA"', '"horse"').replace("encoder_counts = 4096", "encoder_counts = 0")
    with pytest.raises(RecipeError, match="2 mistakes in the mapping"):
        parse_mapping(text, "map")


def test_every_key_is_in_the_documentation():
    text = (RECIPES.parents[1] / "docs" / "imports.md").read_text()
    sections = {
        "rig.": ImportedRig,
        "file.": FileLayout,
        "signals.NAME.": Signal,
        "conditions.": Condition,
        "map.": Map,
        "": Mapping,
    }
    for prefix, section in sections.items():
        for key in section.model_fields:
            group = key in ("rig", "file", "signals", "map") and not prefix
            name = f"`{key}." if group else f"`{prefix}{key}`"
            assert name in text, name
    documented = set(re.findall(r"`((?:rig|file|signals\.NAME|conditions|map)\.\w+)`", text))
    known = {f"{prefix}{key}" for prefix, s in sections.items() if prefix for key in s.model_fields}
    assert documented == known
