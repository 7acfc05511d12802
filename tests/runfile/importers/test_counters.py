"""Counters that begin again, where no mapping states it."""

import numpy as np
import pytest

from rigtool.recipe.mapping import parse_mapping
from rigtool.runfile import open_run
from rigtool.runfile.importers import import_files

TIME = np.arange(600) * 1e-3
TURNS = 1.5 * np.sin(7 * TIME) + 0.2 * np.sin(31 * TIME)
COUNTS = np.floor(4096 * TURNS)


def taken(folder, name, unit, values):
    """Import raw values of one position; returns it in SI, and the notes."""
    text = f"""mapping = 1
[rig]
name = "x"
encoder_counts = 4096
[file]
sampling_rate_hz = 1000
[signals]
{name} = {{ column = 1, unit = "{unit}" }}
"""
    np.save(folder / "a.npy", np.array([values, values]))
    done = import_files(
        [str(folder / "a.npy")], str(folder / "a.h5"), (parse_mapping(text), text), overwrite=True
    ).done
    with open_run(folder / "a.h5") as run:
        return run.recording("imported").read(name), "".join(done[0].notes)


@pytest.mark.parametrize(
    ("name", "unit", "whole", "end", "si"),
    [
        ("position", "deg", 360 * TURNS, 360, np.pi / 180),
        ("position", "rad", 2 * np.pi * TURNS, 2 * np.pi, 1),
        ("output_position", "rev", TURNS, 1, 2 * np.pi),
        ("encoder", "count", COUNTS, 4096, 1),
        ("encoder", "count", COUNTS, 1024, 1),
    ],
)
@pytest.mark.parametrize("start", [0.0, -0.5])
def test_the_end_that_the_samples_show(tmp_path, name, unit, whole, end, si, start):
    low = start * end
    found, notes = taken(tmp_path, name, unit, (whole - low) % end + low)
    assert f"{name} begins again at {end:.10g}" in notes
    np.testing.assert_allclose(found - found[0], (whole - whole[0]) * si, atol=1e-9)


def test_a_turn_of_few_samples_goes_on_as_long_as_they_show_which_way(tmp_path):
    """Up to a quarter of a turn from sample to sample, and up to two thirds of one."""
    for every, shown in ((15, True), (40, False)):
        whole = 360 * TURNS[::every]
        found, notes = taken(tmp_path, "position", "deg", (whole + 90) % 360)
        assert ("begins again at 360" in notes) is shown
        assert np.allclose(found - found[0], np.radians(whole - whole[0])) is shown


def test_samples_that_are_wrong_are_no_end(tmp_path):
    """Nor are counts that go on beyond the range, or a motion as long as a turn between samples."""
    dropped = COUNTS + 2.0**13
    dropped[[100, 300]] = 0
    alternating = np.where(np.arange(600) % 2, 4000.0, 0.0)
    for values in (dropped, COUNTS, alternating):
        found, notes = taken(tmp_path, "encoder", "count", values)
        assert "begins again at" not in notes
        np.testing.assert_array_equal(found, values)
