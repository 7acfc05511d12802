"""The loop of recordings that is compared with those learned."""

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy import stats

from rigtool.experiments.imported_load.loop import learn_loop


def test_mean_is_by_the_sensor_and_deviation_from_it():
    """What leaving out loads changes in all recordings is no part of the mean."""
    place = np.tile(np.linspace(0.001, 0.999, 2000), 6)
    rising = np.repeat([True, False] * 3, 2000)
    recording = np.repeat([0, 1, 2], 4000)
    half = np.array([1.0, 2.0, 4.5])[recording]
    sensor = np.where(rising, 2.5, -0.5) + recording
    found = learn_loop(place, rising, np.where(rising, half, -half), sensor, recording)
    assert_allclose(found.mean, np.full(found.mean.shape, 3.0), rtol=1e-12)
    assert_allclose(found.offset, np.sqrt((1 + 1 + 36) / 2), rtol=1e-12)
    assert_allclose(found.shape, 0, atol=1e-12)
    assert found.recordings == 3


def recordings(count, seed):
    """Return place, direction, torque and number of recordings, whose loops have an offset of 2,
    a shape of 0.5 in each of 20 cells, and the mean 3 + cell; one has not been in cell 4."""
    rng = np.random.default_rng(seed)
    loops = 3 + np.arange(20) + rng.normal(0, 2, (count, 1)) + rng.normal(0, 0.5, (count, 20))
    place = np.tile((np.repeat(np.arange(20), 4) + 0.5) / 20, 2 * count)
    rising = np.tile(np.repeat([True, False], 80), count)
    number = np.repeat(np.arange(count), 160)
    cell = np.floor(place * 20).astype(int)
    torque = np.where(rising, 0.3, -0.7) * loops[number, cell] + 5 * cell
    sensor = np.where(rising, 3 + cell, 0.0)
    torque[(number == 1) & (cell == 4) & rising] = np.nan
    return place, rising, torque, sensor, number, loops


def test_parts_of_a_recording_are_those_of_its_offset_and_shape():
    *rows, loops = recordings(6, 1)
    found = learn_loop(*rows)
    loops[1, 4] = np.nan
    apart = loops - 3 - np.arange(20)
    offsets = np.array([np.mean(row[np.isfinite(row)]) for row in apart])
    assert_allclose(found.offset, np.sqrt(np.sum(offsets**2) / 5), rtol=1e-9)
    shapes = apart - offsets[:, None]
    squares = np.nansum(shapes**2, axis=0) / np.where(np.arange(20) == 4, 4, 5)
    assert_allclose(found.shape, np.sqrt(squares), rtol=1e-9)
    for number in (0, 1, 5):
        own = rows[4] == number
        offset, shape, changing = found.parts(*(each[own] for each in rows[:3]))
        assert_allclose(offset, offsets[number] / found.offset, rtol=1e-9)
        ratio = shapes[number] / found.shape
        assert_allclose(shape**2, np.nanmean(ratio**2), rtol=1e-9)
        assert changing == 1.0  # one stroke in each direction


def test_limits_are_those_of_student_and_fall_with_the_runs():
    found = learn_loop(*recordings(6, 2)[:5])
    assert_allclose(found.limit(0.95), stats.t.interval(0.95, 5)[1], rtol=1e-9)
    several = stats.f.ppf(0.95, 1 / (0.25 + 0.75 / 3), 5)
    assert_allclose(found.limit(0.95, 3), np.sqrt(several), rtol=1e-9)
    # one run deviates as a recording does, and the mean of those learned with it
    assert_allclose(found.limit_of_mean(0.99, 1) / found.limit(0.99), np.sqrt(7 / 6), rtol=1e-9)
    # what runs have in common never averages out
    many = found.limit_of_mean(0.99, 10**9) / found.limit(0.99)
    assert_allclose(many, np.sqrt(1 / 4 + 1 / 6), rtol=1e-6)


@pytest.mark.parametrize("cells", [2, 3])
def test_a_loop_in_few_cells_is_not_compared(cells):
    *rows, _ = recordings(4, 3)
    found = learn_loop(*rows)
    some = (rows[4] == 0) & (rows[0] * 20 < cells)
    parts = found.parts(*(each[some] for each in rows[:3]))
    assert np.isfinite(parts).all() == (cells == 3)
    once = some & (np.arange(len(some)) % 2 == 0)  # two rows in each cell
    assert np.isnan(found.parts(*(each[once] for each in rows[:3]))).all()


def test_a_load_that_changes_between_strokes_shows_less_of_the_mounting():
    """By strokes of one direction: three to, of loads 1, 2 and 6, two fro, of 5 and 9."""
    *rows, _ = recordings(6, 4)
    found = learn_loop(*rows)
    load = np.repeat([1.0, 5.0, 2.0, 9.0, 6.0], 80)
    place = np.tile((np.repeat(np.arange(20), 4) + 0.5) / 20, 5)
    rising = np.repeat([True, False, True, False, True], 80)
    square = (4 + 1 + 9 + 4 + 4) / (3 + 2 - 2)
    for known in (np.ones(400, dtype=bool), ~((load == 9) & (place > 0.5))):
        # half of the cells have one stroke less: (4 + 1 + 9) / (3 + 1 - 2) about the others' means
        fewer = (4 + 1 + 9) / (3 + 1 - 2) * (1 / 3 + 1)
        v = square * (1 / 3 + 1 / 2) if known.all() else (square * (1 / 3 + 1 / 2) + fewer) / 2
        changing = found.parts(place, rising, np.where(known, load, np.nan))[2]
        assert_allclose(changing, np.sqrt(1 + v / found.offset**2), rtol=1e-9)
    # in the lower half each direction has one stroke, and the upper half's scatter; in a cell, its
    # rows that are not known, and what is not compared, count for nothing
    upper = place > 0.5
    once = upper | (load == 1) | (load == 5)
    unknown = (load == 2) & (np.arange(400) % 4 == 1)
    found.shape[3] = 0.0
    changing = found.parts(place, rising, np.where(once & ~unknown, load, np.nan))[2]
    v = (9 * square * 2 + 10 * square * (1 / 3 + 1 / 2)) / 19
    assert_allclose(changing, np.sqrt(1 + v / found.offset**2), rtol=1e-9)
    # where no cell has two strokes of one direction the load may not have changed
    assert found.parts(place[:160], rising[:160], load[:160])[2] == 1.0
