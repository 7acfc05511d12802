"""Maps from text: values alone, or with their angles."""

import numpy as np
import pytest

from rigtool.recipe.mapping import parse_mapping
from rigtool.runfile import open_run
from rigtool.runfile.importers import import_files

MAP = """mapping = 1
[rig]
name = "bench"
[map]
signal = "current"
unit = "mA"
"""
ANGLES = MAP + 'column = 2\nangle = { column = 1, unit = "deg" }\n'


def take(path, text):
    import_files([str(path)], str(path.with_suffix(".h5")), (parse_mapping(text), text))
    with open_run(path.with_suffix(".h5")) as run:
        table = run.table("map")
    return table["position"], table["current"]


def test_one_value_a_line(tmp_path):
    (tmp_path / "a.csv").write_text("1\n2\n3\n4\n")
    position, current = take(tmp_path / "a.csv", MAP)
    np.testing.assert_allclose(position, np.arange(4) * np.pi / 2, rtol=1e-15, atol=0)
    np.testing.assert_allclose(current, [1e-3, 2e-3, 3e-3, 4e-3], rtol=1e-15, atol=0)


def test_angles_in_any_order_over_several_turns(tmp_path):
    """Two values at one angle become their mean."""
    (tmp_path / "a.csv").write_text("270;7\n0;1\n90;3\n360;2\n-180;5\n")
    position, current = take(tmp_path / "a.csv", ANGLES)
    np.testing.assert_allclose(position, np.arange(4) * np.pi / 2, rtol=1e-12, atol=1e-15)
    np.testing.assert_allclose(current, [1.5e-3, 3e-3, 5e-3, 7e-3], rtol=1e-12, atol=0)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [('"deg"', '"A"', "give an angle"), ("column = 2\n", "", "needs `column`")],
)
def test_mappings_that_make_no_map(old, new, message):
    with pytest.raises(ValueError, match=message):
        parse_mapping(ANGLES.replace(old, new))
