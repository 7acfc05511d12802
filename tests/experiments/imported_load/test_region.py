"""Where a model was learned: strokes that count, and cells with speeds and torques of their own."""

import numpy as np
import pytest
from scipy.stats import binned_statistic

from rigtool.experiments.imported_load.region import (
    STROKE_CELLS,
    beside_known,
    beside_known_strokes,
    cell_means,
    learn_region,
    of_known_strokes,
    reached,
)

PHASE = np.linspace(0.05, np.pi - 0.05, 2000)
PLACE, SPEED = (1 - np.cos(PHASE)) / 2, np.sin(PHASE)
DIRECTION = np.repeat([1.0, -1.0, 0.0, 1.0, -1.0, 1.0, -1.0, 1.0], 10)


@pytest.mark.parametrize("inside", [4, 5])
def test_a_stroke_counts_where_half_of_its_motion_is_known(inside):
    moving = DIRECTION != 0
    known = np.zeros(80, dtype=bool)
    known[10 : 10 + inside] = known[30:39] = True
    found = of_known_strokes(known, moving, DIRECTION)
    assert found[10:20].sum() == (inside if inside == 5 else 0)
    assert found[30:40].sum() == 9
    moving[10 + inside + 1 : 20] = False  # rest is not missing
    assert of_known_strokes(known, moving, DIRECTION)[10:20].sum() == inside
    assert not of_known_strokes(known, moving, DIRECTION, 1.0)[10:20].any()


def test_a_standstill_does_not_end_a_stroke():
    """The first 5 of 40 rows of a stroke say nothing of their own, nor do they beside others."""
    direction = np.repeat([-1.0, 1, 0, 1, -1], [40, 5, 3, 35, 40])
    known, moving = np.zeros((2, 123), dtype=bool)
    moving[:], known[40:45] = direction != 0, True
    assert not of_known_strokes(known, moving, direction).any()
    assert not beside_known_strokes(known, moving & (direction > 0), direction).any()
    known[40:65] = True
    assert of_known_strokes(known, moving, direction).sum() == 25
    assert beside_known_strokes(known, moving & (direction > 0), direction).all()
    assert beside_known_strokes(known, np.zeros(123, dtype=bool), direction).all()


def test_part_of_a_stroke_at_either_end_counts_with_the_nearest():
    direction = np.repeat([1.0, -1, 1, -1], [10, 40, 40, 10])
    known, moving = np.zeros(100, dtype=bool), np.ones(100, dtype=bool)
    known[:10] = known[90:] = True
    assert not of_known_strokes(known, moving, direction).any()
    known[60:90] = True
    assert np.flatnonzero(of_known_strokes(known, moving, direction))[[0, 9, 10]].tolist() == [
        *(0, 9, 60)
    ]
    assert not of_known_strokes(known, moving, direction)[90:].any()


def test_strokes_beside_a_known_one_are_next_to_it():
    """A standstill belongs to the stroke before."""
    known = np.zeros(80, dtype=bool)
    known[35] = True
    found = beside_known(known, DIRECTION).reshape(8, 10)
    assert found.all(axis=1).tolist() == [False, True, True, True, True, False, False, False]
    assert found.any(axis=1).tolist() == found.all(axis=1).tolist()


def test_means_of_cells_are_those_of_their_rows():
    rng = np.random.default_rng(1)
    place, values, rows = rng.random(300), rng.normal(size=300), rng.random(300) < 0.2
    found = cell_means(place, values, rows, 3)
    edges = np.linspace(0, 1, STROKE_CELLS + 1)
    means = binned_statistic(place[rows], values[rows], "mean", edges).statistic
    count = binned_statistic(place[rows], values[rows], "count", edges).statistic
    assert 0 < (count < 3).sum() < STROKE_CELLS
    np.testing.assert_allclose(found, np.where(count >= 3, means, np.nan), rtol=1e-12)


def test_a_stroke_reaches_three_hundredths_beyond_both_ends():
    assert reached(np.array([-0.031, -0.029, 0.5, 1.029, 1.031])).tolist() == [0, 1, 1, 1, 0]


def test_a_region_holds_what_was_learned_in_each_cell_and_direction():
    place = np.tile((np.arange(STROKE_CELLS) + 0.5) / STROKE_CELLS, 2)
    side = np.repeat([1.0, -1.0], STROKE_CELLS)
    speed, torque = side * (0.1 + place), 0.05 + 0.1 * place + 0.3 * (side < 0)
    margins = np.array([[0.001, 0.002], [0.003, 0.004]])
    region = learn_region(place, speed, torque, margins)
    assert region.holds(place, speed, torque).all()
    near = 1 / STROKE_CELLS  # the neighbours' speeds and torques count, too
    inner = (place > near) & (place < 1 - near)
    fast, slow = side * (0.1 + place + near) * 1.1, side * (0.1 + place - near) / 1.1
    for limit, beyond in ((fast, 1.001), (slow, 0.999)):
        assert region.moves(
            place,
            limit / beyond,
        )[inner].all()
        assert not region.moves(place, limit * beyond)[inner].any()
    low = torque - 0.1 * near - np.where(side > 0, 0.001, 0.003)
    high = torque + 0.1 * near + np.where(side > 0, 0.002, 0.004)
    for limit, outward in ((low, -1e-6), (high, 1e-6)):
        assert region.holds(place, speed, limit - outward)[inner].all()
        assert not region.holds(place, speed, limit + outward)[inner].any()
    assert not region.holds(place, speed, np.full(len(place), np.nan)).any()
    assert not region.moves(np.full(40, 1.5), speed).any()


@pytest.mark.parametrize("several", [True, False])
def test_other_speeds_are_inside_only_where_speeds_were_learned(several):
    """Along one sine the speed follows from the place."""
    region = learn_region(PLACE, SPEED, np.zeros(2000), np.ones((2, 2)), several=several)
    inner = (PLACE > 0.1) & (PLACE < 0.9)
    assert region.holds(PLACE, SPEED, np.zeros(2000)).all()
    for ratio in (0.85, 1.09):
        inside = region.moves(PLACE, ratio * SPEED)[inner].mean()
        assert inside > 0.5 if several else inside < 0.4
