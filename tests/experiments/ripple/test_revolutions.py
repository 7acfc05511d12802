"""Means by cell of the turn, beside straight lines that are integrated finely."""

from itertools import pairwise

import numpy as np
import pytest

from rigtool.errors import InsufficientDataError
from rigtool.experiments.ripple.revolutions import Revolutions

CELLS, TURNS = 8, 5.3


def turning(forward, seed=1):
    """Return irregular samples of a shaft that turns unevenly, steps back at times, and rests."""
    rng = np.random.default_rng(seed)
    count = 700
    time = 3.0 + np.cumsum(rng.uniform(0.5, 1.5, count)) * 1e-3
    steps = rng.uniform(0.2, 1.8, count)
    steps[[50, 51, 52, 400]] = 0.0
    turns = np.cumsum(steps)
    turns = 0.37 + (turns - turns[0]) / (turns[-1] - turns[0]) * TURNS
    turns[300] = turns[299] - 1e-4  # a count back
    torque = 1.0 + np.sin(2 * np.pi * turns) + rng.normal(0, 0.3, count)
    return time, turns if forward else 10.0 - turns, torque


def expected(time, advance):
    """Return when each edge is first reached and a fine time axis."""
    advance = np.maximum.accumulate(advance)
    edges = np.arange(np.ceil(advance[0]) * CELLS, np.floor(advance[-1] * CELLS) + 1) / CELLS
    moving = np.concatenate([[True], np.diff(advance) > 0])
    return edges, np.interp(edges, advance[moving], time[moving])


def collected(time, turns, torque, forward, blocks=()):
    found = Revolutions(CELLS, forward=forward)
    for part in np.split(np.arange(time.size), blocks):
        found.add(time[part], turns[part], torque[part])
    return found


@pytest.mark.parametrize("forward", [True, False])
def test_a_cell_has_the_mean_over_the_time_in_it(forward):
    time, turns, torque = turning(forward)
    found = collected(time, turns, torque, forward)
    edges, passed = expected(time, turns if forward else -turns)
    means = []
    for begin, end in pairwise(passed):
        inside = time[(time > begin) & (time < end)]
        at = np.concatenate([[begin], inside, [end]])
        means.append(np.trapezoid(np.interp(at, time, torque), at) / (end - begin))
    np.testing.assert_allclose(found.cells(), means, rtol=1e-9)
    began, whole, firsts = found.turns()
    np.testing.assert_allclose(began, passed[::CELLS], rtol=1e-12)
    np.testing.assert_array_equal(firsts, np.searchsorted(time, began))
    turn = [
        np.average(means[n : n + CELLS], weights=np.diff(passed)[n : n + CELLS])
        for n in range(0, len(whole) * CELLS, CELLS)
    ]
    np.testing.assert_allclose(whole, turn, rtol=1e-9)
    rows = found.waveforms(3)
    last = np.reshape(means[: len(means) // CELLS * CELLS], (-1, CELLS))[-3:]
    np.testing.assert_allclose(rows, last if forward else last[:, ::-1], rtol=1e-9)
    assert found.step == pytest.approx(TURNS / 699, rel=1e-9)
    assert edges.size == len(means) + 1


def test_a_sample_at_the_encoders_zero_is_the_first_of_its_turn():
    time = np.arange(12.0)
    found = collected(time, time / 4, np.ones(12), True, (5, 9))
    np.testing.assert_array_equal(found.turns()[2], [0, 4, 8])


@pytest.mark.parametrize("forward", [True, False])
@pytest.mark.parametrize("blocks", [(1, 2, 3), (50, 51, 52, 53), (0, 299, 300, 301, 650)])
def test_blocks_of_any_length_give_the_same(forward, blocks):
    signals = turning(forward, 2)
    whole, parts = collected(*signals, forward), collected(*signals, forward, blocks)
    np.testing.assert_allclose(parts.cells(), whole.cells(), rtol=1e-9)
    assert parts.step == pytest.approx(whole.step, rel=1e-12)
    np.testing.assert_array_equal(parts.turns()[2], whole.turns()[2])


def test_what_it_cannot_use_is_refused():
    time, turns, torque = turning(True)
    found = collected(time, turns, torque, True)
    whole = len(found.turns()[1])
    assert found.waveforms(whole).shape == (whole, CELLS)
    with pytest.raises(InsufficientDataError, match=f"{whole} whole revolutions in the recording"):
        found.waveforms(whole + 1)
    with pytest.raises(InsufficientDataError, match="more than once from one"):
        collected(time[:3], np.array([0.0, 0.5, 2.1]), torque[:3], True)
    collected(time[:3], np.array([0.0, 0.5, 1.9]), torque[:3], True)
    assert collected(time[:1], turns[:1], torque[:1], True).step == 0


@pytest.mark.parametrize("forward", [True, False])
def test_how_long_cells_take_by_turn_and_angle(forward):
    time = np.arange(40001) * 1e-3
    steady = time / 8
    turns = steady + 0.02 * np.sin(2 * np.pi * steady)
    found = collected(time, turns if forward else 5 - turns, np.ones_like(time), forward)
    edges = np.arange(CELLS + 1) / CELLS
    taken = np.diff(np.interp(edges, turns, time))
    expected = np.tile(taken if forward else taken[::-1], (3, 1))
    np.testing.assert_allclose(found.durations(3), expected, atol=1e-3)
