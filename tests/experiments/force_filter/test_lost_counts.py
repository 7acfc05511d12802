"""Counts that are put back: how long a rotor may rest before, and what passes for a wrap."""

import numpy as np
import pytest

from rigtool.experiments.force_filter.lost_counts import Counts

COUNT, INTERVAL = 2 * np.pi / 2000, 125e-6


def counts(largest):
    """Return what puts back leaps beyond so many counts."""
    return Counts(COUNT, largest * COUNT / (5 * 1.1 * INTERVAL), INTERVAL)


@pytest.mark.parametrize(("samples", "put_back"), [(160, True), (161, False)])
def test_a_rotor_rests_that_passed_no_count_for_twenty_milliseconds(samples, put_back):
    encoder = np.append(np.arange(5.0), np.full(samples - 1, 4.0))  # the last count at sample 4
    found = counts(10).add(np.append(encoder, 104.0))
    assert found[-1] == (4.0 if put_back else 104.0)


@pytest.mark.parametrize(("largest", "wraps"), [(480, 2000.0), (520, 0.0)])
def test_a_turn_is_a_wrap_where_it_is_more_than_four_leaps(largest, wraps):
    """Else what a rotor passes at the same time hides which of both it is."""
    watched = counts(largest)
    watched.add(np.array([0.0, 0.0, 2000.0]))
    assert watched.leaps is not None
    assert watched.leaps.wraps.tolist() == [wraps]


@pytest.mark.parametrize("pieces", [(), (1, 700, 701, 2999)])
def test_a_rotor_that_is_faster_than_what_was_learned_does_not_leap(pieces):
    """Something drives it: step by step its speed changes by less than a leap."""
    steps = 60 * np.cos(np.pi * np.arange(4000) / 1000)
    encoder = np.floor(np.cumsum(steps))
    watched = counts(10)
    found = np.concatenate([watched.add(part) for part in np.split(encoder, pieces)])
    np.testing.assert_array_equal(found, encoder)
    assert watched.leaps is None
    leaping = encoder + 70.0 * (np.arange(4000) >= 2500)
    again = counts(10)
    found = np.concatenate([again.add(part) for part in np.split(leaping, pieces)])
    np.testing.assert_allclose(found, encoder, atol=2)
    assert again.leaps.sample.tolist() == [2500]
