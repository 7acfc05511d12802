"""A rotor that swings while it creeps bends its bristles by less than its way states."""

import numpy as np
import pytest

from rigtool.experiments.force_filter.creeping import RESTED_TIME, Creeping
from tests.experiments.force_filter.plants import dahl

STEP, COUNT, LENGTH = 1e-3, 1.6e-3, 8e-3
NEVER = np.zeros(4000, dtype=bool)


def ramp(speed=0.03, seconds=4.0):
    """Return the counts' edges of a way from 0 on, rad, at each step."""
    angle = speed * STEP * np.arange(round(seconds / STEP))
    return np.floor(angle / COUNT) * COUNT


def bristle(angle, start):
    bent = [start]
    for path in np.diff(angle):
        bent.append(dahl(bent[-1], path, LENGTH))
    return np.array(bent)


def follow(low, housing, still=NEVER):
    """Return what is lacking, which does not depend on the angle at which the way begins."""
    found = Creeping(COUNT, LENGTH, STEP).add(low, housing, still)
    for start in (-2500 * COUNT, 4000 * COUNT):
        elsewhere = Creeping(COUNT, LENGTH, STEP).add(low + start, housing, still)
        np.testing.assert_allclose(elsewhere, found, rtol=0, atol=1e-9)
    return found


@pytest.mark.parametrize("side", [1, -1])
def test_a_rotor_that_swings_lacks_what_its_way_would_have_bent(side):
    found = follow(side * ramp(), np.full(4000, side * 0.7))
    assert not found[:500].any()
    np.testing.assert_allclose(found[1000:], 0.3)


@pytest.mark.parametrize("start", [-0.4, 0.0, 0.7])
def test_a_way_in_one_direction_bends_it(start):
    assert not follow(ramp(), bristle(0.03 * STEP * np.arange(4000), start)).any()


def test_a_reversal_begins_another_way():
    way = np.concatenate([ramp(seconds=2.0), ramp(seconds=2.0)[::-1]])
    angle = 0.03 * STEP * np.concatenate([np.arange(2000.0), np.arange(2000.0)[::-1]])
    assert not follow(way, bristle(angle, 0.0)).any()


def test_a_rest_begins_another_way():
    """Bristles yield at rest, within a count."""
    low, housing, still = np.tile(ramp()[:1000], 4), np.full(4000, 0.7), NEVER.copy()
    low += np.repeat(np.arange(4), 1000) * low[999]
    assert follow(low, housing, still)[2000:].all()
    for end in (1000, 2000, 3000):
        still[end - round(RESTED_TIME / STEP) : end] = True
    found = follow(low, housing, still)
    assert not any(found[end : end + 500].any() for end in (1000, 2000, 3000))


def test_what_swings_for_a_moment_does_not_count():
    """As a rotor does that slows down towards a turn."""
    housing = np.where(np.arange(4000) // 400 % 2, 0.7, 0.99)
    assert not follow(ramp(), housing).any()


def test_blocks_of_any_length_give_the_same():
    low, housing = ramp(), np.full(4000, 0.7)
    parts = Creeping(COUNT, LENGTH, STEP)
    found = [parts.add(low[a:b], housing[a:b], NEVER[a:b]) for a, b in ((0, 1), (1, 1), (1, 4000))]
    np.testing.assert_array_equal(np.concatenate(found), follow(low, housing))
