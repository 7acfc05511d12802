"""Signals that contradict each other, or leave the numbers of a computer, are not imported."""

import numpy as np
import pytest

from rigtool.errors import RecipeError, RunFileError
from rigtool.recipe.mapping import parse_mapping
from rigtool.runfile import open_run
from tests.runfile.importers.mappings import take

MAPPING = """mapping = 1
[rig]
name = "bench"
[signals]
time = { column = 1, unit = "s" }
position = { column = 2, unit = "rad" }
speed = { column = 3, unit = "rad/s" }
"""


def write(path, time, position, speed):
    np.savetxt(path, np.column_stack([time, position, speed]), delimiter=",")
    return path


def motion(rate=1000.0, noise=0.0, seed=3):
    """To and fro with a sine, and what a noisy tachometer reads."""
    time = np.arange(4000) / rate
    position = 2 * np.sin(2 * np.pi * 1.5 * time)
    speed = 2 * 2 * np.pi * 1.5 * np.cos(2 * np.pi * 1.5 * time)
    return time, position, speed + noise * np.random.default_rng(seed).standard_normal(len(time))


@pytest.mark.parametrize("factor", [0.5, 2.0, -1.0, 60 / (2 * np.pi)])
def test_a_speed_that_contradicts_the_position_is_refused(tmp_path, factor):
    time, position, speed = motion(noise=5.0)
    source = write(tmp_path / "a.csv", time, position, factor * speed)
    with pytest.raises(RunFileError, match=r"position moves .* times as far as speed states"):
        take(source, tmp_path / "a.h5", MAPPING)
    assert not (tmp_path / "a.h5").exists()


def test_a_wrong_sampling_rate_is_refused(tmp_path):
    time, position, speed = motion()
    source = write(tmp_path / "a.csv", 2 * time, position, speed)
    with pytest.raises(RunFileError, match=r"moves 0\.5 times as far"):
        take(source, tmp_path / "a.h5", MAPPING)


@pytest.mark.parametrize("factor", [0.8, 1.0, 1.3])
def test_a_noisy_tachometer_is_taken(tmp_path, factor):
    time, position, speed = motion(noise=10.0)
    source = write(tmp_path / "a.csv", time, position, factor * speed)
    take(source, tmp_path / "a.h5", MAPPING)


def test_positions_that_do_not_follow_speed_at_all_are_taken_as_they_are(tmp_path):
    """A position that starts again with each turn and has no wraps_at; a motor at rest."""
    time = motion()[0]
    wrapped = write(tmp_path / "a.csv", time, (50 * time) % (2 * np.pi), np.full(len(time), 50.0))
    take(wrapped, tmp_path / "a.h5", MAPPING)
    rest = write(tmp_path / "b.csv", time, np.zeros(len(time)), np.zeros(len(time)))
    take(rest, tmp_path / "b.h5", MAPPING)
    with open_run(tmp_path / "b.h5") as run:
        assert run.recording("imported").size == len(time)


@pytest.mark.parametrize("change", ["scale = 1e308", "scale = 1e15, offset = 1e300"])
def test_scales_without_sense_are_refused(change):
    with pytest.raises(RecipeError, match=r"at most 1e\+15"):
        parse_mapping(MAPPING.replace('unit = "rad"', f'unit = "rad", {change}'))


def test_values_beyond_numbers_are_refused(tmp_path):
    time, position, speed = motion()
    source = write(tmp_path / "a.csv", time, position * 1e300, speed)
    text = MAPPING.replace('unit = "rad"', 'unit = "rad", scale = 1e10')
    with pytest.raises(RunFileError, match="position is beyond the numbers"):
        take(source, tmp_path / "a.h5", text)
    assert not (tmp_path / "a.h5").exists()


def test_a_torque_constant_on_a_linear_axis_is_refused():
    text = MAPPING.replace('"bench"', '"bench"\naxis = "linear"\ntorque_constant = 0.045')
    text = text.replace('"rad"', '"m"').replace('"rad/s"', '"m/s"')
    with pytest.raises(RecipeError, match=r"torque_constant 0.045 N m/A .* linear axis"):
        parse_mapping(text)
