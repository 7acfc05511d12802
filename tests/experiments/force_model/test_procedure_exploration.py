"""The exploring motion keeps to its range and speed, and ends at rest."""

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import stats

from rigtool.experiments.force_model.procedure_exploration import (
    ACCELERATION_TIME,
    FREE_SPEED,
    HOLD_TIME,
    LEG_TIME,
    PAUSE_SHARE,
    TRIANGLE_LENGTHS,
    exploration,
)
from rigtool.experiments.force_model.records import bristle_scale

COUNT = 2 * np.pi / 4000


@settings(max_examples=25, deadline=None)
@given(st.floats(0.5, 5.0), st.floats(1.0, 40.0), st.floats(1.0, 20.0))
def test_it_keeps_to_range_and_speed(span, fastest, time):
    motion = exploration(0.2, 0.2 + span, COUNT, fastest, time)
    position, speed, _ = motion.setpoint(np.arange(0, motion.duration, 2e-3))
    assert position.min() > -1e-9
    assert position.max() < span + 1e-9
    assert np.abs(speed).max() <= fastest * (1 + 1e-9)
    assert motion.speeds[0] == motion.speeds[-1] == 0.0
    assert np.all(np.diff(motion.times) > 0)


def test_it_repeats_itself_exactly():
    assert exploration(0, 2.0, COUNT, 10.0, 5.0) == exploration(0, 2.0, COUNT, 10.0, 5.0)


def test_a_finer_encoder_shows_shorter_triangles_besides_the_same():
    coarse, fine = (exploration(0.0, 2.6, COUNT / by, 10.0, 0.0) for by in (1, 16))
    seen = np.arange(1.5 - coarse.duration, 0.0, 1e-3)
    longest = [np.ptp(one.setpoint(seen + one.duration)[0]) for one in (coarse, fine)]
    assert longest[0] / longest[1] == pytest.approx(16 / 8)  # as a 70th of 2.6 rad allows
    assert len(fine.times) - len(coarse.times) == 3 * 6 * 3  # triangles, strokes, points


LOW, HIGH, FASTEST = 0.3, 2.9, 20.0


def moves(motion):
    """Return way, rad, highest speed, rad/s, and duration, s, of each move or rest in turn; of a
    rest the first two are zero."""
    time, speed = np.array(motion.times), np.array(motion.speeds)
    steps = np.diff(time) * (speed[1:] + speed[:-1]) / 2
    rests = np.flatnonzero(speed == 0)
    return np.array(
        [
            (
                steps[a:b].sum(),
                speed[a : b + 1][np.argmax(np.abs(speed[a : b + 1]))],
                time[b] - time[a],
            )
            for a, b in pairwise(rests)
        ]
    )


def test_triangles_lie_about_the_middle_and_a_hold_follows():
    found = moves(exploration(LOW, HIGH, COUNT, FASTEST, 0.0))
    way, speed, duration = found.T
    place = LOW + np.cumsum(way)
    assert place[0] == pytest.approx((LOW + HIGH) / 2)
    assert abs(speed[0]) == pytest.approx(FASTEST / 4)
    lengths = np.array(TRIANGLE_LENGTHS) * bristle_scale(HIGH - LOW, COUNT)
    strokes = 6
    assert len(found) == 1 + strokes * len(lengths) + 2
    for number, length in enumerate(lengths):
        legs = slice(1 + strokes * number, 1 + strokes * (number + 1))
        assert np.ptp(place[legs]) == pytest.approx(length)
        off = place[legs] - (LOW + HIGH) / 2
        np.testing.assert_allclose(np.abs(off[:-1]), length / 2, rtol=1e-9)
        assert off[-1] == pytest.approx(0.0, abs=1e-9)
        full = slice(legs.start + 1, legs.stop - 1)
        np.testing.assert_allclose(np.abs(speed[full]), length / LEG_TIME, rtol=1e-9)
    np.testing.assert_allclose(duration[-2:], HOLD_TIME, rtol=1e-9)
    assert not way[-2:].any()


@pytest.fixture(scope="module")
def free():
    """Way, speed, duration of a quarter of an hour of free motion, and where each move begins."""
    before = len(moves(exploration(LOW, HIGH, COUNT, FASTEST, 0.0))) - 1
    found = moves(exploration(LOW, HIGH, COUNT, FASTEST, 900.0))
    place = LOW + np.cumsum(found[:, 0])
    return found[before:-1], place[before - 1 : -2]


def test_free_motion_lasts_for_its_time(free):
    duration = free[0][:, 2]
    assert duration[:-2].sum() < 900.0 <= duration.sum()
    assert moves(exploration(LOW, HIGH, COUNT, FASTEST, 900.0))[-1, 2] == pytest.approx(HOLD_TIME)


def test_speeds_are_drawn_alike_by_their_logarithm(free):
    """Moves that are too short for their speed do not show it."""
    way, speed, _ = free[0].T
    drawn = stats.loguniform(FREE_SPEED, FASTEST)
    shown = np.abs(way) > 1.0
    slow = np.abs(speed[shown]) < 1.0 / ACCELERATION_TIME
    seen = np.abs(speed[shown])[slow]
    within = stats.loguniform(FREE_SPEED, 1.0 / ACCELERATION_TIME)
    assert len(seen) > 100
    assert stats.kstest(seen, within.cdf).pvalue > 1e-3
    assert np.abs(speed).max() > 0.9 * FASTEST
    assert drawn.cdf(np.abs(speed[way != 0]).min()) < 0.05


def test_ways_are_drawn_alike_by_their_logarithm_where_there_is_room(free):
    """From a few counts to the range; in the middle a third of it is room on both sides."""
    (way, _, _), begin = free[0].T, free[1]
    middle = np.abs(begin - (LOW + HIGH) / 2) < (HIGH - LOW) / 6
    shown = np.abs(way[middle & (way != 0)])
    shown = shown[shown < (HIGH - LOW) / 3]
    drawn = stats.loguniform(bristle_scale(HIGH - LOW, COUNT), (HIGH - LOW) / 3)
    assert len(shown) > 100
    assert stats.kstest(shown, drawn.cdf).pvalue > 1e-3


def test_moves_go_to_either_side_by_its_room(free):
    (way, _, _), begin = free[0].T, free[1]
    moved = way != 0
    share = (HIGH - begin[moved]) / (HIGH - LOW)
    ups = way[moved] > 0
    score = (ups.sum() - share.sum()) / np.sqrt((share * (1 - share)).sum())
    assert abs(score) < 3.3
    slope = np.corrcoef(ups, share)[0, 1]
    assert slope > 0.3
    assert begin.min() < LOW + 0.05 * (HIGH - LOW)
    assert begin.max() > HIGH - 0.05 * (HIGH - LOW)


def test_one_move_in_seven_is_followed_by_a_pause(free):
    way, _, duration = free[0].T
    pauses = duration[way == 0]
    assert stats.binomtest(len(pauses), int(np.sum(way != 0)), PAUSE_SHARE).pvalue > 1e-3
    assert stats.kstest(pauses, stats.uniform(0.1, HOLD_TIME - 0.1).cdf).pvalue > 1e-3
    assert np.abs(way[way != 0]).min() > 0


def test_short_motion_has_short_moves():
    """A move takes no more than about a tenth of the time."""
    found = moves(exploration(LOW, HIGH, COUNT, FASTEST, 20.0))[-40:]
    assert found[found[:, 0] != 0, 2].max() < 20.0 / 10 + 2 * ACCELERATION_TIME + 1e-9


def test_numbers_have_free_motions_of_their_own():
    one, other = (exploration(LOW, HIGH, COUNT, FASTEST, 30.0, number) for number in (0, 1))
    assert one.times[:50] == other.times[:50]
    assert one.speeds[-30:] != other.speeds[-30:]
