"""Levels of a current that no set point states: plateaus as they were made, steps to the sample."""

import numpy as np
import pytest

from rigtool.errors import InsufficientDataError
from rigtool.experiments.torque_constant.staircases.measured_levels import (
    common_levels,
    find_levels,
    settled_parts,
    stepped,
)

LEVELS = np.array([0.0, 1.0, 2.0, 3.0, 4.0, 3.0, 2.0, 1.0, 0.0])


def stairs(samples, noise=5e-3, seed=1):
    """Return the current, and what it is without noise, of steps of drawn lengths."""
    rng = np.random.default_rng(seed)
    lengths = rng.integers(samples, 2 * samples, len(LEVELS))
    clean = np.repeat(LEVELS, lengths)
    return clean + noise * rng.standard_normal(len(clean)), clean


@pytest.mark.parametrize("samples", [12, 60, 900])
@pytest.mark.parametrize("noise", [0.0, 5e-3, 30e-3])
def test_plateaus_are_those_of_the_steps(samples, noise):
    current, clean = stairs(samples, noise, samples)
    found = find_levels(current, 0.05 * current)
    edges = np.flatnonzero(np.diff(clean)) + 1
    part = np.diff(found.edges).max()
    assert len(found.plateaus) == len(LEVELS)
    begins, ends = np.array(found.plateaus).T
    assert np.abs(begins[1:] - edges).max() <= 2 * part
    assert np.abs(ends[:-1] - edges).max() <= 2 * part
    middles = [np.median(current[a:b]) for a, b in found.plateaus]
    np.testing.assert_allclose(middles, LEVELS, atol=5 * noise / np.sqrt(samples) + 1e-9)
    np.testing.assert_allclose(
        found.level, [np.mean(own) for own in np.split(current, found.edges[1:-1])], atol=1e-12
    )
    assert found.span == pytest.approx(np.ptp(found.level))
    # the set point steps where the current does, whatever the parts
    asked = stepped(current, found.plateaus)
    np.testing.assert_array_equal(np.flatnonzero(np.diff(asked)) + 1, edges)
    np.testing.assert_allclose(asked, clean, atol=6 * noise / np.sqrt(samples) + 1e-9)


def test_the_band_is_that_of_the_noise_of_a_part():
    """Five standard deviations of a difference of two means of samples."""
    rng = np.random.default_rng(3)
    clean = np.repeat(LEVELS, 4000)
    found = find_levels(clean + 20e-3 * rng.standard_normal(len(clean)), clean)
    size = len(clean) / (len(found.edges) - 1)
    # of second differences, of which each of eight steps makes two, as large as itself
    noise = np.sqrt(20e-3**2 + 8 * 2 / 6 / len(clean))
    assert found.band == pytest.approx(5 * np.sqrt(2) * noise / np.sqrt(size), rel=0.01)


@pytest.mark.parametrize("torque", ["ramp", "steps"])
def test_a_current_that_is_read_in_steps_is_a_ramp_where_torque_is_one(torque):
    way = np.concatenate([np.linspace(0, 4, 4000), np.linspace(4, 0, 4000)])
    current = np.round(way * 5) / 5
    current += 1e-3 * np.random.default_rng(4).standard_normal(len(current))
    found = find_levels(current, 0.05 * (way if torque == "ramp" else current))
    assert bool(found.plateaus) == (torque == "steps")


@pytest.mark.parametrize(("noise", "refused"), [(1.0, True), (0.01, False)])
def test_a_current_that_does_not_change_is_refused(noise, refused):
    rng = np.random.default_rng(5)
    current = 0.1 * np.linspace(0, 1, 4000) + noise * rng.standard_normal(4000)
    if refused:
        with pytest.raises(InsufficientDataError, match="step it, or ramp it"):
            find_levels(current, current)
    else:
        assert find_levels(current, current).span == pytest.approx(0.1, rel=0.2)


@pytest.mark.parametrize("way", [20, 30])
def test_slow_changes_are_no_steps(way):
    """The way between plateaus is a quarter of their length at most."""
    plateaus = [(n * (100 + way), n * (100 + way) + 100) for n in range(6)]
    current = np.interp(np.arange(plateaus[-1][1]), np.ravel(plateaus), np.repeat(np.arange(6), 2))
    if way > 25:
        with pytest.raises(InsufficientDataError, match=r"takes 30 samples .* more than 25"):
            stepped(current, plateaus)
    else:
        edges = np.flatnonzero(np.diff(stepped(current, plateaus)))
        middle = [b + way / 2 for _, b in plateaus[:-1]]
        assert np.abs(edges - middle).max() <= 1


def test_a_quarter_of_a_plateau_settles_and_two_samples_stay():
    assert list(settled_parts([(0, 8), (10, 19), (20, 22)])) == [(2, 8), (13, 19), (20, 22)]


def test_levels_within_a_tolerance_are_one():
    level = np.array([0.0, 4.0, 1.001, 0.999, 4.002, 2.0, 0.001])
    expected = [0.0005, 4.001, 1.0, 1.0, 4.001, 2.0, 0.0005]
    np.testing.assert_allclose(common_levels(level), expected, rtol=1e-9)
