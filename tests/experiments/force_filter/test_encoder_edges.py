"""Edges of an encoder in means of its counts, sample by sample."""

from itertools import pairwise

import numpy as np
import pytest
from scipy.interpolate import PchipInterpolator

from rigtool.experiments.force_filter.encoder_angle import interpolated, known_angles


def written_out(encoder):
    """Where a sample is a mean of two counts, an edge was passed within it, once where the samples
    on both sides are on its two sides, else to and fro: about the middle. Where two whole samples
    differ by one, the edge is between them. Where a neighbour is more than a count off, the sample
    is a mean of several counts, whose middle is half a count further."""
    known = []
    for k, mean in enumerate(encoder):
        low, high = np.floor(mean), np.ceil(mean)
        before, after = encoder[max(k - 1, 0)], encoder[min(k + 1, len(encoder) - 1)]
        if abs(before - mean) > 1 or abs(after - mean) > 1:
            if mean == low and abs(after - mean) == 1:
                known.append((k + 1.0, max(mean, after)))
            known.append((k + 0.5, mean + 0.5))
        elif mean > low:
            rises, falls = before <= low < after, after <= low < before
            place = k + (1 - (mean - low) if rises else mean - low if falls else 0.5)
            known.append((place, high))
        elif abs(after - mean) == 1:
            known.append((k + 1.0, max(mean, after)))
    known.sort(key=lambda one: one[0])
    kept = [one for n, one in enumerate(known) if n == 0 or one[0] - known[n - 1][0] > 1e-6]
    return kept


def means(seed, averaged):
    rng = np.random.default_rng(seed)
    speed = np.repeat(rng.choice([-4.0, -1.0, -0.2, 0.0, 0.1, 0.7, 3.0], 12), 25 * averaged)
    angle = 0.3 + np.cumsum(speed / averaged)
    return np.floor(angle).reshape(-1, averaged).mean(axis=1)


@pytest.mark.parametrize("averaged", [1, 2, 4, 16])
@pytest.mark.parametrize("seed", range(4))
def test_edges_are_those_of_the_rule(seed, averaged):
    encoder = means(seed, averaged)
    place, angle = known_angles(encoder)
    expected = np.array(written_out(encoder))
    np.testing.assert_allclose(place, expected[:, 0], atol=1e-12)
    np.testing.assert_allclose(angle, expected[:, 1], atol=1e-12)


@pytest.mark.parametrize("seed", range(4))
def test_angles_between_edges_are_a_monotone_cubic_through_them_and_through_turns(seed):
    """Both ends are in the middle of their counts; so is the rotor between two passages of one edge
    that are two samples apart or more, from a quarter of that time or a sample on until half."""
    encoder = means(seed, 4)
    known = [one for one in written_out(encoder) if 0 < one[0] < len(encoder)]
    known = [(0.0, encoder[0] + 0.5), *known, (float(len(encoder)), encoder[-1] + 0.5)]
    whole = []
    for one, other in pairwise(known):
        whole.append(one)
        if one[1] == other[1] and other[0] - one[0] >= 2:
            middle = (one[0] + other[0]) / 2
            level = encoder[int(middle)] + 0.5
            whole.append((one[0] + min(1.0, (other[0] - one[0]) / 4), level))
            whole.append((middle, level))
    whole.append(known[-1])
    at = np.linspace(0, len(encoder), 900)
    expected = PchipInterpolator(*np.transpose(whole))(at)
    np.testing.assert_allclose(interpolated(encoder, at), expected, atol=1e-9)
