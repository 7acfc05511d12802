"""States of a motion, and the edges of what was learned."""

import numpy as np
import pytest

from rigtool.experiments.force_filter.motion_states import (
    BEYOND_ANGLE,
    FASTEST_LEARNED_RATIO,
    SPEED_TIME,
    Judge,
    Moments,
    Reach,
    State,
)

COUNT, STEP = 1.6e-3, 1e-3
REACH = Reach((-1.0, 2.0), 10.0, 50e-3, (20.0, 50.0))


def moments(torque=0.01, scale=1.0):
    """Move at 1 rad/s for 1 s, back, and rest."""
    time = np.arange(3000) * STEP
    angle = np.where(time < 1, time, np.maximum(2 - time, 0.0)) * scale
    low = np.floor(angle / COUNT) * COUNT
    speed = np.where(time < 1, 1.0, np.where(time < 2, -1.0, 0.0)) * scale
    path = np.where(time < 1, time, time - 1)
    housing = np.where(time < 1, 1.0, 2 * np.exp(-path / 0.01) - 1)
    housing[time >= 1] = np.maximum(housing, -1)[time >= 1]
    same = np.ones(3000)
    return Moments(low, speed, housing, torque * same, 30.0 * same, 0.0 * same, same == 0)


@pytest.mark.parametrize(("causal", "late"), [(False, 0), (True, 50)])
def test_states_of_a_motion_that_turns_and_stops(causal, late):
    found = Judge(REACH, COUNT, STEP, causal).judged(moments()).states
    assert set(found[100:900]) == {State.AGAINST}
    assert set(found[1000:1015]) == {State.REVERSED}
    assert set(found[1100:1900]) == {State.WITH}
    assert set(found[2050 + late :]) == {State.STILL}


def test_causal_states_do_not_know_what_comes():
    whole, judge = moments(), Judge(REACH, COUNT, STEP, causal=True)
    np.testing.assert_array_equal(
        judge.judged(whole.part(0, 1500)).states, judge.judged(whole).states[:1500]
    )


@pytest.mark.parametrize(("causal", "first"), [(False, 900), (True, 1000)])
def test_there_is_no_value_about_a_current_at_its_limit(causal, first):
    whole = moments()
    whole.limited[1000:1010] = 1.0
    outside = Judge(REACH, COUNT, STEP, causal).judged(whole).states == State.OUTSIDE
    assert np.flatnonzero(outside)[[0, -1]].tolist() == [first, 1109]


@pytest.mark.parametrize("middle", [950, 1080, 2020, 2060])
def test_the_span_holds_all_that_a_state_depends_on(middle):
    whole, judge = moments(), Judge(REACH, COUNT, STEP)
    whole.limited[1000:1010] = 1.0
    around = whole.part(middle - judge.span, middle + judge.span + 1)
    assert judge.judged(around).states[judge.span] == judge.judged(whole).states[middle]


@pytest.mark.parametrize("causal", [False, True])
def test_the_speed_that_leaves_what_was_learned_is_a_mean(causal):
    for scale, beyond in ((10.5, False), (11.5, True)):
        whole = moments(scale=scale)
        found = (
            Judge(Reach((-99.0, 99.0), *REACH_BUT_ANGLE), COUNT, STEP, causal).judged(whole).states
        )
        assert bool(found[500] == State.OUTSIDE) == beyond


REACH_BUT_ANGLE = (10.0, 50e-3, (20.0, 50.0))


def test_each_edge_of_what_was_learned_is_one():
    reach = Reach((0.0, 2.0), 10.0, 50e-3, (20.0, 50.0))
    within = np.array([1.0, 5.0, 40e-3, 30.0])
    beyond = [
        (0, -0.1),
        (0, 2.1),
        (1, 12.0),
        (1, -12.0),
        (2, 60e-3),
        (2, -60e-3),
        (3, 19.0),
        (3, 51.0),
    ]
    rows = np.tile(within, (len(beyond) + 1, 1))
    for row, (column, value) in enumerate(beyond):
        rows[row, column] = value
    assert reach.left_by(*rows.T).tolist() == [True] * len(beyond) + [False]


@pytest.mark.parametrize("counts", [500, 1000, 4000, 10_000, 40_000])
@pytest.mark.parametrize("ratio", [0.8, 0.85, 0.9, 1.0])
def test_no_edge_of_what_was_learned_is_a_whole_number_of_counts(counts, ratio):
    """At round speeds and angles: rounding would decide there, and C rounds otherwise. A step is
    1 ms, and `SPEED_TIME` counts 50 of them."""
    for speed in np.arange(1, 60) / 10:
        way = FASTEST_LEARNED_RATIO * speed * ratio * counts * SPEED_TIME
        assert abs(way - round(way)) > 1e-6 * way
    for degrees in (45, 60, 90, 120, 135, 150, 180):
        reach = degrees / 360 * ratio * counts
        for edge in (BEYOND_ANGLE * reach, (1 + BEYOND_ANGLE) * reach):
            assert abs(edge - round(edge)) > 1e-6 * edge
