"""The angle between an encoder's counts, of slow motions that are known."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from rigtool.experiments.force_filter.encoder_angle import interpolated, known_angles


def recorded(first, rate, fast=16):
    """Means of `fast` counts each, of a rotor that turns at `rate` counts a sample."""
    angle = first + rate * (np.arange(400 * fast) + 0.5) / fast
    return np.floor(angle).reshape(-1, fast).mean(axis=1)


@given(st.floats(0.02, 0.4), st.booleans(), st.integers(-5000, 5000))
def test_edges_are_where_the_rotor_passes_them(rate, falling, first):
    rate = -rate if falling else rate
    place, angle = known_angles(recorded(first + 0.3, rate))
    # An edge is known within one of the 16 samples of the loop, but where the recording ends in it.
    inside = (place >= 1) & (place <= 399)
    expected = first + 0.3 + rate * place[inside]
    assert_allclose(angle[inside], expected, rtol=0, atol=abs(rate) / 16 + 1e-9)
    assert len(place) >= int(400 * abs(rate)) - 1


def test_the_angle_between_edges_is_that_of_a_steady_rotor():
    place = np.linspace(20, 380, 97)
    found = interpolated(recorded(700.3, 0.1), place)
    assert_allclose(found, 700.3 + 0.1 * place, rtol=0, atol=0.01)


@pytest.mark.parametrize("samples", [1, 2, 50])
def test_a_rotor_that_never_moves_is_in_the_middle_of_its_count(samples):
    place = np.linspace(0, samples, 7)
    np.testing.assert_array_equal(interpolated(np.full(samples, -3.0), place), -2.5)
    known, angle = known_angles(np.full(samples, -3.0))
    assert known.size == angle.size == 0


@pytest.mark.parametrize("way", [1, -1])
@pytest.mark.parametrize("ends", [True, False])
def test_a_sample_beside_a_leap_of_counts_is_not_one_with_an_edge(way, ends):
    """The rotor passes several counts in a sample: then it is where that sample's mean is."""
    slow, leap = way * np.array([0.5, 1.0]), way * np.array([6.25, 7.0])
    encoder = np.concatenate([slow, leap] if ends else [leap, slow])
    place, angle = known_angles(encoder)
    beside = [2, 1]  # on either side of the leap
    for number in beside:
        at = np.flatnonzero(place == number + 0.5)
        assert_allclose(angle[at], [encoder[number] + 0.5])


@pytest.mark.parametrize("way", [1, -1])
@pytest.mark.parametrize("beyond", [0.3, 0.5, 0.7])
def test_a_rotor_that_turns_is_held_where_its_way_has_ended(way, beyond):
    """It comes at 0.2 counts a sample, stops at once, and creeps back after a while: the mean over
    that time is what half a count instead of the true part makes it."""
    place = np.arange(16 * 200) / 16 + 1 / 32
    edge, held = 40.0, beyond - 0.5
    come = np.minimum(edge + 0.2 * (place - 60), edge + beyond)
    angle = np.minimum(come, edge + beyond - 1e-3 * np.maximum(place - 100, 0) ** 2)
    encoder = np.floor(way * angle).reshape(-1, 16).mean(axis=1)
    shown = way * interpolated(encoder, place)
    stays = (place > 64) & (place < 90)
    assert_allclose(shown[stays] - angle[stays], -held, rtol=0, atol=0.02)
    assert_allclose(shown[160:800], angle[160:800], rtol=0, atol=0.02)
