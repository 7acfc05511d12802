"""States of a motion, and the edges of what was learned."""

import numpy as np

from rigtool.experiments.force_over_time.motion_states import (
    Reach,
    State,
    mean_speed,
    moving_states,
)

COUNT, STEP = 1.6e-3, 1e-3


def test_states_of_a_motion_that_turns_and_stops():
    time = np.arange(3000) * STEP
    angle = np.where(time < 1, time, np.maximum(2 - time, 0.0))  # 1 rad/s, back, and rest
    low = np.floor(angle / COUNT) * COUNT
    speed = np.where(time < 1, 1.0, np.where(time < 2, -1.0, 0.0))
    path = np.where(time < 1, time, time - 1)
    housing = np.where(time < 1, 1.0, 2 * np.exp(-path / 0.01) - 1)
    housing[time >= 1] = np.maximum(housing, -1)[time >= 1]
    found = moving_states(low, speed, housing, np.full(3000, 0.01), COUNT, STEP)
    assert set(found[100:900]) == {State.AGAINST}
    assert set(found[1000:1015]) == {State.REVERSED}
    assert set(found[1100:1900]) == {State.WITH}
    assert set(found[2100:]) == {State.STILL}


def test_the_mean_speed_of_a_ramp_is_its_slope():
    np.testing.assert_allclose(mean_speed(np.arange(1000) * 2e-3, STEP), 2.0, rtol=1e-9)


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
