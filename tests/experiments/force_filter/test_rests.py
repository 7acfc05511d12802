"""A rest has lasted where the encoder was within two counts for long, and ends where it leaves."""

import itertools

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from rigtool.experiments.force_filter.kalman import STATE
from rigtool.experiments.force_filter.rests import REST_TIME, limits_rest, rest_steps

SPAN = REST_TIME / 5
WIDTH = 0.01


def rested(counts):
    """Return the steps up to the last one that stay within two counts."""
    steps = 0
    for first in range(len(counts) - 2, -1, -1):
        if np.ptp(counts[first:]) > 1:
            break
        steps += 1
    return steps


@given(st.lists(st.sampled_from([-3, -1, -1, 0, 0, 0, 0, 1, 1, 2]), max_size=60))
def test_a_rest_lasts_within_two_counts_and_ends_where_they_are_left(moves):
    counts = np.cumsum([0, *moves])
    state = np.zeros(1, dtype=STATE)
    found = [bool(limits_rest(state[0], move * WIDTH, WIDTH, SPAN)) for move in moves]
    long = [rested(counts[: end + 1]) for end in range(len(counts))]
    limit = rest_steps(SPAN)
    wanted = [
        before > limit > now or now > limit >= before for before, now in itertools.pairwise(long)
    ]
    assert found == wanted


@pytest.mark.parametrize("seed", range(4))
def test_a_rest_is_as_long_as_the_rotor_stays_within_two_counts(seed):
    """Back to where the angle was in a third one; it ends where that many steps are no longer."""
    rng, span = np.random.default_rng(seed), 0.25
    moves = rng.choice([-2, -1, 0, 1, 2], 400, p=[0.03, 0.2, 0.54, 0.2, 0.03])
    place, state = np.append(0, np.cumsum(moves)), np.zeros(1, dtype=STATE)

    def lasting(k):
        longest = 0
        for other in (1, -1):
            steps = 0
            while steps < k and place[k - steps - 1] in (place[k], place[k] + other):
                steps += 1
            longest = max(longest, steps)
        return longest

    found = [bool(limits_rest(state[0], move * WIDTH, WIDTH, span)) for move in moves]
    limit = rest_steps(span)
    assert limit == 4
    long = [lasting(k) for k in range(401)]
    ends = [before > limit > now for before, now in itertools.pairwise(long)]
    lasts = [now > limit >= before for before, now in itertools.pairwise(long)]
    assert found == [end or last for end, last in zip(ends, lasts, strict=True)]
    assert sum(found) > 5
